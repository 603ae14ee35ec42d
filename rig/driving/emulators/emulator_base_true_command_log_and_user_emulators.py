"""Base of controller emulators with their log of true commands, and of user's emulators.

Bytes received, answers and their delays; log of the true commands.

A line emulator of the user's own has lines, axes, and the faults that a driver must meet.
"""

import heapq
import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.driving_clock import Clock
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import EmulatedMachine, Faults
from rig.driving.protocols.protocol_interface_and_user_line_protocol import LineProtocol
from rig.driving.protocols.protocol_selection_and_user_protocols import GROUP
from rig.driving.user_protocol_camera_sensor_classes_and_sensor_reader import (
    load_user_class_and_its_file,
    user_class_error,
    wrap_user_call_to_locate_errors,
)
from rig.errors import FileError, LinkLost, RigError

UNPLUGGED = 0.7  # s that the line is cut
LATE = (0.3, 5.0)  # s
LONGEST = 4096  # bytes kept of a line that does not end


class Emulator:
    """Base of emulators, which take whole lines and single bytes that act at once, and send text.

    machine : Machine; faults : Faults, the machine's; clock : Clock; limits : (n, 2) m of the counters
    plugged : whether the line is whole; replugged : how often it came back
    """

    ends = b"\n\r"
    buffer = 1024

    def __init__(self, machine: EmulatedMachine, faults: Faults, clock: Clock, limits: Floats) -> None:
        self.machine, self.faults, self.clock = machine, faults, clock
        self.limits = np.asarray(limits, float)
        self.replugged = 0
        self._cut_until: float | None = None
        self._in = b""
        self._unread = b""  # what came out while bytes came in
        self._out: list[tuple[float, int, bytes | Callable[[], None], int]] = []
        self._number = itertools.count()
        self._last = -np.inf  # s, when the last byte queued goes out
        self._generation = 0
        if faults.always("buffer-64"):
            self.buffer = 64
        elif faults.always("buffer-128"):
            self.buffer = 128

    @property
    def now(self) -> float:
        return self.clock.now()

    @property
    def plugged(self) -> bool:
        """Whether the cable is in; it is again once the time of a cut has passed."""
        if self._cut_until is not None and self.now >= self._cut_until:
            self._cut_until = None
            self.replugged += 1
        return self._cut_until is None

    @property
    def busy(self) -> bool:
        """Whether the axes move or home."""
        return self.machine.moving(self.now) or self.machine.homing(self.now)

    def is_beyond_limits(self, target: Floats) -> bool:
        """Whether a target (n,) m of the counters lies beyond the limits."""
        low, high = self.limits.T
        return bool(((target < low - 1e-9) | (target > high + 1e-9)).any())

    def start_move(self, target: Floats, duration: float) -> set[str]:
        """Start a move to a target (n,) m of the counters within a duration (s), unless an armed fault prevents it.

        Returns the faults of the answer: "ok-after-error" or "resend", where nothing moves, "resend-moving",
            "runs-after-error"
        """
        self.faults.begin()
        for fault in ("ok-after-error", "resend"):
            if self.faults.take(fault):
                return {fault}
        struck = {fault for fault in ("resend-moving", "runs-after-error") if self.faults.take(fault)}
        self.machine.go(self.now, target, duration)
        self.strikes_on_move(self.machine.axes.until - self.now)
        return struck

    def lengths_at(self, t: Floats | float) -> Floats:
        """(..., n) m at which the axes truly stood at t (...) s."""
        return self.machine.axes.lengths_at(t)

    def path(self, since: float = -np.inf) -> tuple[Floats, Floats]:
        """(k,) s and (k, n) m: what the axes truly did from `since` on, linear in between, as commands.csv has it."""
        return self.machine.axes.knots(since)

    def receive(self, data: bytes) -> None:
        """Bytes that come in. Raises LinkLost while the line is cut."""
        if not self.plugged:
            raise LinkLost("unplugged")
        self._unread += self._run_due()
        received = bytearray()
        for byte in data:
            if not self.at_once(byte) and len(received) < self.buffer:  # what comes in one go; in between it is read
                received.append(byte)
        self._in = (self._in + bytes(received))[-LONGEST:]
        while (cut := min((at for at in (self._in.find(end) for end in self.ends) if at >= 0), default=-1)) >= 0:
            line, self._in = self._in[:cut], self._in[cut + 1 :]
            self.line(line)

    def due(self) -> bytes:
        """Bytes that have come out by now. Raises LinkLost while the line is cut."""
        if not self.plugged:
            raise LinkLost("unplugged")
        out, self._unread = self._unread + self._run_due(), b""
        return out

    def next(self) -> float | None:
        """s when something will come out or happen, None for never."""
        return self.now if self._unread else self._out[0][0] if self._out else None

    def at_once(self, byte: int) -> bool:
        """Whether a byte acts at once and is no part of a line; if so, it has acted."""
        return False

    def line(self, line: bytes) -> None:
        """Carry out a line, without its end."""
        raise NotImplementedError

    def greet(self) -> None:
        """Send what is sent when the power comes on."""

    def power_cycle(self) -> None:
        """Switch off and on."""
        self.machine.restart(self.now)
        self._in = b""
        self.forget()
        self.greet()

    def forget(self) -> None:
        """Drop what is queued to be sent or done."""
        self._generation += 1

    def send(self, text: str, acknowledges: bool = False) -> None:
        """Queue text for the line; the faults armed for answers act on it, and acknowledgements may be lost or
        doubled.
        """
        data = text.encode("latin-1")
        take, rng = self.faults.take, self.faults.rng
        if acknowledges and take("lost-ok"):
            return
        if acknowledges and take("two-ok"):
            data *= 2
        delay = rng.uniform(*LATE) if take("late") else 0.0
        if take("garbage"):
            noise = bytes(rng.integers(0, 256, rng.integers(1, 12), dtype=np.uint8))
            at = int(rng.integers(len(data) + 1))
            data = data[:at] + noise + data[at:]
        if take("half-line"):
            half = len(data) // 2
            self._queue(delay, data[:half])
            if rng.random() < 0.5:
                self._queue(delay + 0.3, data[half:])
            return
        self._queue(delay, data)

    def later(self, t: float, act: Callable[[], None]) -> None:
        """Have something done at t (s), unless `forget` comes between."""
        heapq.heappush(self._out, (t, next(self._number), act, self._generation))

    def unplug(self, seconds: float = UNPLUGGED) -> None:
        """Cut the line for a while; what was under way is lost."""
        self._cut_until = self.now + seconds
        self._in = self._unread = b""
        self._out = [each for each in self._out if not isinstance(each[2], bytes)]
        heapq.heapify(self._out)

    def strikes_on_move(self, duration: float) -> None:
        """Faults that come while a move is under way or after it, as armed."""
        take, rng = self.faults.take, self.faults.rng
        at = self.now + rng.uniform(0.1, 0.9) * duration
        if take("unplug"):
            self.later(at, self.unplug)
        if take("restart"):
            self.later(at, self.power_cycle)
        if take("drift"):
            self.later(self.now + duration + 0.2, self.machine.drift)
        if take("reset-ignored"):
            self.later(at, self.deaf_alarm)

    def deaf_alarm(self) -> None:
        """An alarm that only switching off and on ends."""
        self.machine.deafen(self.now)

    def _queue(self, delay: float, data: bytes) -> None:
        self._last = max(self._last, self.now + delay)
        heapq.heappush(self._out, (self._last, next(self._number), data, -1))

    def _run_due(self) -> bytes:
        out = b""
        while self._out and self._out[0][0] <= self.now:
            _, _, what, generation = heapq.heappop(self._out)
            if isinstance(what, bytes):
                out += what
            elif generation == self._generation:
                what()
        return out


class TrueCommandsLog:
    """Appends rows t and a column of each axis to a file up to now whenever `record` is called; t is the clock's."""

    def __init__(self, emulator: Emulator, path: Path, axes: Sequence[str]) -> None:
        """axes : names of the columns. Raises FileError where the file already exists or cannot be written."""
        try:
            self._file = path.open("x", encoding="utf-8")
        except OSError as error:
            raise FileError(path, f"cannot be written: {error.strerror}") from None
        self._emulator, self._done = emulator, emulator.now
        self._file.write(",".join(["t", *axes]) + "\n")

    def record(self) -> None:
        """Write what happened since the last time."""
        now = self._emulator.now
        t, lengths = self._emulator.path(self._done)
        rows = [(one, row) for one, row in zip(t, lengths) if self._done <= one < now]
        rows.append((now, self._emulator.lengths_at(now)))
        if len(rows) == 1 and now - self._done < 0.1:
            return  # standing still needs no more
        self._file.write("".join(f"{one:.6f}," + ",".join(f"{value:.9f}" for value in row) + "\n" for one, row in rows))
        self._file.flush()
        self._done = now + 1e-6

    def close(self) -> None:
        """Write the rest, and close."""
        self.record()
        self._file.close()


class LineEmulator(Emulator):
    """See Emulator. A class of the user's derives from it and states `protocol` and `answer`.

    stop_byte : a byte that slows every axis down at once wherever it comes, b"" where a stop is a line
    """

    ends = b"\n"
    protocol: ClassVar[type[LineProtocol]]
    stop_byte: ClassVar[bytes] = b""
    _guarded: ClassVar[bool]

    def __init__(self, machine: EmulatedMachine, faults: Faults, clock: Clock, limits: Floats) -> None:
        super().__init__(machine, faults, clock, limits)
        self._moves = False  # whether the line under way is of a move or a homing, whose answer may be lost

    def answer(self, text: str) -> str | None:
        """What a line is answered with, None for nothing; carries it out. A line may be anything that came."""
        raise NotImplementedError

    def encode(self, text: str) -> str:
        """A line as it is sent, for a check sum or another end."""
        return f"{text}\n"

    def at_once(self, byte: int) -> bool:
        if self.stop_byte != bytes([byte]):
            return False
        self.machine.halt(self.now)
        return True

    def line(self, line: bytes) -> None:
        text = line.decode("latin-1").strip()
        if not text:
            return
        self._moves = False
        answer = self.answer(text)
        if answer is not None:
            self.send(self.encode(answer), acknowledges=self._moves)

    @property
    def start_number(self) -> int:
        """Number of its starts: another after each."""
        return self.machine.session

    @property
    def activity(self) -> str:
        """idle, moving, homing or alarm."""
        t = self.now
        if self.machine.homing(t):
            return "homing"
        return "moving" if self.machine.moving(t) else "alarm" if self.machine.deaf else "idle"

    @property
    def fault(self) -> str:
        """Why an axis is in error, without blanks; "" for none."""
        return self.machine.fault(self.now).replace(" ", "_")

    @property
    def homed(self) -> bool:
        """Whether its positions are true, as far as it knows."""
        self.machine.settle(self.now)
        return self.machine.homed

    @property
    def positions(self) -> Floats:
        """(axes,) m as it counts."""
        return self.machine.counters(self.now)

    def move(self, target: Floats, seconds: float, accepted: str, refused: str) -> str | None:
        """Begin a move to target (axes,) m in at least so long (s). Returns its answer, None for nothing."""
        self._moves = True
        target = np.asarray(target, float)
        if self.fault or self.busy or not self.homed:
            return f"{refused} {self.fault or ('busy' if self.busy else 'not homed')}"
        if target.shape != (len(self.limits),) or not np.isfinite(target).all():
            return f"{refused} these are not {len(self.limits)} positions"
        if self.is_beyond_limits(target):
            return f"{refused} beyond the limits"
        struck = self.start_move(target, seconds)
        if "ok-after-error" in struck:
            self.send(self.encode(f"{refused} not understood"))
        if struck & {"resend", "resend-moving"}:
            return None
        return f"{refused} not understood" if "runs-after-error" in struck else accepted

    def home(self, accepted: str, refused: str) -> str:
        """Begin to home all axes. Returns what it is answered with."""
        self._moves = True
        if self.machine.deaf:
            return f"{refused} critical"
        self.faults.begin(homing=True)
        end, well = self.machine.start_homing(self.now)
        if not well:
            self.later(end, lambda: self.machine.fail(self.now, "home"))
        return accepted

    def stop(self, accepted: str) -> str:
        """Slow every axis down. Returns what it is answered with."""
        self.machine.halt(self.now)
        return accepted

    def unlock(self, accepted: str, refused: str) -> str:
        """Clear an alarm whose cause is gone. Returns what it is answered with."""
        return f"{refused} critical" if self.machine.deaf else accepted


def load_user_emulator(file_or_package: str) -> type[LineEmulator]:
    """Emulator class in a user's file or package.

    "file:PATH" or "package:NAME".
    Raises FileError, RigError.
    """
    kind, path = load_user_class_and_its_file(file_or_package, LineEmulator, GROUP, "emulator")
    for name in ("protocol", "answer"):
        if getattr(kind, name, None) is getattr(LineEmulator, name, None):
            raise user_class_error(path, kind, f"lacks {name}")
    if "_guarded" not in vars(kind):
        for name in ("answer", "encode", "at_once", "line", "greet"):
            if name in vars(kind):
                setattr(kind, name, wrap_user_call_to_locate_errors(vars(kind)[name], path, RigError, kind.__name__))
        kind._guarded = True
    return kind
