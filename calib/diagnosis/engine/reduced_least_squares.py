"""Least squares reduced by whitening and nuisance elimination, to which columns are added one at a time."""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from scipy.linalg import solve_triangular

from calib.diagnosis.engine.frame_inner_products import SWALLOWED, FrameProducts
from calib.diagnosis.engine.linear_model import LinearModel, orthonormal_combinations
from rig.array_and_json_types import Floats, Integers


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

    def beside(self, columns: Floats) -> "Reduced | None":
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
        since = self.basis[:, stack.beside :]
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
    own : (k, q) squares before; beside : how many columns were taken out first"""

    columns: Floats
    gram: Floats
    own: Floats
    beside: int


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
