"""Native strut protocol of this project.

As docs/protocol.md states it: numbered frames with checksum, watchdog, single execution.
"""

import re

import numpy as np

from rig.driving.controller_address_and_urgent_stop import STOPS
from rig.driving.controller_status_and_limits import ControllerLimits
from rig.driving.protocols.protocol_interface_and_user_line_protocol import (
    TRIES,
    Dialogue,
    Exchange,
    Lines,
    Segment,
    State,
    Verdict,
    dialogue_awaiting_homed,
    dialogue_awaiting_rest_after_stop,
)
from rig.driving.serial_and_epics_ports_and_checksummed_frames import (
    Frame,
    encode_numbered_frame,
    last_valid_frame_in_line,
)
from rig.errors import ControllerFault, NoAnswer

NM = 1e9
VERSION = "struts/1"
NUMBERS = 65536  # sequence numbers, going round
_ACTIVITY = {"idle": "idle", "moving": "moving", "homing": "homing", "alarm": "alarm"}
ERRORS = {
    1: "unknown command",
    2: "arguments that do not fit",
    3: "not homed",
    4: "beyond the limits",
    5: "busy",
    6: "started anew",
    7: "in fault",
}
FAULTS = {
    "silent": "it stopped because it received nothing for too long",
    "motor": "a motor driver is in fault",
    "home": "an axis could not be homed",
    "critical": "only switching it off and on helps",
}


class Struts:
    """See rig.driving.protocols.protocol_interface_and_user_line_protocol.Protocol.

    count : axes; watchdog : s of silence after which the controller stops
    """

    name = "struts"
    urgent_stop = STOPS["struts"]

    def __init__(self, count: int, watchdog: float) -> None:
        self.count, self.watchdog = count, watchdog
        self._number = 0
        self._boot, self._line = "", 0
        self.started_anew = False  # its state says so itself

    def hello(self) -> Dialogue[str]:
        words = (yield from self._query("HELLO")).split()
        match = re.fullmatch(r"axes=(\d+) boot=(\w+) line=(\d+)", " ".join(words[1:4]))
        if match is None or words[0] != VERSION:
            raise ControllerFault(f"not a controller of {VERSION}: {' '.join(words)!r}")
        if int(match[1]) != self.count:
            raise ControllerFault(f"the controller has {match[1]} axes, the rig {self.count}")
        self._boot, self._line = match[2], int(match[3])
        yield from self._query(f"WATCH {round(1e3 * self.watchdog)}")
        return f"{' '.join(words[4:]) or 'a controller'}, {VERSION}, {self.count} axes"

    def fence(self) -> Dialogue[bool]:
        return (yield from self._read())[1] == self._boot

    def state(self) -> Dialogue[State]:
        return (yield from self._read())[0]

    def move(self, segment: Segment) -> Dialogue[Verdict]:
        cruise, ramp = round(1e3 * segment.duration), 0
        if segment.acceleration is not None and segment.acceleration.any():
            ramp = int(
                np.ceil(
                    1e3
                    * (segment.speed[segment.acceleration > 0] / segment.acceleration[segment.acceleration > 0]).max()
                )
            )
            if ramp > cruise:  # a short way never comes to full speed
                ramp = cruise = int(np.ceil(np.sqrt(float(ramp) * max(cruise, 1))))
        nm = " ".join(str(round(value)) for value in NM * segment.target)
        text = f"MOVE {self._boot} {max(cruise, 1)} {ramp} {nm}"
        if len(encode_numbered_frame(">", NUMBERS - 1, text)) > self._line:
            raise ControllerFault(
                f"the controller takes lines of {self._line} bytes, too few for {text!r}; nothing was sent"
            )
        return (yield from self._command(text))

    def home(self, timeout: float) -> Dialogue[Verdict]:
        return (yield from dialogue_awaiting_homed((yield from self._command("HOME")), self.state, timeout))

    def stop(self) -> Dialogue[Verdict]:
        yield from self._query("STOP")
        return (yield from dialogue_awaiting_rest_after_stop(self.state, "STOP"))

    def unlock(self) -> Dialogue[Verdict]:
        return (yield from self._command("UNLOCK"))

    def confirm(self) -> Dialogue[None]:
        self.started_anew = False
        yield from ()

    def limits(self) -> Dialogue[ControllerLimits | None]:
        yield from ()
        return None

    def event(self, line: str) -> str:
        frame = last_valid_frame_in_line("<", line)
        if frame is not None and frame.number is None and frame.text.startswith("BOOT"):
            return "restarted"
        return ""

    def _read(self) -> Dialogue[tuple[State, str]]:
        """State, and which start of the controller it belongs to."""
        for _ in range(TRIES):
            text = yield from self._query("STATE")
            words = text.split()
            if (
                len(words) == 4 + self.count
                and words[0] in _ACTIVITY
                and words[1] in "01"
                and all(re.fullmatch(r"-?\d{1,12}", w) for w in words[4:])
            ):
                fault = "" if words[3] == "-" else FAULTS.get(words[3], words[3])
                positions = np.array([int(word) for word in words[4:]]) / NM
                return State(_ACTIVITY[words[0]], positions, words[1] == "1", fault, text), words[2]
        raise NoAnswer(f"a state that cannot be read: {text!r}")

    def _query(self, text: str) -> Dialogue[str]:
        """What the controller answers to a request that moves nothing, asked again under a new number. Raises NoAnswer,
        ControllerFault.
        """
        for _ in range(TRIES):
            verdict, answer = yield from self._ask(text)
            if verdict.accepted:
                return answer
            if verdict.accepted is False:
                raise ControllerFault(f"the controller refuses {text}: {verdict.reason}")
        raise NoAnswer(f"no answer to {text}, asked {TRIES} times")

    def _command(self, text: str) -> Dialogue[Verdict]:
        return (yield from self._ask(text))[0]

    def _ask(self, text: str) -> Dialogue[tuple[Verdict, str]]:
        self._number = number = self._number % (NUMBERS - 1) + 1
        lines: Lines = yield Exchange(
            encode_numbered_frame(">", number, text), lambda lines: _answers(lines[-1], number)
        )
        frame = None if lines is None else last_valid_frame_in_line("<", lines[-1])
        if frame is None:
            return Verdict(None, f"no answer to {text}"), ""
        word, _, rest = frame.text.partition(" ")
        if frame.number is None:
            return Verdict(None, f"{text} arrived broken"), ""
        if word == "OK":
            return Verdict(True), rest
        code = int(rest.split()[0]) if rest and rest.split()[0].isdecimal() else 0
        return Verdict(False, f"{frame.text} ({ERRORS.get(code, 'see its manual')})"), rest


def _answers(line: str, number: int) -> bool:
    frame = last_valid_frame_in_line("<", line)
    return frame is not None and (
        frame.number == number and frame.text.split(" ")[0] in ("OK", "ERR") or frame == Frame(None, "NAK")
    )
