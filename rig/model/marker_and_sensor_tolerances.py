"""Tolerances of printed markers, corner finder, thermometers and cube seats, each with its reason.

What lies within these limits may be there beyond chance and still is nobody's fault: a diagnosis mentions it as a
remark, with its size.
"""

from dataclasses import dataclass

LIMIT = 4.0  # standard deviations that a limit stands for: parts keep to it, and lie about its middle most often


@dataclass(frozen=True, slots=True)
class Tolerance:
    """limit, in unit; reason : why so much is nobody's fault, in words that follow "no more than"."""

    limit: float
    unit: str
    reason: str

    @property
    def sigma(self) -> float:
        """Standard deviation, in unit."""
        return self.limit / LIMIT


SIDES = Tolerance(
    5e-4,
    "",
    "the side of a printed marker may be off: a laser printer's feed and the paper's moisture change it by 0.05 %",
)
PLACES = Tolerance(
    2e-5,
    "m",
    "a printed marker's place on its face may be off: a printer's dots, 600 an inch, are 42 µm apart, and an edge is "
    "placed to half of one",
)
FINDER = Tolerance(
    0.02, "px", "the corner finder may shift all edges of a camera's images: its blur is a model, and light spills"
)
STILL = Tolerance(0.005, "px", "the corner finder may be off in the same way wherever a marker looks the same")
THERMOMETER = Tolerance(0.1, "K", "a thermometer may drift: 0.1 K is what one glued on, in air, is good for")
SEAT = (5e-4, 5e-3)  # m, rad; standard deviations by which a cube that is taken off a socket and put back may sit off
STEEL = 1.2e-5  # 1/K; expansion of a strut, by which a thermometer's error becomes a length
