"""Whether the frames and the commands of an import are on one clock; where not, by how much they differ."""

from decimal import Decimal

import numpy as np

from rig.checks.clock_shift import standing_shift
from rig.errors import RigError
from rig.formats.importers.command_table import Commanded
from rig.formats.importers.image_file_frames import Exposed
from rig.recording.recording_folder import LAST_DWELL
from rig.recording.time_origin import DIGITS


def require_one_clock(exposed: Exposed, commanded: Commanded | None) -> None:
    """Raise RigError where frames and commands are on different clocks."""
    if commanded is None or commanded.t is None:
        return
    t = sorted(set(exposed.times()))
    section = "images" if any(exposed.camera) else "poses"
    first, last = commanded.t[0], commanded.t[-1]
    after = sum(s > last for s in t)
    if t[0] >= first and (after <= 1 or after <= LAST_DWELL * len(t)):
        return
    clash = (
        f"frames and commands are on different clocks: frames run from {t[0]:f} to {t[-1]:f} s, commands from "
        f"{first:f} to {last:f} s"
    )
    standing = standing_shift(seconds_from(t, first), seconds_from(commanded.t, first), commanded.values)
    if standing is not None:
        raise RigError(
            f"{clash}; --set {section}.shift={standing.shift:.3f} is what puts {standing.frames} of {len(t)} "
            "frames where the commands "
            f"stand still, the middle of what does, +-{standing.room:.2g} s"
        )
    by = first - t[0]
    raise RigError(
        f"{clash}; state the unit or what is to be added: --set {section}.shift={by:.6f} brings the first "
        "frame to the first command"
        "; --set commands.shift=S moves the commands"
    )


def seconds_from(t: list[Decimal], origin: Decimal) -> np.ndarray:
    """(n,) s from an origin."""
    return np.array([float(DIGITS.subtract(one, origin)) for one in t])
