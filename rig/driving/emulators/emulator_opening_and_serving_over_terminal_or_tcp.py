"""Opening of a controller emulator, and serving it over a terminal or TCP.

From the rig's design; it answers at a terminal or over TCP.
"""

import os
import select
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.axis_display_units_and_controller_counts import axes_word, parse_axis_values
from rig.driving.driving_clock import Clock, SimulatedClock
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import (
    EmulatedMachine,
    Faults,
    MovingAxes,
    parse_fault_orders,
)
from rig.driving.emulators.emulated_hexapod_controller_pose_geometry import EmulatedPlatform
from rig.driving.emulators.emulated_newport_tcp_function_server import FunctionServer
from rig.driving.emulators.emulator_base_true_command_log_and_user_emulators import Emulator, load_user_emulator
from rig.driving.emulators.epics import EpicsMotors, EpicsPoseRecords
from rig.driving.emulators.gcs import GCS, GCSHexapod
from rig.driving.emulators.grblhal import GrblHAL
from rig.driving.emulators.linuxcnc import LinuxCNC
from rig.driving.emulators.native_strut_protocol import Struts
from rig.driving.emulators.newport_hxp import NewportHexapod
from rig.driving.emulators.symetrie import SymetrieHexapod
from rig.driving.emulators.tcp_servers_of_emulators import ByteServer
from rig.driving.emulators.urscript import RealTimeServer, UniversalRobot
from rig.driving.user_protocol_camera_sensor_classes_and_sensor_reader import refuse_programs_of_untrusted_rig_toml
from rig.errors import RigError
from rig.formats.rig_toml import design_from_rig_toml
from rig.model import mechanisms
from rig.model.design import Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Commanded, require_axes, require_hexapod
from rig.model.protocol_port_and_user_program_name_checks import TAKE_POSES, is_user_file_or_package

SI = {"m": 1.0, "rad": 1.0}
ACCELERATION = 0.1  # m/s^2 or rad/s^2, where the rig.toml states none


@dataclass(frozen=True, slots=True)
class EmulatorOptions:
    """protocol : None as the rig.toml states; faults : texts KIND[:RATE]; seed : of the faults; start : values of the
    axes at first, m or rad where they have no unit, as a text separated by commas, or None; speed : factor on the
    axes' speed
    Raises RigError for a speed that is not above 0
    """

    protocol: str | None = None
    faults: tuple[str, ...] = ()
    seed: int = 0
    start: str | None = None
    speed: float = 1.0

    def __post_init__(self) -> None:
        if not self.speed > 0:
            raise RigError(f"--speed must be above 0, not {self.speed:g}")

    def start_values(self, units: Sequence[str]) -> Floats | None:
        """(n,) m or rad, None where none are stated. units : of the axes. Raises RigError for other texts."""
        return parse_axis_values("--start", self.start.split(","), units, SI) if self.start else None


def emulator_of_rig_toml_controller(path: Path, options: EmulatorOptions, clock: Clock) -> Emulator:
    """Load the emulator of a rig.toml's controller.

    Raises RigError for a rig without controller or invalid options.
    """
    design = design_from_rig_toml.load_design(path)
    if design.controller is None:
        raise RigError(f"{path} has no [controller]; an emulator needs its speeds and zeros")
    refuse_programs_of_untrusted_rig_toml(path, design)
    if options.protocol:
        design = replace(design, controller=replace(design.controller, protocol=options.protocol))
    faults = Faults(sum((parse_fault_orders(text) for text in options.faults), ()), np.random.default_rng(options.seed))
    units = mechanisms.axis_units(design.mechanism)
    return emulator_of_design(design, faults, clock, options.start_values(units), options.speed)


def emulator_of_design(
    design: Design, faults: Faults, clock: Clock, start_lengths: Floats | None = None, speed_factor: float = 1.0
) -> Emulator:
    """The Emulator of a design's controller.

    With faults, clock and start values.
    start_lengths : (n,) m or rad, at first, by default those after homing; speed_factor : factor on the axes' speed
    Raises RigError for a start that the axes cannot have, and for a rig without a controller
    """
    c = design.controller
    if c is None:
        raise RigError("the rig.toml has no [controller]; an emulator needs its speeds and zeros")
    m = require_axes(design.mechanism)
    home = c.home if c.home is not None else home_lengths(m)
    start_lengths = home if start_lengths is None else np.array(start_lengths, float)
    ranges = mechanisms.kinematics_of(m).travel_ranges(m)
    low, high = ranges.T
    if start_lengths.shape != home.shape or not ((start_lengths >= low) & (start_lengths <= high)).all():
        raise RigError(
            f"the {axes_word(m)} cannot start at {start_lengths.tolist()}; their ranges are {ranges.tolist()} "
            f"{mechanisms.travel_unit(m)}"
        )
    acceleration = np.full(len(home), ACCELERATION) if c.max_acceleration is None else c.max_acceleration
    axes = MovingAxes(clock.now(), start_lengths, speed_factor * c.max_speed, speed_factor**2 * acceleration)
    zero = home if c.protocol in TAKE_POSES else c.zero  # its poses count from home, whatever lengths are called 0
    machine = EmulatedMachine(axes, zero, home, faults, known=not c.homing or c.protocol == "urscript")
    limits = ranges - zero[:, None]
    if is_user_file_or_package(c.protocol):
        return load_user_emulator(c.protocol)(machine, faults, clock, limits)
    if c.protocol == "grblhal":
        return GrblHAL(
            machine,
            faults,
            clock,
            "".join(c.axes) or "XYZABCUVW"[: len(home)],
            limits,
            None if c.homing else {22: 0},
            mechanisms.axis_units(m),
        )
    if c.protocol == "gcs":
        return GCS(machine, faults, clock, c.axes or tuple(str(i + 1) for i in range(len(home))), limits)
    if c.protocol == "gcs-hexapod":
        return GCSHexapod(machine, faults, clock, require_hexapod(m), limits, c.work, c.tool)
    if c.protocol == "hxp":
        return NewportHexapod(machine, faults, clock, limits, require_hexapod(m), c.work, c.tool, c.angles)
    if c.protocol == "symetrie":
        return SymetrieHexapod(machine, faults, clock, limits, require_hexapod(m), c.work, c.tool)
    if c.protocol == "struts":
        return Struts(machine, faults, clock, limits)
    if c.protocol == "linuxcnc":
        return LinuxCNC(
            machine,
            faults,
            clock,
            c.axes or tuple("XYZABCUVW"[: len(home)]),
            limits,
            require_hexapod(m) if c.kinematics == "world" else None,
            mechanisms.axis_units(m),
        )
    records = c.axes or tuple(f"m{i + 1}" for i in range(len(home)))
    if c.protocol == "epics":
        return EpicsMotors(machine, faults, clock, records, limits)
    if c.protocol == "epics-hexapod":
        platform = EmulatedPlatform(require_hexapod(m), c.work, c.tool, c.angles)
        return EpicsPoseRecords(machine, faults, clock, records, limits, platform)
    if c.protocol == "urscript":
        return UniversalRobot(machine, faults, clock, limits)
    raise RigError(f"there is no emulator of {c.protocol!r}")


def home_lengths(mechanism: Commanded) -> Floats:
    """Home lengths or joint values (n,) m or rad of a mechanism.

    They hold where [controller] home states none.
    Those of the home pose; of what does not lie within an axis's range the middle of it.
    """
    module = mechanisms.kinematics_of(mechanism)
    home, ranges = module.home_values(mechanism), module.travel_ranges(mechanism)
    low, high = ranges.T
    return np.where((home > low) & (home < high), home, ranges.mean(axis=1))


INSTANT = 1e-6  # s; a sum of times may round to just before


class EmulatorPort:
    """See rig.driving.request_and_answer_exchange_with_controller.Port. emulator : its clock must be the one given."""

    def __init__(self, emulator: Emulator, clock: SimulatedClock) -> None:
        self._emulator, self._clock = emulator, clock
        emulator.due()  # what was said before anybody listened is gone, and a cut line raises

    def write(self, data: bytes) -> None:
        self._emulator.receive(data)

    def read(self, until: float) -> bytes:
        while not (data := self._emulator.due()):
            if self._clock.now() >= until:
                return b""
            come = self._emulator.next()
            self._clock.sleep(max(min(until, until if come is None else come) - self._clock.now(), 0.0) + INSTANT)
        return data

    def close(self) -> None:
        """Nothing is held."""


MOST = 4096  # bytes of a read
IDLE = 0.2  # s between looks at whether to end


class Wire(Protocol):
    """What carries an emulator's bytes to whoever is there."""

    name: str

    def wait(self, seconds: float) -> bytes:
        """Bytes that came within a time (s), b"" for none."""

    def send(self, data: bytes) -> None:
        """Send bytes; those that nobody takes are lost."""

    def cut(self) -> None:
        """Pull the plug."""

    def plug(self) -> None:
        """Plug in again; the name may be another then."""

    def close(self) -> None:
        """End."""


class Terminal:
    """A pseudo-terminal. name : of the end to open; link : a symlink that is kept pointing at it, or None.
    Raises RigError where the system has none.
    """

    def __init__(self, link: Path | None = None) -> None:
        if not hasattr(os, "openpty"):
            raise RigError("this system has no pseudo-terminals: state a TCP address for the emulator (--tcp)")
        self._link, self._next = link, os.openpty()
        self.plug()

    def plug(self) -> None:
        import tty

        self._master, self._slave = self._next
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.name = os.ttyname(self._slave)
        if self._link is not None:
            if self._link.exists() and not self._link.is_symlink():
                raise RigError(f"{self._link} is there and is no link")
            part = self._link.with_name(self._link.name + ".part")
            part.unlink(missing_ok=True)
            part.symlink_to(self.name)
            part.replace(self._link)

    def wait(self, seconds: float) -> bytes:
        if not select.select([self._master], [], [], max(seconds, 0))[0]:
            return b""
        return os.read(self._master, MOST)

    def send(self, data: bytes) -> None:
        try:
            os.write(self._master, data)
        except BlockingIOError:
            return  # nobody reads, as on a line where nobody listens

    def cut(self) -> None:
        self._next = os.openpty()  # before the old one is free, so that the name is another
        os.close(self._master)
        os.close(self._slave)

    def close(self) -> None:
        for end in (self._master, self._slave):
            os.close(end)
        if self._link is not None:
            self._link.unlink(missing_ok=True)


def tcp_server_for_emulator(emulator: Emulator, address: tuple[str, int]) -> Wire:
    """TCP server (Wire) for an emulator. Raises RigError where it cannot listen at (host, port)."""
    if isinstance(emulator, UniversalRobot):
        return RealTimeServer(emulator, address)
    return FunctionServer(address) if isinstance(emulator, NewportHexapod) else ByteServer(address)


def serve_emulator(
    emulator: Emulator,
    wire: Wire,
    is_running: Callable[[], bool],
    print_line: Callable[[str], None],
    after_motion: Callable[[], None],
) -> None:
    """Serve an emulator on a wire while it is running.

    The wire is a pseudo-terminal or TCP; is_running() says whether it goes on.

    print_line : takes a line whenever the wire has a name to open; after_motion : called after whatever may have moved
        the axes
    """
    plugged, count = True, emulator.replugged
    print_line(wire.name)
    emulator.greet()
    while is_running():
        if plugged != emulator.plugged or count != emulator.replugged:
            if plugged:
                wire.cut()
            plugged = emulator.plugged
            if plugged:
                count = emulator.replugged
                wire.plug()
                print_line(wire.name)
        come = emulator.next()
        pause = IDLE if come is None else min(max(come - emulator.now, 0.0), IDLE)
        if not plugged:
            emulator.clock.sleep(min(pause, 0.02) or 0.001)
            continue
        if data := wire.wait(pause):
            emulator.receive(data)
        if emulator.plugged and (data := emulator.due()):
            wire.send(data)
        after_motion()
