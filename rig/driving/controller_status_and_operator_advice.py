"""Status of the controller and of a finished move, and advice to the operator where nothing moves."""

from dataclasses import dataclass

from rig.array_and_json_types import Floats


@dataclass(frozen=True, slots=True, eq=False)
class ControllerStatus:
    """activity : as rig.driving.protocols.protocol_interface.State; lengths : (n,) m; known : whether the lengths can
    be believed; fault, said : text; homing_required : as of a State"""

    activity: str
    lengths: Floats
    known: bool
    fault: str
    said: str
    homing_required: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class FinishedMove:
    """A move that is done. lengths : (n,) m, as read back; start_time, ended : s on the clock; note : what went wrong
    on the way, or "".
    """

    lengths: Floats
    start_time: float
    ended: float
    note: str


@dataclass(frozen=True, slots=True, eq=False)
class PositionReport:
    """Lengths (n,) m that the controller reported on request. requested, answered : s on the clock"""

    requested: float
    answered: float
    lengths: Floats

    @property
    def t(self) -> float:
        """s, middle of the time in which the lengths were read."""
        return (self.requested + self.answered) / 2


TRUST = "home it (rig home), or, where the lengths reported are true, use --trust (rig run: --no-home)"
ANEW = f"the controller has restarted since the last contact; {TRUST}"
OUT_OF_RANGE = "is [controller] zero the length, joint centre to joint centre, at which the controller counts 0?"
CANNOT_HOME = (
    "[controller] homing = false: this controller cannot home, so nothing was sent; an alarm is cleared with "
    "rig jog --unlock, "
    "and its position is trusted with --trust once you have verified it"
)
_BY_ACTIVITY = {
    "alarm": "see what is wrong at the machine, then rig home --unlock",
    "off": "see that nobody is in the way, then rig home --unlock, which switches it on",
    "held": "it was put in hold: rig stop drops what is held, then continue",
    "homing": "wait until it is home, or rig stop",
    "moving": "wait until it is at rest, or rig stop",
}


def operator_advice(activity: str, can_home: bool) -> str:
    """Advice to the operator for the controller's activity, as text after "; "; "" where it is ready.
    can_home : whether the controller can home.
    """
    if activity in ("alarm", "off") and not can_home:
        return (
            "; see what is wrong at the machine, then rig jog --unlock, with --trust where the position it reads "
            "is true"
        )
    return f"; {_BY_ACTIVITY[activity]}" if activity in _BY_ACTIVITY else ""
