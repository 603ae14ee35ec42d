"""Hexapod and two-strut entries of rig.toml.

Hexapods of six to eight struts and two struts in a plane, read with checks.
"""

import numpy as np

from rig.array_and_json_types import Floats
from rig.formats.checked_toml_and_json_entries import LARGEST_RIG, Entries
from rig.model.mechanism_geometry_classes import STRUT_COUNTS, Hexapod, Planar2
from rig.model.mechanisms.hexapod import singular_geometry_problem
from rig.model.mechanisms.redundant_strut_best_six_legs_and_loop_closures import hexapod_of_actuated_struts

SHORTEST = 2e-3  # m; no strut is shorter, so that a smaller figure in a file in mm is in metres


def two_strut_plane_of_table(table: Entries) -> Planar2:
    """Mechanism of two struts in a plane (Planar2) of a table, lengths in m. Raises FileError."""
    table.refuse_misspelt(("kind", "base_joints", "strut_range"))
    return Planar2(
        table.array("base_joints", (2, 2), length_limit=LARGEST_RIG),
        _strut_ranges(table, "strut_range", 2, LARGEST_RIG),
    )


def hexapod_of_table(table: Entries) -> Hexapod:
    """Hexapod of a table, lengths in m.

    Raises FileError for a home out of reach or where the struts are singular.
    """
    table.refuse_misspelt(("kind", "base_joints", "platform_joints", "strut_range", "home", "followers"))
    count = stated_strut_count(table)
    base = table.array("base_joints", (count, 3), length_limit=LARGEST_RIG)
    platform = table.array("platform_joints", (count, 3), length_limit=LARGEST_RIG)
    ranges = _strut_ranges(table, "strut_range", count, LARGEST_RIG)
    hexapod = Hexapod(base, platform, ranges, table.pose("home"), followers=follower_strut_numbers(table, count))
    per_m, unit = table.units.per_si("m"), table.units.length
    digits = 6 if unit == "m" else 3
    lengths = np.linalg.norm(hexapod.home.apply(platform) - base, axis=1)
    for i, (length, (low, high)) in enumerate(zip(lengths, hexapod.strut_range)):
        if not low <= length <= high:
            table.fail(
                f"{table.name('home')} needs strut {i + 1} at {length * per_m:.{digits}f} {unit}, outside its "
                f"strut_range {low * per_m:.10g} .. {high * per_m:.10g} {unit}",
                "home",
            )
    for which in (hexapod, hexapod_of_actuated_struts(hexapod)) if hexapod.followers else (hexapod,):
        if singular_geometry_problem(which):
            whose = "" if which is hexapod else " with the driven struts alone"
            table.fail(f"{table.name('home')}{whose} {singular_geometry_problem(which)}", "home")
    return hexapod


def stated_strut_count(table: Entries) -> int:
    """Number of struts that a hexapod's table states.

    Six to eight, for which it lists joints of both plates.
    """
    plates = [table.tree.get(key) for key in ("base_joints", "platform_joints")]
    listed = min(len(rows) if isinstance(rows, list) else 0 for rows in plates)
    return min(max(listed, STRUT_COUNTS[0]), STRUT_COUNTS[-1])


def follower_strut_numbers(table: Entries, count: int) -> tuple[int, ...]:
    """Numbers, from 0, of the follower struts that a table states.

    They bear no force and follow; of `count` struts, none where nothing is stated.
    Raises FileError for other numbers than there are struts beyond six
    """
    stated = table.get("followers", [])
    listed = stated if isinstance(stated, list) else [None]
    numbers = [one - 1 for one in listed if isinstance(one, int) and not isinstance(one, bool) and 1 <= one <= count]
    if len(numbers) < len(listed) or listed and len(set(numbers)) != count - 6:
        least = f"the {count - 6} struts beyond six" if count > 6 else "struts beyond six, and there are six"
        table.fail(f"{table.name('followers')} lists the numbers, from 1, of {least}, not {stated!r}", "followers")
    return tuple(numbers)


def _strut_ranges(table: Entries, key: str, count: int, length_limit: float) -> Floats:
    ranges = table.array(key, (count, 2), length_limit=length_limit)
    for i, (low, high) in enumerate(ranges):
        if not low < high:
            table.fail(message_of_disordered_limits(table, key, (low, high), "m", i), key, i)
        if low <= 0:
            table.fail(f"{table.name(key)}[{i + 1}] must be positive, not {table.units.shown(low, 'm')}", key, i, 0)
        if high < SHORTEST and table.units.length != "m":
            table.fail(
                f"{table.name(key)}[{i + 1}] ends at {table.units.shown(high, 'm')}, shorter than any strut: the file "
                f'states units = "{table.units}"; is this in metres?',
                key,
                i,
                1,
            )
    return ranges


def message_of_disordered_limits(
    table: Entries, key: str, limits: tuple[float, float], unit: str, row: int | None = None
) -> str:
    """Message that limits are not in the order smaller, larger.

    limits : in SI; row : of the key, or None
    """
    low, high = (table.units.shown(value, unit).removesuffix(" rad" if unit == "rad" else " m") for value in limits)
    label = table.name(key) + ("" if row is None else f"[{row + 1}]")
    return f"{label} must run from small to large, not {low} .. {high}"
