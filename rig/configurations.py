"""Which configurations to visit: evenly over a configuration space, on its grids and simplices, along and about the axes of space."""

from itertools import product

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.stats import qmc

from rig import mechanisms
from rig.design import Design, Hexapod
from rig.errors import RigError
from rig.pose import pose

FILL = 0.8  # of the strokes that plans use


def low_discrepancy(strokes: np.ndarray, count: int, fill: float = FILL, seed: int = 0) -> np.ndarray:
    """(count, axes) configurations that cover the middle `fill` of the strokes (axes, 2) evenly (scrambled Sobol points)."""
    points = qmc.Sobol(len(strokes), rng=np.random.default_rng(seed)).random_base2(int(np.ceil(np.log2(max(count, 2)))))[:count]
    return scaled(strokes, 2 * points - 1, fill)


def grid(strokes: np.ndarray, per_axis: int, fill: float = FILL) -> np.ndarray:
    """(per_axis ** axes, axes) vertices of an even cube grid in configuration space (patent [0031], [0032]), serpentine."""
    if per_axis < 2:
        raise RigError(f"a grid has at least 2 points an axis, got {per_axis}")
    return scaled(strokes, np.array(_serpentine(len(strokes), np.linspace(-1, 1, per_axis))), fill)


def _serpentine(axes: int, levels: np.ndarray) -> list[tuple]:
    """Grid points of levels on each axis in an order in which neighbours differ in one axis by one level."""
    if axes == 0:
        return [()]
    inner = _serpentine(axes - 1, levels)
    return [(level, *rest) for k, level in enumerate(levels) for rest in (inner if k % 2 == 0 else inner[::-1])]


def simplices(strokes: np.ndarray, shells: int = 2, fill: float = FILL) -> np.ndarray:
    """Vertices of simplices that fill the configuration space (patent [0033], [0034]): the centre and, on each shell, the
    axes' ends and the corners of a half fraction of the cube, which together split it into simplices."""
    axes = len(strokes)
    ends = np.concatenate([np.eye(axes), -np.eye(axes)])
    corners = np.array([signs for signs in product((-1, 1), repeat=axes) if np.prod(signs) > 0])
    shell = np.concatenate([ends, corners])
    return scaled(strokes, np.concatenate([np.zeros((1, axes)), *[shell * (k + 1) / shells for k in range(shells)]]), fill)


def along_and_about(design: Design, per_axis: int = 9) -> np.ndarray:
    """(6 per_axis, 6) commands of the translations along and rotations about X, Y and Z through home, as far as the struts reach
    (on-line learning patent, [0011]-[0015]). Raises RigError for a mechanism that is no hexapod."""
    mechanism = design.mechanism
    if mechanism.kind != "hexapod":
        raise RigError(f"axes plans are for hexapods, not for a mechanism of kind {mechanism.kind!r}")
    module, middle = mechanisms.of(mechanism), mechanism.strut_range.mean(axis=1)
    found = []
    for axis in range(6):
        reach = []
        for sign in (-1, 1):
            low, high = 0.0, 1.0
            for _ in range(40):
                half = (low + high) / 2
                lengths = module.inverse(_shifted(mechanism, axis, sign * half), mechanism)
                inside = not module.limits(middle + (lengths - middle) / FILL, mechanism).any()
                low, high = (half, high) if inside else (low, half)
            reach.append(sign * low)
        found += [module.inverse(_shifted(mechanism, axis, step), mechanism) for step in np.linspace(reach[0], reach[1], per_axis)]
    return np.array(found)


def _shifted(mechanism: Hexapod, axis: int, step: float) -> RigidTransform:
    offset = np.zeros(6)
    offset[axis] = step
    return pose(offset[:3], [0, 0, 0]) * mechanism.home * pose([0, 0, 0], offset[3:])


def scaled(strokes: np.ndarray, unit: np.ndarray, fill: float) -> np.ndarray:
    """(count, axes) configurations (m or rad) of numbers -1..1 (count, axes), which span the middle `fill` of the strokes (axes, 2)."""
    return strokes.mean(axis=1) + fill * np.ptp(strokes, axis=1) / 2 * unit
