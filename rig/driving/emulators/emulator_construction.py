"""A rig.toml -> the emulator of its controller."""

import numpy as np

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
from rig.model.design import Design, Hexapod, Planar2
from rig.model.mechanism_kinds import hexapod_of, struts_of

ACCELERATION = 0.1  # m/s^2, where the rig.toml states none


def emulator_of_design(
    design: Design, faults: Faults, clock: Clock, start: np.ndarray | None = None, speed: float = 1.0
) -> Emulator:
    """The Emulator of a design's controller.

    start : (n,) m, lengths at first, by default those after homing; speed : factor on the struts' speed. Raises
    RigError for a start that the struts cannot have, and for a rig without a controller
    """
    c = design.controller
    if c is None:
        raise RigError("the rig.toml has no [controller]; its speeds and zeros are what an emulator needs")
    m = struts_of(design.mechanism)
    home = c.home if c.home is not None else home_lengths(m)
    start = home if start is None else np.array(start, float)
    low, high = m.strut_range.T
    if start.shape != home.shape or not ((start >= low) & (start <= high)).all():
        raise RigError(f"the struts cannot start at {start.tolist()} m; their ranges are {m.strut_range.tolist()} m")
    acceleration = np.full(len(home), ACCELERATION) if c.max_acceleration is None else c.max_acceleration
    axes = Axes(clock.now(), start, speed * c.max_speed, speed**2 * acceleration)
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
            hexapod_of(m) if c.kinematics == "world" else None,
        )
    raise RigError(f"there is no emulator of {c.protocol!r}")


def home_lengths(mechanism: Hexapod | Planar2) -> np.ndarray:
    """(n,) m of a Hexapod's home pose; of two struts in the plane the middle of their ranges."""
    if mechanism.kind != "hexapod":
        return mechanism.strut_range.mean(axis=1)
    return np.linalg.norm(mechanism.home.apply(mechanism.platform_joints) - mechanism.base_joints, axis=1)
