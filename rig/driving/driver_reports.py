"""What a driver reports: how the controller and the struts stand, and a move that is done."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True, eq=False)
class Status:
    """activity : as rig.driving.protocols.protocol_interface.State; lengths : (n,) m; known : whether the lengths can
    be believed; fault,
    said : text."""

    activity: str
    lengths: np.ndarray
    known: bool
    fault: str
    said: str


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """A move that is done. lengths : (n,) m, as read back; start_time, ended : s on the clock; note : what went wrong
    on the way, or "".
    """

    lengths: np.ndarray
    start_time: float
    ended: float
    note: str
