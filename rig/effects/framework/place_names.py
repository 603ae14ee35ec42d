"""What a place is called: an axis of a machine or of a stage of a chain, a camera, a marker, a target, or the whole of
something.
"""

import re
from collections.abc import Collection
from functools import cache

import numpy as np

AXES = ("strut", "joint", "slide")  # what "axis" stands for among an effect's places
WHOLE = {**dict.fromkeys(AXES, "rig"), "camera": "cameras", "marker": "markers"}  # what takes in all places of a kind
NUMBER = "[1-9][0-9]{0,8}"
STAGE = re.compile(rf"stage ({NUMBER}) (.+)")
SHORT = re.compile(rf"stage[ _]?({NUMBER})[ _]?({'|'.join(AXES)})[ _]?({NUMBER})")


@cache
def kind_of(place: str) -> str:
    """The kind of a place, its first word: "strut" of "strut 3" as of "stage 2 strut 3", "camera" of "camera left",
    "rig".
    """
    return split_stage(place)[1].split(" ")[0]


def axis_word(place: str) -> str:
    """What the axis of a place is called: "strut", "joint" or "slide"; of what is no axis, "strut"."""
    word = kind_of(place)
    return word if word in AXES else "strut"


def axis_neutral_text(text: str) -> str:
    """What an effect says of its {axis}, of an axis of any kind."""
    return text.replace("{axis}s", "axes").format(axis="axis")


def split_stage(place: str) -> tuple[str, str]:
    """("stage 2 ", "strut 3") of a place in a chain, ("", the place) of any other."""
    found = STAGE.fullmatch(place)
    return (f"stage {found[1]} ", found[2]) if found and found[2].split(" ")[0] in AXES else ("", place)


def parse_stage_place(text: str, kinds: Collection[str]) -> str | None:
    """The place in a chain that a text means ("stage2strut3"), where axes are among the kinds of place; None for any
    other text.
    """
    found = SHORT.fullmatch(text) if "axis" in kinds else None
    return None if found is None else f"stage {found[1]} {found[2]} {found[3]}"


def includes_place(place: str, other: str) -> bool:
    """Whether a place is another, or takes in all of its kind, as "rig" does struts."""
    return place == other or place == WHOLE.get(kind_of(other))


@cache
def axis_mask(at: str, places: tuple[str, ...]) -> np.ndarray:
    """(axes,) 1.0 for the axes' places that a place is or takes in, else 0.0."""
    return np.array([float(includes_place(at, place)) for place in places])
