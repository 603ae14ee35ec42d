"""Emulated Newport HXP controller.

It takes poses by a geometry of its own, and calls as the lines of rig.driving.newport_function_call_tcp_port.

A move and a homing are answered at their end, and a move that was stopped by an error.
"""

import re
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.driving.driving_clock import Clock
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import MOTOR, EmulatedMachine, Faults
from rig.driving.emulators.emulated_hexapod_controller_pose_geometry import EmulatedPlatform
from rig.driving.emulators.emulator_base_true_command_log_and_user_emulators import LineEmulator
from rig.driving.protocols.controller_poses_for_hexapod_strut_lengths import MM
from rig.driving.protocols.newport_hxp import HXP
from rig.errors import NotConverged
from rig.model.mechanism_geometry_classes import Hexapod

ERRORS = {
    -4: "Unknown command",
    -17: "Parameter out of range or incorrect",
    -22: "Not allowed action",
    -25: "Following error",
    -26: "Emergency signal",
    -27: "Move Aborted",
    -28: "Home search timeout",
}
STATES = {
    0: "Not initialized state",
    2: "Not initialized state due to an emergency stop : see positioner status",
    5: "Not initialized state due to a homing timeout",
    7: "Not initialized state due to a KillAll command",
    10: "Ready state due to an AbortMove command",
    11: "Ready state from homing",
    12: "Ready state from motion",
    13: "Ready State due to a MotionEnable command",
    40: "Emergency braking",
    22: "Disabled state due to a following error during motion",
    42: "Not referenced state",
    43: "Homing state",
    44: "Moving state",
}
HOMED, MOVED, STOPPED, ENABLED = 11, 12, 10, 13
JERK = (0.005, 0.05)  # s, least and greatest


class NewportHexapod(LineEmulator):
    """geometry : the controller's own; limits : (6, 2) m of the struts' counters; work : T_base_work, its home by
    default; tool : T_platform_tool; angles : "moving" or "fixed"; systems : values of its coordinate systems
    """

    protocol = HXP

    def __init__(
        self,
        machine: EmulatedMachine,
        faults: Faults,
        clock: Clock,
        limits: Floats,
        geometry: Hexapod,
        work: RigidTransform | None,
        tool: RigidTransform | None,
        angles: str = "moving",
    ) -> None:
        super().__init__(machine, faults, clock, limits)
        self.platform, self.buffer = (
            EmulatedPlatform(geometry, work, tool, angles),
            4096,
        )  # a connection of TCP drops nothing
        self.systems = {"Work": np.zeros(6), "Tool": np.zeros(6)}
        self.greet()

    def greet(self) -> None:
        axes = self.machine.axes
        self.profiles = np.column_stack([MM * axes.speed, MM * axes.acceleration, *np.tile(JERK, (6, 1)).T])
        self._initialised, self._enabled, self._ready = self.machine.homed, True, HOMED
        self._unanswered: str | None = None  # number of the motion that goes on
        self._killed = self._aborted = False

    def encode(self, text: str) -> str:
        return f"{text},EndOfAPI\n"

    def answer(self, text: str) -> str | None:
        found = re.fullmatch(r"(\d{1,5}) (\w+)\s*\((.*)\)", text)
        if found is None:
            return None  # it scans for whole calls
        number, function, *words = found[1], found[2], *(word.strip() for word in found[3].split(","))
        if function == "HexapodMoveAbsolute":
            return self._go(number, words)
        if function in ("GroupMoveAbort", "GroupKill", "KillAll", "GroupInitialize", "GroupMotionEnable"):
            return f"{number} {self._command(function)},"
        if function == "GroupHomeSearch":
            return self._search(number)
        if function == "PositionerSGammaParametersSet":
            return f"{number} {self._set_profile(words)},"
        try:
            values = self._values(function, words)
        except (ValueError, IndexError, KeyError):
            return f"{number} -17,{function}"
        return f"{number} -4,{function}" if values is None else f"{number} 0,{values}"

    @property
    def group_state(self) -> int:
        """The group's state."""
        t = self.now
        self.machine.settle(t)
        fault = self.machine.fault(t)
        if self.machine.deaf or fault == "home":
            self._initialised = False
            return 40 if self.machine.deaf and self.machine.moving(t) else 2 if self.machine.deaf else 5
        if self.machine.homing(t):
            return 43
        if self.machine.moving(t):
            return 44 if self._initialised else 40
        if fault.startswith(MOTOR):
            self._enabled = False
        if not self._initialised:
            return 7 if self._killed else 0
        if not self.machine.homed:
            return 42
        return self._ready if self._enabled else 22

    def _values(self, function: str, words: list[str]) -> str | None:
        """What a function returns, None for one that there is not."""
        axes = self.machine.axes
        texts: dict[str, Callable[[], str]] = {
            "FirmwareVersionGet": lambda: "HXP-D EMULATED V1.0",
            "GroupStatusGet": lambda: str(self.group_state),
            "GroupStatusStringGet": lambda: STATES.get(int(words[0]), "Unknown state"),
            "ErrorStringGet": lambda: ERRORS.get(int(words[0]), "Unknown error"),
        }
        if function in texts:
            return texts[function]()
        numbers: dict[str, Callable[[], Floats]] = {
            "HexapodPositionCurrentGet": lambda: self.platform.values(self._lengths()),
            "HexapodCoordinateSystemGet": lambda: self.systems[words[1]],
            "PositionerSGammaParametersGet": lambda: self.profiles[_strut(words)],
            "PositionerUserTravelLimitsGet": lambda: MM * self.limits[_strut(words)],
            "PositionerMaximumVelocityAndAccelerationGet": lambda: (
                MM * np.array([axes.speed[_strut(words)], axes.acceleration[_strut(words)]])
            ),
        }
        return ",".join(f"{value:.9f}" for value in numbers[function]()) if function in numbers else None

    def _lengths(self) -> Floats:
        return self.machine.counters(self.now) + self.machine.zero

    def _go(self, number: str, words: list[str]) -> str | None:
        if self.group_state != self._ready:
            self._moves = True
            return f"{number} -22,"
        try:
            lengths = self.platform.lengths(np.array([float(word) for word in words[2:]]))
        except (ValueError, IndexError, NotConverged):
            return f"{number} -17,"
        target = lengths - self.machine.zero
        seconds = float((MM * np.abs(target - self.positions) / self.profiles[:, 0]).max())
        done, self._ready, self._aborted = f"{number} 0,", MOVED, False
        answer = self.move(target, seconds, done, f"{number} -17,")
        if answer != done:
            return answer
        self._unanswered = number
        self.later(self.machine.axes.until, self._end)
        return None

    def _search(self, number: str) -> str | None:
        if self.group_state != 42:
            return f"{number} -22,"
        self._ready, self._aborted = HOMED, False
        answer = self.home(f"{number} 0,", f"{number} -26,")
        if not answer.startswith(f"{number} 0"):
            return answer
        self._unanswered = number
        self.later(self.machine.axes.until, self._end)
        return None

    def _end(self) -> None:
        """Answer the motion that went on."""
        if self._unanswered is None:
            return
        if self.machine.axes.until > self.now:
            self.later(self.machine.axes.until, self._end)
            return
        error = {5: -28, 22: -25, 2: -26}.get(self.group_state, -27 if self._aborted else 0)
        self.send(self.encode(f"{self._unanswered} {error},"), acknowledges=True)
        self._unanswered = None

    def _command(self, function: str) -> int:
        """Error of a command that is done at once, 0 for none."""
        state = self.group_state
        if function == "GroupMoveAbort":
            if state != 44:
                return -22
            self.machine.halt(self.now)
            self._ready, self._aborted = STOPPED, True
        elif function == "GroupMotionEnable":
            if state not in (20, 22):
                return -22
            self.machine.fail(0.0, "")
            self._enabled, self._ready = True, ENABLED
        elif function == "GroupInitialize":
            if self._initialised or self.machine.deaf:
                return -26 if self.machine.deaf else -22
            self.machine.fail(0.0, "")
            self._initialised, self._enabled = True, True
        else:  # a kill: motors off, and nothing is known
            self.machine.halt(self.now)
            self.machine.homed, self._initialised, self._killed, self._aborted = False, False, True, True
        return 0

    def _set_profile(self, words: list[str]) -> int:
        try:
            strut, profile = _strut(words), np.array([float(word) for word in words[1:]])
        except ValueError:
            return -17
        top = MM * np.array([self.machine.axes.speed[strut], self.machine.axes.acceleration[strut]])
        if profile.shape != (4,) or not (profile > 0).all() or (profile[:2] > top * (1 + 1e-9)).any():
            return -17
        self.profiles[strut] = profile
        return 0


def _strut(words: list[str]) -> int:
    """Number of the strut, from 0, that a call's first word names. Raises ValueError for another word."""
    if not re.fullmatch(r"HEXAPOD\.[1-6]", words[0]):
        raise ValueError(words[0])
    return int(words[0][-1]) - 1
