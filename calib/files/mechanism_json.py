"""A mechanism as a JSON file of ours holds it: written, and read with every figure checked."""

from typing import Any

import numpy as np

from calib.files.calibration_file_checks import require_plausible
from rig.formats.checked_entries import LARGEST_RIG, Entries
from rig.model.design import Arm, Chain, Hexapod, Planar2
from rig.model.mechanism_kinds import Struts
from rig.model.pose import pose_entry_text

MOST_JOINTS = 64


def mechanism_dict(mechanism: Struts | Arm | Chain) -> dict[str, Any]:
    """dict of a mechanism, as JSON holds it."""
    if isinstance(mechanism, Chain):
        return {"kind": "chain", "stages": [mechanism_dict(stage) for stage in mechanism.stages]}
    if isinstance(mechanism, Arm):
        return {
            "kind": "arm",
            "joints": mechanism.rows.tolist(),
            "limits": mechanism.limits.tolist(),
            "base": pose_entry_text(mechanism.base),
            "tool": pose_entry_text(mechanism.tool),
            **({"slides": mechanism.slides.tolist()} if mechanism.slides.any() else {}),
        }
    if isinstance(mechanism, Planar2):
        return {
            "kind": "planar2",
            **{name: getattr(mechanism, name).tolist() for name in ("base_joints", "strut_range", "strut_zeros")},
        }
    return {
        "kind": mechanism.kind,
        "base_joints": mechanism.base_joints.tolist(),
        "platform_joints": mechanism.platform_joints.tolist(),
        "strut_range": mechanism.strut_range.tolist(),
        "strut_zeros": mechanism.strut_zeros.tolist(),
        "home": pose_entry_text(mechanism.home),
    }


def mechanism_from_entries(table: Entries, stated: bool = False) -> Struts | Arm | Chain:
    """The mechanism of what `mechanism_dict` gave, as Entries; stated : whether it is the owner's. Raises FileError for
    anything else.
    """
    if table.text("kind", ("hexapod", "planar2", "arm", "chain")) == "chain":
        stages = table.tables("stages")
        if len(stages) < 2:
            table.fail(f"{table.name('stages')} of a chain are two or more, got {len(stages)}", "stages")
        return Chain(tuple(_stage_in(stage, stated) for stage in stages))
    return _stage_in(table, stated)


def _stage_in(table: Entries, stated: bool) -> Struts | Arm:
    """A mechanism that stands alone, or in a chain, of figures that a machine may have."""
    found = _figures_of(table)
    require_plausible(table, found, stated)
    return found


def _figures_of(table: Entries) -> Struts | Arm:
    kind = table.text("kind", ("hexapod", "planar2", "arm"))
    if kind == "planar2":
        return Planar2(
            table.array("base_joints", (2, 2), length_limit=LARGEST_RIG),
            table.array("strut_range", (2, 2), length_limit=LARGEST_RIG),
            table.array("strut_zeros", (2,), length_limit=LARGEST_RIG),
        )
    if kind == "arm":
        rows = table.get("joints")
        columns = (
            len(rows[0]) if isinstance(rows, list) and rows and isinstance(rows[0], list) and len(rows[0]) == 4 else 5
        )
        joints = table.array("joints", (None, columns))
        if not 0 < len(joints) <= MOST_JOINTS:
            table.fail(f"{table.name('joints')} has {len(joints)} rows; an arm has 1 to {MOST_JOINTS} joints", "joints")
        return Arm(
            joints,
            table.array("limits", (len(joints), 2)),
            table.pose("base"),
            table.pose("tool"),
            _slides_in(table, len(joints)),
        )
    return Hexapod(
        table.array("base_joints", (6, 3), length_limit=LARGEST_RIG),
        table.array("platform_joints", (6, 3), length_limit=LARGEST_RIG),
        table.array("strut_range", (6, 2), length_limit=LARGEST_RIG),
        table.pose("home"),
        table.array("strut_zeros", (6,), length_limit=LARGEST_RIG),
    )


def _slides_in(table: Entries, count: int) -> np.ndarray:
    """(count,) bool, which joints slide; none where nothing is said."""
    listed = table.get("slides", [False] * count)
    if not isinstance(listed, list) or len(listed) != count or not all(isinstance(slide, bool) for slide in listed):
        table.fail(f"{table.name('slides')} must list {count} times true or false", "slides")
    return np.array(listed, bool)
