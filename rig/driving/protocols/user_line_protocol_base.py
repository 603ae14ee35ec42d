"""Base class of a user's own line protocol.

Requests and answers are lines of text; the base has what each driver needs.

A question moves nothing and is asked again where no answer comes. A command is sent once, and its answer decides.
"""

import re
from collections.abc import Sequence

import numpy as np

from rig.driving.controller_status_and_limits import ControllerLimits
from rig.driving.protocols.protocol_interface import (
    ACTIVITIES,
    TRIES,
    Dialogue,
    Exchange,
    Segment,
    State,
    Verdict,
    await_homed,
    await_stopped,
)
from rig.errors import ControllerFault, NoAnswer
from rig.model.design import Controller

NUMBERS = 65536  # of requests, going round


class LineProtocol:
    """See rig.driving.protocols.protocol_interface.Protocol. Texts and patterns may have `#`: the request's number.

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
        return (yield from await_homed((yield from self.command(self.home_line)), self.state, timeout))

    def stop(self) -> Dialogue[Verdict]:
        for _ in range(TRIES):  # a stop may be repeated
            if (yield from self.command(self.stop_line)).accepted is not None:
                break
        return (yield from await_stopped(self.state, repr(self.stop_line)))

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
            return whole.fullmatch(self.decode(lines[-1]).strip())

        lines = yield Exchange(data, lambda lines: answer(lines) is not None)
        return None if lines is None else answer(lines)


def state_problem(state: object, count: int) -> str | None:
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
