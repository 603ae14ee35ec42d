"""n-linear interpolation on a grid: all 2^axes vertices of a cell, each by the share of the cell that lies opposite.

Source: configuration-space patent, [0028], [0088] (fig. 6 and 7 are its two axes' functions)
"""

from itertools import product
from typing import ClassVar

import numpy as np

from calib.correct.interpolation.grid import Grid
from calib.correct.interpolation.grid_kernels import linear_kernel
from calib.correct.interpolation.weighted_fields import Weights


class Linear(Grid):
    """A Grid, linear along each axis within its cells."""

    __slots__ = ()
    kind: ClassVar[str] = "linear"
    exact: ClassVar[bool] = True

    def value(self, x: np.ndarray) -> np.ndarray:
        x = np.ascontiguousarray(x, float)
        out = np.empty((x.size // x.shape[-1], self.values.shape[1]))
        linear_kernel(x.reshape(-1, x.shape[-1]), *self.tables, out)
        return out.reshape(*x.shape[:-1], -1)

    def weights(self, x: np.ndarray) -> Weights:
        cell, t, slope = self.cells(x)
        corners = np.array(list(product((0, 1), repeat=x.shape[1])))
        index = (cell @ self.strides())[:, None] + corners @ self.strides()
        shares = np.where(corners, t[:, None], 1 - t[:, None])  # (n, 2^axes, axes)
        slopes = np.empty_like(shares)
        for i in range(x.shape[1]):
            slopes[..., i] = (
                np.delete(shares, i, axis=2).prod(axis=2) * np.where(corners[:, i], 1, -1) * slope[:, None, i]
            )
        return Weights(index, shares.prod(axis=2), slopes)
