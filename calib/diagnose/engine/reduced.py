"""Frames' own directions whitened, nuisances taken out: ordinary least squares in which columns are added one after the other."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from calib.diagnose.engine.linear import LinearModel, orthonormal
from calib.diagnose.engine.products import SWALLOWED, FrameProducts


@dataclass(frozen=True, slots=True, eq=False)
class Reduced:
    """Of frames that can be moved in directions (a). rows : (f,) which frames; root : (f, a, a) that whitens the directions
    y : (f a,) residual; basis : (f a, r) of what is taken out, as far as these directions see it; size : numbers that the residual holds"""

    rows: np.ndarray
    root: np.ndarray
    y: np.ndarray
    basis: np.ndarray
    size: float

    @staticmethod
    def of(products: FrameProducts, rows: np.ndarray, known: tuple[np.ndarray, np.ndarray] | None = None) -> "Reduced":
        """Reduced of products of frames rows (f,). known : ((p, p) information of the nuisances on these frames with all that was known
        beforehand, (p,) the residual's products with their columns there), None where the model has them taken out already"""
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
            turn = orthonormal(information)
            basis = basis @ turn
            y = y - basis @ (turn.T @ right)
        return Reduced(rows, root, y, basis, float(seen.sum() - (basis**2).sum()))

    @staticmethod
    def on(model: LinearModel, products: FrameProducts, train: np.ndarray) -> "Reduced":
        """Reduced of the frames of a mask train (F,), the nuisances of a LinearModel with an explicit basis fitted to these alone."""
        rho, grams = model.by_frames()
        rows, own = np.flatnonzero(train), [slice(int(block.edges[-1]), None) for block in model.blocks]
        basis = list(zip(model.columns.whole, model.blocks, own))
        information = grams[train].sum(axis=0) + sum(Q[at].T @ Q[at] for Q, _, at in basis)
        right = rho[train].sum(axis=0) + sum(Q[at].T @ block.residual[at] for Q, block, at in basis)
        confined = FrameProducts(products.beta[rows], products.gamma[rows], products.kappa[rows], products.half)
        return Reduced.of(confined, rows, (information, right))

    def whitened(self, weights: np.ndarray) -> np.ndarray:
        """(f a, q) columns of weights (f, a, q)."""
        return (self.root @ weights).reshape(len(self.y), -1)

    def beside(self, columns: np.ndarray) -> "Reduced | None":
        """The same with columns (f a, q) fitted and taken out; None where nuisances and columns swallow one another."""
        free = columns - self.basis @ (self.basis.T @ columns)
        gram = columns.T @ free
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        if (np.diag(gram) <= SWALLOWED * (columns**2).sum(axis=0)).any() or np.linalg.eigvalsh(gram / scale[:, None] / scale)[0] < SWALLOWED:
            return None
        lower = np.linalg.cholesky(gram)
        along = solve_triangular(lower, free.T, lower=True).T
        left = self.y - along @ solve_triangular(lower, columns.T @ self.y, lower=True)
        return replace(self, y=left, basis=np.concatenate([self.basis, along], axis=1))

    def coefficients(self, columns: np.ndarray) -> np.ndarray:
        """(q,) of columns (f a, q) at their best."""
        free = columns - self.basis @ (self.basis.T @ columns)
        return np.linalg.solve(columns.T @ free, columns.T @ self.y)

    def drops(self, columns: np.ndarray) -> np.ndarray:
        """(k,) by which the squares fall with each of k pairs (or single columns) by themselves. columns : (f a, k, q), q = 1 or 2"""
        n, k, q = columns.shape
        flat = columns.reshape(n, k * q)
        b = (self.y @ flat).reshape(k, q)
        onto = (self.basis.T @ flat).reshape(-1, k, q)
        raw = np.einsum("nkq,nkr->kqr", columns, columns)
        gram = raw - np.einsum("mkq,mkr->kqr", onto, onto)
        own = np.maximum(np.einsum("kqq->kq", raw), 1e-300)
        if q == 1:
            seen = gram[:, 0, 0] > SWALLOWED * own[:, 0]
            return np.where(seen, b[:, 0] ** 2 / np.where(seen, gram[:, 0, 0], 1.0), 0.0)
        det = gram[:, 0, 0] * gram[:, 1, 1] - gram[:, 0, 1] ** 2
        seen = det > SWALLOWED * own.prod(axis=1)
        square = b[:, 0] ** 2 * gram[:, 1, 1] + b[:, 1] ** 2 * gram[:, 0, 0] - 2 * b[:, 0] * b[:, 1] * gram[:, 0, 1]
        return np.where(seen, square / np.where(seen, det, 1.0), 0.0)
