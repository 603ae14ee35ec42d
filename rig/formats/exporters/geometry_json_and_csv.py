"""Geometry of a mechanism as JSON or CSV, in m and rad."""

import json
from collections.abc import Iterable
from typing import Any

from rig.model.mechanism_geometry import Arm, Hexapod
from rig.model.mechanism_kinds import has_plates
from rig.model.pose import pose_to_entry, pose_to_vector

HEXAPOD = (
    "strut",
    "base_x",
    "base_y",
    "base_z",
    "platform_x",
    "platform_y",
    "platform_z",
    "zero",
    "shortest",
    "longest",
)
ARM = ("joint", "theta", "d", "a", "alpha", "beta", "lowest", "highest", "slides")


def geometry_json(mechanism: Hexapod | Arm) -> str:
    """Geometry of a Hexapod or an Arm as JSON."""
    if has_plates(mechanism):
        tree = {
            name: getattr(mechanism, name).tolist()
            for name in ("base_joints", "platform_joints", "strut_zeros", "strut_range")
        }
        tree["home"] = pose_to_entry(mechanism.home)
    else:
        tree = {
            "joints": mechanism.joints.tolist(),
            "limits": mechanism.limits.tolist(),
            "slides": mechanism.slides.tolist(),
        }
        tree |= {
            name: pose_to_vector(getattr(mechanism, name)).tolist()
            for name in ("base", "tool")
            if hasattr(mechanism, name)
        }
    return json.dumps({"schema": "geometry/1", "kind": mechanism.kind, "units": "m, rad", **tree}, indent=1) + "\n"


def geometry_csv(mechanism: Hexapod | Arm) -> str:
    """Geometry as CSV: a row per strut of a Hexapod, a row per joint of an Arm."""
    header: tuple[str, ...]
    parts: Iterable[tuple[Any, ...]]
    if has_plates(mechanism):
        header, last = HEXAPOD, [""] * len(mechanism.axes)
        parts = zip(
            mechanism.base_joints, mechanism.platform_joints, mechanism.strut_zeros[:, None], mechanism.strut_range
        )
    else:
        header, last = ARM, [f",{int(slide)}" for slide in mechanism.slides]
        parts = zip(mechanism.rows, mechanism.limits)
    rows = [
        ",".join([str(i + 1), *(f"{value:.12f}" for part in row for value in part)]) + end
        for i, (row, end) in enumerate(zip(parts, last))
    ]
    return "\n".join([",".join(header), *rows]) + "\n"
