"""Wild rows: what is far off all that smooth functions allow, and off its neighbours in time and configuration as well.

All that may be smooth is first fitted by weights that fall to nothing with the residual (Tukey's biweight, from the start that Huber's weights
reach), so that no wild row hides itself or another. A short event is not wild: the row before or after it, or one at nearly the same
configuration, shows the same. Source: Maronna, Martin and Yohai, Robust statistics, 2006, ch. 5.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

CONSISTENT = 1.4826  # times the median of absolute residuals: the standard deviation of normal ones
HUBER, TUKEY = 1.5, 6.0  # standard deviations: of the weights at first, and from which a row counts for nothing
ROUNDS = 12  # of either weights
ALIKE = 0.5  # of a row's residual, by which its neighbour's may differ and still show the same
IN_TIME, IN_PLACE = 2, 6  # neighbours either way in time, and in configuration
MOST = 0.1  # share of rows that may be wild; where more are far off, something is left out of the model
FIRM = 1e-8  # share of a column's square that is added to it, so that columns that repeat one another can be solved for


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A row that was left out of all that was asked. frame : its number; place : where it shows most; off : in unit
    times : the scatter of the others; what : "pose" where the whole frame was left out, "corners" where those of one marker in one image were
    reason : in words"""

    frame: int
    what: str
    place: str
    off: float
    unit: str
    times: float
    reason: str


@dataclass(frozen=True, slots=True)
class Crowd:
    """So many of a kind are far off that they are not wild: something is left out of the model. what : in the plural; count, of : how many."""

    what: str
    count: int
    of: int


@dataclass(frozen=True, slots=True, eq=False)
class Robust:
    """What a robust fit leaves. residual : (n, k) as given; scale : (k,) its scatter, by its middle"""

    residual: np.ndarray
    scale: np.ndarray

    @property
    def relative(self) -> np.ndarray:
        """(n, k) residual over its scatter."""
        return self.residual / self.scale


def robust_fit(parts: Sequence[tuple[np.ndarray, np.ndarray]]) -> Robust:
    """Robust of parts [(residual (n, k), columns (n, k, p))], each whitened and with columns of its own; a row has one weight in all of them."""
    n = len(parts[0][0])
    free = [1 - min(columns.shape[2] / max(n * columns.shape[1], 1), 0.8) for _, columns in parts]
    weight = np.ones(n)
    for turn in range(2 * ROUNDS):
        left = np.concatenate([_left(residual, columns, weight) for residual, columns in parts], axis=1)
        scale = np.concatenate([np.full(residual.shape[1], 1 / np.sqrt(share)) for (residual, _), share in zip(parts, free)])
        scale = np.maximum(scale * CONSISTENT * np.median(np.abs(left), axis=0), 1e-300)
        far = np.abs(left / scale).max(axis=1)
        weight = np.minimum(1.0, HUBER / np.maximum(far, 1e-12)) if turn < ROUNDS else np.maximum(1 - (far / TUKEY) ** 2, 0.0) ** 2
    return Robust(left, scale)


def _left(residual: np.ndarray, columns: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(n, k) residual less columns (n, k, p) at their best for weights (n,)."""
    p = columns.shape[2]
    if not p:
        return residual
    flat, y = columns.reshape(-1, p), residual.reshape(-1)
    weighted = np.repeat(weight, residual.shape[1])[:, None] * flat
    gram = weighted.T @ flat
    gram[np.diag_indices(p)] += FIRM * np.maximum((flat**2).sum(axis=0), 1e-300)
    return residual - (flat @ np.linalg.solve(gram, weighted.T @ y)).reshape(residual.shape)


def wild_rows(relative: np.ndarray, t: np.ndarray, q: np.ndarray, gate: float) -> np.ndarray:
    """(n,) bool, rows with a residual beyond the gate that no neighbour shares.

    relative : (n, k) residuals over their scatter; t : (n,) s; q : (n, axes) where rows stand
    """
    far = np.abs(relative).max(axis=1) > gate
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
        apart = np.linalg.norm(relative[others] - relative[i], axis=1)
        out[i] = not (apart < ALIKE * np.linalg.norm(relative[i])).any()
    return out
