"""Emulated grblHAL controller.

Answers to G-code lines and real-time bytes as its firmware gives them.

An error stands until a `$` line or an empty one, as in grblHAL: lines of G-code in between are answered by it and not
carried out.
"""

import re
from collections.abc import Sequence

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.axis_display_units_and_controller_counts import controller_counts_per_metre_or_radian
from rig.driving.driving_clock import Clock
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import EmulatedMachine, Faults
from rig.driving.emulators.emulator_base_true_command_log_and_user_emulators import Emulator

INCH = 25.4
BANNER = "\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n"
UNLOCK = "[MSG:'$H'|'$X' to unlock]\r\n"
BLOCKS = 100  # moves that may be queued
ON_REQUEST = {ord("?"), ord("!"), ord("~"), 0x18, 0x80, 0x87}
MODAL = ("G0", "G1", "G20", "G21", "G90", "G91", "G94", "G54", "G17", "G61", "G80", "M0", "M2", "M5", "M9", "M30")


class GrblHAL(Emulator):
    """axes : letters; settings : numbers as $$ lists them, on top of the usual; units : "m" or "rad" of each axis, by
    default m; the rest as of an Emulator
    """

    def __init__(
        self,
        machine: EmulatedMachine,
        faults: Faults,
        clock: Clock,
        axes: str,
        limits: Floats,
        settings: dict[int, float] | None = None,
        units: Sequence[str] = (),
    ) -> None:
        super().__init__(machine, faults, clock, limits)
        self.axes = axes
        n = len(axes)
        counts = self._counts = controller_counts_per_metre_or_radian(units or ["m"] * n)  # mm or degrees per m or rad
        self.settings = {
            0: 5.0,
            1: 25,
            10: 511,
            11: 0.01,
            12: 0.002,
            13: 0,
            20: 0,
            21: 0,
            22: 1,
            23: 0,
            30: 1000.0,
            32: 0,
            **{100 + i: 250.0 for i in range(n)},
            **{110 + i: counts[i] * 60 * machine.axes.speed[i] for i in range(n)},
            **{120 + i: counts[i] * machine.axes.acceleration[i] for i in range(n)},
            **{130 + i: counts[i] * np.ptp(self.limits[i]) for i in range(n)},
            376: 0,
            **(settings or {}),
        }
        self._forget_modes()
        self.alarm, self.held, self._checking = self._alarm_at_start(), False, False
        self.offset = np.zeros(n)  # m, of the work coordinates
        self._reports, self._blocked = 0, False  # by an alarm that only a reset releases

    def greet(self) -> None:
        self._forget_modes()
        self.alarm, self.held = self._alarm_at_start(), False
        self.send(BANNER + (UNLOCK if self.alarm else ""))

    def at_once(self, byte: int) -> bool:
        if byte not in ON_REQUEST:
            return byte >= 0x80
        if byte in (ord("?"), ord("!"), 0x80, 0x87) and not self.alarm and self.machine.homing(self.now):
            pass  # while it homes it reports nothing ($10), and only a reset stops it
        elif byte in (ord("?"), 0x80, 0x87):
            self.send(self._report(byte == 0x87))
        elif byte == ord("!") and (self.machine.moving(self.now) or not self.alarm):
            self.machine.halt(self.now)
            self.held = True
        elif byte == ord("~"):
            self.held = False
        elif byte == 0x18:
            self._reset()
        return True

    def line(self, line: bytes) -> None:
        text = re.sub(r"\(.*?\)|;.*", "", line.decode("latin-1")).replace(" ", "").upper()
        if text.startswith("$"):
            self._error = self._system(text)
            if self._error is not None:
                self._verdict(self._error)
        elif self.alarm or self.machine.deaf:
            self._verdict(9)
        elif not text:
            self._error = 0
            self._verdict(0)
        elif self._error:
            self._verdict(self._error)  # what was wrong still is
        else:
            self._block(text)

    def deaf_alarm(self) -> None:
        super().deaf_alarm()
        self.alarm = 17
        self.send("ALARM:17\r\n")

    def _alarm_at_start(self) -> int:
        """Alarm 11 where it must be homed before anything else ($22 with 4), 0 for none."""
        return 11 if int(self.settings[22]) & 4 and not self.machine.homed else 0

    def _verdict(self, error: int) -> None:
        self.send(f"error:{error}\r\n" if error else "ok\r\n", acknowledges=not error)

    def _forget_modes(self) -> None:
        self._inches, self._relative, self._feed, self._motion, self._error = False, False, 0.0, 0, 0

    def _reset(self) -> None:
        if self.machine.deaf:
            return
        moving = self.machine.moving(self.now)
        homing = self.machine.homing(self.now)
        if moving or homing:
            self.machine.halt(self.now)
        self.forget()
        self._forget_modes()
        self._in, self.held, self._blocked = b"", False, False
        alarm = 6 if homing else 3 if moving else 0
        if self.faults.take("stale-alarm"):
            self.send(f"{self._report(False)[:25]}ALARM:{alarm or 3}\r\n")
            alarm = alarm or 3
        elif alarm:
            self.send(f"ALARM:{alarm}\r\n")
        self.alarm = alarm if alarm else self.alarm
        self.send(BANNER + (UNLOCK if self.alarm else ""))

    def _report(self, whole: bool) -> str:
        t = self.now
        mask, positions = int(self.settings[10]), self._counts * self.machine.counters(t)
        busy = self.machine.moving(t)
        word = "Alarm" if self.alarm else "Home" if self.machine.homing(t) else "Check" if self._checking else "Idle"
        if self.held:
            word = "Hold:1" if busy else "Hold:0"
        elif word == "Idle" and busy:
            word = "Run"
        if word == "Alarm" and whole:
            word = f"Alarm:{self.alarm}"
        if mask & 1:
            text = f"<{word}|MPos:{self._figures(positions)}"
        else:
            text = f"<{word}|WPos:{self._figures(positions - self._counts * self.offset)}"
        if mask & 2:
            text += f"|Bf:{BLOCKS - busy},{self.buffer - 1}"
        text += f"|FS:{self._feed if busy else 0:.0f},0"
        if self.machine.fault(t).startswith("motor"):
            text += "|Pn:M"
        if whole or self._reports % 10 == 1:
            text += f"|WCO:{self._figures(self._counts * self.offset)}"
        elif self._reports % 10 == 0:
            text += "|Ov:100,100,100"
        if int(self.settings[22]) & 1 and (whole or self._reports % 10 == 2):
            text += f"|H:{int(self.machine.homed)}"
        self._reports += 1
        return text + ">\r\n"

    def _figures(self, mm: Floats) -> str:
        if self.settings[13]:
            return ",".join(f"{value / INCH:.4f}" for value in mm)
        return ",".join(f"{value:.3f}" for value in mm)

    def _system(self, text: str) -> int | None:
        """Carry out a $ line; returns the error, 0 for none, or None where the answer comes later."""
        busy = self.machine.moving(self.now)
        if text == "$":
            self.send("[HLP:$$ $# $G $I $x=val $C $X $H ~ ! ? ctrl-x]\r\n")
        elif text == "$I":
            self.send(
                f"[VER:1.1f.20260817:]\r\n[OPT:VNML,{BLOCKS},{self.buffer},{len(self.axes)},0]\r\n"
                f"[AXS:{len(self.axes)}:{self.axes}]\r\n"
                "[FIRMWARE:grblHAL]\r\n"
            )
        elif text == "$G":
            self.send(
                f"[GC:G{self._motion} G54 G17 G{20 if self._inches else 21} G{91 if self._relative else 90} "
                "G94 G49 G98 G50 M5 M9 T0 "
                f"F{self._feed:g} S0.]\r\n"
            )
        elif text == "$#":
            zeros = self._figures(np.zeros(len(self.axes)))
            self.send(f"[G54:{self._figures(self._counts * self.offset)}]\r\n[G92:{zeros}]\r\n[TLO:{zeros}]\r\n")
        elif text == "$X":
            if self.machine.deaf or self._blocked:
                return 79
            if self.alarm == 11:
                return 46
            if self.alarm:
                self.alarm = 0
                self.send("[MSG:Caution: Unlocked]\r\n")
        elif busy:
            return 8
        elif text == "$$":
            self.send(
                "".join(
                    f"${number}={value:.3f}\r\n" if isinstance(value, float) else f"${number}={value}\r\n"
                    for number, value in sorted(self.settings.items())
                )
            )
        elif text == "$H":
            return self._home()
        elif match := re.fullmatch(r"\$(\d+)=(-?\d+(?:\.\d+)?)", text):
            if int(match[1]) not in self.settings:
                return 3
            self.settings[int(match[1])] = type(self.settings[int(match[1])])(float(match[2]))
        else:
            return 3
        return 0

    def _home(self) -> int | None:
        if not int(self.settings[22]) & 1:
            return 5
        if self.machine.deaf or self._blocked:
            return 79
        self.faults.begin(homing=True)
        self.alarm, self._error = 0, 0
        end, well = self.machine.start_homing(self.now)
        self.later(end, lambda: self._homed(well))
        return None

    def _homed(self, well: bool) -> None:
        if well:
            self.machine.settle(self.now)
            self._verdict(0)
            return
        self.alarm = 9
        self.send("ALARM:9\r\n[MSG:Reset to continue]\r\n")

    def _block(self, text: str) -> None:
        """Parse and carry out a line of G-code."""
        words = re.findall(r"([A-Z])(-?\d*\.?\d+)", text)
        if "".join(letter + number for letter, number in words) != text:
            return self._fail(2 if re.search(r"[A-Z](?![-\d.])", text) else 1)
        codes = {f"{letter}{float(number):g}" for letter, number in words if letter in "GM"}
        unknown = codes - {*MODAL, "G53", "G4"}
        if unknown or any(letter not in "GMFSTPN" + self.axes for letter, _ in words):
            return self._fail(20)
        if len([letter for letter, _ in words if letter in self.axes]) != len(
            {letter for letter, _ in words if letter in self.axes}
        ):
            return self._fail(25)
        if len(codes & {"G0", "G1"}) > 1:
            return self._fail(21)
        values = {letter: float(number) for letter, number in words if letter in self.axes}
        scale = INCH if "G20" in codes or (self._inches and "G21" not in codes) else 1.0
        feed = next((float(number) * scale for letter, number in words if letter == "F"), self._feed)
        motion = 0 if "G0" in codes else 1 if "G1" in codes else self._motion
        if values and motion == 1 and feed <= 0:
            return self._fail(22)
        if "G53" in codes and not values:
            return self._fail(26)
        self._inches = "G20" in codes or (self._inches and "G21" not in codes)
        self._relative = "G91" in codes or (self._relative and "G90" not in codes)
        self._feed, self._motion = feed, motion
        if values:
            return self._move({axis: value * scale for axis, value in values.items()}, "G53" in codes)
        self._verdict(0)
        return None

    def _fail(self, error: int) -> None:
        self._error = error
        self._verdict(error)

    def _move(self, values: dict[str, float], machine_coordinates: bool) -> None:
        start = self.machine.counters(max(self.now, self.machine.axes.until))
        target = start.copy()
        for axis, value in values.items():
            i = self.axes.index(axis)
            value /= self._counts[i]
            if self._relative and not machine_coordinates:
                target[i] += value
            else:
                target[i] = value + (0 if machine_coordinates else self.offset[i])
        if self.settings[20] and self.is_beyond_limits(target):
            self.alarm, self._blocked = 2, True
            self.send("ALARM:2\r\n[MSG:Reset to continue]\r\n")
            return
        duration = float(np.linalg.norm(self._counts * (target - start))) / (self._feed / 60) if self._motion else 0.0
        struck = self.start_move(target, duration)
        if "ok-after-error" in struck:
            self._fail(1)
            self._error = 0
            self.send("ok\r\n")
        elif struck & {"resend", "resend-moving"}:
            self.send("Resend:1\r\n")
        else:
            self._verdict(1 if struck else 0)
