"""A geometry as JSON or CSV: every figure in m and rad, to the last bit (JSON) or to a picometre (CSV)."""

import json
from collections.abc import Iterable

from rig.model.design import Arm, Hexapod
from rig.model.pose import pose_entry_text, pose_to_vector

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


def as_json(mechanism: Hexapod | Arm) -> str:
    """JSON of a Hexapod or an Arm."""
    if mechanism.kind == "hexapod":
        tree = {
            name: getattr(mechanism, name).tolist()
            for name in ("base_joints", "platform_joints", "strut_zeros", "strut_range")
        }
        tree["home"] = pose_entry_text(mechanism.home)
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


def as_csv(mechanism: Hexapod | Arm) -> str:
    """CSV of a Hexapod, a row per strut, or of an Arm, a row per joint; slides : 1 where the joint slides, its limits
    in m.
    """
    header: tuple[str, ...] = HEXAPOD if mechanism.kind == "hexapod" else ARM
    parts: Iterable[tuple]
    if mechanism.kind == "hexapod":
        parts = zip(
            mechanism.base_joints, mechanism.platform_joints, mechanism.strut_zeros[:, None], mechanism.strut_range
        )
    else:
        parts = zip(mechanism.rows, mechanism.limits)
    last = [f",{int(slide)}" for slide in mechanism.slides] if mechanism.kind == "arm" else [""] * len(mechanism.axes)
    rows = [
        ",".join([str(i + 1), *(f"{value:.12f}" for part in row for value in part)]) + end
        for i, (row, end) in enumerate(zip(parts, last))
    ]
    return "\n".join([",".join(header), *rows]) + "\n"
