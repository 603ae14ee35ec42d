"""A number (or several) of an effect: its unit, what makes sense, what rigs show, and how the effect depends on it."""

from dataclasses import dataclass, replace

TURNED = {"m": "rad", "N/m": "N m/rad"}  # units of a strut's and of a joint's axis

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Parameter:
    """name; unit; bounds : (low, high) that make sense, beyond any value that nature prefers; usual : (low, high) that rigs show
    size : numbers it has, 0 for any; signed : whether minus what is usual is as usual
    joint : (bounds, usual) at a joint, whose travel is rad, where these are not those of a strut

    role : how the effect depends on it, for those who search: "linear", "inverse" (its reciprocal enters linearly), "size"
    (nothing at zero, but not linear), "phase" (of a sinusoid that a linear parameter scales), "log" or "even" (a shape's
    parameter, to be searched over `usual` on a scale of that kind), "moment" (a time, s from the recording's start), "frequency",
    "direction" (of which only the direction counts), "choice" (given or chosen, never fitted)
    """

    name: str
    unit: str
    bounds: Range
    usual: Range
    size: int = 1
    role: str = "linear"
    signed: bool = False
    joint: tuple[Range, Range] | None = None

    def at(self, place: str) -> "Parameter":
        """The same as it is at a place: in rad in place of m at a joint."""
        if self.joint is None or not place.startswith("joint"):
            return self
        return replace(self, unit=TURNED.get(self.unit, self.unit), bounds=self.joint[0], usual=self.joint[1], joint=None)
