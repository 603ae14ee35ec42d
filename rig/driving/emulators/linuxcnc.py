"""Emulated LinuxCNC controller.

It answers as linuxcncrsh over TCP: joint moves, or poses through genhexkins.
"""

import re
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats
from rig.driving.axis_display_units_and_controller_counts import controller_counts_per_metre_or_radian
from rig.driving.driving_clock import Clock
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import EmulatedMachine, Faults
from rig.driving.emulators.emulator_base_true_command_log_and_user_emulators import Emulator
from rig.model import mechanisms
from rig.model.mechanism_geometry_classes import Hexapod

MM = 1e3
END, SET_END = "\r\n", "\n\r"  # as emcrsh.cc has them
FREE = ("ECHO", "VERBOSE", "ENABLE")  # what may be set before control is enabled


class LinuxCNC(Emulator):
    """axes : letters; limits : (n, 2) m of the joints; hexapod : the geometry where words are poses, None where they
    are joints; units : "m" or "rad" of each axis, by default m
    """

    def __init__(
        self,
        machine: EmulatedMachine,
        faults: Faults,
        clock: Clock,
        axes: tuple[str, ...],
        limits: Floats,
        hexapod: Hexapod | None,
        units: Sequence[str] = (),
    ) -> None:
        super().__init__(machine, faults, clock, limits)
        self._counts = controller_counts_per_metre_or_radian(units or ["m"] * len(axes))  # mm or degrees per m or rad
        self.axes, self.hexapod = axes, hexapod
        self.greet()

    def greet(self) -> None:
        self._linked, self._echo, self._verbose, self._enabled = False, True, False, False
        self._estop, self._power, self._mode = False, False, "MANUAL"
        self._errors: list[str] = []

    def unplug(self, seconds: float = 0.7) -> None:
        super().unplug(seconds)
        self._linked, self._echo, self._verbose, self._enabled = False, True, False, False  # a connection's own

    def line(self, line: bytes) -> None:
        text = line.decode("latin-1").strip()
        if not text:
            return
        if self._echo and self._linked:
            self.send(text + END)
        words = text.split()
        command = words[0].upper()
        if command == "HELLO":
            self._linked = len(words) == 4 and words[1] == "EMC"
            self.send(("HELLO ACK EMCNETSVR 1.1" if self._linked else "HELLO NAK") + END)
        elif not self._linked or len(words) < 2 or command not in ("GET", "SET"):
            self.send(f"{command if command in ('GET', 'SET') else 'Unknown command:'} NAK{END}")
        elif command == "GET":
            self._get(words[1].upper())
        else:
            self._set(words[1].upper(), words[2:], text)

    def deaf_alarm(self) -> None:
        super().deaf_alarm()
        self._estop, self._power = True, False
        self._errors.append("emergency stop")

    def _get(self, word: str) -> None:
        t, n = self.now, len(self.limits)
        self.machine.settle(t)
        fault = self.machine.fault(t)
        if fault.startswith("motor") and not self.busy and self._power:
            self._power = False
            self._errors.append(f"joint {int(fault.split()[-1]) - 1} amplifier fault")
        answers = {
            "ECHO": "ON" if self._echo else "OFF",
            "VERBOSE": "ON" if self._verbose else "OFF",
            "ENABLE": "ON" if self._enabled else "OFF",
            "PROGRAM_STATUS": "RUNNING" if self.machine.moving(t) and not self.machine.homing(t) else "IDLE",
            "MODE": self._mode,
            "ESTOP": "ON" if self._estop else "OFF",
            "MACHINE": "ON" if self._power else "OFF",
            "JOINT_POS": " ".join(f"{value:.6f}" for value in self._counts * self.machine.counters(t)),
            "JOINT_HOMED": " ".join(["YES" if self.machine.homed else "NO"] * n),
            "JOINT_FAULT": " ".join("FAULT" if fault == f"motor {i + 1}" else "OK" for i in range(n)),
            "KINEMATICS_TYPE": "1" if self.hexapod is None else "4",
            "USER_LINEAR_UNITS": "MM",
        }
        if word == "ERROR":
            self.send(f"ERROR {self._errors.pop(0) if self._errors else 'OK'}{END}")
        else:
            self.send((f"{word} {answers[word]}" if word in answers else f"GET {word} NAK") + END)

    def _set(self, word: str, arguments: list[str], text: str) -> None:
        value = arguments[0].upper() if arguments else ""
        if word not in FREE and not self._enabled:
            return self._answer(word, False)
        if word in ("ECHO", "VERBOSE") and value in ("ON", "OFF"):
            setattr(self, f"_{word.lower()}", value == "ON")
        elif word == "ENABLE":
            self._enabled = bool(arguments) and arguments[0] == "EMCTOO"
            return self._answer(word, self._enabled or value == "OFF")
        elif word == "ESTOP" and value in ("ON", "OFF"):
            self._estop = value == "ON" or self.machine.deaf
            self._power = self._power and not self._estop
        elif word == "MACHINE" and value in ("ON", "OFF"):
            self._power = value == "ON" and not self._estop
            if self._power:
                self.machine.fail(0.0, "")
        elif word == "MODE" and value in ("MANUAL", "AUTO", "MDI"):
            self._mode = value
        elif word == "ABORT":
            self.machine.halt(self.now)
        elif word == "HOME" and re.fullmatch(r"-1|\d", value):
            return self._home()
        elif word == "MDI":
            return self._mdi(text.split(None, 2)[2] if len(arguments) else "")
        elif word != "TELEOP_ENABLE":
            return self._answer(word, False)
        return self._answer(word, True)

    def _answer(self, word: str, accepted: bool) -> None:
        if not accepted or self._verbose:
            self.send(
                f"SET {word} {'ACK' if accepted else 'NAK'}{SET_END}", acknowledges=accepted and word in ("MDI", "HOME")
            )

    def _home(self) -> None:
        if not self._power or self._mode != "MANUAL":
            self._errors.append("can't do that (EMC_JOINT_HOME) in this state")
            return self._answer("HOME", True)
        self.faults.begin(homing=True)
        end, well = self.machine.start_homing(self.now)
        if not well:
            self.later(end, lambda: self._errors.append("joint 0 home switch not found"))
        return self._answer("HOME", True)

    def _mdi(self, text: str) -> None:
        words = {
            letter: float(number)
            for letter, number in re.findall(r"([A-Z])(-?\d+(?:\.\d*)?)", text.upper())
            if letter != "G"
        }
        codes = {float(number) for number in re.findall(r"G(\d+(?:\.\d)?)", text.upper())}
        if not self._power or self._mode != "MDI" or not self.machine.homed:
            self._errors.append("can't do that (EMC_TASK_PLAN_EXECUTE:MDI) in this mode, or before homing")
            return self._answer("MDI", True)
        if not {1.0, 53.0, 93.0} <= codes or set(words) != {*self.axes, "F"} or words["F"] <= 0 or self.busy:
            self._errors.append("bad MDI line, or it came while another runs")
            return self._answer("MDI", True)
        values = np.array([words[axis] for axis in self.axes]) * (25.4 if 20.0 in codes else 1.0)
        if self.hexapod is None:
            target = values / self._counts
        else:
            pose = RigidTransform.from_components(values[:3] / MM, Rotation.from_euler("xyz", values[3:], degrees=True))
            target = mechanisms.kinematics_of(self.hexapod).inverse(pose, self.hexapod) - self.machine.zero
        if self.is_beyond_limits(target):
            self._errors.append("Linear move in MDI would exceed a joint's limit")
            return self._answer("MDI", True)
        return self._go(target, 60 / words["F"])

    def _go(self, target: Floats, duration: float) -> None:
        struck = self.start_move(target, duration)
        if "ok-after-error" in struck:
            self.send(f"SET MDI NAK{SET_END}SET MDI ACK{SET_END}")
            return
        if "resend" in struck:
            return  # the line never came
        if "resend-moving" not in struck:
            self._answer("MDI", not struck)
        if self.faults.take("stale-alarm"):
            self._errors.append("stale")
