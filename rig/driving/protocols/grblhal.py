"""Protocol of grblHAL and Grbl 1.1 controllers.

Axes are in mm, joints in degrees, by G-code lines and real-time bytes.
Moves are in machine coordinates (G53), so that no work offset matters; scaling would, and is switched off. The feed
word holds what is known of the position: F0 since a start, F1 once greeted after one, more once homed, confirmed or
moved. Source: Grbl 1.1 Interface and Commands (gnea/grbl wiki); grblHAL core, report.c, gcode.c and system.c.
"""

import re
from collections.abc import Callable, Sequence
from typing import cast

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.axis_display_units_and_controller_counts import controller_counts_per_metre_or_radian
from rig.driving.controller_address_and_urgent_stop import STOPS
from rig.driving.controller_status_and_limits import ControllerLimits
from rig.driving.protocols.protocol_interface_and_user_line_protocol import (
    POLL,
    Dialogue,
    Exchange,
    Segment,
    State,
    Verdict,
    is_never_complete,
    pause_dialogue,
    query_dialogue,
)
from rig.errors import ControllerFault, NoAnswer

INCH = 25.4  # mm
LINE = 78  # characters that every Grbl takes in a line
BUFFER = 64  # bytes of the receive buffer, where the controller does not say
REPORTS = 12  # within which a controller says whether it is homed, if it ever does
STANDS, STANDSTILL_POLL = 60.0, 0.1  # s in which a move that another process began may end; s between looks
HOLD = 10.0  # s that a feed hold may take
# s, times: a status report in order to stop; a controller that homes gives none and heeds no hold
STATUS_REQUESTS = (0.5, 2)
READY = "G21G90G94"
UNCONFIRMED, CONFIRMED = "F1", "F100"  # mm/min; of a position since the controller started
SLOWEST = 2.0  # mm/min, of a move, so that its feed word is no F0 or F1
BLOCKED = 79  # the error of a line in an alarm that blocks until a reset
HOMING_REQUIRED = 11  # the alarm of a controller that starts locked ($22 with 4)
_STATUS = re.compile(r"<([A-Za-z]+(?::\d+)?)((?:\|[^<>|]*)*)>")
_NUMBERS = r"-?\d+\.\d+(?:,-?\d+\.\d+)*"
_END = re.compile(r"ok|error:\d+")
_ALARM = re.compile(r"ALARM:(\d+)")
_BANNER = re.compile(r"Grbl(HAL)? \d+\.\d+", re.IGNORECASE)
_ACTIVITY = {
    "Idle": "idle",
    "Run": "moving",
    "Jog": "moving",
    "Home": "homing",
    "Hold": "held",
    "Tool": "held",
    "Door": "held",
    "Alarm": "alarm",
    "Check": "off",
    "Sleep": "off",
}
_PINS = {"M": "a motor driver is in fault", "E": "emergency stop is pressed"}
_WAITS = {
    "Door": "a safety door is open",
    "Tool": "it waits for a tool change",
    "Check": "it checks its input and moves nothing ($C): rig stop ends that",
    "Sleep": "it sleeps: rig stop wakes it, and its position is not known then",
}
_DEAF = {"Hold", "Door", "Tool"}  # takes no line until it is told to go on
_SLOWING = {"Run", "Jog", "Hold:1", "Door:2", "Door:3"}  # a reset then is an alarm, and the position is lost
_HOMING_OFF = (
    "homing is not enabled there: set $22=1, or state homing = false in [controller] where there are no switches"
)
ERRORS = {
    5: _HOMING_OFF,
    8: "not while it moves",
    9: "locked by an alarm: home, or unlock",
    10: "soft limits require homing: $22=1",
    11: "line too long",
    13: "a safety door is open",
    14: "line too long",
    15: "beyond the soft limits",
    18: "no homing cycles are set",
    45: "on a limit switch",
    46: "it must be homed first, without unlocking",
    50: "emergency stop is pressed",
    51: "a motor driver is in fault",
    BLOCKED: "not while an alarm is critical",
}
ALARMS = {
    1: "a limit switch was hit, position lost",
    2: "beyond the soft limits",
    3: "reset while moving, position lost",
    6: "homing was reset",
    7: "door opened while homing",
    8: "homing could not leave the switch",
    9: "homing found no switch",
    10: "emergency stop",
    11: "homing is required",
    17: "a motor driver is in fault",
}


class GrblHAL:
    """See rig.driving.protocols.protocol_interface_and_user_line_protocol.Protocol.

    axes : letters of the axes, in the machine's order; units : "m" or "rad" of each, by default m
    """

    name = "grblhal"
    urgent_stop = STOPS["grblhal"]

    def __init__(self, axes: Sequence[str], units: Sequence[str] = ()) -> None:
        self.axes = tuple(axes)
        self._counts = controller_counts_per_metre_or_radian(
            units or ["m"] * len(self.axes)
        )  # of the controller per m or rad
        self._settings: dict[int, float] = {}
        self._letters = "XYZABCUVW"[: len(self.axes)]
        self._buffer = BUFFER
        self._offset: Floats | None = None  # mm, WCO
        self._homed: bool | None = None
        self._whole_report = b"?"
        self._homing = False
        self.started_anew = False

    def hello(self) -> Dialogue[str]:
        report = _STATUS.search(
            (yield from query_dialogue(b"?", lambda lines: _STATUS.search(lines[-1]) is not None))[-1]
        )
        if report is not None and report[1].split(":")[0] in _DEAF:
            raise ControllerFault(
                f"the controller is in hold, accepts nothing ({report[0]}): see why, then rig stop drops what is held"
            )
        build = yield from _answer_lines(b"$I\n", patience=STANDS)
        version = next((line[5:-1].rstrip(":") for line in build if line.startswith("[VER:")), "unknown version")
        for line in build:
            if match := re.fullmatch(r"\[OPT:[^,\]]*,\d+,(\d+).*\]", line):
                self._buffer = int(match[1])
            if match := re.fullmatch(r"\[AXS:(\d+):(\w+)\]", line):
                self._letters = match[2]
        missing = [axis for axis in self.axes if axis not in self._letters]
        if missing:
            raise ControllerFault(
                f"the controller has the axes {self._letters}, not {''.join(missing)}: [controller] axes "
                "names one for each axis "
                "in their order, and the firmware must be built with that many"
            )
        settings = yield from _answer_lines(b"$$\n", patience=STANDS)
        self._settings = {
            int(match[1]): float(match[2])
            for line in settings
            if (match := re.fullmatch(r"\$(\d+)=(-?\d+(?:\.\d+)?)", line))
        }
        if self._turning() and int(self._settings.get(680, 0)) & 1:
            raise ControllerFault(
                f"the controller takes {self._turning()} for rotary axes whose feed is that of the others "
                "($376, $680): set $376=0"
            )
        words = yield from _modes()
        self.started_anew = _feeds(words, "[01]")
        ready = yield from self._make_ready()
        if _scaled(words):
            yield from _answer_lines(b"G50\n", locked=True)
        self._whole_report = b"\x87" if "[FIRMWARE:grblHAL]" in build else b"?"
        yield from self._learn_homed()
        return f"grblHAL {version}, axes {self._letters}" + (f", {ready[-1]}" if ready[-1] != "ok" else "")

    def fence(self) -> Dialogue[bool]:
        words = yield from _modes()
        return {"G21", "G90", "G94"} <= words and not _scaled(words) and not _feeds(words, "0")

    def state(self) -> Dialogue[State]:
        for _ in range(40):  # the work offset comes with every 30th report, at the latest
            lines = yield from query_dialogue(b"?", lambda lines: self._read(lines[-1]) is not None)
            state = self._read(lines[-1])
            if state is not None and state.activity == "alarm" and self._whole_report != b"?":  # which has its number
                lines = yield from query_dialogue(self._whole_report, lambda lines: self._read(lines[-1]) is not None)
                state = self._read(lines[-1])
            if state is not None and state.positions is not None:
                return state
        raise NoAnswer(
            "status reports give work positions and never their offset WCO: set $10=511 (Grbl 1.1: $10=1) on "
            "the controller"
        )

    def move(self, segment: Segment) -> Dialogue[Verdict]:
        speed = 60 * np.linalg.norm(self._counts * (segment.target - segment.start)) / max(segment.duration, 1e-6)
        feed = f"F{max(speed, SLOWEST):.1f}"
        for digits, apart in ((4, False), (4, True), (3, False), (3, True)):
            words = "".join(
                f"{axis}{value:.{digits}f}" for axis, value in zip(self.axes, self._counts * segment.target)
            )
            line = f"G53G1{words}" + ("" if apart else feed)
            if len(line) < min(LINE, self._buffer - 1):
                break
        else:
            raise ValueError(f"{line!r} does not fit into the controller's receive buffer of {self._buffer} bytes")
        if apart:
            verdict = yield from _command(feed)
            if not verdict.accepted:
                return verdict
        return (yield from _command(line))

    def home(self, timeout: float) -> Dialogue[Verdict]:
        if 22 in self._settings and not int(self._settings[22]) & 1:
            return Verdict(False, _HOMING_OFF)
        if left := self._never_homed():
            return Verdict(
                False,
                f"its homing cycles ($44 .. $49) leave out {left}: give each a cycle, and set $376=0 where "
                "they are rotary",
            )
        self._homing = True
        verdict = yield from self._out_of_alarm("$H", timeout)
        if verdict.accepted is None:
            return Verdict(None, f"not home within {timeout:g} s ([controller] home_timeout)")
        self._homing, self._homed = False, None
        if verdict.accepted:
            yield from self.confirm()  # in an alarm it took no line, and so has none of what `hello` set
        yield from self._learn_homed()
        return verdict

    def stop(self) -> Dialogue[Verdict]:
        word, self._homing = "Home" if self._homing else "Run", False
        yield Exchange(b"!", is_never_complete, 0.0)
        for _ in range(int(HOLD / POLL) if word != "Home" else 0):
            try:
                lines = yield from query_dialogue(
                    b"?", lambda lines: _STATUS.search(lines[-1]) is not None, *STATUS_REQUESTS
                )
            except NoAnswer:
                break
            status = _STATUS.search(lines[-1])
            word = status[1] if status is not None else word
            if word not in _SLOWING:
                break
            yield from pause_dialogue()
        if word != "Idle":
            yield Exchange(b"\x18", lambda lines: bool(_BANNER.match(lines[-1])))
            yield from self._make_ready()
        return Verdict(True)

    def unlock(self) -> Dialogue[Verdict]:
        verdict = yield from self._out_of_alarm("$X")
        if verdict.accepted:
            yield from self._make_ready()
        return verdict

    def confirm(self) -> Dialogue[None]:
        self.started_anew = False
        yield from self._make_ready()

    def limits(self) -> Dialogue[ControllerLimits | None]:
        yield from ()
        span = self._axis_settings(130) / self._counts
        if not int(self._settings.get(20, 0)) & 1:  # soft limits are off: it refuses nothing
            span = np.full(len(self.axes), np.nan)
        return ControllerLimits(
            np.full((len(self.axes), 2), np.nan),  # whether it counts up from 0 or down to it depends on its homing
            span,
            self._axis_settings(110) / self._counts / 60,
            self._axis_settings(120) / self._counts,
            "$130 .. with $20=1",
            "$110 ..",
            "$120 ..",
        )

    def _axis_settings(self, first: int) -> Floats:
        """(n,) a setting of each axis, NaN where it is not listed. first : number of the first axis's"""
        return np.array([self._settings.get(first + self._letters.index(axis), np.nan) for axis in self.axes])

    def event(self, line: str) -> str:
        line = line.strip()
        if _BANNER.match(line):
            self._homed = None
            return "restarted"
        if match := _ALARM.search(line):
            return f"ALARM:{match[1]}" + (f" ({ALARMS[int(match[1])]})" if int(match[1]) in ALARMS else "")
        if re.fullmatch(r"error:\d+", line):
            return _reason(line)
        return ""

    def _make_ready(self) -> Dialogue[tuple[str, ...]]:
        """Units, distances, feed; what it answers. In an alarm it takes none of them."""
        feed = UNCONFIRMED if self.started_anew else CONFIRMED
        return (yield from _answer_lines(f"{READY}{feed}\n".encode(), locked=True))

    def _out_of_alarm(self, line: str, timeout: float | None = None) -> Dialogue[Verdict]:
        """Send what ends an alarm; one that blocks (a limit switch's, a motor's) takes it after a reset alone."""
        verdict = yield from _command(line, timeout)
        if verdict.reason.startswith(f"error:{BLOCKED}"):
            yield Exchange(b"\x18", lambda lines: bool(_BANNER.match(lines[-1])))
            yield from self._make_ready()  # its answer comes after the alarm that the start itself may raise
            verdict = yield from _command(line, timeout)
        return verdict

    def _learn_homed(self) -> Dialogue[None]:
        """Ask until it says whether it is homed, which comes with a whole report, or with every tenth, or never."""
        for _ in range(REPORTS if int(self._settings.get(22, 0)) & 1 else 0):
            if self._homed is None:
                yield Exchange(self._whole_report, lambda lines: self._read(lines[-1]) is not None)

    def _turning(self) -> str:
        """Letters of the axes that the controller takes for rotary ones."""
        rotary = int(self._settings.get(376, 0)) << 3
        return "".join(axis for axis in self.axes if rotary >> self._letters.index(axis) & 1)

    def _never_homed(self) -> str:
        """Letters of the axes that no homing cycle holds; "" where all have one, or the controller states no
        cycles.
        """
        cycles = [int(self._settings[number]) for number in range(44, 50) if number in self._settings]
        return "".join(
            axis
            for axis in self.axes
            if any(cycles) and not any(cycle >> self._letters.index(axis) & 1 for cycle in cycles)
        )

    def _read(self, line: str) -> State | None:
        """State of a status report, positions None while the work offset is not known; None for what is no report."""
        match = _STATUS.search(line)
        if match is None or match[1].split(":")[0] not in _ACTIVITY:
            return None
        fields = dict(field.partition(":")[::2] for field in match[2].split("|")[1:])
        if "WCO" in fields:
            self._offset = self._numbers(fields["WCO"])
        machine, work = self._numbers(fields.get("MPos", "")), self._numbers(fields.get("WPos", ""))
        if machine is None and work is None:
            return None
        if machine is None and self._offset is not None:
            machine = cast(Floats, work) + self._offset
        word, _, number = match[1].partition(":")
        fault = "; ".join(text for pin, text in _PINS.items() if pin in fields.get("Pn", ""))
        if word == "Alarm":
            fault = f"alarm {number} ({ALARMS.get(int(number or 0), 'see its manual')})" if number else fault or "alarm"
        elif word in _WAITS:
            fault = _WAITS[word]
        if "H" in fields:
            self._homed = fields["H"].startswith("1") and not self._never_homed()
        chosen = None if machine is None else machine[[self._letters.index(axis) for axis in self.axes]] / self._counts
        activity = "moving" if match[1] == "Hold:1" else _ACTIVITY[word]
        required = word == "Alarm" and number == str(HOMING_REQUIRED)
        return State(activity, chosen, self._homed, fault, match[0], required)

    def _numbers(self, text: str) -> Floats | None:
        """(axes,) mm, or None where they are not as many as the controller has axes."""
        if not re.fullmatch(_NUMBERS, text) or text.count(",") != len(self._letters) - 1:
            return None
        values = np.array([float(word) for word in text.split(",")])
        if self._settings.get(13):  # reports in inches, but for rotary axes
            rotary = int(self._settings.get(376, 0)) << 3
            values *= [1.0 if rotary >> i & 1 else INCH for i in range(len(values))]
        return values


def _answer_lines(data: bytes, locked: bool = False, patience: float = 0.0) -> Dialogue[tuple[str, ...]]:
    """The lines of an answer that ends with ok. Raises ControllerFault for an error.

    locked : error:9 will do; patience : s for which it is asked again where the axes still move (error:8), as whoever
        came before told them
    """
    for _ in range(1 + int(patience / STANDSTILL_POLL)):
        lines = yield from query_dialogue(data, lambda lines: _END.fullmatch(lines[-1].strip()) is not None)
        end = lines[-1].strip()
        if end != "error:8":
            break
        yield from pause_dialogue(STANDSTILL_POLL)
    if end != "ok" and not (locked and end == "error:9"):
        raise ControllerFault(f"the controller refuses {data.decode().strip()}: {_reason(end)}")
    return tuple(line.strip() for line in lines)


def _modes() -> Dialogue[set[str]]:
    """The words of what it takes for granted: units, distances, feed."""
    lines = yield from query_dialogue(b"$G\n", _after("[GC:"))
    return {*next(line for line in lines if line.startswith("[GC:"))[4:].strip().rstrip("]").split()}


def _feeds(words: set[str], whole: str) -> bool:
    """Whether the feed word is one of some whole numbers, as a class of characters."""
    return any(re.fullmatch(rf"F{whole}(\.0*)?", word) for word in words)


def _scaled(words: set[str]) -> bool:
    """Whether coordinates are multiplied, those of the machine too."""
    return any(word.startswith("G51") for word in words)


def _command(line: str, timeout: float | None = None) -> Dialogue[Verdict]:
    lines = yield Exchange(
        line.encode() + b"\n",
        lambda lines: bool(_END.fullmatch(lines[-1].strip()) or _ALARM.search(lines[-1])),
        timeout,
    )
    if lines is None:
        return Verdict(None, f"no answer to {line}")
    end = lines[-1].strip()
    return Verdict(end == "ok", "" if end == "ok" else _reason(end))


def _reason(line: str) -> str:
    kind, _, number = line.rpartition(":")
    known = (ALARMS if "ALARM" in kind else ERRORS).get(int(number) if number.isdecimal() else -1)
    return f"{line} ({known})" if known else line


def _after(start: str) -> Callable[[Sequence[str]], bool]:
    """Whether lines end with ok, after one that begins so: an ok before it is older."""
    return lambda lines: lines[-1].strip() == "ok" and any(line.startswith(start) for line in lines)
