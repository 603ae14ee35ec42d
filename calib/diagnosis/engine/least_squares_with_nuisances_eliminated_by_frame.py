"""Least squares reduced by elimination of nuisances: from inner products of columns by frame.

The normal equations are made of the products; columns are added one at a time, and sums against sinusoids are fast.
A candidate moves each frame in a few directions (an axis longer, a camera's mount moved) by weights; so a search over
thousands of hypotheses costs sums over frames alone.

Each pose's values are spread onto an even grid by a short kernel, the grid is transformed, and the kernel's own
transform divided out. Source: Barnett, Magland and af Klinteberg, SIAM J. Sci. Comput. 41, 2019, C479-C504 (type 1;
kernel eq. 1.8, upsampling 2).
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple, cast

import numpy as np
from scipy.fft import next_fast_len
from scipy.linalg import solve_triangular
from scipy.optimize import nnls
from scipy.sparse import csr_array

from calib.diagnosis.engine.linear_residual_model import LinearModel, orthonormal_combinations
from rig.array_and_json_types import Booleans, Floats, Integers

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
    taken out; raw : (k, q) squares before they were; onto : (k, q, r) products with the nuisances' orthonormal basis,
    where they are wanted later"""

    b: Floats
    G: Floats
    raw: Floats
    onto: Floats | None = None


class Solved(NamedTuple):
    """delta_chi2 : (k,) by which the sum of squares falls; coefficients : k of (q,); rank : (k,) numbers that the data
    determine
    seen : (k,) share of the candidate's own size that nuisances leave, 0..1"""

    delta_chi2: Floats
    coefficients: list[Floats]
    rank: Floats
    seen: Floats

    def part(self, rows: slice) -> "Solved":
        """Those of some rows."""
        return Solved(self.delta_chi2[rows], self.coefficients[rows], self.rank[rows], self.seen[rows])

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
    rows = np.moveaxis(weights, 3, 1).reshape(k * q, F * a)  # of all candidates, that kappa is passed through once
    b = (rows @ products.beta.ravel()).reshape(k, q)
    K = products.onto(rows @ products.kappa.reshape(F * a, -1)).reshape(k, q, -1)
    pushed = products.gamma * weights if a == 1 else products.gamma @ weights
    G = rows.reshape(k, q, F * a) @ pushed.reshape(k, F * a, q)
    return Normal(b, G - K @ np.swapaxes(K, 1, 2), np.einsum("kqq->kq", G).copy(), K)


def normal_equations_by_common_weights(products: FrameProducts, frame_weights: Floats) -> Normal:
    """Normal equations of candidates that weight all directions (a) of a frame alike, by frame weights (k, F)."""
    b = frame_weights @ products.beta
    K = products.onto(np.tensordot(frame_weights, products.kappa, 1))
    G = np.tensordot(frame_weights**2, products.gamma, 1)
    return Normal(b, G - K @ np.swapaxes(K, 1, 2), np.einsum("kqq->kq", G).copy())


def solve_normal_equations(normal: Normal) -> Solved:
    """Solved normal equations.

    Least squares in the directions that nuisances leave visible.
    """
    b, G, raw = normal[:3]
    scale = np.sqrt(np.maximum(raw, 1e-300))
    values, vectors = np.linalg.eigh(G / scale[:, :, None] / scale[:, None, :])
    retained = values > SWALLOWED
    inverse = np.where(retained, 1 / np.where(retained, values, 1), 0)
    z = np.einsum("kji,kj->ki", vectors, b / scale)
    delta = (z**2 * inverse).sum(axis=1)
    coefficients = np.einsum("kij,kj->ki", vectors, z * inverse) / scale
    return Solved(delta, list(coefficients), retained.sum(axis=1), np.clip(values, 0, 1).max(axis=1))


def solve_nonnegative(normal: Normal) -> Solved:
    """Solved normal equations with no coefficient below zero.

    As many numbers are determined as are above it.
    Given which are above zero, what they explain is distributed as if no others had been there (Kudo, Biometrika 50,
    1963, 403-418). Source of the solution: Lawson and Hanson, Solving Least Squares Problems, 1974, ch. 23
    """
    b, G, raw = normal[:3]
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
    """Solved normal equations with a normal prior.

    Standard deviations (q,), on the coefficients.
    """
    b, G, raw = normal[:3]
    size = np.linalg.solve(G + np.eye(b.shape[1]) / np.square(prior), np.concatenate([b[..., None], G], axis=2))
    rank = np.round(np.einsum("sqq->s", size[..., 1:]), 1)
    return Solved((b * size[..., 0]).sum(axis=1), list(size[..., 0]), rank, np.ones(len(b)))


def chi2_reduction_at_unit_coefficient(normal: Normal) -> Solved:
    """Chi-square reduction (Solved) at a coefficient of one.

    Of one-column candidates whose coefficient is fixed.
    """
    b, G, raw = normal.b[:, 0], normal.G[:, 0, 0], normal.raw[:, 0]
    seen = G / np.maximum(raw, 1e-300)
    return Solved(
        np.where(seen > SWALLOWED, 2 * b - G, 0.0), [np.zeros(0)] * len(b), np.zeros(len(b), int), np.clip(seen, 0, 1)
    )


WIDTH = 10  # grid points that a pose is spread onto; errors are about ten to the power of 1 - WIDTH
SHAPE = 2.30 * WIDTH
NODES = 60  # of the quadrature for the kernel's transform


def sinusoid_weighted_sums(q: Floats, values: Floats, step: float, first: int, count: int) -> Floats:
    """Sums (count, p), complex, of values times sinusoids of q at evenly spaced orders.

    Over poses, values * exp(1j * order * q) at orders step * (first, first + 1, ..).
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


@dataclass(frozen=True, slots=True, eq=False)
class Reduced:
    """Of frames that can be moved in directions (a). rows : (f,) which frames; root : (f, a, a) that whitens the
    directions
    y : (f a,) residual; basis : (f a, r) of what is taken out, as far as these directions see it; size : numbers that
        the residual holds"""

    rows: Integers
    root: Floats
    y: Floats
    basis: Floats
    size: float

    @staticmethod
    def of(products: FrameProducts, rows: Integers, known: tuple[Floats, Floats] | None = None) -> "Reduced":
        """Reduced of products of frames rows (f,). known : ((p, p) information of the nuisances on these frames with
        all that was known beforehand, (p,) the residual's products with their columns there), None where the model has
        them taken out already"""
        values, vectors = np.linalg.eigh(products.gamma)
        seen = values > SWALLOWED * np.maximum(values[:, -1:], 1e-300)
        half = np.sqrt(np.where(seen, values, 0.0))
        inverse = np.where(seen, 1 / np.where(seen, half, 1.0), 0.0)
        root = np.einsum("fij,fj,fkj->fik", vectors, half, vectors)
        back = np.einsum("fij,fj,fkj->fik", vectors, inverse, vectors)
        y = np.einsum("fij,fj->fi", back, products.beta).ravel()
        basis = products.onto(back @ products.kappa).reshape(len(y), -1)
        if known is not None:
            information, right = known
            turn = orthonormal_combinations(information)
            basis = basis @ turn
            y = y - basis @ (turn.T @ right)
        return Reduced(rows, root, y, basis, float(seen.sum() - (basis**2).sum()))

    @staticmethod
    def on(model: LinearModel, products: FrameProducts, train: Floats) -> "Reduced":
        """Reduced of the frames of a mask train (F,), the nuisances of a LinearModel with an explicit basis fitted to
        these alone.
        """
        rows, known = (
            np.flatnonzero(train),
            [
                (Q[block.known_rows], block.residual[block.known_rows])
                for Q, block in zip(model.columns.whole, model.blocks)
            ],
        )
        information = model.gram(train) + sum(Q.T @ Q for Q, _ in known)
        right = model.right(train, [block.residual for block in model.blocks]) + sum(
            Q.T @ residual for Q, residual in known
        )
        confined = FrameProducts(products.beta[rows], products.gamma[rows], products.kappa[rows], products.half)
        return Reduced.of(confined, rows, (information, right))

    def whitened(self, weights: Floats) -> Floats:
        """(f a, q) columns of weights (f, a, q)."""
        return (self.root @ weights).reshape(len(self.y), -1)

    def with_nuisances(self, columns: Floats) -> "Reduced | None":
        """The same with columns (f a, q) fitted and taken out; None where nuisances and columns swallow one another."""
        free = columns - self.basis @ (self.basis.T @ columns)
        gram = columns.T @ free
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        if (np.diag(gram) <= SWALLOWED * (columns**2).sum(axis=0)).any() or np.linalg.eigvalsh(
            gram / scale[:, None] / scale
        )[0] < SWALLOWED:
            return None
        lower = np.linalg.cholesky(gram)
        along = solve_triangular(lower, free.T, lower=True).T
        left = self.y - along @ solve_triangular(lower, columns.T @ self.y, lower=True)
        return replace(self, y=left, basis=np.concatenate([self.basis, along], axis=1))

    def coefficients(self, columns: Floats) -> Floats:
        """(q,) of columns (f a, q) at their best."""
        free = columns - self.basis @ (self.basis.T @ columns)
        return cast(Floats, np.linalg.solve(columns.T @ free, columns.T @ self.y))

    def stack(self, columns: Floats) -> "Stack":
        """Stack of columns (f a, k, q) beside what is taken out now."""
        raw = _grams(columns)
        return Stack(
            columns,
            raw - _grams(_onto(self.basis, columns)),
            np.maximum(np.einsum("kqq->kq", raw), 1e-300),
            self.basis.shape[1],
        )

    def drops(self, stack: "Stack") -> Floats:
        """(k,) by which the squares fall with each of a Stack's columns, or pairs, by themselves, beside what was taken
        out since it was made.
        """
        b: Floats = (self.y @ stack.columns.reshape(len(self.y), -1)).reshape(stack.own.shape)
        since = self.basis[:, stack.eliminated :]
        gram = stack.gram if not since.shape[1] else stack.gram - _grams(_onto(since, stack.columns))
        if b.shape[1] == 1:
            seen = gram[:, 0, 0] > SWALLOWED * stack.own[:, 0]
            return np.where(seen, b[:, 0] ** 2 / np.where(seen, gram[:, 0, 0], 1.0), 0.0)
        det = gram[:, 0, 0] * gram[:, 1, 1] - gram[:, 0, 1] ** 2
        seen = det > SWALLOWED * stack.own.prod(axis=1)
        square = b[:, 0] ** 2 * gram[:, 1, 1] + b[:, 1] ** 2 * gram[:, 0, 0] - 2 * b[:, 0] * b[:, 1] * gram[:, 0, 1]
        return np.where(seen, square / np.where(seen, det, 1.0), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Stack:
    """Columns that are tried, each by itself. columns : (f a, k, q), q = 1 or 2; gram : (k, q, q) of them, what was
    taken out first left out
    own : (k, q) squares before; eliminated : how many columns were taken out first"""

    columns: Floats
    gram: Floats
    own: Floats
    eliminated: int


def _onto(basis: Floats, columns: Floats) -> Floats:
    """(m, k, q) products of a basis (n, m) with columns (n, k, q)."""
    return (basis.T @ columns.reshape(len(columns), -1)).reshape(-1, *columns.shape[1:])


def _grams(columns: Floats) -> Floats:
    """(k, q, q) products of the q columns (n, k, q) of each with each other."""
    q = columns.shape[2]
    out = np.empty((columns.shape[1], q, q))
    for i in range(q):
        for j in range(i, q):
            out[:, i, j] = out[:, j, i] = (columns[..., i] * columns[..., j]).sum(axis=0)
    return out
