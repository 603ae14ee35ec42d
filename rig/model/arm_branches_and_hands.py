"""Branches and hands of an arm that has several hands on one trunk."""

from dataclasses import dataclass

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


def joint_parents(count: int, branches: tuple[Branch, ...]) -> Integers:
    """Index (n,) of the joint whose link carries each of n joints, -1 for the base: the one before it without branch.

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


def carried_joints(parents: Integers) -> Booleans:
    """Whether joint i carries joint j (n, n) bool, [i, j]: its link moves with joint i, as its own link does."""
    out = np.eye(len(parents), dtype=bool)
    for j, parent in enumerate(parents.tolist()):
        if parent >= 0:
            out[:, j] |= out[:, parent]
    return out


def hand_names(mechanism: object) -> tuple[str, ...]:
    """Names of the hands of a mechanism that has several; none of others."""
    hands: tuple[Hand, ...] = getattr(mechanism, "hands", ())
    return tuple(hand.name for hand in hands)


def hand_number(mechanism: object, hand: str | int) -> int:
    """Number, from 0, of a hand by its name or number. Raises RigError for a hand that the mechanism does not have."""
    names = hand_names(mechanism)
    if isinstance(hand, int) and 0 <= hand < len(names):
        return hand
    if isinstance(hand, int) or hand not in names:
        what = f"number {hand}, counted from 0" if isinstance(hand, int) else repr(hand)
        raise RigError(f"the mechanism has no hand {what}; there are {', '.join(names) or 'no named hands'}")
    return names.index(hand)


def require_one_hand(mechanism: object, what: str) -> None:
    """Raise RigError for a mechanism with several hands. what : is not done for it, as a sentence's beginning"""
    names = hand_names(mechanism)
    if names:
        raise RigError(f"{what} for arms with one hand; this one has {len(names)}: {', '.join(names)}")


def seen_hand(mechanism: object) -> str | None:
    """Name of the hand at which an arm with several is seen; None of other mechanisms."""
    number: int = getattr(mechanism, "hand", 0)
    names = hand_names(mechanism)
    return names[number] if names else None
