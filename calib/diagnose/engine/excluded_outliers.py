"""Records of excluded outliers, and of deviations in too many rows to be outliers."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A row that was left out of all that was asked. frame : its number; place : where it shows most; off : in unit
    times : the scatter of the others; what : "pose" where the whole frame was left out, "corners" where those of one
        marker in one image were
    reason : in words"""

    frame: int
    what: str
    place: str
    off: float
    unit: str
    times: float
    reason: str


@dataclass(frozen=True, slots=True)
class Crowd:
    """So many of a kind are far off that they are not wild: something is left out of the model. what : in the plural;
    count, of : how many.
    """

    what: str
    count: int
    of: int
