"""Records of excluded outliers, and of deviations in too many rows to be outliers."""

from dataclasses import dataclass, replace

from calib.identify.robust_fit import MOST


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


@dataclass(frozen=True, slots=True, eq=False)
class Outliers:
    """frames : numbers of those left out whole; sightings : {(frame's number, camera's index, marker's row)} of those
    whose corners are
    left_out : (LeftOut, ..) of both; crowd : Crowd of what is far off in too many, or None"""

    frames: frozenset[int] = frozenset()
    sightings: frozenset[tuple[int, int, int]] = frozenset()
    left_out: tuple[LeftOut, ...] = ()
    crowd: Crowd | None = None

    def with_more(self, more: "Outliers", count: int, what: str) -> "Outliers":
        """Both together, of so many rows, called `what`; where these are too many, the first alone and the crowd that
        they are.
        """
        both = len(self.frames) + len(more.frames - self.frames)
        if both > MOST * count:
            return replace(self, crowd=Crowd(what, both, count))
        left_out = sorted(self.left_out + more.left_out, key=lambda one: one.frame)
        return Outliers(
            self.frames | more.frames, self.sightings | more.sightings, tuple(left_out), more.crowd or self.crowd
        )
