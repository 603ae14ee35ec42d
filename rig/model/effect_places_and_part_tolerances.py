"""Places where effects act, and part tolerances.

Tolerances of markers, corner finder, thermometers and cube seats, with their reasons.

Files, JSON and the command line have a place's text. What lies within the tolerances may be there beyond chance and
still is nobody's fault: a diagnosis mentions it as a remark, with its size.
"""

import re
from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from typing import Self

import numpy as np

from rig.array_and_json_types import Floats

AXES = ("strut", "joint", "slide")  # what "axis" stands for among an effect's places
WHOLE = {**dict.fromkeys(AXES, "rig"), "camera": "cameras", "marker": "markers"}  # what takes in all places of a kind
NUMBER = "[1-9][0-9]{0,8}"
STAGE = re.compile(rf"stage ({NUMBER}) ((?:{'|'.join(AXES)})(?: .*)?)", re.DOTALL)
SHORT = re.compile(rf"stage[ _]?({NUMBER})[ _]?({'|'.join(AXES)})[ _]?({NUMBER})")


@dataclass(frozen=True, slots=True)
class Place:
    """kind : "strut", "joint", "slide", "camera", "marker" or "target", with a name; "rig", "clock", "cameras" or
    "markers" without one
    name : which of its kind, "3" or "left"; stage : of a chain, from 1, 0 for what is no stage's"""

    kind: str
    name: str = ""
    stage: int = 0

    @classmethod
    def axis(cls, kind: str, index: int) -> Self:
        """The axis of a machine by its index, from 0."""
        return cls(kind, str(index + 1))

    @classmethod
    def parse(cls, text: str) -> "Place":
        """The Place of a text, "strut 3", "stage 2 strut 3", "camera left" or "rig"; of any other text what stands
        before and after its first space.
        """
        return _parsed(text)

    def __str__(self) -> str:
        own = f"{self.kind} {self.name}" if self.name else self.kind
        return f"stage {self.stage} {own}" if self.stage else own

    @property
    def is_axis(self) -> bool:
        """Whether it is an axis."""
        return self.kind in AXES

    @property
    def axis_word(self) -> str:
        """What its axis is called: "strut", "joint" or "slide"; of what is no axis, "strut"."""
        return self.kind if self.is_axis else AXES[0]

    @property
    def number(self) -> int:
        """The number that is its name. Raises ValueError for another name"""
        return int(self.name)

    def includes(self, other: "Place") -> bool:
        """Whether it is another, or takes in all of its kind, as "rig" does struts."""
        whole = WHOLE.get(other.kind)
        return self == other or (whole is not None and self == Place(whole))


@cache
def _parsed(text: str) -> Place:
    found = STAGE.fullmatch(text)
    kind, _, name = (found[2] if found else text).partition(" ")
    return Place(kind, name, int(found[1]) if found else 0)


def parse_stage_place(text: str, kinds: Collection[str]) -> Place | None:
    """Parse a Place in a stage of a chain ("stage2strut3").

    None for any other text.

    Axes must be among the kinds of place.
    """
    found = SHORT.fullmatch(text) if "axis" in kinds else None
    return None if found is None else Place(found[2], found[3], int(found[1]))


@cache
def axis_mask(effect_place: Place, places: tuple[str, ...]) -> Floats:
    """Axis mask (axes,) of a place.

    places : texts of the axes' places

    1.0 for those that a place is or includes, else 0.0.
    """
    return np.array([float(effect_place.includes(Place.parse(place))) for place in places])


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
