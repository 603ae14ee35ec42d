"""Base class of the emulator of a user's protocol.

Lines, axes, and faults that a driver must meet.
"""

from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.clock import Clock
from rig.driving.emulators.controller_emulator import Emulator
from rig.driving.emulators.controller_faults import Faults
from rig.driving.emulators.emulated_axis_motion_and_homing import EmulatedMachine
from rig.driving.protocols.protocol_selection_and_user_protocols import GROUP
from rig.driving.protocols.user_line_protocol_base import LineProtocol
from rig.driving.user_protocol_camera_and_sensor_classes import fail_at_class, guard_call, load_user_class
from rig.errors import RigError


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
            self.say(self.encode(answer), acknowledges=self._moves)

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
            self.say(self.encode(f"{refused} not understood"))
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


def load_user_emulator(stated: str) -> type[LineEmulator]:
    """Emulator class in a user's file or package.

    "file:PATH" or "package:NAME".
    Raises FileError, RigError.
    """
    kind, path = load_user_class(stated, LineEmulator, GROUP, "emulator")
    for name in ("protocol", "answer"):
        if getattr(kind, name, None) is getattr(LineEmulator, name, None):
            raise fail_at_class(path, kind, f"lacks {name}")
    if "_guarded" not in vars(kind):
        for name in ("answer", "encode", "at_once", "line", "greet"):
            if name in vars(kind):
                setattr(kind, name, guard_call(vars(kind)[name], path, RigError, kind.__name__))
        kind._guarded = True
    return kind
