"""A step of least squares that keeps its unknowns within bounds, and sums of them as they are."""

import numpy as np
from scipy.linalg import null_space

NULL = 1e-11  # of the greatest eigenvalue; directions below are not stepped along


def bounded_step(
    b: np.ndarray, G: np.ndarray, values: np.ndarray, ends: np.ndarray, kept: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(step (c,) of values (c,), to a bound at the most, their covariance (c, c), of which bounds know nothing).

    b : (c,) gradient; G : (c, c) information, priors included in both; ends : (c, 2) bounds; kept : (k, c) sums that
        the step must not change
    """
    low, high = ends.T
    step, covariance = _solved(b, G, kept)
    held = np.zeros(len(step), bool)
    for _ in range(len(step)):
        over = ~held & ((values + step < low) | (values + step > high))
        if not over.any():
            break
        held |= over
        step[held] = np.clip(values + step, low, high)[held] - values[held]
        step[~held] = _solved(b[~held] - G[np.ix_(~held, held)] @ step[held], G[np.ix_(~held, ~held)], kept[:, ~held])[
            0
        ]
    return step, covariance


def _solved(b: np.ndarray, G: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(G^-1 b, G^-1) in the directions that anything sees and that keep sums (k, c)."""
    if not len(b):
        return np.zeros(0), np.zeros((0, 0))
    scale = np.sqrt(np.maximum(np.diag(G), 1e-300))
    scaled = G / scale[:, None] / scale
    kept = kept[kept.any(axis=1)]
    along = null_space(kept / scale) if len(kept) else None
    values, vectors = np.linalg.eigh(scaled if along is None else along.T @ scaled @ along)
    there = values > NULL * max(values[-1], 1e-300)
    half = vectors[:, there] / np.sqrt(values[there])
    half = (half if along is None else along @ half) / scale[:, None]
    return half @ (half.T @ b), half @ half.T
