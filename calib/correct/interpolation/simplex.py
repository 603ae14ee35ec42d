"""Barycentric interpolation on the simplices into which Kuhn cuts each cell of a grid: axes + 1 samples a place,
however many the axes.

A place in a cell lies in the simplex whose vertices are met on going through the cell along the axes in the order of
the place's coordinates, the largest first; neighbouring cells are cut alike where they meet. Sources:
configuration-space patent, [0033], [0034]; Kuhn, Some combinatorial lemmas in topology, 1960.
"""

from typing import ClassVar

import numpy as np

from calib.correct.interpolation.grid import Grid
from calib.correct.interpolation.grid_kernels import simplex_kernels
from calib.correct.interpolation.weighted_fields import Weights
from rig.model.mechanisms.hexapod_kernels import EACH, run_in_threads


class Simplex(Grid):
    """A Grid whose cells are cut into simplices."""

    __slots__ = ()
    kind: ClassVar[str] = "simplex"
    exact: ClassVar[bool] = True

    def value(self, x: np.ndarray) -> np.ndarray:
        x = np.ascontiguousarray(x, float)
        flat, out = x.reshape(-1, x.shape[-1]), np.empty((x.size // x.shape[-1], self.values.shape[1]))
        kernel = simplex_kernels(x.shape[-1]).values
        if len(flat) < 2 * EACH:
            kernel(flat, *self.tables, out)
        else:
            run_in_threads(lambda part: kernel(flat[part], *self.tables, out[part]), len(flat))
        return out.reshape(*x.shape[:-1], -1)

    def fixed_points(self, goal: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
        """(commands (n, axes), what their last step changed (n,)): commands = goal + value(commands), for goals (n,
        axes).
        """
        commands, change = np.empty(goal.shape), np.empty(len(goal))
        kernel = simplex_kernels(goal.shape[1]).fixed_points
        run_in_threads(lambda part: kernel(goal[part], self.tables, tolerance, commands[part], change[part]), len(goal))
        return commands, change

    def weights(self, x: np.ndarray) -> Weights:
        cell, t, slope = self.cells(x)
        n, axes = x.shape
        strides = self.strides()
        order = np.argsort(-t, axis=1, kind="stable")
        index = np.cumsum(np.column_stack([cell @ strides, strides[order]]), axis=1)
        largest = np.column_stack([np.ones(n), np.take_along_axis(t, order, axis=1), np.zeros(n)])
        slopes = np.zeros((n, axes + 1, axes))
        at, step = np.arange(n)[:, None], np.take_along_axis(slope, order, axis=1)
        slopes[at, np.arange(axes), order] -= step
        slopes[at, np.arange(1, axes + 1), order] += step
        return Weights(index, -np.diff(largest, axis=1), slopes)
