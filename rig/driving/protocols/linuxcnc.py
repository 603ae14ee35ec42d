"""Protocol LinuxCNC (linuxcncrsh over TCP).

Moves are MDI lines, positions are of joints.

"joint": each axis word is a strut (trivkins, identity kinematics). "world": poses go through the controller's own
inverse kinematics (genhexkins with this rig.toml's geometry); what is read back are the joints all the same. An
emergency stop is never released automatically.
Source: linuxcncrsh(1), genhexkins(9); G93 gives every move its time, whichever of its words are lengths and whichever
    angles.
"""

import re
from collections.abc import Callable, Sequence

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.axis_display_units_and_controller_counts import controller_counts_per_metre_or_radian
from rig.driving.controller_address_and_urgent_stop import CLIENT, STOPS
from rig.driving.controller_status_and_limits import ControllerLimits
from rig.driving.protocols.protocol_interface_and_user_line_protocol import (
    POLL,
    REST,
    Dialogue,
    Exchange,
    Lines,
    Segment,
    State,
    Verdict,
    pause_dialogue,
    query_dialogue,
)
from rig.errors import ControllerFault, NoAnswer

UNITS = {"MM": 1e3, "INCH": 1 / 0.0254, "CM": 1e2}  # of a metre
IDENTITY = "1"  # KINEMATICS_TYPE
ECHO = 0.3  # s to wait for an answer that need not come
MOST_ERRORS = 20  # that may be waiting to be read
_NUMBER = r"-?\d+\.\d+"


class LinuxCNC:
    """See rig.driving.protocols.protocol_interface_and_user_line_protocol.Protocol.

    axes : letters, in the machine's order; kinematics : "joint" or "world"; units : "m" or "rad" of each axis, by
    default m; of a joint that turns the controller counts degrees
    """

    name = "linuxcnc"
    urgent_stop = STOPS["linuxcnc"]

    def __init__(
        self, axes: Sequence[str], kinematics: str, password: str, enable_password: str, units: Sequence[str] = ()
    ) -> None:
        self.axes, self.kinematics, self._password, self._enable = tuple(axes), kinematics, password, enable_password
        self._units = tuple(units or ["m"] * len(self.axes))
        self._unit, self._inch, self._homed = 1e3, False, False
        self.started_anew = False  # JOINT_HOMED says so itself

    def hello(self) -> Dialogue[str]:
        greeting = yield from self._greet()
        yield Exchange(
            b"SET ECHO OFF\r\n", lambda lines: "ECHO" in lines[-1].upper(), ECHO
        )  # echoed, acknowledged, or neither
        for line in ("SET VERBOSE ON", f"SET ENABLE {self._enable}"):
            verdict = yield from self._set(line, 4)
            if not verdict.accepted:
                raise ControllerFault(
                    f"{line.rpartition(' ')[0]} was not accepted ({verdict.reason}); is [controller] "
                    "enable_password right?"
                )
        kind = yield from self._get("KINEMATICS_TYPE", r"\d+")
        if (kind == IDENTITY) != (self.kinematics == "joint"):
            raise ControllerFault(
                f'the controller\'s kinematics are of type {kind} and [controller] kinematics is "{self.kinematics}"; '
                '"joint" takes type 1 (identity: an axis word is a strut), "world" any other'
            )
        unit = yield from self._get("USER_LINEAR_UNITS", r"\w+")
        if unit not in UNITS:
            raise ControllerFault(f"the controller counts in {unit}; it must be one of {', '.join(UNITS)}")
        self._unit, self._inch = UNITS[unit], unit == "INCH"
        if len((yield from self._positions())) < len(self.axes):
            raise ControllerFault(f"the controller has fewer joints than the rig's {len(self.axes)} axes")
        self._homed = yield from self._all_homed()
        return f"LinuxCNC, {greeting}, {self.kinematics} mode"

    def fence(self) -> Dialogue[bool]:
        yield from self._greet()
        homed = yield from self._all_homed()
        return homed or not self._homed

    def state(self) -> Dialogue[State]:
        running = yield from self._get("PROGRAM_STATUS", r"\w+")
        positions = (yield from self._positions())[: len(self.axes)] / self._counts
        fault = yield from self._errors()
        if running == "RUNNING":
            return State("moving", positions, None, fault, f"PROGRAM_STATUS {running}")
        power, stopped = (yield from self._get("MACHINE", "ON|OFF")), (yield from self._get("ESTOP", "ON|OFF"))
        bad = [
            str(i) for i, word in enumerate((yield from self._words("JOINT_FAULT"))[: len(self.axes)]) if word != "OK"
        ]
        self._homed = (homed := (yield from self._all_homed())) or self._homed
        if stopped == "ON":
            fault = "; ".join(filter(None, (fault, "emergency stop")))
        if bad:
            fault = "; ".join(filter(None, (fault, f"joints {', '.join(bad)} are in fault")))
        activity = "off" if power == "OFF" or stopped == "ON" else "held" if running == "PAUSED" else "idle"
        return State(activity, positions, homed, fault, f"PROGRAM_STATUS {running}, MACHINE {power}, ESTOP {stopped}")

    def move(self, segment: Segment) -> Dialogue[Verdict]:
        if (yield from self._get("MODE", r"\w+")) != "MDI":
            verdict = yield from self._set("SET MODE MDI", 4)
            if not verdict.accepted:
                return verdict
        values = self._counts * segment.target
        if self.kinematics == "world":
            if segment.pose is None:
                raise ValueError("a controller commanded in poses requires segments with poses")
            values = np.r_[self._unit * segment.pose.translation, segment.pose.rotation.as_euler("xyz", degrees=True)]
        words = " ".join(f"{axis}{value:.6f}" for axis, value in zip(self.axes, values))
        line = f"SET MDI G{20 if self._inch else 21} G90 G93 G53 G1 {words} F{60 / max(segment.duration, 1e-3):.6f}"
        return (yield from self._set(line, 1))

    def home(self, timeout: float) -> Dialogue[Verdict]:
        if (yield from self._get("ESTOP", "ON|OFF")) == "ON":
            return Verdict(False, "emergency stop; release it, then unlock")
        for line in ("SET MACHINE ON", "SET MODE MANUAL", "SET TELEOP_ENABLE OFF"):
            verdict = yield from self._set(line, 4)
            if not verdict.accepted:
                return verdict
        yield from self._errors()  # what was left by whoever came before
        verdict = yield from self._set("SET HOME -1", 1)
        if verdict.accepted is False:  # older ones home joint by joint
            for joint in range(len(self.axes)):
                verdict = yield from self._set(f"SET HOME {joint}", 1)
        for _ in range(max(int(timeout / POLL), 1)):
            if verdict.accepted is False:
                return verdict
            if error := (yield from self._errors()):
                return Verdict(False, error)
            if (yield from self._all_homed()):
                self._homed = True
                return Verdict(True)
            yield from pause_dialogue()
        return Verdict(None, f"not home after {timeout:g} s")

    def stop(self) -> Dialogue[Verdict]:
        if not (yield from self._set("SET ABORT", 2)).accepted:  # a server that started anew listens to nobody yet
            yield from self.hello()
            yield from self._set("SET ABORT", 2)
        last = None
        for _ in range(int(REST / POLL)):
            positions = yield from self._positions()
            if (
                last is not None
                and np.array_equal(positions, last)
                and (yield from self._get("PROGRAM_STATUS", r"\w+")) == "IDLE"
            ):
                return Verdict(True)
            last = positions
            yield from pause_dialogue()
        return Verdict(None, f"still moving {REST:g} s after the abort")

    def unlock(self) -> Dialogue[Verdict]:
        verdict = yield from self._set("SET ESTOP OFF", 4)
        if verdict.accepted:
            verdict = yield from self._set("SET MACHINE ON", 4)
        return verdict

    def confirm(self) -> Dialogue[None]:
        self.started_anew = False
        yield from ()

    def limits(self) -> Dialogue[ControllerLimits | None]:
        yield from ()
        return None  # linuxcncrsh does not say; [controller] ini does

    def event(self, line: str) -> str:
        return ""

    @property
    def _counts(self) -> Floats:
        """(n,) how much the controller counts per m or rad of each axis."""
        return controller_counts_per_metre_or_radian(self._units, self._unit)

    def _greet(self) -> Dialogue[str]:
        """The server's name and version; a greeting may be said again, and whatever was sent before has been dealt with
        then.
        """
        lines = yield from query_dialogue(
            f"HELLO {self._password} {CLIENT}\r\n".encode(),
            lambda lines: lines[-1].strip().startswith(("HELLO ACK", "HELLO NAK")),
        )
        if lines[-1].strip().startswith("HELLO NAK"):
            raise ControllerFault("the controller refuses the greeting; is [controller] password right?")
        return lines[-1].strip()[len("HELLO ACK ") :]

    def _get(self, word: str, pattern: str) -> Dialogue[str]:
        """What a question is answered with, without its word and in capitals where it is one word. Raises NoAnswer,
        ControllerFault.
        """
        whole = re.compile(rf"{word} (?:{pattern})", re.IGNORECASE)
        refused = f"GET {word} NAK"
        lines = yield from query_dialogue(
            f"GET {word}\r\n".encode(),
            _either(lambda line: whole.fullmatch(line) or line.upper().startswith((refused, "GET NAK"))),
        )
        answer = lines[-1].strip()
        if answer.upper().startswith((refused, "GET NAK")):
            raise ControllerFault(f"the controller does not answer GET {word}: {answer}")
        text = answer[len(word) + 1 :]
        return text.upper() if " " not in text else text

    def _words(self, word: str) -> Dialogue[list[str]]:
        return (yield from self._get(word, r"\w+(?: \w+)+")).upper().split()

    def _errors(self) -> Dialogue[str]:
        """What it complains of, one complaint an answer, until there is none: "" for nothing."""
        found: list[str] = []
        for _ in range(MOST_ERRORS):
            error = yield from self._get("ERROR", r".+")
            if error == "OK":
                break
            found.append(error)
        return "; ".join(found)

    def _all_homed(self) -> Dialogue[bool]:
        words = yield from self._words("JOINT_HOMED")
        if len(words) < len(self.axes) or not {*words} <= {"YES", "NO", "HOMED", "NOT"}:
            raise NoAnswer(f"JOINT_HOMED says {' '.join(words)}")
        return {*words[: len(self.axes)]} <= {"YES", "HOMED"}

    def _positions(self) -> Dialogue[Floats]:
        return np.array(
            [float(word) for word in (yield from self._get("JOINT_POS", rf"{_NUMBER}(?: {_NUMBER})*")).split()]
        )

    def _set(self, line: str, tries: int) -> Dialogue[Verdict]:
        """A command; only those that move nothing may be tried more than once."""
        word = line.split()[1]
        ends = (f"SET {word} ACK", f"SET {word} NAK", "SET NAK")
        for _ in range(tries):
            lines: Lines = yield Exchange(
                f"{line}\r\n".encode(), _either(lambda answer: answer.upper().startswith(ends))
            )
            if lines is not None:
                accepted = "ACK" in lines[-1].upper()
                return Verdict(accepted, "" if accepted else "; ".join(answer.strip() for answer in lines))
        return Verdict(None, f"no answer to {line}")


def _either(fits: Callable[[str], object]) -> Callable[[Sequence[str]], bool]:
    return lambda lines: bool(fits(lines[-1].strip()))
