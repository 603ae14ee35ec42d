"""Place: where an effect sits, as a value: an axis of a machine or of a stage of a chain, a camera, a marker, a target,
or the whole of something. Files, JSON and the command line have its text.
"""

import re
from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from typing import Self

import numpy as np

from rig.arrays import Floats

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


def axis_neutral_text(text: str) -> str:
    """What an effect says of its {axis}, of an axis of any kind."""
    return text.replace("{axis}s", "axes").format(axis="axis")


def parse_stage_place(text: str, kinds: Collection[str]) -> Place | None:
    """The Place in a chain that a text means ("stage2strut3"), where axes are among the kinds of place; None for any
    other text.
    """
    found = SHORT.fullmatch(text) if "axis" in kinds else None
    return None if found is None else Place(found[2], found[3], int(found[1]))


@cache
def axis_mask(at: Place, places: tuple[str, ...]) -> Floats:
    """(axes,) 1.0 for the axes' places (texts) that a place is or takes in, else 0.0."""
    return np.array([float(at.includes(Place.parse(place))) for place in places])
