"""Least squares with bounds, and robust fits.

In square-root information form; outliers and excess scatter.

Over blocks of observations; folds of time blocks, for fits that leave some out.
A problem hands over whitened residuals and their derivatives, block by block (a block: a pose, a configuration of an
arm). What all blocks share (the cameras' errors, say) is estimated beside the parameters and then marginalised.
Source: Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, ch. IV and V.

In a robust fit, all that may be smooth is first fitted by weights that fall to nothing with the residual (Tukey's
biweight, from the start that Huber's weights reach), so that no wild row hides itself or another. A short event is not
wild: the row before or after it, or one at nearly the same configuration, shows the same. Source: Maronna, Martin and
Yohai, Robust statistics, 2006, ch. 5.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from scipy.linalg import null_space, qr, solve_triangular
from scipy.spatial import cKDTree
from scipy.special import chdtri

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.errors import NotEnoughData, RigError

NULL = 1e-11  # of the greatest eigenvalue; directions below are not stepped along


def bounded_step_and_covariance(
    b: Floats, G: Floats, values: Floats, bounds: Floats, preserved_sums: Floats
) -> tuple[Floats, Floats]:
    """Least-squares step within bounds that keeps some sums of the values, and its covariance.

    b : (c,) gradient; G : (c, c) information, priors included in both; bounds : (c, 2) bounds; preserved_sums : (k, c)
        sums that the step must not change
    Returns (step (c,), covariance (c, c), which ignores the bounds)
    """
    low, high = bounds.T
    step, covariance = _solved(b, G, preserved_sums)
    held = np.zeros(len(step), bool)
    for _ in range(len(step)):
        over = ~held & ((values + step < low) | (values + step > high))
        if not over.any():
            break
        held |= over
        step[held] = np.clip(values + step, low, high)[held] - values[held]
        step[~held] = _solved(
            b[~held] - G[np.ix_(~held, held)] @ step[held], G[np.ix_(~held, ~held)], preserved_sums[:, ~held]
        )[0]
    return step, covariance


def _solved(b: Floats, G: Floats, sums: Floats) -> tuple[Floats, Floats]:
    """(G^-1 b, G^-1) in the directions that anything sees and that keep sums (k, c)."""
    if not len(b):
        return np.zeros(0), np.zeros((0, 0))
    scale = np.sqrt(np.maximum(np.diag(G), 1e-300))
    scaled = G / scale[:, None] / scale
    sums = sums[sums.any(axis=1)]
    along = null_space(sums / scale) if len(sums) else None
    values, vectors = np.linalg.eigh(scaled if along is None else along.T @ scaled @ along)
    determined = values > NULL * max(values.max(initial=0.0), 1e-300)  # none where every direction changes a sum
    half = vectors[:, determined] / np.sqrt(values[determined])
    half = (half if along is None else along @ half) / scale[:, None]
    return half @ (half.T @ b), half @ half.T


MAX_ITERATIONS = 30
CHUNK = 2048  # rows reduced at a time, so that the work stays in the cache
SETTLED = 1e-5  # standard deviations; the length of the last step, all parameters together
ROUNDED = (
    1e-3  # standard deviations; a step so short that is no shorter than half the last one is the residuals' rounding
)
GATE = 1e-9  # share of honest blocks that lie beyond and are lost


@dataclass(frozen=True, slots=True, eq=False)
class Linear:
    """A problem at some parameters, whitened: its noise has unit covariance.

    residual : (n, m) measured less predicted; jacobian : (n, m, k) of what is predicted with the parameters
    common : (n, m, c) what one draw z ~ N(0, I), shared by all blocks, adds to the measured: residual = jacobian dp +
        common z + noise
    """

    residual: Floats
    jacobian: Floats
    common: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The optimum and what is known of it.

    parameters : (k,); covariance : (k, k), prior included; shared : (c,) the draw that the blocks share
    root : (k, k) upper triangular, square root of the information in the data alone: root.T @ root
    residual : (n, m) whitened, shared errors taken out; inliers : (n,) bool; cost : of data, shared draw and prior
    iterations : how many it took
    """

    parameters: Floats
    covariance: Floats
    shared: Floats
    root: Floats
    residual: Floats
    inliers: Booleans
    cost: float
    iterations: int


def fit_least_squares(
    linearise: Callable[[Floats], Linear],
    start: Floats,
    mean: Floats,
    sigma: Floats,
    inliers: Booleans | None = None,
    robust: bool = False,
) -> Fit:
    """Least-squares fit.

    It is by Gauss-Newton, docs/mathematics.md (7).
    linearise : function of parameters (k,) -> Linear; start : (k,); mean, sigma : (k,) the prior, sigma infinite where
        there is none
    inliers : (n,) bool blocks to use, or None for all; robust : whether blocks that disagree are sorted out, in rounds
    Returns Fit. Raises NotEnoughData where the data and prior leave a direction open, RigError where the steps do not
        settle.
    """
    p, mean, weight = np.array(start, float), np.asarray(mean, float), 1 / np.asarray(sigma, float)
    linear = linearise(p)
    used, last = np.ones(len(linear.residual), bool) if inliers is None else inliers, np.inf
    for iteration in range(1, MAX_ITERATIONS + 1):
        data = _triangle(linear, used)
        step = _step(data, linear.common.shape[2], weight, mean - p)
        p = p + step.parameters
        linear = linearise(p)
        length, before = float(np.linalg.norm(step.root @ step.parameters)), last
        last = length
        if length > SETTLED and not before / 2 < length < ROUNDED:
            continue
        left = linear.residual - linear.common @ step.shared
        retained = _agreeing(left, used) if robust else used
        if (retained == used).all():
            half = solve_triangular(step.root, np.eye(len(step.root)))
            c = linear.common.shape[2]
            return Fit(p, half @ half.T, step.shared, data[c:-1, c:-1], left, used, step.cost, iteration)
        used = retained
    raise RigError(
        f"the least squares did not settle in {MAX_ITERATIONS} iterations: the last step was {last:.3g} sigma"
    )


def _triangle(linear: Linear, inliers: Booleans) -> Floats:
    """(c + k + 1,) square upper triangle of [common, jacobian, residual], the shared draw's prior included."""
    rows = np.concatenate([linear.common, linear.jacobian, linear.residual[..., None]], axis=2)
    c, width = linear.common.shape[2], rows.shape[2]
    return _r(np.concatenate([rows[inliers].reshape(-1, width), np.eye(c, width)]), width)


def _r(rows: Floats, width: int) -> Floats:
    """Upper triangle (width, width) of the QR factorisation of rows, with zeros below where there are fewer rows."""
    if len(rows) > 2 * CHUNK:
        rows = np.concatenate(
            [np.asarray(np.linalg.qr(rows[at : at + CHUNK], mode="r")) for at in range(0, len(rows), CHUNK)]
        )
    R = np.asarray(np.linalg.qr(rows, mode="r"))
    return R if len(R) == width else np.concatenate([R, np.zeros((width - len(R), width))])


class _Step(NamedTuple):
    """parameters : (k,); shared : (c,) draw; root : (k, k) square root of the information with the prior; cost : at the
    step's end.
    """

    parameters: Floats
    shared: Floats
    root: Floats
    cost: float


def _step(data: Floats, c: int, weight: Floats, to_mean: Floats) -> _Step:
    """The step that the triangle of the data and the prior, of weight (k,) and to_mean (k,) away, ask for together."""
    held = np.isfinite(weight) & (weight > 0)
    prior = np.concatenate([np.zeros((held.sum(), c)), np.diag(weight)[held], (weight * to_mean)[held, None]], axis=1)
    R = _r(np.concatenate([data, prior]), data.shape[1])
    root, right = R[c:-1, c:-1], R[c:-1, -1]
    size = np.abs(np.diag(root))
    if not size.min() > 1e-13 * size.max():
        missing = int((size <= 1e-13 * size.max()).sum())
        raise NotEnoughData(f"the observations leave {missing} of {len(size)} directions open, and no prior holds them")
    step = solve_triangular(root, right)
    z = solve_triangular(R[:c, :c], R[:c, -1] - R[:c, c:-1] @ step) if c else np.zeros(0)
    return _Step(step, z, root, float(R[-1, -1] ** 2))


def _agreeing(left: Floats, inliers: Booleans) -> Booleans:
    """(n,) bool, the blocks whose residual (n, m) is no larger than the others' scale makes likely."""
    square, m = (left**2).sum(axis=1), left.shape[1]
    scale = max(1.0, float(np.median(square[inliers])) / scipy.special.chdtri(m, 0.5))
    return square < scale * scipy.special.chdtri(m, GATE)


@dataclass(frozen=True, slots=True, eq=False)
class Visibility:
    """What data tell of parameters, each measured in the size that it plausibly has.

    singular : (j,) descending; 1 / singular is the standard error, in plausible sizes, along directions (j, k), a row
        each
    condition : greatest over smallest; parameters : covariance-ordered permutation, the best determined first
    """

    singular: Floats
    directions: Floats
    condition: float
    order: Floats


def parameter_visibility(information_root: Floats, plausible_size: Floats) -> Visibility:
    """Visibility of parameters from the square root of their information.

    information_root : (j, k); plausible_size : (k,) plausible sizes
    """
    _, s, directions = np.linalg.svd(information_root * plausible_size, full_matrices=False)
    order = qr(information_root * plausible_size, mode="r", pivoting=True)[1]
    return Visibility(s, directions, float(s[0] / s[-1]) if s[-1] > 0 else np.inf, order)


CONSISTENT = 1.4826  # times the median of absolute residuals: the standard deviation of normal ones
HUBER, TUKEY = 1.5, 6.0  # standard deviations: of the weights at first, and from which a row counts for nothing
ROUNDS = (12, 60)  # of Huber's weights, and the first number of Tukey's
ALIKE = 0.5  # of a row's residual, by which its neighbour's may differ and still show the same
IN_TIME, IN_PLACE = 2, 6  # neighbours either way in time, and in configuration
MOST = 0.1  # share of rows that may be wild; where more are far off, the model is incomplete
TAIL = 0.9  # share of rows, by the greatest of which a tail is measured
GROSS = 10.0  # times the gate, from which a row may be wild in one number alone
FIRM = 1e-8  # share of a column's square that is added to it, so that columns that repeat one another can be solved for


@dataclass(frozen=True, slots=True, eq=False)
class Robust:
    """What a robust fit leaves. residual : (n, k) as given; scale : (k,) its scatter, by its middle"""

    residual: Floats
    scale: Floats

    @property
    def relative(self) -> Floats:
        """(n, k) residual over its scatter."""
        return self.residual / self.scale


def robust_fit(parts: Sequence[tuple[Floats, Floats]]) -> Robust:
    """Robust fit of parts [(residual (n, k), columns (n, k, p))], whitened.

    A row has one weight in all parts. Of the fits that few and that many rounds of Huber's weights lead to, the one
    that leaves fewer rows out: gross rows that few others hold in place are let go slowly, and others too fast.
    """
    fits = [_reweighted_fit(parts, ROUNDS[0])]
    if _rows_left_out(fits[0]):
        fits.append(_reweighted_fit(parts, ROUNDS[1]))
    return min(fits, key=_rows_left_out)


def _rows_left_out(fit: Robust) -> int:
    return int((np.abs(fit.relative).max(axis=1) > TUKEY).sum())


def _reweighted_fit(parts: Sequence[tuple[Floats, Floats]], rounds: int) -> Robust:
    n = len(parts[0][0])
    free = [1 - min(columns.shape[2] / max(n * columns.shape[1], 1), 0.8) for _, columns in parts]
    stated = np.concatenate([np.full(residual.shape[1], 1 / np.sqrt(part)) for (residual, _), part in zip(parts, free)])
    weight = np.ones(n)
    for weigh, turns in ((_huber_weight, rounds), (_tukey_weight, ROUNDS[0])):
        for _ in range(turns):
            left = np.concatenate([_left(residual, columns, weight) for residual, columns in parts], axis=1)
            scale = np.maximum(stated * CONSISTENT * np.median(np.abs(left), axis=0), 1e-300)
            weight = weigh(np.abs(left / scale).max(axis=1))
    return Robust(left, scale)


def _huber_weight(far: Floats) -> Floats:
    return np.minimum(1.0, HUBER / np.maximum(far, 1e-12))


def _tukey_weight(far: Floats) -> Floats:
    return np.asarray((1 - np.minimum(far / TUKEY, 1.0) ** 2) ** 2)


def _left(residual: Floats, columns: Floats, weight: Floats) -> Floats:
    """(n, k) residual less columns (n, k, p) at their best for weights (n,)."""
    p = columns.shape[2]
    if not p:
        return residual
    flat, y = columns.reshape(-1, p), residual.reshape(-1)
    weighted = np.repeat(weight, residual.shape[1])[:, None] * flat
    gram = weighted.T @ flat
    gram[np.diag_indices(p)] += FIRM * np.maximum((flat**2).sum(axis=0), 1e-300)
    return residual - (flat @ np.linalg.solve(gram, weighted.T @ y)).reshape(residual.shape)


def isolated_outlier_rows(scaled_residuals: Floats, t: Floats, q: Floats, gate: float) -> Booleans:
    """Whether rows (n,) are isolated outliers.

    Beyond the gate while no neighbour is.
    scaled_residuals : (n, k) residuals over their scatter; t : (n,) s; q : (n, axes) where rows stand
    gate : where what is left is normal; where its tail is longer, as what is left out of a model has it, by as much
        more
    """
    far = np.abs(scaled_residuals).max(axis=1)
    far = far > gate * tail_quantile_ratio_to_normal_within_gate(scaled_residuals, gate)
    if not far.any():
        return far
    order = np.argsort(t, kind="stable")
    place = np.argsort(order)
    at = q / np.maximum(q.std(axis=0), 1e-12)
    near = cKDTree(at).query(at[far], k=min(IN_PLACE + 1, len(at)))[1].reshape(int(far.sum()), -1)
    out = far.copy()
    for i, places in zip(np.flatnonzero(far).tolist(), near):
        times = order[max(place[i] - IN_TIME, 0) : place[i] + IN_TIME + 1]
        others = np.setdiff1d(np.concatenate([times, places]), [i])
        apart = np.linalg.norm(scaled_residuals[others] - scaled_residuals[i], axis=1)
        out[i] = not (apart < ALIKE * np.linalg.norm(scaled_residuals[i])).any()
    return out


def tail_quantile_ratio_to_normal_within_gate(scaled_residuals: Floats, gate: float) -> float:
    """Ratio of the tail length of rows (n, k) within a gate to a normal one's.

    1 at the least.
    """
    size = np.abs(scaled_residuals).max(axis=1)
    near = size[size <= gate]
    usual = scipy.special.ndtri((1 + TAIL ** (1 / scaled_residuals.shape[1])) / 2)
    return max(1.0, float(np.quantile(near, TAIL) / usual)) if len(near) else 1.0


def rows_with_several_deviating_or_one_gross_number(scaled_residuals: Floats, gate: float) -> Booleans:
    """Whether a row (n,) has several deviating numbers, or one gross one.

    Several are what a wrong pose has.
    scaled_residuals : (n, k) residuals over their scatter; gate : of the greatest; half of it counts as far off in the
        second
    """
    size = np.sort(np.abs(scaled_residuals), axis=1)
    return np.asarray((size[:, -1] > gate) & (size[:, -2] > gate / 2) | (size[:, -1] > GROSS * gate))


MIDDLE = float(chdtri(3, 0.5))  # of the squared length of three normal numbers
FAR = 1e-3  # chance of a length beyond which a pose counts less
EXCESS = 3.0  # standard errors by which scatter must exceed the instrument's own before it counts


def excess_scatter(residuals: Floats, instrument_covariance: Floats, fitted_share: float | Floats = 0.0) -> Floats:
    """Excess scatter (k,) m and rad beyond the instrument's own.

    One figure for positions, one for rotations.
    residuals : (m, k) residuals, m and rad; instrument_covariance : (m, k, k) the instrument's covariance;
    fitted_share : of the squares, what the fit took away, one figure or one for positions and one for rotations
    """
    out = np.zeros(residuals.shape[1])
    for part, fitted in zip((slice(0, 3), slice(3, 6)), np.broadcast_to(fitted_share, 2)):
        if residuals[:, part].size:
            length, stated = (
                (residuals[:, part] ** 2).sum(axis=1),
                float(np.einsum("mkk->mk", instrument_covariance)[:, part].mean()),
            )
            count = min(3, residuals.shape[1])
            middle = max(float(np.median(length)) / (MIDDLE if count == 3 else float(chdtri(count, 0.5))), stated)
            tail = robust_weights(length / middle, count)
            seen = float(tail @ length) / float(tail.sum()) / count / (1 - float(fitted))
            chance = (
                np.sqrt(2 * (instrument_covariance[:, part, part] ** 2).sum()) / residuals[:, part].size
            )  # of a mean of squares of poses that are not alike
            if seen > stated + EXCESS * chance:
                out[part] = np.sqrt(seen - stated)
    return out


def robust_weights(squared_lengths: Floats, count: int) -> Floats:
    """Robust weights (m,) of poses by the squared length (m,) of their `count` whitened numbers."""
    return np.minimum(1.0, float(chdtri(count, FAR)) / np.maximum(squared_lengths, 1e-300))


def time_block_folds(count: int, folds: int) -> Integers:
    """Fold number (count,) of each sample, folds being contiguous blocks of time of equal size."""
    return np.minimum(np.arange(count) * folds // max(count, 1), folds - 1)
