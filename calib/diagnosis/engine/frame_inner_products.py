"""Inner products of columns frame by frame, the normal equations made of them, and fast sums against sinusoids.

A candidate moves each frame in a few directions (an axis longer, a camera's mount moved) by weights; so a search over
thousands of hypotheses costs sums over frames alone.

Each pose's values are spread onto an even grid by a short kernel, the grid is transformed, and the kernel's own
transform divided out. Source: Barnett, Magland and af Klinteberg, SIAM J. Sci. Comput. 41, 2019, C479-C504 (type 1;
kernel eq. 1.8, upsampling 2).
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.fft import next_fast_len
from scipy.optimize import nnls
from scipy.sparse import csr_array

from rig.array_and_json_types import Booleans, Floats

SWALLOWED = 1e-7  # share of a direction's square that the nuisances must leave for it to count as seen


@dataclass(frozen=True, slots=True, eq=False)
class FrameProducts:
    """Of the directions (a) that a frame can be moved in. beta : (F, a) with the residual; gamma : (F, a, a) with each
    other
    kappa : (F, a, p) with columns that span the nuisances; half : (p, r), columns @ half orthonormal, None where they
        are so already."""

    beta: Floats
    gamma: Floats
    kappa: Floats
    half: Floats | None = None

    def confined(self, directions: Booleans) -> "FrameProducts":
        """The same of some of the directions: (a,) bool."""
        if directions.all():
            return self
        return FrameProducts(
            self.beta[:, directions], self.gamma[:, directions][:, :, directions], self.kappa[:, directions], self.half
        )

    def onto(self, products: Floats) -> Floats:
        """Products with the columns (.., p) -> with the orthonormal basis (.., r)."""
        return products if self.half is None else products @ self.half

    def of_columns(self, sizes: Floats) -> Floats:
        """Sizes (r, ..) on the orthonormal basis -> on the columns (p, ..)."""
        return sizes if self.half is None else self.half @ sizes


class Normal(NamedTuple):
    """Normal equations of k candidates. b : (k, q) projections of the residual; G : (k, q, q) Gram matrices, nuisances
    taken out;
    raw : (k, q) squares before they were"""

    b: Floats
    G: Floats
    raw: Floats


class Solved(NamedTuple):
    """delta_chi2 : (k,) by which the sum of squares falls; coefficients : k of (q,); rank : (k,) numbers that the data
    determine
    seen : (k,) share of the candidate's own size that nuisances leave, 0..1"""

    delta_chi2: Floats
    coefficients: list[Floats]
    rank: Floats
    seen: Floats

    @staticmethod
    def of(parts: list["Solved"]) -> "Solved":
        """Several one after the other."""
        return Solved(
            np.concatenate([p.delta_chi2 for p in parts]),
            [c for p in parts for c in p.coefficients],
            np.concatenate([p.rank for p in parts]),
            np.concatenate([p.seen for p in parts]),
        )


def normal_equations_by_direction_weights(products: FrameProducts, weights: Floats) -> Normal:
    """Normal equations of candidates that weight each direction in each frame by weights (k, F, a, q)."""
    k, F, a, q = weights.shape
    rows = np.swapaxes(weights.reshape(k, F * a, q), 1, 2)
    b = rows @ products.beta.ravel()
    K = products.onto(rows @ products.kappa.reshape(F * a, -1))
    pushed = products.gamma * weights if a == 1 else products.gamma @ weights
    G = rows @ pushed.reshape(k, F * a, q)
    return Normal(b, G - K @ np.swapaxes(K, 1, 2), np.einsum("kqq->kq", G).copy())


def normal_equations_by_common_weights(products: FrameProducts, frame_weights: Floats) -> Normal:
    """Normal equations of candidates that weight all directions (a) of a frame alike, by frame weights (k, F)."""
    b = frame_weights @ products.beta
    K = products.onto(np.tensordot(frame_weights, products.kappa, 1))
    G = np.tensordot(frame_weights**2, products.gamma, 1)
    return Normal(b, G - K @ np.swapaxes(K, 1, 2), np.einsum("kqq->kq", G).copy())


def solve_normal_equations(normal: Normal) -> Solved:
    """Solved normal equations: least squares in the directions that nuisances leave visible."""
    b, G, raw = normal
    scale = np.sqrt(np.maximum(raw, 1e-300))
    values, vectors = np.linalg.eigh(G / scale[:, :, None] / scale[:, None, :])
    kept = values > SWALLOWED
    inverse = np.where(kept, 1 / np.where(kept, values, 1), 0)
    z = np.einsum("kji,kj->ki", vectors, b / scale)
    delta = (z**2 * inverse).sum(axis=1)
    coefficients = np.einsum("kij,kj->ki", vectors, z * inverse) / scale
    return Solved(delta, list(coefficients), kept.sum(axis=1), np.clip(values, 0, 1).max(axis=1))


def solve_nonnegative(normal: Normal) -> Solved:
    """Solved normal equations with no coefficient below zero: as many numbers are determined as are above it.

    Given which are above zero, what they explain is distributed as if no others had been there (Kudo, Biometrika 50,
    1963, 403-418). Source of the solution: Lawson and Hanson, Solving Least Squares Problems, 1974, ch. 23
    """
    b, G, raw = normal
    scale = np.sqrt(np.maximum(raw, 1e-300))
    values, vectors = np.linalg.eigh(G / scale[:, :, None] / scale[:, None, :])
    root = np.sqrt(np.where(values > SWALLOWED, values, 0.0))
    right = np.einsum("kji,kj->ki", vectors, b / scale) / np.where(root > 0, root, np.inf)
    rows = root[:, :, None] * np.swapaxes(vectors, 1, 2)
    found = [nnls(A, y)[0] for A, y in zip(rows, right)]
    delta = np.array([2 * x @ A.T @ y - np.sum((A @ x) ** 2) for x, A, y in zip(found, rows, right)])
    rank = np.array([np.count_nonzero(x) for x in found])
    return Solved(delta, [x / s for x, s in zip(found, scale)], rank, np.clip(values, 0, 1).max(axis=1))


def solve_with_prior(normal: Normal, prior: Floats | float) -> Solved:
    """Solved normal equations with a normal prior, standard deviations (q,), on the coefficients."""
    b, G, raw = normal
    size = np.linalg.solve(G + np.eye(b.shape[1]) / np.square(prior), np.concatenate([b[..., None], G], axis=2))
    rank = np.round(np.einsum("sqq->s", size[..., 1:]), 1)
    return Solved((b * size[..., 0]).sum(axis=1), list(size[..., 0]), rank, np.ones(len(b)))


def chi2_reduction_at_unit_coefficient(normal: Normal) -> Solved:
    """Chi-square reduction (Solved) of one-column candidates whose coefficient is fixed at one."""
    b, G, raw = normal.b[:, 0], normal.G[:, 0, 0], normal.raw[:, 0]
    seen = G / np.maximum(raw, 1e-300)
    return Solved(
        np.where(seen > SWALLOWED, 2 * b - G, 0.0), [np.zeros(0)] * len(b), np.zeros(len(b), int), np.clip(seen, 0, 1)
    )


WIDTH = 10  # grid points that a pose is spread onto; errors are about ten to the power of 1 - WIDTH
SHAPE = 2.30 * WIDTH
NODES = 60  # of the quadrature for the kernel's transform


def sinusoid_sums(q: Floats, values: Floats, step: float, first: int, count: int) -> Floats:
    """(count, p) complex: sum over poses of values * exp(1j * order * q) at orders step * (first, first + 1, ..).

    q : (m,) rad, its span times step below 2 pi; values : (m, p); step : cycles per radian times 2 pi, between orders;
        first : at least 0
    """
    last = first + count
    size = next_fast_len(4 * last + 2 * WIDTH)
    centre = (q.min() + q.max()) / 2
    at = (q - centre) * step * size / (2 * np.pi)  # in grid steps
    start = np.ceil(at - WIDTH / 2).astype(int)
    cells = start[:, None] + np.arange(WIDTH)
    rows = np.repeat(np.arange(len(q)), WIDTH)
    spread = csr_array(
        (_kernel(2 * (cells - at[:, None]) / WIDTH).ravel(), ((cells % size).ravel(), rows)), shape=(size, len(q))
    )
    order = np.arange(first, last)
    grid = np.fft.rfft(spread @ values, axis=0)[order].conj()
    return grid * (np.exp(1j * order * step * centre) / _transform(size, first, count))[:, None]


def _kernel(z: Floats) -> Floats:
    """The kernel at z in -1..1 (half its width is 1)."""
    return np.exp(SHAPE * (np.sqrt(np.maximum(1 - z**2, 0)) - 1))


@lru_cache(maxsize=64)
def _transform(size: int, first: int, count: int) -> Floats:
    """(count,) transform of the kernel, in grid steps, at orders first, first + 1, .. of a grid of a size."""
    z, weight = np.polynomial.legendre.leggauss(NODES)
    frequency = np.arange(first, first + count) / size
    return WIDTH / 2 * np.cos(np.pi * WIDTH * frequency[:, None] * z) @ (weight * _kernel(z))
