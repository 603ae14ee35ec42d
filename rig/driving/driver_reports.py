"""What a driver reports: how the controller and the struts stand, and a move that is done."""

from dataclasses import dataclass

from rig.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Status:
    """activity : as rig.driving.protocols.protocol_interface.State; lengths : (n,) m; known : whether the lengths can
    be believed; fault,
    said : text."""

    activity: str
    lengths: Floats
    known: bool
    fault: str
    said: str


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """A move that is done. lengths : (n,) m, as read back; start_time, ended : s on the clock; note : what went wrong
    on the way, or "".
    """

    lengths: Floats
    start_time: float
    ended: float
    note: str
