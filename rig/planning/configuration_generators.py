"""Generators of configurations to visit.

Sobol points, grids, simplices, moves along axes, ISO 9283 poses.
"""

from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.errors import FileError, RigError
from rig.formats import csv_and_parquet_tables_and_time_origin
from rig.formats.local_and_remote_input_files import short_repr
from rig.model import mechanisms
from rig.model.design import Design
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Commanded,
    is_redundant,
    require_hexapod_or_redundant_hexapod,
)
from rig.model.mechanisms.redundant_strut_best_six_legs_and_loop_closures import nearest_compatible_strut_lengths
from rig.model.pose import pose

FILL = 0.8  # of the strokes that plans use
FARTHEST = 1.0  # m or rad from home, or times a way
DIAGONAL = 0.8  # of half the cube's diagonal, at which ISO 9283 places its poses: a tenth of the whole from each end


def sobol_configurations(strokes: Floats, count: int, fill: float = FILL, seed: int = 0) -> Floats:
    """Sobol configurations (count, axes) over the strokes (axes, 2).

    They cover the middle `fill` of them evenly.
    """
    return scale_to_strokes(strokes, 2 * _sobol_points(len(strokes), count, seed) - 1, fill)


def evenly_spread_configurations(mechanism: Commanded, count: int, fill: float = FILL, seed: int = 0) -> Floats:
    """Evenly spread configurations (count, axes) of a mechanism, m or rad.

    Sobol points that cover the middle `fill` of its travel.
    Of more than six struts the nearest that close on poses. Raises NotConverged where none do
    """
    found = sobol_configurations(mechanisms.kinematics_of(mechanism).travel_ranges(mechanism), count, fill, seed)
    if is_redundant(mechanism):
        return nearest_compatible_strut_lengths(found, mechanism, fill)
    return mechanisms.with_followers(found, mechanism)


def _sobol_points(axes: int, count: int, seed: int) -> Floats:
    """Scrambled Sobol points (count, axes) of the unit cube, 0 to 1."""
    import scipy.stats.qmc  # takes a third of a second

    whole = int(np.ceil(np.log2(max(count, 2))))
    return np.asarray(scipy.stats.qmc.Sobol(axes, rng=np.random.default_rng(seed)).random_base2(whole)[:count])


def grid_configurations(strokes: Floats, per_axis: int, fill: float = FILL) -> Floats:
    """Grid configurations (per_axis ** axes, axes) over the strokes.

    Even, in serpentine order.
    Raises RigError for less than two points an axis.
    """
    if per_axis < 2:
        raise RigError(f"a grid has at least 2 points an axis, got {per_axis}")
    return scale_to_strokes(strokes, np.array(_serpentine(len(strokes), np.linspace(-1, 1, per_axis))), fill)


def _serpentine(axes: int, levels: Floats) -> list[tuple[float, ...]]:
    """Grid points of levels on each axis in an order in which neighbours differ in one axis by one level."""
    return _vertices([levels] * axes)


def _vertices(levels: Sequence[Floats]) -> list[tuple[float, ...]]:
    """Grid points of each axis' own levels in an order in which neighbours differ in one axis by one level."""
    if not len(levels):
        return [()]
    inner = _vertices(levels[1:])
    return [(level, *rest) for k, level in enumerate(levels[0]) for rest in (inner if k % 2 == 0 else inner[::-1])]


def divided_grid_configurations(strokes: Floats, division: str) -> Floats:
    """Grid configurations (vertices, axes) of a division of each axis.

    In serpentine order.
    strokes : (axes, 2); division : "3", parts of every axis, or "3x3x2x3x3x2", of each, evenly over the middle FILL of
        the
    strokes, or over another share of them, "3@0.5"; or the name of a table axis,level with the levels of each axis,
    evenly or not, m or rad
    Raises RigError for a text that is no division, FileError for a table with levels twice, beyond the strokes, or
        fewer than two of an axis
    Source: configuration-space patent, [0028], [0031], [0032], [0126], [0127], [0145]
    """
    return np.array(
        _vertices(
            _levels_of_file(strokes, Path(division))
            if division.endswith(".csv")
            else _levels_of_text(strokes, division)
        )
    )


def parse_grid_parts_and_stroke_share(axes: int, text: str) -> tuple[list[int], float]:
    """Parts of each axis, and share of the strokes, parsed from the text of a grid division.

    Returns (parts of each axis, share of the strokes)
    Raises RigError where it is none.
    """
    numbers, _, share = text.partition("@")
    found = numbers.split("x")
    whole = all(one.isascii() and one.isdigit() and 1 <= len(one) <= 4 and int(one) for one in found)
    try:
        fill = float(share) if share else FILL
    except ValueError:
        fill = 0.0
    if not whole or len(found) not in (1, axes) or not 0 < fill <= 1:
        raise RigError(
            f"a division is the parts of every axis (3), of each of the {axes} (3x2x..), with a share of the "
            "strokes (3@0.5) up to 1 or "
            f"not, or a table axis,level (FILE.csv), not {short_repr(text)}"
        )
    return [int(one) for one in (found * axes if len(found) == 1 else found)], fill


def _levels_of_text(strokes: Floats, text: str) -> list[Floats]:
    counts, fill = parse_grid_parts_and_stroke_share(len(strokes), text)
    middle, half = strokes.mean(axis=1), fill * np.ptp(strokes, axis=1) / 2
    return [middle[i] + half[i] * np.linspace(-1, 1, count + 1) for i, count in enumerate(counts)]


def _levels_of_file(strokes: Floats, path: Path) -> list[Floats]:
    rows = csv_and_parquet_tables_and_time_origin.read_csv_table(path, ("axis", "level"))
    axis, level = rows.matrix(("axis", "level")).T
    out = []
    for i, (low, high) in enumerate(strokes):
        mine = np.flatnonzero(axis == i + 1)
        for k in mine[(level[mine] < low) | (level[mine] > high)]:
            rows.fail(
                f"the level {level[k]:g} of axis {i + 1} is beyond its stroke, {low:g} to {high:g} (m or rad)", int(k)
            )
        levels = np.unique(level[mine])
        if len(levels) < 2 or len(levels) < len(mine):
            raise FileError(
                path,
                f"axis {i + 1} must have two levels or more, each once; it has {len(mine)}, {len(levels)} of "
                "them different",
            )
        out.append(levels)
    for k in np.flatnonzero(~np.isin(axis, np.arange(1, len(strokes) + 1))):
        rows.fail(f"there is no axis {axis[k]:g}: axes are 1 to {len(strokes)}", int(k))
    return out


def simplex_configurations(strokes: Floats, shells: int = 2, fill: float = FILL) -> Floats:
    """Simplex configurations (n, axes) over the strokes, in shells.

    At the centre, the axis ends and half of the corners.
    The corners are a half fraction of the cube's, which with the ends split it into simplices.
    strokes : (axes, 2) m or rad
    """
    axes = len(strokes)
    ends = np.concatenate([np.eye(axes), -np.eye(axes)])
    corners = np.array([signs for signs in product((-1, 1), repeat=axes) if np.prod(signs) > 0])
    shell = np.concatenate([ends, corners])
    return scale_to_strokes(
        strokes, np.concatenate([np.zeros((1, axes)), *[shell * (k + 1) / shells for k in range(shells)]]), fill
    )


def single_axis_pose_commands(design: Design, per_axis: int = 9) -> Floats:
    """Commands (6 per_axis, axes) of pose moves along and about single axes.

    X, Y, Z through home.
    Raises RigError for a mechanism that is not a hexapod.
    Source: on-line learning patent, [0011]-[0015]
    """
    mechanism = _hexapod(design, "axes plans are for hexapods")
    return _through_home(mechanism, np.eye(6), per_axis)


def combined_translation_rotation_commands(design: Design, per_pair: int = 6) -> Floats:
    """Commands (18 per_pair, axes) of moves that combine a translation and a rotation.

    Through home.
    Raises RigError for a mechanism that is not a hexapod
    """
    mechanism = _hexapod(design, "combined plans are for hexapods")
    alone = np.diag(_reach(mechanism, np.eye(6)))
    return _through_home(
        mechanism,
        np.array([along + sign * about for along in alone[:3] for about in alone[3:] for sign in (1, -1)]),
        per_pair,
    )


def _hexapod(design: Design, what: str) -> Hexapod:
    """A design's mechanism. Raises RigError for one that is not a hexapod, of which `what` says the rest."""
    return require_hexapod_or_redundant_hexapod(design.mechanism, f"{what}, not for a mechanism of kind {{kind!r}}")


def _through_home(mechanism: Hexapod, ways: Floats, count: int) -> Floats:
    """(k count, axes) m, commands along ways (k, 6) m, rad through home, one after the other, as far as the struts
    reach on either side.
    """
    steps = np.linspace(-_reach(mechanism, -ways), _reach(mechanism, ways), count, axis=1)
    return mechanisms.kinematics_of(mechanism).inverse(
        _shifted(mechanism, (steps[..., None] * ways[:, None]).reshape(-1, 6)), mechanism
    )


def _reach(mechanism: Hexapod, ways: Floats) -> Floats:
    """(k,) how many times each way (k, 6) m, rad from home the struts reach, within the middle part FILL of their
    strokes; at most FARTHEST.
    """
    module, middle = mechanisms.kinematics_of(mechanism), mechanism.strut_range.mean(axis=1)
    low, high = np.zeros(len(ways)), np.full(len(ways), FARTHEST)
    for _ in range(40):
        half = (low + high) / 2
        lengths = module.inverse(_shifted(mechanism, half[:, None] * ways), mechanism)
        inside = ~module.signed_limit_excess(middle + (lengths - middle) / FILL, mechanism).any(axis=1)
        low, high = np.where(inside, half, low), np.where(inside, high, half)
    return low


def iso9283_five_test_pose_commands(design: Design) -> Floats:
    """Commands (5, axes) of the five test poses of ISO 9283.

    P1 to P5, each once.
    P1 is the middle of a cube; P2 to P5 lie on the diagonals of a plane through four of its corners, a tenth of the
    diagonal from each.
    Raises RigError for a mechanism that is not a hexapod.
    """
    mechanism = _hexapod(design, "ISO 9283's poses are planned for hexapods")
    corners = np.pad(list(product((-1.0, 1.0), repeat=3)), ((0, 0), (0, 3)))
    half = _reach(mechanism, corners).min()
    plane = corners[corners[:, 1] == corners[:, 2]]
    return mechanisms.kinematics_of(mechanism).inverse(
        _shifted(mechanism, half * np.concatenate([np.zeros((1, 6)), DIAGONAL * plane])), mechanism
    )


def _shifted(mechanism: Hexapod, offset: Floats) -> RigidTransform:
    """Home moved and turned by offsets (k, 6) m, rad."""
    return (
        pose(offset[:, :3], np.zeros((len(offset), 3)))
        * mechanism.home
        * pose(np.zeros((len(offset), 3)), offset[:, 3:])
    )


def scale_to_strokes(strokes: Floats, unit_points: Floats, fill: float) -> Floats:
    """Unit points (-1..1) scaled to the middle `fill` of the strokes.

    Configurations (count, axes), m or rad.
    """
    return strokes.mean(axis=1) + fill * np.ptp(strokes, axis=1) / 2 * unit_points
