"""Interface of controller protocols, and the base of a user's own line protocol.

Dialogues that yield request bytes and receive answer lines.

Requests and answers are lines of text; the base has what each driver needs.

A question moves nothing and is asked again where no answer comes. A command is sent once, and its answer decides.
"""

import re
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Protocol as Interface
from typing import TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.driving.controller_status_and_limits import ControllerLimits
from rig.errors import ControllerFault, NoAnswer
from rig.model.design import Controller

T = TypeVar("T")
TRIES = 4  # times that a question is asked which moves nothing
POLL = 0.05  # s between looks at axes that are to come to rest
REST = 20.0  # s that a stop may take
ACTIVITIES = ("idle", "moving", "homing", "held", "alarm", "off")


@dataclass(frozen=True, slots=True)
class Exchange:
    """data : bytes to send; complete : whether the lines so far are a whole answer; timeout : s, None for the link's
    own.
    """

    data: bytes
    complete: Callable[[Sequence[str]], bool]
    timeout: float | None = None


Lines = tuple[str, ...] | None  # what an exchange came to; None when its time ran out
Dialogue = Generator[Exchange, Lines, T]


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the controller said to a command: accepted True or False, with its reason, or None where no answer came."""

    accepted: bool | None
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """activity : one of ACTIVITIES; positions : (n,) m as the controller counts, None while it has not said
    homed : all axes, None where it does not say
    fault : why it cannot be moved, or ""; controller_text : its own words; homing_required : whether it is in alarm
        for no other reason than that it must be homed first, as after power-on
    """

    activity: str
    positions: Floats | None
    homed: bool | None
    fault: str
    controller_text: str
    homing_required: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """One straight move of all axes, which start and arrive together.

    start, target : (n,) m as the controller counts; duration : s at the speeds asked for, without the ramps
    speed : (n,) m/s; acceleration : (n,) m/s^2 in proportion, or None; pose : T_base_platform there, for controllers
        that take poses
    """

    start: Floats
    target: Floats
    duration: float
    speed: Floats
    acceleration: Floats | None
    pose: RigidTransform | None = None


class Protocol(Interface):
    """Commands of one kind of controller as dialogues; it knows what the controller reported, and no port.

    name : as rig.toml has it; urgent_stop : bytes that slow every axis down at once, sent past any request in flight
    started_anew : whether `hello` found that it has started since a position was last confirmed or homed, where it
        shows that
    """

    name: str
    urgent_stop: bytes
    started_anew: bool

    def hello(self) -> Dialogue[str]:
        """Its name and version; learns its units and sizes and readies it. Raises NoAnswer, ControllerFault."""

    def fence(self) -> Dialogue[bool]:
        """Have all that was sent before dealt with; False where the controller has started anew since `hello`. Raises
        NoAnswer.
        """

    def state(self) -> Dialogue[State]:
        """Its activity, and the positions of its axes. Raises NoAnswer."""

    def move(self, segment: Segment) -> Dialogue[Verdict]:
        """Begin a move; it is sent once."""

    def home(self, timeout: float) -> Dialogue[Verdict]:
        """Home all axes, to the end; timeout : s. It is sent once."""

    def stop(self) -> Dialogue[Verdict]:
        """Slow every axis down, drop what is queued, and keep the position where the controller can."""

    def unlock(self) -> Dialogue[Verdict]:
        """Clear an alarm without homing."""

    def confirm(self) -> Dialogue[None]:
        """Mark the position as confirmed by the operator, where the controller can hold such a mark."""

    def limits(self) -> Dialogue[ControllerLimits | None]:
        """Travel, speed and acceleration that it allows itself, None where it says nothing of them; after `hello`."""

    def event(self, line: str) -> str:
        """Content of an unsolicited line: "restarted", an alarm or an error in words, or "" for nothing."""


def pause_dialogue(seconds: float = POLL) -> Dialogue[None]:
    """Dialogue that sends nothing and takes so many seconds."""
    yield Exchange(b"", is_never_complete, seconds)


def dialogue_awaiting_homed(
    home_command_verdict: Verdict, query_state: Callable[[], Dialogue[State]], timeout: float
) -> Dialogue[Verdict]:
    """Dialogue that waits until a controller is homed or refuses.

    A controller that reports states; timeout s at the most.
    home_command_verdict : what its home command came to; query_state : asks for its State
    """
    for _ in range(max(int(timeout / POLL), 1)):
        if home_command_verdict.accepted is False:
            return home_command_verdict
        now = yield from query_state()
        if now.fault or now.activity == "alarm":
            return Verdict(False, now.fault or now.controller_text)
        if now.activity == "idle":
            return Verdict(bool(now.homed), "" if now.homed else "it is at rest and not homed")
        yield from pause_dialogue()
    return Verdict(None, f"not home after {timeout:g} s")


def dialogue_awaiting_rest_after_stop(query_state: Callable[[], Dialogue[State]], command: str) -> Dialogue[Verdict]:
    """Dialogue that waits until a controller rests after a stop command.

    A controller that reports states; REST s at the most.
    """
    for _ in range(int(REST / POLL)):
        if (yield from query_state()).activity not in ("moving", "homing"):
            return Verdict(True)
        yield from pause_dialogue()
    return Verdict(None, f"still moving {REST:g} s after {command}")


def is_never_complete(lines: Sequence[str]) -> bool:
    """Completeness test of answer lines that is never met.

    Never, so that the whole timeout is awaited.
    """
    return False


def query_dialogue(
    data: bytes, is_complete: Callable[[Sequence[str]], bool], timeout: float | None = None, tries: int = TRIES
) -> Dialogue[tuple[str, ...]]:
    """Dialogue of a query that moves nothing.

    Returns the answer lines, repeated up to `tries` times
    Raises NoAnswer with the question.
    """
    for _ in range(tries):
        lines = yield Exchange(data, is_complete, timeout)
        if lines is not None:
            return lines
    raise NoAnswer(f"no answer to {data!r}, asked {tries} times")


NUMBERS = 65536  # of requests, going round


class LineProtocol:
    """See rig.driving.protocols.protocol_interface_and_user_line_protocol.Protocol.

    Texts and patterns may have `#`: the request's number.
    urgent_stop : bytes, as a literal, that slow every axis down whatever is under way
    accepted, refused : patterns (`re`) of whole answers to a command; a group of `refused` is the reason
    home_line, stop_line, unlock_line : commands; "" for none
    longest : bytes of a line that the controller takes; a longer one is an error and is not sent
    controller : [controller] of rig.toml; count : axes
    """

    name: str
    urgent_stop: bytes
    accepted: str
    refused: str
    home_line: str = ""
    stop_line: str
    unlock_line: str = ""
    longest: int = 64
    _guarded: bool

    def __init__(self, controller: Controller, count: int) -> None:
        self.controller, self.count = controller, count
        self.started_anew = False  # the state says itself whether it is homed
        self._number, self._start = 0, ""

    def identity(self) -> Dialogue[tuple[str, str]]:
        """(its name, what is another after each of its starts), asked of it."""
        raise NotImplementedError
        yield

    def state(self) -> Dialogue[State]:
        """Its activity, and the positions (axes,) m of its axes, asked of it in one question."""
        raise NotImplementedError
        yield

    def move_line(self, segment: Segment) -> str:
        """The line that begins a move of all axes, which arrive together."""
        raise NotImplementedError

    def encode(self, text: str) -> bytes:
        """Bytes of a line, for a check sum or another end."""
        return f"{text}\n".encode("ascii")

    def decode(self, line: str) -> str:
        """Text of a line that came; "" for one whose check sum is wrong."""
        return line

    def answer_ended_by_last_line(self, lines: Sequence[str]) -> str:
        """Text of the answer that ends with the last of the lines that came, "" where none does."""
        return self.decode(lines[-1]).strip()

    def event(self, line: str) -> str:
        """Content of an unsolicited line: "restarted", an alarm in words, or "" for nothing."""
        return ""

    def ask(self, text: str, pattern: str) -> Dialogue[re.Match[str]]:
        """Match of the answer to a question that moves nothing, which is asked again where none comes. Raises
        NoAnswer.
        """
        for _ in range(TRIES):
            found = yield from self._exchange(text, pattern)
            if found is not None:
                return found
        raise NoAnswer(f"no answer to {text!r} that is {pattern!r}, asked {TRIES} times")

    def command(self, text: str) -> Dialogue[Verdict]:
        """What a command came to; it is sent once."""
        if not text:
            return Verdict(False, "the controller has no such command")
        found = yield from self._exchange(text, f"(?:{self.accepted})|(?P<no>{self.refused})")
        if found is None:
            return Verdict(None, f"no answer to {text!r}")
        if found["no"] is None:
            return Verdict(True)
        return Verdict(False, " ".join(filter(None, (found.groups()[1:]))) or found[0])

    def hello(self) -> Dialogue[str]:
        name, self._start = yield from self.identity()
        return name

    def fence(self) -> Dialogue[bool]:
        return (yield from self.identity())[1] == self._start

    def move(self, segment: Segment) -> Dialogue[Verdict]:
        return (yield from self.command(self.move_line(segment)))

    def home(self, timeout: float) -> Dialogue[Verdict]:
        return (yield from dialogue_awaiting_homed((yield from self.command(self.home_line)), self.state, timeout))

    def stop(self) -> Dialogue[Verdict]:
        for _ in range(TRIES):  # a stop may be repeated
            if (yield from self.command(self.stop_line)).accepted is not None:
                break
        return (yield from dialogue_awaiting_rest_after_stop(self.state, repr(self.stop_line)))

    def unlock(self) -> Dialogue[Verdict]:
        return (yield from self.command(self.unlock_line))

    def confirm(self) -> Dialogue[None]:
        self.started_anew = False
        yield from ()

    def limits(self) -> Dialogue[ControllerLimits | None]:
        yield from ()
        return None

    def _exchange(self, text: str, pattern: str) -> Dialogue[re.Match[str] | None]:
        self._number = self._number % (NUMBERS - 1) + 1
        data = self.encode(text.replace("#", str(self._number)))
        if len(data) > self.longest:
            raise ControllerFault(f"the controller takes lines of {self.longest} bytes, too few for {data!r}: not sent")
        whole = re.compile(pattern.replace("#", str(self._number)))

        def answer(lines: Sequence[str]) -> re.Match[str] | None:
            return whole.fullmatch(self.answer_ended_by_last_line(lines))

        lines = yield Exchange(data, lambda lines: answer(lines) is not None)
        return None if lines is None else answer(lines)


def user_protocol_state_problem(state: object, count: int) -> str | None:
    """Problem with a State that a user's protocol gave.

    For `count` axes.

    None where nothing is.
    """
    if not isinstance(state, State):
        return f"gave {type(state).__name__}, not a State"
    if state.activity not in ACTIVITIES:
        return f"gave the activity {state.activity!r}; there are {', '.join(ACTIVITIES)}"
    positions = np.asarray(state.positions)
    if positions.shape != (count,) or positions.dtype.kind != "f" or not np.isfinite(positions).all():
        return f"gave positions {state.positions!r}, not {count} finite numbers in m"
    return None
