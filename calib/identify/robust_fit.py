"""Robust fits, outlier rows, and the excess of scatter over an instrument's covariance.

All that may be smooth is first fitted by weights that fall to nothing with the residual (Tukey's biweight, from the
start that Huber's weights reach), so that no wild row hides itself or another. A short event is not wild: the row
before or after it, or one at nearly the same configuration, shows the same. Source: Maronna, Martin and Yohai, Robust
statistics, 2006, ch. 5.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from scipy.spatial import cKDTree
from scipy.special import chdtri

from rig.array_and_json_types import Booleans, Floats

CONSISTENT = 1.4826  # times the median of absolute residuals: the standard deviation of normal ones
HUBER, TUKEY = 1.5, 6.0  # standard deviations: of the weights at first, and from which a row counts for nothing
ROUNDS = 12  # of either weights
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
    """Robust fit of parts [(residual (n, k), columns (n, k, p))], whitened; a row has one weight in all parts."""
    n = len(parts[0][0])
    free = [1 - min(columns.shape[2] / max(n * columns.shape[1], 1), 0.8) for _, columns in parts]
    weight = np.ones(n)
    for turn in range(2 * ROUNDS):
        left = np.concatenate([_left(residual, columns, weight) for residual, columns in parts], axis=1)
        scale = np.concatenate(
            [np.full(residual.shape[1], 1 / np.sqrt(share)) for (residual, _), share in zip(parts, free)]
        )
        scale = np.maximum(scale * CONSISTENT * np.median(np.abs(left), axis=0), 1e-300)
        far = np.abs(left / scale).max(axis=1)
        weight = (
            np.minimum(1.0, HUBER / np.maximum(far, 1e-12))
            if turn < ROUNDS
            else (1 - np.minimum(far / TUKEY, 1.0) ** 2) ** 2
        )
    return Robust(left, scale)


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
    """Whether rows (n,) are isolated outliers: beyond the gate while no neighbour is.

    scaled_residuals : (n, k) residuals over their scatter; t : (n,) s; q : (n, axes) where rows stand
    gate : where what is left is normal; where its tail is longer, as what is left out of a model has it, by as much
        more
    """
    far = np.abs(scaled_residuals).max(axis=1)
    far = far > gate * tail_length_ratio(scaled_residuals, gate)
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


def tail_length_ratio(scaled_residuals: Floats, gate: float) -> float:
    """Ratio of the tail length of rows (n, k) within a gate to a normal one's; 1 at the least."""
    size = np.abs(scaled_residuals).max(axis=1)
    near = size[size <= gate]
    usual = scipy.special.ndtri((1 + TAIL ** (1 / scaled_residuals.shape[1])) / 2)
    return max(1.0, float(np.quantile(near, TAIL) / usual)) if len(near) else 1.0


def has_several_deviating_numbers(scaled_residuals: Floats, gate: float) -> Booleans:
    """Whether a row (n,) has several numbers that deviate, as a wrong pose has, or one grossly.

    scaled_residuals : (n, k) residuals over their scatter; gate : of the greatest; half of it counts as far off in the
        second
    """
    size = np.sort(np.abs(scaled_residuals), axis=1)
    return np.asarray((size[:, -1] > gate) & (size[:, -2] > gate / 2) | (size[:, -1] > GROSS * gate))


MIDDLE = float(chdtri(3, 0.5))  # of the squared length of three normal numbers
FAR = 1e-3  # chance of a length beyond which a pose counts less
EXCESS = 3.0  # standard errors by which scatter must exceed the instrument's own before it counts


def excess_scatter(residuals: Floats, instrument_covariance: Floats, share: float | Floats = 0.0) -> Floats:
    """Excess scatter (k,) m and rad beyond the instrument's own: one figure for positions, one for rotations.

    residuals : (m, k) residuals, m and rad; instrument_covariance : (m, k, k) the instrument's covariance; share : of
        the squares, what the
    fit took away, one figure or one for positions and one for rotations
    """
    out = np.zeros(residuals.shape[1])
    for part, fitted in zip((slice(0, 3), slice(3, 6)), np.broadcast_to(share, 2)):
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
