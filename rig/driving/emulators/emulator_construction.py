"""Construction of a controller emulator from the rig's design."""

import numpy as np

from rig.arrays import Floats
from rig.driving.clock import Clock
from rig.driving.emulators.controller_emulator import Emulator
from rig.driving.emulators.controller_faults import Faults
from rig.driving.emulators.emulated_machine import Machine
from rig.driving.emulators.gcs import GCS
from rig.driving.emulators.grblhal import GrblHAL
from rig.driving.emulators.linuxcnc import LinuxCNC
from rig.driving.emulators.moving_axes import Axes
from rig.driving.emulators.own_strut_protocol import Struts
from rig.errors import RigError
from rig.model.design import Design
from rig.model.mechanism_geometry import Hexapod, Planar2
from rig.model.mechanism_kinds import require_hexapod, require_struts

ACCELERATION = 0.1  # m/s^2, where the rig.toml states none


def emulator_of_design(
    design: Design, faults: Faults, clock: Clock, start_lengths: Floats | None = None, speed_factor: float = 1.0
) -> Emulator:
    """The Emulator of the controller of a rig's design, with faults, clock and start lengths.

    start_lengths : (n,) m, lengths at first, by default those after homing; speed_factor : factor on the struts' speed.

        Raises
    RigError for a start that the struts cannot have, and for a rig without a controller
    """
    c = design.controller
    if c is None:
        raise RigError("the rig.toml has no [controller]; its speeds and zeros are what an emulator needs")
    m = require_struts(design.mechanism)
    home = c.home if c.home is not None else home_lengths(m)
    start_lengths = home if start_lengths is None else np.array(start_lengths, float)
    low, high = m.strut_range.T
    if start_lengths.shape != home.shape or not ((start_lengths >= low) & (start_lengths <= high)).all():
        raise RigError(
            f"the struts cannot start at {start_lengths.tolist()} m; their ranges are {m.strut_range.tolist()} m"
        )
    acceleration = np.full(len(home), ACCELERATION) if c.max_acceleration is None else c.max_acceleration
    axes = Axes(clock.now(), start_lengths, speed_factor * c.max_speed, speed_factor**2 * acceleration)
    machine = Machine(axes, c.zero, home, faults, known=not c.homing)
    limits = m.strut_range - c.zero[:, None]
    if c.protocol == "grblhal":
        return GrblHAL(
            machine, faults, clock, "".join(c.axes) or "XYZABC"[: len(home)], limits, None if c.homing else {22: 0}
        )
    if c.protocol == "gcs":
        return GCS(machine, faults, clock, c.axes or tuple(str(i + 1) for i in range(len(home))), limits)
    if c.protocol == "struts":
        return Struts(machine, faults, clock, limits)
    if c.protocol == "linuxcnc":
        return LinuxCNC(
            machine,
            faults,
            clock,
            c.axes or tuple("XYZABC"[: len(home)]),
            limits,
            require_hexapod(m) if c.kinematics == "world" else None,
        )
    raise RigError(f"there is no emulator of {c.protocol!r}")


def home_lengths(mechanism: Hexapod | Planar2) -> Floats:
    """Home lengths (n,) m: strut lengths at a Hexapod's home pose; for two struts the middle of their ranges."""
    home, (base, platform) = mechanism.home_pose, mechanism.strut_joints
    if home is None:
        return mechanism.strut_range.mean(axis=1)
    return np.linalg.norm(home.apply(platform) - base, axis=1)
