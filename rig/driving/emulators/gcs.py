"""Emulators of PI GCS controllers.

Of single axes and of hexapods.
General Command Set (GCS) 2.0, closed-loop axes in mm.

C-887: GCS with poses, X Y Z in mm and U V W in degrees, by a geometry of its own.

The controller computes strut lengths from a pose by its nominal geometry. The machine at its struts is built otherwise.
A move takes as long as the platform's origin, and its fastest strut, need at the platform's velocity (VLS).
"""

import re
from collections.abc import Callable, Iterable

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats
from rig.driving.driving_clock import Clock
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import EmulatedMachine, Faults
from rig.driving.emulators.emulated_hexapod_controller_pose_geometry import EmulatedPlatform
from rig.driving.emulators.emulator_base_true_command_log_and_user_emulators import Emulator
from rig.driving.protocols.controller_poses_for_hexapod_strut_lengths import AXES
from rig.driving.protocols.gcs import HEXAPOD_UNITS, PIVOT
from rig.errors import NotConverged
from rig.model import mechanisms
from rig.model.mechanism_geometry_classes import Hexapod

MM = 1e3
IDENTITY = "(c)2026 Physik Instrumente (PI) GmbH & Co. KG, C-EMULATED, 0, 1.000"
READY, NOT_READY = "\xb1", "\xb0"


class GCS(Emulator):
    """axes : names; the rest as of an Emulator"""

    ends = b"\n"

    def __init__(
        self, machine: EmulatedMachine, faults: Faults, clock: Clock, axes: tuple[str, ...], limits: Floats
    ) -> None:
        super().__init__(machine, faults, clock, limits)
        self.axes = axes
        self.velocity, self.acceleration = machine.axes.speed.copy(), machine.axes.acceleration.copy()
        self.servo, self.error = np.zeros(len(axes), bool), 0
        self.greet()
        self._moved = False  # whether the next ERR? answers a move

    def greet(self) -> None:
        self.servo[:], self.error = False, 0
        self._hold(self.now)

    def at_once(self, byte: int) -> bool:
        if byte == 5:
            self.send(f"{(1 << len(self.axes)) - 1 if self.busy else 0:X}\n")
        elif byte == 7:
            self.send(f"{NOT_READY if self.machine.homing(self.now) else READY}\n")
        elif byte == 24:
            self._halt()
        return byte in (5, 7, 24)

    def line(self, line: bytes) -> None:
        words = line.decode("latin-1").strip().split()
        if not words:
            return
        word, arguments = words[0].upper(), words[1:]
        if word == "ERR?":
            self._answer_error()
        elif word in ("*IDN?", "SAI?", "HLP?", "VER?", "CSV?", "RDY?"):
            self.send(
                {
                    "*IDN?": IDENTITY + "\n",
                    "SAI?": _lines(self.axes),
                    "CSV?": "2.0\n",
                    "VER?": IDENTITY + "\n",
                    "RDY?": "1\n",
                    "HLP?": _lines(
                        ("*IDN?", "#5", "#7", "#24", "ERR?", "MOV", "POS?", "ONT?", "SVO", "FRF", "HLT", "STP")
                    ),
                }[word]
            )
        elif word.endswith("?"):
            self._ask(word, arguments)
        elif word in ("HLT", "STP"):
            self._halt()
        elif word in ("SVO", "VEL", "ACC", "DEC", "MOV"):
            self._set(word, arguments)
        elif word in ("FRF", "FNL", "FPL"):
            self._reference(arguments)
        elif word != "RON":
            self.error = 2

    def deaf_alarm(self) -> None:
        super().deaf_alarm()
        self.servo[:], self.error = False, -1024

    def _halt(self) -> None:
        self._hold(self.machine.halt(self.now))
        self.error = 10

    def _hold(self, t: float) -> None:
        """What is aimed at is where the axes stand at t (s)."""
        self.target, self._goal = self.machine.counters(t), self.machine.axes.at(t)

    def _answer_error(self) -> None:
        t = self.now
        if self.machine.fault(t) and not self.busy:
            self.error, self.servo = -1024, self.servo & False
        self.send(f"{self.error}\n", acknowledges=self._moved)
        self.error = 0
        if self._moved and self.faults.take("stale-alarm"):
            self.send("0")  # a piece of an older answer, which runs into the next
        self._moved = False

    def _ask(self, word: str, arguments: list[str]) -> None:
        if any(axis not in self.axes for axis in arguments):
            self.error = 15
            return
        t, n = self.now, len(self.axes)
        known = {
            "POS?": lambda: MM * self.machine.counters(t),
            "MOV?": lambda: MM * self.target,
            "VEL?": lambda: MM * self.velocity,
            "ACC?": lambda: MM * self.acceleration,
            "DEC?": lambda: MM * self.acceleration,
            "TMN?": lambda: MM * self.limits[:, 0],
            "TMX?": lambda: MM * self.limits[:, 1],
        }
        flags: dict[str, Callable[[], Booleans]] = {
            "ONT?": lambda: np.full(n, not self.busy and self._on_target()),
            "SVO?": lambda: self.servo,
            "FRF?": lambda: np.full(n, self.machine.homed and not self.machine.homing(t)) & self._referenced(),
        }
        if word in known:
            values = [f"{value:.6f}" for value in known[word]()]
        elif word in flags:
            values = [str(int(value)) for value in flags[word]()]
        elif word == "PUN?":
            values = ["MM"] * n
        else:
            self.error = 2
            return
        self.send(
            _lines([f"{axis}={value}" for axis, value in zip(self.axes, values) if not arguments or axis in arguments])
        )

    def _referenced(self) -> Floats:
        self.machine.settle(self.now)
        return np.full(len(self.axes), self.machine.homed)

    def _on_target(self) -> bool:
        return bool(np.abs(self.machine.axes.at(self.now) - self._goal).max() < 2e-6)

    def _set(self, word: str, arguments: list[str]) -> None:
        if (
            len(arguments) % 2
            or not arguments
            or not all(re.fullmatch(r"[-+]?\d+(\.\d*)?", value) for value in arguments[1::2])
        ):
            self.error = 24 if len(arguments) % 2 or not arguments else 25
            return
        names = arguments[::2]
        if any(axis not in self.axes for axis in names):
            self.error = 15
            return
        index = [self.axes.index(axis) for axis in names]
        values = np.array([float(value) for value in arguments[1::2]])
        if word == "SVO":
            if self.machine.deaf:
                self.error = -1024
                return
            self.servo[index] = values != 0
            self.machine.fail(0.0, "")
            self._hold(self.now)
        elif word == "MOV":
            target = self.target.copy()
            target[index] = values / MM
            self._move(target, index)
        elif (values <= 0).any():
            self.error = 8 if word == "VEL" else 17
        else:
            (self.velocity if word == "VEL" else self.acceleration)[index] = values / MM

    def _move(self, target: Floats, index: list[int]) -> None:
        self._moved = True
        if not self.servo[index].all() or not self._referenced().all():
            self.error = 5
        elif self.is_beyond_limits(target):
            self.error = 7
        else:
            self._begin(target)

    def seconds_of_move(self, target: Floats) -> float:
        """s that a move to counters (n,) m takes at the velocities that are set."""
        return float((np.abs(target - self.machine.counters(self.now)) / self.velocity).max())

    def _begin(self, target: Floats) -> None:
        struck = self.start_move(target, self.seconds_of_move(target))
        if "ok-after-error" in struck:
            self.send("24\n0\n")
            return
        if struck & {"resend", "resend-moving"}:
            self._in = b""  # the line came broken, and what came with it
        if "resend" in struck:
            return
        self.target, self._goal = target, self.machine.executed[-1].target
        if "runs-after-error" in struck:
            self.error = 25

    def _reference(self, arguments: list[str]) -> None:
        if any(axis not in self.axes for axis in arguments):
            self.error = 15
        elif not self.servo.all():
            self.error = 5
        else:
            self.faults.begin(homing=True)
            end, well = self.machine.start_homing(self.now)
            self.later(end, self._end_reference if well else self._fail_reference)

    def _end_reference(self) -> None:
        self._hold(self.now)

    def _fail_reference(self) -> None:
        self.error = 216


def _lines(texts: Iterable[str]) -> str:
    """An answer: a blank before every line feed but the last."""
    return " \n".join(texts) + "\n"


UNKNOWN, VELOCITY, INVALID_AXIS, OUT_OF_LIMITS, WRONG_NUMBER = 2, 8, 15, 7, 25  # errors
FASTEST = 5.0  # times a strut's speed that the platform may move


class GCSHexapod(GCS):
    """Its controller; see rig.driving.emulators.gcs.GCS.

    geometry : its own; limits : (6, 2) m of the struts' counters; work : T_base_work, in which it takes poses of its
        tool, its home by default; tool : T_platform_tool
    """

    def __init__(
        self,
        machine: EmulatedMachine,
        faults: Faults,
        clock: Clock,
        geometry: Hexapod,
        limits: Floats,
        work: RigidTransform | None = None,
        tool: RigidTransform | None = None,
    ) -> None:
        self.platform = EmulatedPlatform(geometry, work, tool)
        super().__init__(machine, faults, clock, AXES, limits)

    def greet(self) -> None:
        self.platform.pivot, self.platform_velocity = np.zeros(3), float(self.machine.axes.speed.min())
        super().greet()

    def line(self, line: bytes) -> None:
        words = line.decode("latin-1").strip().split()
        word = words[0].upper() if words else ""
        if word == "SPI?":
            self.send(" \n".join(f"{name}={MM * value:.6f}" for name, value in zip(PIVOT, self.platform.pivot)) + "\n")
        elif word == "VLS?":
            self.send(f"{MM * self.platform_velocity:.6f}\n")
        elif word == "SPI":
            self._set_pivot(words[1:])
        elif word == "VLS":
            self._set_velocity(words[1:])
        elif word in ("VEL", "ACC", "DEC"):  # of single axes, which a hexapod has none of
            self.error = UNKNOWN
        else:
            super().line(line)

    def pose_values(self) -> Floats:
        """(6,) X Y Z in mm, U V W in degrees, as it computes them from its struts."""
        return self.platform.values(self.machine.counters(self.now) + self.machine.zero)

    def _set_pivot(self, arguments: list[str]) -> None:
        names, values = arguments[::2], arguments[1::2]
        if len(arguments) % 2 or not names or set(names) - set(PIVOT):
            self.error = INVALID_AXIS
        elif np.abs(self.pose_values()[3:]).max() > 1e-6:  # only while it is not turned
            self.error = OUT_OF_LIMITS
        else:
            for name, value in zip(names, values):
                self.platform.pivot[PIVOT.index(name)] = float(value) / MM

    def _set_velocity(self, arguments: list[str]) -> None:
        try:
            (value,) = (float(text) / MM for text in arguments)
        except ValueError:
            self.error = WRONG_NUMBER
            return
        if 0 < value <= FASTEST * self.machine.axes.speed.max():
            self.platform_velocity = value
        else:
            self.error = VELOCITY

    def seconds_of_move(self, target: Floats) -> float:
        """s that a move to counters (6,) m takes at the platform's velocity."""
        start = self.machine.counters(self.now)
        ends = [mechanisms.hexapod.forward(one + self.machine.zero, self.platform.geometry) for one in (start, target)]
        distance = np.linalg.norm(ends[1].translation - ends[0].translation)
        return float(max(distance, np.abs(target - start).max()) / self.platform_velocity)

    def _ask(self, word: str, arguments: list[str]) -> None:
        if word not in ("POS?", "PUN?"):
            super()._ask(word, arguments)
            return
        if any(axis not in AXES for axis in arguments):
            self.error = INVALID_AXIS
            return
        shown = [f"{value:.6f}" for value in self.pose_values()] if word == "POS?" else HEXAPOD_UNITS
        rows = [f"{axis}={value}" for axis, value in zip(AXES, shown) if not arguments or axis in arguments]
        self.send(" \n".join(rows) + "\n")

    def _set(self, word: str, arguments: list[str]) -> None:
        if word != "MOV":
            super()._set(word, arguments)
            return
        names = arguments[::2]
        if len(arguments) % 2 or not names or set(names) - set(AXES):
            self.error = INVALID_AXIS
            return
        values = self.pose_values()
        try:
            values[[AXES.index(name) for name in names]] = [float(value) for value in arguments[1::2]]
            lengths = self.platform.lengths(values)
        except (ValueError, NotConverged):
            self.error = WRONG_NUMBER
            return
        self._move(lengths - self.machine.zero, list(range(6)))
