"""A number (or several) of an effect: its unit, what makes sense, what rigs show, and how the effect depends on it."""

from dataclasses import dataclass, replace

from rig.effects.framework.place_names import kind_of
from rig.formats.number_rounding import quantity_text

MOST_SHOWN = 3  # numbers of several

TURNED = {"m": "rad", "N/m": "N m/rad"}  # units of a strut's and of a joint's axis

FAR = 10.0  # times what rigs show, from which a size is said to be unusual

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Parameter:
    """name; unit; bounds : (low, high) that make sense, beyond any value that nature prefers; usual : (low, high) that
    rigs show
    size : numbers it has, 0 for any; signed : whether minus what is usual is as usual
    joint : (bounds, usual) at a joint, whose travel is rad, where these are not those of a strut

    role : how the effect depends on it, for those who search: "linear", "inverse" (its reciprocal enters linearly),
    "size" (nothing at zero, but not linear), "phase" (of a sinusoid that a linear parameter scales), "log" or "even" (a
    node's parameter, to be searched over `usual` on a scale of that kind), "moment" (a time, s from the recording's
    start), "frequency", "direction" (of which only the direction counts), "choice" (given or chosen, never fitted)
    """

    name: str
    unit: str
    bounds: Range
    usual: Range
    size: int = 1
    role: str = "linear"
    signed: bool = False
    joint: tuple[Range, Range] | None = None

    def unusual(self, value: object) -> str | None:
        """Whether a value is far beyond what rigs show, in a sentence; None where it is not, or is no number."""
        if self.role not in ("linear", "size", "inverse") or not isinstance(value, (int, float)):
            return None
        inverse = self.role == "inverse"
        most = self.usual[0] if inverse else self.usual[1]
        if not (abs(value) * FAR < most if inverse else abs(value) > FAR * most):
            return None
        end = "least" if inverse else "most"
        return (
            f"{self.name.replace('_', ' ')} {quantity_text(value, self.unit)} is far beyond what rigs show, "
            f"{quantity_text(most, self.unit)} at the "
            f"{end}: "
            "something else may hide behind it"
        )

    def at(self, place: str) -> "Parameter":
        """The same as it is at a place: in rad in place of m at a joint."""
        if self.joint is None or kind_of(place) != "joint":
            return self
        return replace(
            self, unit=TURNED.get(self.unit, self.unit), bounds=self.joint[0], usual=self.joint[1], joint=None
        )

    def said(self, value: float | tuple[float, ...]) -> str:
        """Its name and a value, in a unit that people read."""
        numbers = value if isinstance(value, tuple) else (value,)
        more = f", the first {MOST_SHOWN} of {len(numbers)}" if len(numbers) > MOST_SHOWN else ""
        return f"{self.name.replace('_', ' ')} {quantity_text(numbers[:MOST_SHOWN], self.unit)}{more}"
