"""Compiled kernels that evaluate grids at many places: simplex and n-linear interpolation."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from rig.arrays import Floats, Integers
from rig.compute.numba_kernels import njit

STEPS = 100  # of a fixed point


class Tables(NamedTuple):
    """A grid as kernels take it: levels (axes, most), the rest of a row infinite; inverse : (axes, most - 1) of the
    cells' widths;
    cells : (axes,) how many; strides : (axes,); values : (vertices, outputs)."""

    levels: Floats
    inverse: Floats
    cells: Floats
    strides: Floats
    values: Floats


class SimplexKernels(NamedTuple):
    """values : (x (n, axes), *Tables, out (n, outputs)), out filled; fixed_points : (goal (n, axes), Tables, tolerance,
    commands (n, axes), change (n,)), commands = goal + value(commands) filled, and what its last step changed."""

    values: Callable[..., None]
    fixed_points: Callable[..., None]


@cache
def compiled_simplex_kernels(axes: int) -> SimplexKernels:
    """Simplex kernels compiled for a number of axes."""

    @njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
    def at(
        x: Floats,
        levels: Floats,
        inverse: Floats,
        cells: Floats,
        strides: Floats,
        values: Floats,
        scratch: tuple[Floats, Floats, Integers],
        out: Floats,
    ) -> None:
        t, ranked, steps = scratch
        vertex = 0
        for i in range(axes):
            inner = min(max(x[i], levels[i, 0]), levels[i, cells[i]])
            cell = 0
            for j in range(1, cells[i]):
                cell += inner >= levels[i, j]
            t[i] = (inner - levels[i, cell]) * inverse[i, cell]
            vertex += cell * strides[i]
        for i in range(axes):  # how many are larger; of equal ones the first is
            rank = 0
            for j in range(i):
                rank += t[j] >= t[i]
            for j in range(i + 1, axes):
                rank += t[j] > t[i]
            ranked[rank], steps[rank] = t[i], strides[i]
        for k in range(values.shape[1]):
            out[k] = (1.0 - ranked[0]) * values[vertex, k]
        for i in range(axes):
            vertex += steps[i]
            weight = ranked[i] - ranked[i + 1]
            for k in range(values.shape[1]):
                out[k] += weight * values[vertex, k]

    @njit(cache=True, nogil=True, error_model="numpy")
    def simplex(
        x: Floats, levels: Floats, inverse: Floats, cells: Floats, strides: Floats, values: Floats, out: Floats
    ) -> None:
        scratch = np.empty(axes), np.zeros(axes + 1), np.empty(axes, np.int64)
        for q in range(x.shape[0]):
            at(x[q], levels, inverse, cells, strides, values, scratch, out[q])

    @njit(cache=True, nogil=True, error_model="numpy")
    def fixed_points(goal: Floats, tables: Tables, tolerance: float, commands: Floats, change: Floats) -> None:
        levels, inverse, cells, strides, values = tables
        scratch, found = (np.empty(axes), np.zeros(axes + 1), np.empty(axes, np.int64)), np.empty(values.shape[1])
        for q in range(goal.shape[0]):
            commands[q] = goal[q]
            for _ in range(STEPS):
                at(commands[q], levels, inverse, cells, strides, values, scratch, found)
                change[q] = 0.0
                for i in range(axes):
                    new = goal[q, i] + found[i]
                    change[q] = max(change[q], abs(new - commands[q, i]))
                    commands[q, i] = new
                if change[q] < tolerance:
                    break

    return SimplexKernels(simplex, fixed_points)


@njit(cache=True, nogil=True, error_model="numpy")
def n_linear_interpolation_kernel(
    x: Floats, levels: Floats, inverse: Floats, cells: Floats, strides: Floats, values: Floats, out: Floats
) -> None:
    """Kernel of n-linear interpolation: values into out (n, outputs) at x (n, axes)."""
    axes, outputs = x.shape[1], values.shape[1]
    corner, t = np.zeros(2**axes, np.int64), np.empty(axes)
    part = np.empty((2**axes, outputs))
    for c in range(2**axes):
        for i in range(axes):
            if c >> (axes - 1 - i) & 1:
                corner[c] += strides[i]
    for q in range(x.shape[0]):
        vertex = 0
        for i in range(axes):
            inner = min(max(x[q, i], levels[i, 0]), levels[i, cells[i]])
            cell = 0
            for j in range(1, cells[i]):
                cell += inner >= levels[i, j]
            t[i] = (inner - levels[i, cell]) * inverse[i, cell]
            vertex += cell * strides[i]
        half = 2 ** (axes - 1)
        for c in range(half):
            for k in range(outputs):
                low = values[vertex + corner[c], k]
                part[c, k] = low + t[0] * (values[vertex + corner[c + half], k] - low)
        for i in range(1, axes):
            half //= 2
            for c in range(half):
                for k in range(outputs):
                    part[c, k] += t[i] * (part[c + half, k] - part[c, k])
        for k in range(outputs):
            out[q, k] = part[0, k]
