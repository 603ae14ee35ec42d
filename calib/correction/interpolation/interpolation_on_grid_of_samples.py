"""Interpolation on a grid of samples.

N-linear, or barycentric on the simplices of a cell. Of a few vertices that were not measured, values are estimated.

The levels W(0, i) < W(1, i) < .. < W(Q(i), i) of actuator i may leave out the ends of its stroke. Source:
configuration-space patent, [0031], [0032], [0144], [0145].

Source: configuration-space patent, [0028], [0088] (fig. 6 and 7 are its two axes' functions)

A place in a cell lies in the simplex whose vertices are met on going through the cell along the axes in the order of
the place's coordinates, the largest first; neighbouring cells are cut alike where they meet. Sources:
configuration-space patent, [0033], [0034]; Kuhn, Some combinatorial lemmas in topology, 1960.
"""

import math
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import combinations, product
from typing import ClassVar, NamedTuple, Self

import numpy as np
import scipy

from calib.correction.interpolation.delaunay_interpolation_and_grid_interpolation_kernels import (
    Tables,
    compiled_simplex_kernels,
    fill_n_linear_interpolation,
)
from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import (
    FieldSamples,
    WeightedField,
    Weights,
    group_means_and_variances_of_samples,
)
from rig.array_and_json_types import Floats, Integers
from rig.errors import RigError
from rig.model.mechanisms.hexapod_kernels import EACH, run_kernel_in_threads

SAME = 1e-5  # of the stroke, within which commands are one level: they are written to a tenth of a micrometre
PART = 1 / 3  # of the samples at the fullest level of an axis, that a level has at least which lost vertices
LOST = 0.25  # share of a grid's vertices, from which so few are measured that the samples fill no grid
LEAST = 1e-40  # square of a difference; of values that are affine to rounding, all differences weigh alike


class Lattice(NamedTuple):
    """levels : per axis (Q + 1,), ascending; vertex : (n,) number of each sample's vertex, counted in C order, -1 for
    one off the grid.
    """

    levels: tuple[Floats, ...]
    vertex: Integers

    @property
    def filled(self) -> int:
        """How many vertices have a sample."""
        return len(np.unique(self.vertex[self.vertex >= 0]))

    @property
    def lost(self) -> Floats:
        """(k, axes) configurations of the vertices at which no sample stands."""
        shape = tuple(len(level) for level in self.levels)
        at = np.unravel_index(np.setdiff1d(np.arange(np.prod(shape)), self.vertex), shape)
        return np.stack([level[i] for level, i in zip(self.levels, at)], axis=1)


def grid_lattice_of_configurations(configurations: Floats, strokes: Floats) -> Lattice | None:
    """Grid lattice of configurations (n, axes).

    They fill all its vertices but less than a share LOST.
    None where they fill none.
    strokes : (axes, 2), the scale by which levels are told apart
    """
    tolerance, whole = SAME * np.ptp(strokes, axis=1), 2 ** (len(strokes) - 1)
    found = [_lattice(configurations, tolerance, fewest) for fewest in (whole, max(whole // 2, 2), None)]
    return max((one for one in found if one is not None), key=lambda one: one.filled, default=None)


def _lattice(configurations: Floats, tolerance: Floats, fewest: int | None) -> Lattice | None:
    """Lattice of the levels that at least so many configurations (n, axes) share, or, for None, a share PART as many as
    the level of the same axis that most share. None for an axis with fewer than two, and where a share LOST of the
    vertices lacks.
    """
    n, axes = configurations.shape
    on = np.ones(n, bool)
    for _ in range(axes + 1):  # samples off the grid may first share some levels by chance
        levels = tuple(_levels(configurations[on, i], tolerance[i], fewest) for i in range(axes))
        if any(len(level) < 2 for level in levels):
            return None
        nearest = [np.abs(configurations[:, i, None] - level).argmin(axis=1) for i, level in enumerate(levels)]
        now = np.all(
            [np.abs(configurations[:, i] - level[nearest[i]]) <= tolerance[i] for i, level in enumerate(levels)], axis=0
        )
        if (now == on).all():
            break
        on = now
    shape = [len(level) for level in levels]
    needed = (1 - LOST) * math.prod(shape)  # counted before vertices are: a table of them all may fill no memory
    if on.sum() <= needed:
        return None
    lattice = Lattice(levels, np.where(on, np.ravel_multi_index(nearest, shape), -1))
    return lattice if lattice.filled > needed else None


def _levels(values: Floats, tolerance: float, fewest: int | None) -> Floats:
    """The middle of each of those groups of values, no further than the tolerance from each other, that have at least
    so many; for None at least PART of the largest.
    """
    ordered = np.sort(values)
    groups = np.split(ordered, np.flatnonzero(np.diff(ordered) > tolerance) + 1)
    least = PART * max(map(len, groups)) if fewest is None else fewest
    return np.array([group[len(group) // 2] for group in groups if len(group) >= least])


@dataclass(frozen=True, slots=True, eq=False)
class Grid(WeightedField):
    """levels : per axis (Q + 1,), ascending; values, variances : (vertices, outputs), C order; misfit : (outputs,).

    Raises ValueError where these do not fit each other
    """

    levels: tuple[Floats, ...]
    values: Floats
    variances: Floats
    misfit: Floats
    tables: Tables = field(init=False, repr=False)  # as kernels take it

    def __post_init__(self) -> None:
        for level in self.levels:
            if len(level) < 2 or not (np.diff(level) > 0).all():
                raise ValueError(f"levels must be at least two and increasing, got {np.asarray(level).tolist()}")
        vertices = int(np.prod([len(level) for level in self.levels]))
        if (
            self.values.shape != self.variances.shape
            or self.values.shape[0] != vertices
            or self.misfit.shape != self.values.shape[1:]
        ):
            raise ValueError(
                f"a grid of {vertices} vertices has values {self.values.shape}, variances "
                f"{self.variances.shape} and misfit "
                f"{self.misfit.shape}"
            )
        object.__setattr__(self, "tables", _tables(self))

    @classmethod
    def fit(cls, known: FieldSamples) -> Self:
        """The field of samples that fill a grid; those beside it are left out, repeats of a vertex averaged, and the
        values of vertices without a sample estimated from the others.

        Raises RigError where the samples fill no grid, or where vertices are lost that the others do not determine
        """
        found = grid_lattice_of_configurations(known.configurations, known.strokes)
        if found is None:
            n, axes = known.configurations.shape
            raise RigError(
                f"the {n} samples fill no grid of configurations, which {cls.__name__.lower()} takes (a plan "
                "division:2 visits one; over "
                f"{axes} axes it has {2**axes} vertices at least); delaunay, axes, radial and polynomial "
                "accept samples anywhere"
            )
        on = found.vertex >= 0
        filled, group = np.unique(found.vertex[on], return_inverse=True)
        values, variances = group_means_and_variances_of_samples(known.take(on), group)
        if len(found.lost):
            values, variances = _with_estimates(found, filled, values, variances)
        grid = cls(found.levels, values, variances, np.zeros(values.shape[1]))
        return replace(grid, misfit=_misfit(grid))

    @property
    def shape(self) -> tuple[int, ...]:
        """Levels an axis."""
        return tuple(len(level) for level in self.levels)

    def outside(self, x: Floats) -> Floats:
        low, high = (np.array([level[k] for level in self.levels]) for k in (0, -1))
        beyond = np.maximum(low - x, 0) + np.maximum(x - high, 0)
        return np.linalg.norm(beyond / ((high - low) / 2), axis=1)

    def cells(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """(cell (n, axes), place in it 0..1 (n, axes), its change with x (n, axes)): places beyond the grid at its
        nearest faces.
        """
        cell, t, slope = np.empty(x.shape, int), np.empty(x.shape), np.empty(x.shape)
        for i, level in enumerate(self.levels):
            inner = np.clip(x[:, i], level[0], level[-1])
            cell[:, i] = np.clip(np.searchsorted(level, inner, side="right") - 1, 0, len(level) - 2)
            width = np.diff(level)[cell[:, i]]
            t[:, i] = np.minimum((inner - level[cell[:, i]]) / width, 1.0)
            slope[:, i] = (inner == x[:, i]) / width
        return cell, t, slope

    def strides(self) -> Integers:
        """(axes,) by how much a vertex' number grows along each axis."""
        return np.cumprod((1, *self.shape[:0:-1]))[::-1]


def _with_estimates(lattice: Lattice, filled: Integers, values: Floats, variances: Floats) -> tuple[Floats, Floats]:
    """(values, variances), (vertices, outputs) each, of all vertices from those of the filled (k,) ones.

    The others have the values at which differences are the least likely to be seen larger, each kind of difference
    weighed by its mean square where all its vertices are filled; their variances agree with how well every filled
    vertex is estimated from the others, and are not below the noise that the estimate takes over.
    Source: Rue and Held, Gaussian Markov Random Fields, 2005, ch. 2 and 3
    """
    count = int(np.prod([len(level) for level in lattice.levels]))
    lost = np.setdiff1d(np.arange(count), filled)
    out, square = np.zeros((count, values.shape[1])), np.zeros((count, values.shape[1]))
    out[filled], square[filled] = values, variances
    kinds = []
    for D in _differences(lattice.levels):
        complete = abs(D[:, lost]).sum(axis=1) == 0
        if complete.any():
            kinds.append((D, ((D[complete] @ out) ** 2).mean(axis=0)))
    for m in range(values.shape[1]):
        Q = sum(D.T @ D / max(float(size[m]), LEAST) for D, size in kinds).tocsr()
        own = Q[lost][:, lost].toarray()
        if np.linalg.matrix_rank(own) < len(lost):
            raise RigError(
                f"the grid of {count} vertices lost {len(lost)} that the others do not determine: visit them again"
            )
        covariance = np.linalg.inv(own)
        weights = -covariance @ Q[lost][:, filled]
        out[lost, m] = weights @ values[:, m]
        times = float(((Q @ out[:, m])[filled] ** 2 / Q.diagonal()[filled]).mean())
        square[lost, m] = np.maximum(times * np.diag(covariance), weights**2 @ variances[:, m])
    return out, square


def _differences(levels: tuple[Floats, ...]) -> "list[scipy.sparse.csr_array]":
    """[(rows, vertices)] divided differences of a grid's values: the second along each axis of three levels or more,
    and the mixed ones of each pair of axes.
    """
    first = [np.diff(np.eye(len(level)), axis=0) / np.diff(level)[:, None] for level in levels]
    second = {
        i: np.diff(first[i], axis=0) / ((level[2:] - level[:-2]) / 2)[:, None]
        for i, level in enumerate(levels)
        if len(level) > 2
    }
    chosen = [{i: D} for i, D in second.items()]
    chosen += [{i: first[i], j: first[j]} for i, j in combinations(range(len(levels)), 2)]
    return [
        reduce(
            scipy.sparse.kron, [scipy.sparse.csr_array(one.get(i, np.eye(len(x)))) for i, x in enumerate(levels)]
        ).tocsr()
        for one in chosen
    ]


def _misfit(grid: Grid) -> Floats:
    """(outputs,) what a piecewise linear field leaves in the middle of cells, from second differences along each axis.

    f'' h^2 / 8 an axis in the middle, a quarter of what a vertex is off the mean of its neighbours. Two levels show no
    curvature: what their vertices leave of a plane stands in for it.
    """
    shape, noise = grid.shape, grid.variances.mean(axis=0)
    cube = grid.values.reshape(*shape, -1)
    square = np.zeros(cube.shape[-1])
    for axis, level in enumerate(grid.levels):
        if len(level) < 3:
            continue
        part = np.moveaxis(cube, axis, 0)
        share = ((level[1:-1] - level[:-2]) / (level[2:] - level[:-2])).reshape(-1, *[1] * (part.ndim - 1))
        off = part[1:-1] - (1 - share) * part[:-2] - share * part[2:]
        square += np.maximum((off**2).reshape(-1, off.shape[-1]).mean(axis=0) - 1.5 * noise, 0) / 16
    if min(shape) < 3:
        corners = np.stack(
            np.meshgrid(*[np.linspace(-1, 1, count) for count in shape], indexing="ij"), axis=-1
        ).reshape(-1, len(shape))
        plane = np.column_stack([np.ones(len(corners)), corners])
        left = grid.values - plane @ np.linalg.lstsq(plane, grid.values, rcond=None)[0]
        square += np.maximum((left**2).sum(axis=0) / max(len(left) - plane.shape[1], 1) - noise, 0)
    return np.sqrt(square)


def _tables(grid: Grid) -> Tables:
    """Tables of a Grid."""
    most = max(grid.shape)
    levels, inverse = np.full((len(grid.levels), most), np.inf), np.zeros((len(grid.levels), most - 1))
    for i, level in enumerate(grid.levels):
        levels[i, : len(level)], inverse[i, : len(level) - 1] = level, 1 / np.diff(level)
    return Tables(
        levels, inverse, np.array(grid.shape) - 1, grid.strides().astype(np.int64), np.ascontiguousarray(grid.values)
    )


class Linear(Grid):
    """A Grid, linear along each axis within its cells."""

    __slots__ = ()
    kind: ClassVar[str] = "linear"
    exact: ClassVar[bool] = True

    def value(self, x: Floats) -> Floats:
        x = np.ascontiguousarray(x, float)
        out = np.empty((x.size // x.shape[-1], self.values.shape[1]))
        fill_n_linear_interpolation(x.reshape(-1, x.shape[-1]), *self.tables, out)
        return out.reshape(*x.shape[:-1], -1)

    def weights(self, x: Floats) -> Weights:
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


class Simplex(Grid):
    """A Grid whose cells are cut into simplices."""

    __slots__ = ()
    kind: ClassVar[str] = "simplex"
    exact: ClassVar[bool] = True

    def value(self, x: Floats) -> Floats:
        x = np.ascontiguousarray(x, float)
        flat, out = x.reshape(-1, x.shape[-1]), np.empty((x.size // x.shape[-1], self.values.shape[1]))
        kernel = compiled_simplex_kernels(x.shape[-1]).values
        if len(flat) < 2 * EACH:
            kernel(flat, *self.tables, out)
        else:
            run_kernel_in_threads(lambda part: kernel(flat[part], *self.tables, out[part]), len(flat))
        return out.reshape(*x.shape[:-1], -1)

    def fixed_points(self, goal: Floats, tolerance: float) -> tuple[Floats, Floats]:
        """(commands (n, axes), what their last step changed (n,)): commands = goal + value(commands), for goals (n,
        axes).
        """
        commands, change = np.empty(goal.shape), np.empty(len(goal))
        kernel = compiled_simplex_kernels(goal.shape[1]).fixed_points
        run_kernel_in_threads(
            lambda part: kernel(goal[part], self.tables, tolerance, commands[part], change[part]), len(goal)
        )
        return commands, change

    def weights(self, x: Floats) -> Weights:
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
