"""Clock consistency of imported frames and commands: whether both use one clock, else the shift."""

from decimal import Decimal

import numpy as np

from rig.arrays import Floats
from rig.checks.clock_mistakes import dwell_clock_shift
from rig.errors import RigError
from rig.formats.importers.command_table import Commanded
from rig.formats.importers.image_file_frames import Exposed
from rig.recording.recording_folder import LAST_DWELL
from rig.recording.time_origin import DIGITS


def require_one_clock(exposures: Exposed, commands: Commanded | None) -> None:
    """Raise RigError unless exposures and commands are on one clock."""
    if commands is None or commands.t is None:
        return
    t = sorted(set(exposures.times()))
    section = "images" if any(exposures.camera) else "poses"
    first, last = commands.t[0], commands.t[-1]
    after = sum(s > last for s in t)
    if t[0] >= first and (after <= 1 or after <= LAST_DWELL * len(t)):
        return
    clash = (
        f"frames and commands are on different clocks: frames run from {t[0]:f} to {t[-1]:f} s, commands from "
        f"{first:f} to {last:f} s"
    )
    standing = dwell_clock_shift(
        seconds_since_origin(t, first), seconds_since_origin(commands.t, first), commands.values
    )
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


def seconds_since_origin(t: list[Decimal], origin: Decimal) -> Floats:
    """Seconds (n,) of times since an origin."""
    return np.array([float(DIGITS.subtract(one, origin)) for one in t])
