"""What a calibration.json must state word for word, and what figures of a mechanism no machine has: without it a file
means something else.
"""

from collections.abc import Sequence

import numpy as np

from rig.formats.checked_entries import LARGEST_RIG, Entries
from rig.formats.input_files import value_text
from rig.model import mechanisms
from rig.model.design import Arm, Chain, Hexapod, Planar2
from rig.model.mechanism_kinds import Struts


def require_text(tree: Entries, key: str, known: Sequence[str]) -> None:
    """Raise FileError where a key holds another text than those known, the newest first: units, frames and orders are
    not converted.
    """
    found = tree.text(key)
    if found not in known:
        differs = next((i for i, (a, b) in enumerate(zip(found, known[0])) if a != b), min(len(found), len(known[0])))
        start = max(differs - 20, 0)
        tree.fail(
            f"{key} is {value_text(found[start : differs + 40])} where this rig reads "
            f"{value_text(known[0][start : differs + 40])} "
            f"(character {differs + 1}); nothing is converted",
            key,
            value=found,
        )


def require_contents(tree: Entries, needed: Sequence[str], refused: Sequence[str]) -> None:
    """Raise FileError where a file of a schema lacks what that schema stands for, or holds what only another one
    has.
    """
    schema = tree.text("schema")
    for key in needed:
        if tree.get(key, None) is None:
            tree.fail(f"{key} is missing, and a file of schema {value_text(schema)} has it", "schema")
    for key in refused:
        if key in tree.tree:
            tree.fail(
                f"{key} is there, and a file of schema {value_text(schema)} has none: a reader of that "
                "schema would leave it out in silence",
                key,
            )


def require_plausible(table: Entries, mechanism: Struts | Arm, stated: bool) -> None:
    """Raise FileError for ranges, zeros and joints that no machine has, lengths in m. stated : whether it is the
    owner's, whose home is in reach
    """
    if isinstance(mechanism, Arm):
        _arm(table, mechanism)
        return
    for i, (low, high) in enumerate(mechanism.strut_range):
        if not 0 < low < high:
            table.fail(
                f"{table.name('strut_range')}[{i + 1}] must be positive and run from small to large, not "
                f"{low:g} .. {high:g} m",
                "strut_range",
                i,
                value=[low, high],
            )
        if abs(mechanism.strut_zeros[i]) > high:
            table.fail(
                f"{table.name('strut_zeros')}[{i + 1}] = {mechanism.strut_zeros[i]:g} m is more than the "
                f"strut's greatest length, {high:g} m",
                "strut_zeros",
                i,
                value=float(mechanism.strut_zeros[i]),
            )
    if stated and isinstance(mechanism, Hexapod):
        lengths = mechanisms.kinematics_of(mechanism).home(mechanism)
        for i, (length, (low, high)) in enumerate(zip(lengths, mechanism.strut_range)):
            if not low <= length <= high:
                table.fail(
                    f"{table.name('home')} needs strut {i + 1} at {length:.6f} m, outside its strut_range "
                    f"{low:g} .. {high:g} m",
                    "home",
                )


def require_same_ranges(tree: Entries, nominal: Struts | Arm | Chain, fitted: Struts | Arm | Chain) -> None:
    """Raise FileError where the fitted mechanism is of another kind than the nominal one, or may move elsewhere: ranges
    are stated, not fitted.
    """
    if (fitted.kind, len(fitted.axes)) != (nominal.kind, len(nominal.axes)):
        tree.fail(
            f"fitted is of kind {fitted.kind!r} with {len(fitted.axes)} axes, nominal of kind "
            f"{nominal.kind!r} with {len(nominal.axes)}",
            "fitted",
            "kind",
        )
    if isinstance(nominal, Hexapod | Planar2) and isinstance(fitted, Hexapod | Planar2):
        different = np.flatnonzero((nominal.strut_range != fitted.strut_range).any(axis=1))
        if len(different):
            i = int(different[0])
            tree.fail(
                f"fitted.strut_range[{i + 1}] is {fitted.strut_range[i].tolist()} m and nominal.strut_range[{i + 1}] "
                f"{nominal.strut_range[i].tolist()} m: they are the same strut's",
                "fitted",
                "strut_range",
                i,
            )


def _arm(table: Entries, arm: Arm) -> None:
    for i, (low, high) in enumerate(arm.limits):
        if not low < high:
            table.fail(
                f"{table.name('limits')}[{i + 1}] must run from small to large, not {low:g} .. {high:g}",
                "limits",
                i,
                value=[low, high],
            )
        if arm.slides[i]:
            for j in range(2):
                table.numbers(float(arm.limits[i, j]), (), "limits", (i, j), LARGEST_RIG)
    for i, j in np.argwhere(np.abs(arm.rows[:, 1:3]) > LARGEST_RIG):
        table.numbers(float(arm.rows[i, 1 + j]), (), "joints", (int(i), int(1 + j)), LARGEST_RIG)
