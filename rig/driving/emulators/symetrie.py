"""Emulated Symétrie controller: the command interface of its Power PMAC, poses by a geometry of its own.

A move takes as long as the longer of its way at the speed of translations and its turn at that of rotations. It is
ready at once when it is switched on, and does not home by itself.
"""

import re
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.driving.driving_clock import Clock
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import EmulatedMachine, Faults
from rig.driving.emulators.emulated_hexapod_controller_pose_geometry import EmulatedPlatform
from rig.driving.emulators.emulator_base_true_command_log_and_user_emulators import LineEmulator
from rig.driving.protocols.controller_poses_for_hexapod_strut_lengths import poses_of_xyz_mm_uvw_degrees
from rig.driving.protocols.symetrie import (
    ACK,
    CONTROL_ON,
    ERROR,
    HOMED,
    HOMING,
    IN_POSITION,
    INITIALISED,
    MOTION,
    STATUS,
    SYSTEMS,
    TURNS,
    Symetrie,
)
from rig.errors import NotConverged
from rig.model.mechanism_geometry_classes import Hexapod

VERSION = (1.0, 5, 0, 22, 222, 5, 0, 22, 222, 1, 1, 1)
SPEEDS, RAMPS = (0.01, 0.001, 500.0, 500.0), (0.001, 5.0)  # mm/s and deg/s, s: least and greatest
CARRYING_OUT = 0.02  # s that a command takes
WORD = re.compile(r"(c_par)\((\d+)\)=(\S+)|c_(cfg)=([01])|c_cmd=C_(\w+)|(c_cmd|s_hexa|c_par\((\d+)\))(?:,(\d+),1)?")
ABSOLUTE = 0  # of a move: in the User coordinate system
ACCEPTED, WRONG_KIND, UNKNOWN, NOT_CONTROLLED, MOVING = 0, -10, -30, -35, -38  # codes of c_cmd
INFEASIBLE, CRITICAL, FAULT, NOT_HOMED = -40, -43, -44, -45


class SymetrieHexapod(LineEmulator):
    """geometry : the controller's own; limits : (6, 2) m of the struts' counters; work : T_base_work, its home by
    default; tool : T_platform_tool; systems : (6,) mm and degrees, values of its coordinate systems
    """

    protocol = Symetrie

    def __init__(
        self,
        machine: EmulatedMachine,
        faults: Faults,
        clock: Clock,
        limits: Floats,
        geometry: Hexapod,
        work: RigidTransform | None,
        tool: RigidTransform | None,
    ) -> None:
        super().__init__(machine, faults, clock, limits)
        self.platform, self.buffer = EmulatedPlatform(geometry, work, tool, TURNS), 4096  # TCP drops nothing
        self.systems = {name: np.zeros(6) for name in SYSTEMS}
        self.greet()

    def greet(self) -> None:
        self._parameters, self._setting, self._code, self._carried_out = np.zeros(20), False, ACCEPTED, -np.inf
        self._named = True  # a connection begins so
        self._controlled, self._speeds, self._ramp = False, np.array([1.0, 1.0]), 0.1

    def answer(self, text: str) -> str | None:
        if text == "echo7":
            self._named = False
            return ACK
        errors: list[str] = []
        lines: list[str] = []
        other: str | None = ""  # answer
        for word in text.split():
            found = WORD.fullmatch(word)
            try:
                if found is None:
                    raise ValueError(word)
                if found[1]:
                    self._parameters[int(found[2])] = float(found[3])
                elif found[4]:
                    self._setting = found[5] == "1"
                elif found[6]:
                    other = self._command(found[6])
                else:
                    lines += self._variables(found[7], int(found[8] or 0), int(found[9] or 1))
            except (ValueError, IndexError):
                errors.append(f"stdin:1:1: error #20: ILLEGAL CMD: {word}")
        return other if other is None or other else "\n".join([*errors, *lines, ACK])

    @property
    def status(self) -> int:
        """Bits of s_hexa."""
        t, bits = self.now, INITIALISED
        homing = self.machine.homing(t)
        moving = self.machine.moving(t) and not homing
        if self.fault:
            self._controlled = False
        for bit, holds in (
            (ERROR, self.fault),
            (CONTROL_ON, self._controlled),
            (IN_POSITION, not moving and not homing),
            (MOTION, moving),
            (HOMING, homing),
            (HOMED, self.homed),
        ):
            bits |= bit if holds else 0
        return bits

    def _variables(self, name: str, first: int, count: int) -> list[str]:
        """Texts of so many variables from one on. Raises IndexError where there are not so many."""
        if name == "c_cmd":
            values = np.array([1 if self.now < self._carried_out else self._code])
        elif name == "s_hexa":
            pose, values = self._pose(), np.zeros(STATUS)
            values[0], values[1] = self.status, 4 if self.status & HOMING else 6 if self.status & MOTION else 0
            values[2:14], values[STATUS - 1] = np.tile(pose, 2), bool(self.fault)
        else:
            values = self._parameters[first:]
        if count > len(values):
            raise IndexError(name)
        names = [f"{name}({k})=" if self._named else "" for k in range(first, first + count)]
        return [f"{name}{value:.12g}" for name, value in zip(names, values[:count])]

    def _pose(self) -> Floats:
        return self.platform.values(self.machine.counters(self.now) + self.machine.zero)

    def _command(self, name: str) -> str | None:
        """Carry a command out, and note its code. Returns the answer of its line where that is another than usual, ""
        where it is not, None for none.
        """
        self._carried_out = self.now + CARRYING_OUT
        if name == "MOVE_PTP":
            return self._go()
        if name == "HOME":
            self._moves = True
            self._code = CRITICAL if self.machine.deaf else FAULT if self.fault else MOVING if self.busy else ACCEPTED
            if not self._code:
                self.home("", "")
        elif name == "STOP":
            self.machine.halt(self.now)
            self._code = ACCEPTED
        elif name == "CONTROLON":
            self._code = CRITICAL if self.machine.deaf else FAULT if self.fault else ACCEPTED
            self._controlled = not self._code
        elif name == "CLEARERROR":
            self._code = ACCEPTED
            if not self.machine.deaf:
                self.machine.fail(0.0, "")
        else:
            self._code = self._configure(name)
        return ""

    def _configure(self, name: str) -> int:
        """Code of a command that leaves numbers in c_par, or takes them there."""
        given = self._parameters
        if name == "CFG_SPEED" and self._setting:
            wrong = ~((given[:2] >= SPEEDS[:2]) & (given[:2] <= SPEEDS[2:]))
            if wrong.any():
                return -10 - int(np.argmax(wrong))
            self._speeds = given[:2].copy()
        elif name == "CFG_TA" and self._setting:
            if not RAMPS[0] <= given[0] <= RAMPS[1]:
                return -10
            self._ramp = float(given[0])
        found: Mapping[str, Sequence[float] | Floats] = {
            "VERSION": VERSION,
            "CFG_SPEED": (*self._speeds, *SPEEDS),
            "CFG_TA": (self._ramp, *RAMPS),
            "CFG_CS": np.concatenate([*self.systems.values()]),
        }
        if name not in found:
            return UNKNOWN
        self._parameters[: len(found[name])] = np.asarray(found[name])
        return ACCEPTED

    def _go(self) -> str | None:
        self._moves = True
        kind, values = self._parameters[0], self._parameters[1:7]
        target: Floats | None
        try:
            target = self.platform.lengths(values) - self.machine.zero
        except (ValueError, NotConverged):
            target = None
        refusals = {
            WRONG_KIND: kind != ABSOLUTE,
            FAULT: bool(self.fault),
            MOVING: self.busy,
            NOT_HOMED: not self.homed,
            NOT_CONTROLLED: not self._controlled,
            INFEASIBLE: target is None or self.is_beyond_limits(target),
        }
        self._code = next((code for code, holds in refusals.items() if holds), ACCEPTED)
        if self._code or target is None:
            return ""
        ends = poses_of_xyz_mm_uvw_degrees(np.stack([self._pose(), values]), TURNS)
        way = 1e3 * np.linalg.norm(ends[1].translation - ends[0].translation)
        turn = np.degrees((ends[0].rotation.inv() * ends[1].rotation).magnitude())
        seconds = float(max(way / self._speeds[0], turn / self._speeds[1]))
        return self.move(target, seconds, "", "stdin:1:1: error #20: ILLEGAL CMD:")
