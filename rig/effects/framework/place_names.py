"""Names of places where effects act: an axis, a stage's axis, a camera, a marker, a target, or all of a kind."""

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
    """Kind of a place, its first word: "strut" of "strut 3" and of "stage 2 strut 3", "camera", "rig"."""
    return split_stage(place)[1].split(" ")[0]


def axis_word(place: str) -> str:
    """Word for the axis of a place: "strut", "joint" or "slide"; "strut" where it is no axis."""
    word = kind_of(place)
    return word if word in AXES else "strut"


def axis_neutral_text(text: str) -> str:
    """Text of an effect made neutral: {axis} replaced by the word axis, for an axis of any kind."""
    return text.replace("{axis}s", "axes").format(axis="axis")


def split_stage(place: str) -> tuple[str, str]:
    """("stage 2 ", "strut 3"), a place split at its stage in a chain; ("", place) of any other."""
    found = STAGE.fullmatch(place)
    return (f"stage {found[1]} ", found[2]) if found and found[2].split(" ")[0] in AXES else ("", place)


def parse_stage_place(text: str, kinds: Collection[str]) -> str | None:
    """Place in a stage of a chain parsed from a text ("stage2strut3"); None for any other text."""
    found = SHORT.fullmatch(text) if "axis" in kinds else None
    return None if found is None else f"stage {found[1]} {found[2]} {found[3]}"


def includes_place(place: str, other: str) -> bool:
    """Whether a place includes another: the same, or all of its kind, as "rig" includes struts."""
    return place == other or place == WHOLE.get(kind_of(other))


@cache
def axis_mask(at: str, places: tuple[str, ...]) -> np.ndarray:
    """Mask (axes,) of the axes' places: 1.0 for those that a place includes, else 0.0."""
    return np.array([float(includes_place(at, place)) for place in places])
