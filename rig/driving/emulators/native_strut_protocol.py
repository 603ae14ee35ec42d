"""Emulated firmware of the native strut protocol of this project.

As docs/protocol.md states it, sound or with faults.
"""

import re

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.driving_clock import Clock
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import EmulatedMachine, Faults
from rig.driving.emulators.emulator_base_true_command_log_and_user_emulators import Emulator
from rig.driving.protocols.native_strut_protocol import NM, VERSION
from rig.driving.serial_and_epics_ports_and_checksummed_frames import encode_numbered_frame, last_valid_frame_in_line


class Struts(Emulator):
    """Its controller; see Emulator."""

    ends = b"\n"

    def __init__(self, machine: EmulatedMachine, faults: Faults, clock: Clock, limits: Floats) -> None:
        super().__init__(machine, faults, clock, limits)
        self._watch, self._heard = 1.0, clock.now()
        self._silent = False
        self._answered: tuple[int, str, bytes] | None = None  # number, text and answer of the last request

    def greet(self) -> None:
        self._answered, self._silent = None, False
        self.send(encode_numbered_frame("<", None, f"BOOT {self._boot}").decode())

    def at_once(self, byte: int) -> bool:
        if byte != ord("!"):
            return False
        self.machine.halt(self.now)
        return True

    def line(self, line: bytes) -> None:
        frame = last_valid_frame_in_line(">", line.decode("latin-1"))
        if frame is None or frame.number is None:
            if line.strip():
                self.send(encode_numbered_frame("<", None, "NAK").decode())
            return
        self._heard = self.now
        if self._answered is not None and self._answered[:2] == (frame.number, frame.text):
            self.send(self._answered[2].decode())  # asked again: answered again, not carried out again
            return
        word, *arguments = frame.text.split()
        answer = self._carry_out(word, arguments)
        if answer is None:
            return
        data = encode_numbered_frame("<", frame.number, answer)
        self._answered = None if word == "HELLO" else (frame.number, frame.text, data)
        self.send(data.decode(), acknowledges=word in ("MOVE", "HOME"))

    def due(self) -> bytes:
        self._watchdog()
        return super().due()

    def next(self) -> float | None:
        come = super().next()
        if self.machine.axes.until <= self.now:
            return come
        bark = self._heard + self._watch
        return bark if come is None else min(come, bark)

    @property
    def _boot(self) -> str:
        return f"{self.machine.session:08X}"

    def _watchdog(self) -> None:
        if self.machine.axes.until > self.now and self.now - self._heard > self._watch:
            self.machine.halt(self.now)
            self._silent = True

    def _carry_out(self, word: str, arguments: list[str]) -> str | None:
        """The answer to a request, None where it gets none."""
        if word == "HELLO":
            return f"OK {VERSION} axes={len(self.limits)} boot={self._boot} line={min(self.buffer, 256)} emulator"
        if word == "STATE":
            return self._state()
        if word == "WATCH":
            if len(arguments) != 1 or not re.fullmatch(r"\d{2,5}", arguments[0]):
                return "ERR 2 WATCH MILLISECONDS"
            self._watch = int(arguments[0]) / 1e3
            return "OK"
        if word == "STOP":
            self.machine.halt(self.now)
            self._silent = False
            return "OK"
        if word == "UNLOCK":
            return "ERR 7" if self.machine.deaf else "OK"
        if word == "HOME":
            return self._home()
        return self._move(arguments) if word == "MOVE" else "ERR 1"

    def _state(self) -> str:
        t = self.now
        fault = self.machine.fault(t).split(" ")[0] or ("silent" if self._silent else "-")
        activity = (
            "homing"
            if self.machine.homing(t)
            else "moving"
            if self.machine.moving(t)
            else "alarm"
            if self.machine.deaf
            else "idle"
        )
        counters = " ".join(str(round(value)) for value in NM * self.machine.counters(t))
        return f"OK {activity} {int(self.machine.homed)} {self._boot} {fault} {counters}"

    def _home(self) -> str:
        if self.machine.deaf:
            return "ERR 7"
        self.faults.begin(homing=True)
        end, well = self.machine.start_homing(self.now)
        if not well:
            self.later(end, lambda: self.machine.fail(self.now, "home"))
        return "OK"

    def _move(self, arguments: list[str]) -> str | None:
        if len(arguments) != 3 + len(self.limits) or not all(
            re.fullmatch(r"-?\d{1,12}", word) for word in arguments[1:]
        ):
            return "ERR 2 MOVE BOOT CRUISE RAMP POSITIONS"
        if arguments[0] != self._boot:
            return "ERR 6"
        if self.machine.fault(self.now) or self._silent:
            return "ERR 7"
        if not self.machine.homed:
            return "ERR 3"
        if self.busy:
            return "ERR 5"
        cruise, _, *nm = (int(word) for word in arguments[1:])
        target = np.array(nm) / NM
        if self.is_beyond_limits(target):
            return "ERR 4"
        struck = self.start_move(target, cruise / 1e3)
        if "ok-after-error" in struck:
            self.send(encode_numbered_frame("<", None, "NAK").decode())
            return "ERR 2" if self.faults.rng.random() < 0.5 else None
        if "resend" in struck:
            return "NAK" if self.faults.rng.random() < 0.5 else None
        if "resend-moving" in struck:
            self.send(encode_numbered_frame("<", None, "NAK").decode())
            return None
        return "ERR 2" if struck else "OK"
