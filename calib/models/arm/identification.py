"""Identification of an arm's parameters: Hayati's model by robust least squares, with a rank report.

The six steps of the source: start from the nominal figures; linearise (rows B x = b, eq. 4.65); least squares; correct
the figures; repeat until the step is small; the errors are what was changed. Around that, weights: scatter beyond the
instrument's own is found from the residuals, observations that do not agree are left out.
Source: lecture on the manipulator Jacobian, eqs 4.63-4.65 and steps (1)-(6); counts 4 n + 3 and 4 n + 6 there.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.identify.robust_fit import excess_scatter
from calib.models.arm import error_model, independent_parameters
from calib.models.arm.independent_parameters import Rank
from calib.models.arm.independent_parameters import parameter_rank as independent
from calib.models.arm.instrument_observations import Observations
from rig.arrays import Booleans, Floats
from rig.errors import NotEnoughData, RigError
from rig.model.mechanism_geometry import Arm

MAX_ITERATIONS = 60
CONVERGED = 1e-10  # m and rad; largest step
ROUNDS = 12  # of weighing anew; one that still wavers then stays as it was
SETTLED = 1e-3  # share by which the scatter may still change
GATE = 6.0  # standard deviations beyond which an observation is left out
FARTHEST = 0.1  # m; an owner's model that misses by more is of another arm, or stands elsewhere
LONGEST_STEP = 0.5  # m and rad, of one iteration


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """What a fit of an arm found, p = 12 + 5 n parameters in the order of calib.models.arm.error_model.

    arm : Arm with the fitted geometry, base and tool; covariance : (p, p), 0 where held; free : (p,) bool
    rank : Rank, which columns depend and were held; shared : (j,) draw of the common errors
    residuals : (m, k) what is left, common errors taken out; scatter : (k,) m and rad beyond the instrument's own, per
    component (one figure for positions, one for rotations); inliers : (m,) bool; iterations : steps taken in all
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


def independent_arm_parameters(arm: Arm, kind: str) -> Booleans:
    """(p,) bool: the independent parameters of an arm's structure, 4 n + 6 for poses, 4 n + 3 for positions, 4 n for
    distances, 2 n + 3 for orientations; a slide, of which the direction counts and not the place, has two fewer (see
    calib.models.arm.independent_parameters).

    Axis 1 stands in the base, so theta 1 and d 1 add nothing to it; the last row adds nothing to the tool. Where a
    row's two axes are near parallel, beta takes the place of d (Hayati), for which the common normal's place along them
    is undefined.
    """
    if arm.slides.any() or kind == "orientation":
        return independent_parameters.generally_independent_parameters(arm, kind)
    n = len(arm.joints)
    free = np.ones((n, 5), bool)
    parallel = independent_parameters.near_parallel_axis_rows(arm)
    free[:, 1], free[:, 4] = ~parallel, parallel
    free[0, :2] = False
    free[-1] = False
    base, tool = np.ones(6, bool), np.ones(6, bool)
    if n > 1 and parallel[0]:
        base[2] = False  # the base along axis 1 is d 2 along the parallel axis 2
    if kind != "pose":
        tool[3:] = False
    if kind == "distance":
        base[3:] = False
    return np.concatenate([base, free.ravel(), tool])


def identify_arm(
    observations: Observations, nominal: Arm, free: Booleans | None = None, farthest: float = FARTHEST
) -> Identified:
    """Identified arm: the parameters that explain the observations.

    observations : Observations; nominal : Arm, where the fit starts, its base and tool included (see
        calib.models.arm.instrument_placement)
    free : (p,) bool, the parameters to fit, those of `parameters` by default; farthest : m (orientations: rad), median
        by which nominal may miss
    Raises NotEnoughData for fewer equations than parameters, RigError where nominal is far off or the fit does not
        settle
    """
    free = independent_arm_parameters(nominal, observations.kind) if free is None else np.asarray(free, bool)
    k = observations.residuals(nominal).shape[1]
    require_enough_observations(len(observations), k, int(free.sum()))
    far = np.median(np.linalg.norm(observations.residuals(nominal)[:, :3], axis=1))
    if far > farthest:
        unit = "mrad" if observations.kind == "orientation" else "mm"
        raise RigError(
            f"what was measured is {far * 1e3:.0f} {unit} (median) from where the owner's model has it: are "
            "these the joint angles of "
            'these poses, with these senses and zeros, and is [instrument] base or tool unknown ("free")?'
        )
    inliers, arm, total = np.ones(len(observations), bool), nominal, 0
    scatter = _scatter(
        observations.residuals(nominal), observations, inliers, 0
    )  # cautious weights first, the instrument's when earned
    for _ in range(ROUNDS):
        arm, rank, fit, iterations = _settle(observations, arm, free, inliers, scatter)
        total += iterations
        new_scatter = _scatter(fit.left, observations, inliers, rank.free.sum())
        new_inliers = _inliers(fit.left, observations, new_scatter)
        if k * new_inliers.sum() <= free.sum():
            raise NotEnoughData(f"only {new_inliers.sum()} of {len(observations)} observations agree with one geometry")
        if (new_inliers == inliers).all() and np.allclose(new_scatter, scatter, rtol=SETTLED, atol=1e-12):
            break
        inliers, scatter = new_inliers, new_scatter
    covariance = np.zeros((len(free), len(free)))
    covariance[np.ix_(rank.free, rank.free)] = fit.covariance
    return Identified(arm, covariance, rank.free, rank, fit.shared, fit.left, scatter, inliers, total)


def require_enough_observations(count: int, numbers_each: int, parameter_count: int) -> None:
    """Raise NotEnoughData where `count` observations are not enough for the parameters, with how many it takes."""
    if numbers_each * count <= parameter_count:
        raise NotEnoughData(
            f"{count} observations give {numbers_each * count} equations, too few for {parameter_count} "
            "parameters; it takes "
            f"{parameter_count // numbers_each + 1} different "
            f"poses at the least, better {3 * (parameter_count // numbers_each + 1)}"
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


def _settle(observations: Observations, arm: Arm, free: Booleans, inliers: Booleans, scatter: Floats) -> _Settled:
    """Gauss-Newton for given weights."""
    W = np.linalg.inv(np.linalg.cholesky(observations.covariance + np.diag(scatter**2)))[inliers]
    J = observations.jacobian(arm)
    B = W @ J[inliers]
    rank = independent(
        B.reshape(-1, B.shape[-1]), free, error_model.parameter_names(arm), error_model.parameter_units(arm)
    )
    for iteration in range(MAX_ITERATIONS):
        J = observations.jacobian(arm) if iteration else J
        fit = _solve(observations.residuals(arm), J[..., rank.free], observations.common, W, inliers)
        step = np.zeros(len(free))
        step[rank.free] = fit.step / max(1.0, np.abs(fit.step).max() / LONGEST_STEP)
        arm = error_model.arm_with_parameter_step(arm, step)
        if np.abs(step).max() < CONVERGED:
            return _Settled(arm, rank, fit, iteration + 1)
    raise RigError(
        f"the arm's parameters did not settle in {MAX_ITERATIONS} steps (last step {np.abs(step).max():.3g} m or rad): "
        "are the joint angles those of these poses, and is [mechanism] joints near the truth?"
    )


def _solve(r: Floats, J: Floats, common: Floats, W: Floats, inliers: Booleans) -> _Fit:
    """One weighted least squares, the common errors solved for with the parameters."""
    count = common.shape[2]
    M = (W @ np.concatenate([J, common], axis=2)[inliers]).reshape(-1, J.shape[2] + count)
    prior = np.zeros((count, J.shape[2] + count))
    prior[:, J.shape[2] :] = np.eye(count)
    right = np.concatenate([(W @ r[inliers][..., None]).ravel(), np.zeros(count)])
    stacked = np.concatenate([M, prior])
    scale = np.linalg.norm(stacked, axis=0)
    Q, R = np.linalg.qr(stacked / scale)
    solution = np.linalg.solve(R, Q.T @ right) / scale
    half = np.linalg.inv(R) / scale[:, None]
    shared = solution[J.shape[2] :]
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
