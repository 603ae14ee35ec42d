"""Hands of an arm, places where effects act, and tolerances of parts.

Several hands stand on branches of one trunk. Tolerances are of markers, corner finder, thermometers and cube seats,
with their reasons.

Files, JSON and the command line have a place's text. What lies within the tolerances may be there beyond chance and
still is nobody's fault: a diagnosis mentions it as a remark, with its size.
"""

import re
from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from typing import Self

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.errors import RigError


@dataclass(frozen=True, slots=True, eq=False)
class Branch:
    """Where a joint stands that does not follow the joint before it.

    joint : its index; parent : index of the joint whose link carries it, -1 for the base
    mount : pose of the frame of its row in the frame of that link
    """

    joint: int
    parent: int
    mount: RigidTransform


@dataclass(frozen=True, slots=True, eq=False)
class Hand:
    """One of several hands of an arm.

    name : as poses.csv has it; joint : index of the joint whose link holds it
    tool : pose of what is measured (hand, target) in the frame of that link
    mass : kg; centre_of_mass : (3,) m in the hand's own frame
    """

    name: str
    joint: int
    tool: RigidTransform
    mass: float | None = None
    centre_of_mass: Floats | None = None


@dataclass(frozen=True, slots=True)
class Coupling:
    """A joint that follows another: its value is multiplier * (the leader's) + offset.

    joint, leader : their indices; multiplier : the joint's motion by the leader's (rad or m each); offset : m, of
    a joint that turns rad
    """

    joint: int
    leader: int
    multiplier: float
    offset: float


COUPLED = 1e-3  # m or rad, by which a follower's value may miss its leader's


def coupling_matrix(count: int, couplings: tuple[Coupling, ...]) -> Floats:
    """Matrix (n, n) of joints' motion by commanded motion, with couplings.

    It is the identity, but a follower's row is its leader's.
    Raises ValueError for a coupling of a joint that there is not, with itself, stated twice, or behind a follower
    """
    out = np.eye(count)
    for k, one in enumerate(couplings):
        if not 0 <= one.joint < count or not 0 <= one.leader < count or one.joint == one.leader:
            raise ValueError(f"coupling {k + 1}: joint {one.joint + 1} cannot follow joint {one.leader + 1}")
        if one.joint in [other.joint for other in couplings[:k]]:
            raise ValueError(f"coupling {k + 1}: joint {one.joint + 1} follows another joint already")
        if one.leader in [other.joint for other in couplings]:
            raise ValueError(f"coupling {k + 1}: joint {one.leader + 1} follows a joint itself: name that one")
        if not np.isfinite(one.multiplier) or not one.multiplier or not np.isfinite(one.offset):
            raise ValueError(f"coupling {k + 1}: multiplier {one.multiplier:g} or offset {one.offset:g} is no figure")
        out[one.joint, one.joint], out[one.joint, one.leader] = 0.0, one.multiplier
    return out


def joint_parent_indices(count: int, branches: tuple[Branch, ...]) -> Integers:
    """Index (n,) of the parent of each joint, -1 for the base.

    That is the joint whose link carries it: the one before it without branch.
    Raises ValueError for a branch of a joint that there is not, stated twice, or that stands on a later joint
    """
    parents = np.arange(-1, count - 1)
    for k, branch in enumerate(branches):
        if not 0 <= branch.joint < count or not -1 <= branch.parent < branch.joint:
            raise ValueError(f"branch {k + 1}: joint {branch.joint + 1} cannot stand on joint {branch.parent + 1}")
        if branch.joint in [one.joint for one in branches[:k]]:
            raise ValueError(f"branch {k + 1}: joint {branch.joint + 1} has a branch already")
        parents[branch.joint] = branch.parent
    return parents


def joint_carries_joint_matrix(parents: Integers) -> Booleans:
    """Whether joint i carries joint j, matrix (n, n) bool.

    [i, j]: its link moves with joint i, as its own link does.
    """
    out = np.eye(len(parents), dtype=bool)
    for j, parent in enumerate(parents.tolist()):
        if parent >= 0:
            out[:, j] |= out[:, parent]
    return out


def hand_names(mechanism: object) -> tuple[str, ...]:
    """Names of the hands of a mechanism.

    Of one that has several; none of others.
    """
    hands: tuple[Hand, ...] = getattr(mechanism, "hands", ())
    return tuple(hand.name for hand in hands)


def hand_number(mechanism: object, hand: str | int) -> int:
    """Number, from 0, of a hand of a mechanism.

    By its name or number. Raises RigError for a hand that the mechanism does not have.
    """
    names = hand_names(mechanism)
    if isinstance(hand, int) and 0 <= hand < len(names):
        return hand
    if isinstance(hand, int) or hand not in names:
        what = f"number {hand}, counted from 0" if isinstance(hand, int) else repr(hand)
        raise RigError(f"the mechanism has no hand {what}; there are {', '.join(names) or 'no named hands'}")
    return names.index(hand)


def require_single_hand_mechanism(mechanism: object, refusal_beginning: str) -> None:
    """Raise RigError for a mechanism with several hands. refusal_beginning : says what is not done"""
    names = hand_names(mechanism)
    if names:
        raise RigError(f"{refusal_beginning} for arms with one hand; this one has {len(names)}: {', '.join(names)}")


def require_no_couplings(mechanism: object, refusal_beginning: str) -> None:
    """Raise RigError for an arm with joints that follow others. refusal_beginning : says what is not done"""
    for one in getattr(mechanism, "couplings", ())[:1]:
        raise RigError(
            f"{refusal_beginning} for arms whose joints all move alone; joint {one.joint + 1} follows joint "
            f"{one.leader + 1}"
        )


def selected_hand_name(mechanism: object) -> str | None:
    """Name of the selected hand of a mechanism, None where it has not several.

    It is the hand at which the arm is seen.
    """
    number: int = getattr(mechanism, "hand", 0)
    names = hand_names(mechanism)
    return names[number] if names else None


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


def parse_place_in_stage(text: str, kinds: Collection[str]) -> Place | None:
    """Parse a Place in a stage of a chain ("stage2strut3").

    None for any other text.

    Axes must be among the kinds of place.
    """
    found = SHORT.fullmatch(text) if "axis" in kinds else None
    return None if found is None else Place(found[2], found[3], int(found[1]))


@cache
def axis_mask(effect_place: Place, places: tuple[str, ...]) -> Floats:
    """Mask (axes,) of the axes that an effect's place includes.

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
