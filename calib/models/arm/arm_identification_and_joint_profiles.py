"""Identification of an arm's parameters, and joint profiles.

By robust least squares; profiles are of the errors of its joints.

The six steps of the source: start from the nominal figures; linearise (rows B x = b, eq. 4.65); least squares; correct
the figures; repeat until the step is small; the errors are what was changed. Around that, weights: scatter beyond the
instrument's own is found from the residuals, observations that do not agree are left out.
Source: lecture on the manipulator Jacobian, eqs 4.63-4.65 and steps (1)-(6); counts 4 n + 3 and 4 n + 6 there.

Of a slide a metre stands for a radian, and 2 pi metres for a turn.
A joint's real angle differs from its command by gears, encoder and the load that its posture brings. The summand
rho_j(q) = commanded - effective is a series in the joint's own angle, as fine as the poses can tell (an encoder's error
has tens of waves a turn), and, more weakly, in its neighbours'. How large each octave of waves is, is found by the
evidence, and one that does not stand out is left out.
Sources: configuration-space patent [0024]-[0031] (the summand); MacKay, Bayesian interpolation, Neural Computation 1992
(sizes by the evidence).
"""

from dataclasses import dataclass
from typing import NamedTuple, cast

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs

from calib.identify.bounded_and_robust_least_squares_fit import excess_scatter
from calib.models.arm import arm_error_model_and_instrument_observations
from calib.models.arm.arm_error_model_and_instrument_observations import Observations, Rank
from calib.models.arm.arm_error_model_and_instrument_observations import parameter_rank as independent
from calib.models.arm.tilt_observations import (
    TiltRows,
    TiltWeights,
    link_rotation_jacobian_by_parameters,
    tilt_equation_rows,
)
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.errors import NotEnoughData, RigError
from rig.model.mechanism_geometry_classes import Arm

MAX_ITERATIONS = 60
CONVERGED = 1e-10  # m and rad; largest step
ROUNDS = 12  # of weighing anew; one that still wavers then remains unchanged
SETTLED = 1e-3  # share by which the scatter may still change
GATE = 6.0  # standard deviations beyond which an observation is left out
FARTHEST = 0.1  # m; an nominal model that misses by more is of another arm, or stands elsewhere
LONGEST_STEP = 0.5  # m and rad, of one iteration


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """What a fit of an arm found, p = 12 + 5 n parameters in the order of
    calib.models.arm.arm_error_model_and_instrument_observations.

    arm : Arm with the fitted geometry, base and tool; covariance : (p, p), 0 where held; free : (p,) bool
    rank : Rank, which columns depend and were held; shared : (j,) draw of the common errors
    residuals : (m, k) what is left, common errors taken out; scatter : (k,) m and rad beyond the instrument's own, per
    component (one figure for positions, one for rotations); inliers : (m,) bool; iterations : steps taken in all
    tilts : TiltWeights of the tilt sensors' readings, None without
    """

    arm: Arm
    covariance: Floats
    free: Booleans
    rank: Rank
    shared: Floats
    residuals: Floats
    scatter: Floats
    inliers: Booleans
    iterations: int
    tilts: TiltWeights | None = None


def independent_arm_parameter_mask(arm: Arm, observation_kind: str) -> Booleans:
    """Mask (p,) of an arm's parameters that are independent, for a kind of observation.

    4 n + 6 for poses, 4 n + 3 for positions, 4 n for distances, 2 n + 3 for orientations; a slide, of which the
    direction counts and not the place, has two fewer (see
    calib.models.arm.arm_error_model_and_instrument_observations). Axis 1 stands in the base, so theta 1 and d 1 add
    nothing to it; the last row adds nothing to the tool. Where a row's two axes are near parallel, beta takes the
    place of d (Hayati), for which the common normal's place along them is undefined.
    """
    if arm.slides.any() or arm.hands or arm.couplings or observation_kind in ("orientation", "direction"):
        return arm_error_model_and_instrument_observations.generally_independent_parameters(arm, observation_kind)
    n = len(arm.joints)
    free = np.ones((n, 5), bool)
    parallel = arm_error_model_and_instrument_observations.is_next_axis_near_parallel(arm)
    free[:, 1], free[:, 4] = ~parallel, parallel
    free[0, :2] = False
    free[-1] = False
    base, tool = np.ones(6, bool), np.ones(6, bool)
    if n > 1 and parallel[0]:
        base[2] = False  # the base along axis 1 is d 2 along the parallel axis 2
    if observation_kind != "pose":
        tool[3:] = False
    if observation_kind == "distance":
        base[3:] = False
    return np.concatenate([base, free.ravel(), tool])


def identify_arm(
    observations: Observations, nominal: Arm, free: Booleans | None = None, largest_median_error: float = FARTHEST
) -> Identified:
    """Identified arm: the parameters that explain the observations.

    observations : Observations; nominal : Arm, where the fit starts, its base and tool included (see
        calib.models.arm.arm_base_and_tool_placement_in_instrument_frame)
    free : (p,) bool, the parameters to fit, those of `parameters` by default; largest_median_error : m (orientations:
        rad), median by which nominal may miss
    Raises NotEnoughData for fewer equations than parameters, RigError where nominal is far off or the fit does not
        settle
    """
    free = independent_arm_parameter_mask(nominal, observations.kind) if free is None else np.asarray(free, bool)
    k = observations.residuals(nominal).shape[1]
    require_enough_observations(len(observations), k, int(free.sum()))
    far = np.median(np.linalg.norm(observations.residuals(nominal)[:, :3], axis=1))
    if far > largest_median_error:
        unit = "mrad" if observations.kind in ("orientation", "direction") else "mm"
        raise RigError(
            f"what was measured is {far * 1e3:.0f} {unit} (median) from where the nominal model has it: are "
            "these the joint angles of "
            'these poses, with these signs and zeros, and is [instrument] base or tool unknown ("free")?'
        )
    inliers, arm, total = np.ones(len(observations), bool), nominal, 0
    scatter = _scatter(
        observations.residuals(nominal), observations, inliers, 0
    )  # cautious weights first, the instrument's when earned
    tilts = _tilt_weights(observations, arm, 0)
    for _ in range(ROUNDS):
        arm, rank, fit, iterations = _settle(observations, arm, free, inliers, scatter, tilts)
        total += iterations
        tilts = _tilt_weights(observations, arm, int(rank.free.sum()))
        new_scatter = _scatter(fit.left, observations, inliers, rank.free.sum())
        new_inliers = _inliers(fit.left, observations, new_scatter)
        if k * new_inliers.sum() <= free.sum():
            raise NotEnoughData(f"only {new_inliers.sum()} of {len(observations)} observations agree with one geometry")
        if (new_inliers == inliers).all() and np.allclose(new_scatter, scatter, rtol=SETTLED, atol=1e-12):
            break
        inliers, scatter = new_inliers, new_scatter
    covariance = np.zeros((len(free), len(free)))
    covariance[np.ix_(rank.free, rank.free)] = fit.covariance
    return Identified(arm, covariance, rank.free, rank, fit.shared, fit.left, scatter, inliers, total, tilts)


def _tilt_weights(observations: Observations, arm: Arm, fitted: int) -> TiltWeights | None:
    """TiltWeights of tilt sensors' readings by what an arm leaves of them, `fitted` numbers fitted to all; or None."""
    if observations.tilts is None:
        return None
    rows = tilt_equation_rows(observations.tilts, observations.q, arm)
    numbers = rows.residuals.size + observations.covariance.shape[1] * len(observations)
    return rows.weights((fitted + len(rows.mounting)) / numbers)


def whitened_tilt_rows_and_columns(
    observations: Observations, arm: Arm, weights: TiltWeights
) -> tuple[TiltRows, Floats]:
    """TiltRows and whitened columns of the tilt sensors.

    Returns (TiltRows, columns (r, p) of the arm's parameters) of the sensors beside observations
    """
    assert observations.tilts is not None
    rows = tilt_equation_rows(observations.tilts, observations.q, arm)
    J = arm_error_model_and_instrument_observations.parameter_jacobian(observations.q, arm)
    turned = link_rotation_jacobian_by_parameters(observations.tilts, observations.q, arm, J)
    return rows, rows.whitened_columns(weights, turned)


def require_enough_observations(count: int, numbers_each: int, parameter_count: int) -> None:
    """Raise NotEnoughData where `count` observations are not enough.

    The error says how many the parameters take.
    """
    if numbers_each * count <= parameter_count:
        raise NotEnoughData(
            f"{count} observations give {numbers_each * count} equations, too few for {parameter_count} "
            "parameters; minimum "
            f"{parameter_count // numbers_each + 1} different "
            f"poses, better {3 * (parameter_count // numbers_each + 1)}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    step: Floats
    shared: Floats
    covariance: Floats
    left: Floats


class _Settled(NamedTuple):
    """arm : Arm; rank : Rank; fit : the last linear solve; iterations : steps taken."""

    arm: Arm
    rank: Rank
    fit: _Fit
    iterations: int


def _settle(
    observations: Observations, arm: Arm, free: Booleans, inliers: Booleans, scatter: Floats, tilts: TiltWeights | None
) -> _Settled:
    """Gauss-Newton for given weights."""
    W = np.linalg.inv(np.linalg.cholesky(observations.covariance + np.diag(scatter**2)))[inliers]
    J = observations.jacobian(arm)
    B = W @ J[inliers]
    tilt_columns = None if tilts is None else whitened_tilt_rows_and_columns(observations, arm, tilts)
    rank = independent(
        _with_tilt_columns(B.reshape(-1, B.shape[-1]), tilt_columns, tilts),
        free,
        arm_error_model_and_instrument_observations.parameter_names(arm),
        arm_error_model_and_instrument_observations.parameter_units(arm),
    )
    for iteration in range(MAX_ITERATIONS):
        if iteration:
            J = observations.jacobian(arm)
            tilt_columns = None if tilts is None else whitened_tilt_rows_and_columns(observations, arm, tilts)
        below = None
        if tilt_columns is not None and tilts is not None:
            rows, columns = tilt_columns
            below = (columns[:, rank.free], rows.whitened_mounting(tilts), rows.whitened_residuals(tilts))
        fit = _solve(observations.residuals(arm), J[..., rank.free], observations.common, W, inliers, below)
        step = np.zeros(len(free))
        step[rank.free] = fit.step / max(1.0, np.abs(fit.step).max() / LONGEST_STEP)
        arm = arm_error_model_and_instrument_observations.arm_with_parameter_step(arm, step)
        if np.abs(step).max() < CONVERGED:
            return _Settled(arm, rank, fit, iteration + 1)
    raise RigError(
        f"the arm's parameters did not settle in {MAX_ITERATIONS} steps (last step {np.abs(step).max():.3g} m or rad): "
        "are the joint angles those of these poses, and is [mechanism] joints near the truth?"
    )


def _with_tilt_columns(B: Floats, tilt_columns: tuple[TiltRows, Floats] | None, tilts: TiltWeights | None) -> Floats:
    """Whitened columns (rows, p) of the parameters with those that tilt sensors add, their mounting projected out."""
    if tilt_columns is None or tilts is None:
        return B
    Q = np.linalg.qr(tilt_columns[0].whitened_mounting(tilts))[0]
    return np.concatenate([B, tilt_columns[1] - Q @ (Q.T @ tilt_columns[1])])


def _solve(
    r: Floats,
    J: Floats,
    common: Floats,
    W: Floats,
    inliers: Booleans,
    below: tuple[Floats, Floats, Floats] | None = None,
) -> _Fit:
    """One weighted least squares, the common errors solved for with the parameters.

    below : (columns (r, p), nuisances (r, c), residuals (r,)), whitened, of what else was observed, or None
    """
    count = common.shape[2]
    M = (W @ np.concatenate([J, common], axis=2)[inliers]).reshape(-1, J.shape[2] + count)
    prior = np.zeros((count, J.shape[2] + count))
    prior[:, J.shape[2] :] = np.eye(count)
    right = np.concatenate([(W @ r[inliers][..., None]).ravel(), np.zeros(count)])
    stacked = np.concatenate([M, prior])
    if below is not None:
        columns, nuisances, more = below
        lower = np.concatenate([columns, np.zeros((len(more), count)), nuisances], axis=1)
        stacked = np.concatenate([np.pad(stacked, ((0, 0), (0, nuisances.shape[1]))), lower])
        right = np.concatenate([right, more])
    scale = np.linalg.norm(stacked, axis=0)
    Q, R = np.linalg.qr(stacked / scale)
    solution = np.linalg.solve(R, Q.T @ right) / scale
    half = np.linalg.inv(R) / scale[:, None]
    shared = solution[J.shape[2] : J.shape[2] + count]
    left = r - np.einsum("mki,i->mk", J, solution[: J.shape[2]]) - np.einsum("mkj,j->mk", common, shared)
    return _Fit(solution[: J.shape[2]], shared, (half @ half.T)[: J.shape[2], : J.shape[2]], left)


def _scatter(left: Floats, observations: Observations, inliers: Booleans, fitted: int) -> Floats:
    """(k,) scatter beyond the instrument's own: one figure for the three positions, one for the three rotations."""
    return excess_scatter(
        left[inliers], observations.covariance[inliers], min(fitted / (inliers.sum() * left.shape[1]), 0.9)
    )


def _inliers(left: Floats, observations: Observations, scatter: Floats) -> Floats:
    sigma = np.sqrt(np.einsum("mkk->mk", observations.covariance) + scatter**2)
    scale = np.maximum(1.0, 1.4826 * np.median(np.abs(left / sigma), axis=0))
    return (np.abs(left) < GATE * scale * sigma).all(axis=1)


FINEST = 45.0  # waves per turn of the joint; shorter ones are left out
MARGIN = 1.15  # of the joint's travel, half the longest wave: so the ends need not meet
SHARE = 0.1  # of the measured numbers, as many as there may be features
OCTAVES = (0.0, 1.5, 3.0, 6.0, 12.0, 24.0, np.inf)  # waves per turn; each has a size of its own
START = 1e-4  # rad; size of a part before the data speak
PROFILE_ROUNDS = 40
LARGEST = 2e-4  # rad; where a joint hardly moves, a larger part is geometry in disguise and goes astray outside
SMALLEST = 3e-6  # rad; a part that shrinks below is nothing
PROFILE_SETTLED = 3e-2


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """rho of one joint. axis : its index; orders : (k,) waves per turn of its own angle; own : (2 k,) rad, their sines,
    then cosines
    others : (n, 2) rad, sine and cosine of every joint's angle (its own row is 0)."""

    axis: int
    orders: Floats
    own: Floats
    others: Floats

    def __call__(self, q: Floats) -> Floats:
        """(...,) rad at joint angles q (..., n) rad."""
        q = np.asarray(q, float)
        return (
            _waves(q[..., self.axis], self.orders) @ self.own
            + np.sin(q) @ self.others[:, 0]
            + np.cos(q) @ self.others[:, 1]
        )


def fit_joint_profiles(observations: Observations, identified: Identified) -> tuple[Profile | None, ...]:
    """Joint profiles fitted to residuals of an Identified arm.

    A Profile or None per joint.

    The geometry's own freedoms are solved for beside the profiles and thrown away, so that neither takes the other's
    part.
    """
    good = identified.inliers
    q, n = observations.q[good], observations.q.shape[1]
    W = np.linalg.inv(np.linalg.cholesky(observations.covariance[good] + np.diag(identified.scatter**2)))
    y = (W @ identified.residuals[good][..., None]).ravel()
    orders = [_orders(q[:, j], SHARE * len(y) / n) for j in range(n)]
    features = [-_features(q, j, orders[j]) for j in range(n)]
    J = W @ observations.joint_jacobian(identified.arm)[good]
    A = np.concatenate([(J[..., j : j + 1] * features[j][:, None, :]).reshape(len(y), -1) for j in range(n)], axis=1)
    kinds = len(OCTAVES) + 1
    group = np.concatenate(
        [j * kinds + np.r_[np.tile(np.digitize(orders[j], OCTAVES), 2), np.zeros(2 * (n - 1), int)] for j in range(n)]
    )
    B = (W @ observations.jacobian(identified.arm)[good][..., identified.free]).reshape(len(y), -1)
    Q = np.linalg.qr(B)[0]
    A, y = A - Q @ (Q.T @ A), y - Q @ (Q.T @ y)
    weights = _evidence(A, y, np.unique(group, return_inverse=True)[1])
    parts = []
    for j, w in enumerate(np.split(weights, np.cumsum([f.shape[1] for f in features])[:-1])):
        k = 2 * len(orders[j])
        others = np.zeros((n, 2))
        others[np.arange(n) != j] = w[k:].reshape(-1, 2)
        parts.append(Profile(j, orders[j], w[:k], others) if w.any() else None)
    return tuple(parts)


def _orders(angle: Floats, most: float) -> Floats:
    """(k,) waves per turn, evenly from the longest that the joint's travel tells, at most `most` features of them."""
    step = np.pi / (MARGIN * max(np.ptp(angle), np.pi / FINEST))
    return cast(Floats, step * np.arange(1, max(min(int(FINEST / step), int(most / 2)), 1) + 1))


def _waves(angle: Floats, orders: Floats) -> Floats:
    turned = np.asarray(angle)[..., None] * orders
    return np.concatenate([np.sin(turned), np.cos(turned)], axis=-1)


def _features(q: Floats, axis: int, orders: Floats) -> Floats:
    """(m, 2 k + 2 (n - 1)) waves of the own angle, then sine and cosine of the other angles."""
    rest = np.delete(q, axis, axis=1)
    return np.concatenate(
        [_waves(q[:, axis], orders), np.stack([np.sin(rest), np.cos(rest)], axis=-1).reshape(len(q), -1)], axis=1
    )


def _solved(M: Floats, right: Floats) -> tuple[Floats, Floats]:
    """(M^-1 right, diagonal of M^-1), both (k,), of a positive definite M (k, k). Raises LinAlgError where it is
    none.
    """
    half, failed = dpotrf(M)  # upper; its lower triangle is zero
    if failed:
        raise np.linalg.LinAlgError(f"the matrix of {len(M)} weights is not positive definite")
    w, _ = dpotrs(half, right)
    inverse, _ = dpotri(half)
    return w, np.diag(inverse)


def _evidence(A: Floats, y: Floats, group: Integers) -> Floats:
    """(features,) weights of greatest evidence: each group's size set by the fixed point of its well-determined
    share.
    """
    H, right = A.T @ A, A.T @ y
    size = np.full(group.max() + 1, START)
    for _ in range(PROFILE_ROUNDS):
        alive = size[group] > 0
        prior = 1 / size[group][alive] ** 2
        w, known = np.zeros(len(group)), np.zeros(len(group))
        w[alive], variances = _solved(H[np.ix_(alive, alive)] + np.diag(prior), right[alive])
        known[alive] = 1 - prior * variances
        before = size.copy()
        for g in np.flatnonzero(size):
            share = known[group == g].sum()
            size[g] = min(np.sqrt((w[group == g] ** 2).sum() / max(share, 1e-12)), LARGEST)
            if size[g] < SMALLEST or share < 1e-3:
                size[g] = 0.0
        if not size.any() or np.allclose(size, before, rtol=PROFILE_SETTLED):
            break
    return np.where(size[group] > 0, w, 0.0)
