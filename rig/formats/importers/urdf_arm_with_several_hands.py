"""Arm with several hands read from a URDF: the joints from a root link to several tips, shared ones once."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats
from rig.errors import FileError
from rig.formats.checked_entries import name_problem
from rig.formats.importers.urdf_joint_chain import JointChain, UrdfJoint, load_joint_chain
from rig.model.arm_branches_and_hands import Branch, Hand
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms.arm import joint_frames
from rig.model.mechanisms.denavit_hartenberg_rows_of_joint_axes import denavit_hartenberg_rows_of_joint_axes


def urdf_arm_with_several_hands(
    path: Path, tips: tuple[str, ...], root: str | None = None
) -> tuple[Arm, tuple[JointChain, ...]]:
    """(Arm, JointChain to each tip) of a URDF's joints from a root link to several tips, its hands named by these.

    The first tip's joints come first, and then those of each further one that are not listed yet. Where joints stand on
    a link that an earlier joint moves, they are a branch; a row of a shared joint is that of the first tip.
    Raises FileError as `load_joint_chain`, and for a tip named twice or by no name that a column of a table can hold
    """
    for number, tip in enumerate(tips):
        if tip in tips[:number]:
            raise FileError(path, f"--tip {tip!r} is named twice")
        if name_problem(tip):
            raise FileError(path, f"--tip {tip!r} names a hand: {name_problem(tip)}")
    chains = tuple(load_joint_chain(path, tip, root) for tip in tips)
    points, directions, T = chains[0].axes_at_zero()
    placed = denavit_hartenberg_rows_of_joint_axes(points, directions, T)
    first = chains[0].moving
    arm = Arm(placed.rows, _limits(first), placed.base, placed.tool, _slides(first))
    names, hands = [joint.name for joint in first], [Hand(tips[0], len(first) - 1, placed.tool)]
    for chain in chains[1:]:
        arm = _with_hand(arm, chain, names, hands)
    return replace(arm, hands=tuple(hands)), chains


def _with_hand(arm: Arm, chain: JointChain, names: list[str], hands: list[Hand]) -> Arm:
    """The arm with a further chain's joints that it lacks, whose names and hand are added to the lists."""
    points, directions, T = chain.axes_at_zero()
    shared = [joint.name for joint in chain.moving if joint.name in names]
    parent = names.index(shared[-1]) if shared else -1
    after = joint_frames(np.zeros(len(names)), replace(arm, hands=())).after
    here = arm.base if parent < 0 else RigidTransform.from_matrix(after[parent])
    own = chain.moving[len(shared) :]
    if not own:
        hands.append(Hand(chain.tip, parent, here.inv() * T))
        return arm
    there = here.inv()
    rows = denavit_hartenberg_rows_of_joint_axes(
        there.apply(points[len(shared) :]), there.rotation.apply(directions[len(shared) :]), there * T
    )
    branch = Branch(len(names), parent, rows.base)
    names += [joint.name for joint in own]
    hands.append(Hand(chain.tip, len(names) - 1, rows.tool))
    return replace(
        arm,
        joints=np.concatenate([arm.rows, rows.rows]),
        limits=np.concatenate([arm.limits, _limits(own)]),
        slides=np.concatenate([arm.slides, _slides(own)]),
        branches=(*arm.branches, branch),
    )


def _limits(joints: tuple[UrdfJoint, ...]) -> Floats:
    return np.array([joint.limits for joint in joints], float)


def _slides(joints: tuple[UrdfJoint, ...]) -> Booleans:
    return np.array([joint.kind == "prismatic" for joint in joints])
