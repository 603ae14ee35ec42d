"""Delaunay interpolation, and kernels of interpolation on grids.

Delaunay interpolation is of scattered samples; compiled kernels interpolate on regular grids.

Beyond the samples' hull a place takes the value where the way to it from their middle leaves the hull, so that the
field goes on continuously. Source: configuration-space patent, [0033], [0034]; Devillers, Pion and Teillaud, Walking in
a triangulation, 2002
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from typing import ClassVar, NamedTuple, Self, TypeVar

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial import Delaunay as Triangulation

from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import (
    FieldSamples,
    WeightedField,
    Weights,
    merge_repeated_samples,
)
from rig.array_and_json_types import Floats, Integers
from rig.compute.numba_compilation_and_kernel_cache_folder import njit
from rig.errors import RigError

MOST = {
    1: 100_000,
    2: 100_000,
    3: 50_000,
    4: 10_000,
    5: 3_000,
    6: 600,
    7: 150,
}  # samples for each number of axes: simplices grow with its factorial
WITHIN = 1 - 1e-9  # of the way to the hull: on a face rounding would decide
EDGE = -1e-10  # of a barycentric weight, for rounding


@dataclass(frozen=True, slots=True, eq=False)
class Delaunay(WeightedField):
    """centre, half : (axes,) scale of the configuration space; samples : (n, axes) scaled; values, variances : (n,
    outputs); misfit : (outputs,).

    Raises RigError for samples that span no simplex, or that are too many for their triangulation to be kept
    """

    centre: Floats
    half: Floats
    samples: Floats
    values: Floats
    variances: Floats
    misfit: Floats
    _cut: Triangulation = field(init=False, repr=False)
    _faces: Floats = field(init=False, repr=False)
    kind: ClassVar[str] = "delaunay"
    exact: ClassVar[bool] = True

    def __post_init__(self) -> None:
        n, axes = self.samples.shape
        if n > MOST.get(axes, 0):
            raise RigError(
                f"{n} samples in {axes} dimensions are too many to triangulate (at most {MOST.get(axes, 0)}); "
                "simplex accepts that number on a grid, radial anywhere"
            )
        if axes < 2:
            raise RigError("delaunay requires at least two axes; on one axis linear is equivalent")
        try:
            object.__setattr__(self, "_cut", Triangulation(self.samples))
            object.__setattr__(self, "_faces", ConvexHull(self.samples).equations)
        except QhullError as error:
            raise RigError(
                f"the {n} samples span no simplex of {axes} dimensions, which delaunay requires: "
                f"{str(error).splitlines()[0]}"
            ) from None

    @classmethod
    def fit(cls, known: FieldSamples) -> Self:
        """The field through samples anywhere, repeats of a configuration averaged. Raises RigError as above."""
        each = merge_repeated_samples(known)
        centre, half = known.strokes.mean(axis=1), np.ptp(known.strokes, axis=1) / 2
        found = cls(
            centre,
            half,
            (each.configurations - centre) / half,
            each.values,
            each.variances,
            np.zeros(each.values.shape[1]),
        )
        return replace(found, misfit=_misfit(found))

    def outside(self, x: Floats) -> Floats:
        scaled = (x - self.centre) / self.half
        return np.linalg.norm(scaled - self._shrunk(scaled)[0], axis=1)

    def weights(self, x: Floats) -> Weights:
        shrunk, share, face = self._shrunk((x - self.centre) / self.half)
        cut = self._cut
        simplex, weight = _walk(
            np.ascontiguousarray(shrunk), cut.transform, cut.neighbors, int(cut.vertex_to_simplex[0])
        )
        T = cut.transform[simplex]
        slope = np.concatenate([T[:, :-1], -T[:, :-1].sum(axis=1, keepdims=True)], axis=1)
        # where the place was drawn in to the hull, only what moves along its face counts: d shrunk = share (I - to n /
        # (n . to)) dx
        to, normal = shrunk - self.samples.mean(axis=0), self._faces[face, :-1]
        along = np.einsum("ni,ni->n", normal, to)
        drawn = share < 1
        slope = np.where(
            drawn[:, None, None],
            share[:, None, None]
            * (slope - (slope @ to[..., None]) * (normal / np.where(drawn, along, 1.0)[:, None])[:, None]),
            slope,
        )
        return Weights(cut.simplices[simplex], weight, slope / self.half)

    def _shrunk(self, scaled: Floats) -> tuple[Floats, Floats, Floats]:
        """(places drawn in to the hull (n, axes), by which share (n,), across which face (n,)) of scaled places (n,
        axes).
        """
        middle = self.samples.mean(axis=0)
        to = scaled - middle
        room = -(self._faces[:, :-1] @ middle + self._faces[:, -1])  # from the middle to each face, positive
        share, face = np.ones(len(scaled)), np.zeros(len(scaled), int)
        for at in range(0, len(scaled), 512):
            crossed = (to[at : at + 512] @ self._faces[:, :-1].T) / room  # 1 on a face
            face[at : at + 512] = crossed.argmax(axis=1)
            share[at : at + 512] = 1 / np.maximum(crossed.max(axis=1), 1.0)
        share = np.where(share < 1, share * WITHIN, 1.0)
        return middle + share[:, None] * to, share, face


@njit(cache=True, error_model="numpy")
def _walk(x: Floats, transform: Floats, neighbors: Floats, start: int) -> tuple[Integers, Floats]:
    """(simplex (n,), barycentric weight (n, axes + 1)) of places x (n, axes) within the hull: across faces, each from
    where the last ended.

    transform : (simplices, axes + 1, axes), NaN for flat ones; neighbors : (simplices, axes + 1), -1 beyond the hull
    """
    n, axes = x.shape
    found, weight, now = np.empty(n, np.int64), np.empty((n, axes + 1)), np.empty(axes + 1)
    at = start
    for q in range(n):
        best, least = -1, -np.inf
        tried = -1  # simplices tried in turn, once flat ones have led the walk astray
        for _ in range(2 * len(transform)):
            now[axes] = 1.0
            for i in range(axes):
                now[i] = 0.0
                for j in range(axes):
                    now[i] += transform[at, i, j] * (x[q, j] - transform[at, axes, j])
                now[axes] -= now[i]
            worst = 0
            for i in range(axes + 1):
                if not now[i] >= now[worst]:
                    worst = i
            if now[worst] > least:
                best, least = at, now[worst]
                weight[q] = now
            if least >= EDGE:
                break
            following = neighbors[at, worst] if tried < 0 and not np.isnan(now[worst]) else -1
            if following < 0:
                tried += 1
                if tried == len(transform):
                    break
                following = tried
            at = following
        at = found[q] = best
        total = 0.0
        for i in range(axes + 1):
            weight[q, i] = max(weight[q, i], 0.0)
            total += weight[q, i]
        for i in range(axes + 1):
            weight[q, i] /= total
    return found, weight


def _misfit(found: Delaunay) -> Floats:
    """(outputs,) what lies between samples: a quarter of what each is off the plane through its nearest others, the
    noise taken out.
    """
    n, axes = found.samples.shape
    count = min(2 * (axes + 1), n - 1)
    if count <= axes + 1:
        return found.values.std(axis=0)
    square = np.zeros(found.values.shape[1])
    for i in range(n):
        far = ((found.samples - found.samples[i]) ** 2).sum(axis=1)
        near = np.argpartition(far, count)[: count + 1]
        near = near[near != i][:count]
        plane = np.column_stack([np.ones(len(near)), found.samples[near] - found.samples[i]])
        coefficients, _, rank, _ = np.linalg.lstsq(plane, found.values[near], rcond=1e-6)
        square += (found.values[i] - coefficients[0]) ** 2
    return np.sqrt(np.maximum(square / n - 2 * found.variances.mean(axis=0), 0)) / 4


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


F = TypeVar("F", bound=Callable[..., None])  # a function that is compiled


@cache
def compiled_simplex_kernels(axes: int) -> SimplexKernels:
    """Simplex kernels compiled for a number of axes.

    Each number has a name of its own: of two functions of one name a process may link the wrong one where one of them
    comes from the cache
    """

    def at_point(
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

    at = njit(cache=True, nogil=True, error_model="numpy")(_named(at_point, axes))

    def simplex(
        x: Floats, levels: Floats, inverse: Floats, cells: Floats, strides: Floats, values: Floats, out: Floats
    ) -> None:
        scratch = np.empty(axes), np.zeros(axes + 1), np.empty(axes, np.int64)
        for q in range(x.shape[0]):
            at(x[q], levels, inverse, cells, strides, values, scratch, out[q])

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

    compiled = njit(cache=True, nogil=True, error_model="numpy")
    return SimplexKernels(*(compiled(_named(one, axes)) for one in (simplex, fixed_points)))


def _named(function: F, axes: int) -> F:
    """A function with the number of axes in its name."""
    function.__name__ = function.__qualname__ = f"{function.__name__}_of_{axes}_axes"
    return function


@njit(cache=True, nogil=True, error_model="numpy")
def fill_n_linear_interpolation(
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
