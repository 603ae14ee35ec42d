"""Several hands of an arm from a URDF, and Denavit-Hartenberg rows of joint axes.

Rows come from the lines of an arm's axes, and from a table in Craig's convention.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Booleans, Floats
from rig.errors import FileError
from rig.formats.checked_toml_and_json_entries import rig_part_name_problem
from rig.formats.importers.urdf_joint_chain import JointChain, UrdfJoint, load_joint_chain
from rig.model.arm_hands_effect_places_and_tolerances import Branch, Coupling, Hand
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms.arm_kinematics_limits_and_loads import joint_frames, link_transform
from rig.model.pose import pose

NEARLY_PARALLEL = 0.1  # rad; below it the common normal is far away, and Hayati's beta takes its place
SAME = 1e-13  # m, rad; two axes so near are one line
DECIMALS = 15  # of rows, m and rad


class PlacedRows(NamedTuple):
    """rows : (n, 5) theta, d, a, alpha, beta, rad and m; base, tool : RigidTransform, as of Arm"""

    rows: Floats
    base: RigidTransform
    tool: RigidTransform


def denavit_hartenberg_rows_of_joint_axes(points: Floats, directions: Floats, T_root_tip: RigidTransform) -> PlacedRows:
    """Denavit-Hartenberg rows (PlacedRows) of an arm's joint axes.

    Its joints turn about, or slide along, these lines while all joint values are 0.
    points : (n, 3) m, a point on each axis, where the origins of Hayati's rows are put; directions : (n, 3) of length
    1, about which a joint value is right-handed; both in the root's frame. T_root_tip : the tip's pose at 0
    Hayati's beta is not 0 only where an axis is nearly parallel to the next one, and not exactly.
    Raises ValueError for other shapes. Source: Denavit and Hartenberg 1955; Hayati 1983
    """
    points, directions = np.asarray(points, float), np.asarray(directions, float)
    if points.shape != directions.shape or points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise ValueError(f"expected points and directions (n, 3), got {points.shape} and {directions.shape}")
    tip = T_root_tip.as_matrix()
    base = _first_frame(points[0], directions[0])
    frame, rows = base.as_matrix(), list[Floats]()
    for point, direction in zip([*points[1:], tip[:3, 3]], [*directions[1:], tip[:3, 2]]):
        last = len(rows) == len(points) - 1
        inside = frame[:3, :3].T @ np.column_stack([point - frame[:3, 3], direction, tip[:3, 0]])
        row = _row(inside[:, 0], inside[:, 1], inside[:, 2] if last else np.array([1.0, 0.0, 0.0]), last)
        rows.append(np.round(row, DECIMALS) + 0.0)
        frame = frame @ link_transform(np.zeros(()), rows[-1])
    tool = RigidTransform.from_matrix(frame).inv() * T_root_tip
    return PlacedRows(np.array(rows), base, _identity_if_near(tool))


def _first_frame(point: Floats, direction: Floats) -> RigidTransform:
    """Frame 0: the root's own as far as joint 1's axis, its z, leaves it so."""
    sine = float(np.hypot(direction[0], direction[1]))
    if sine < SAME and direction[2] > 0:
        return _identity_if_near(pose([point[0], point[1], 0.0], [0.0, 0.0, 0.0]))
    about = np.array([-direction[1], direction[0], 0.0]) / sine if sine >= SAME else np.array([1.0, 0.0, 0.0])
    return pose(point, about * np.arctan2(sine, direction[2]))


def _identity_if_near(T: RigidTransform) -> RigidTransform:
    near = np.abs(T.translation).max() < SAME and T.rotation.magnitude() < SAME
    return RigidTransform.identity() if near else T


def _row(point: Floats, direction: Floats, x: Floats, last: bool) -> Floats:
    """Row (5,) from a frame to the next: its z along a line through a point (3,) m, of a direction (3,).

    x : (3,) to which the next frame's x is nearest of the two that there are; last : whether it is the tip's own, which
    is taken where any would do
    """
    sine = float(np.hypot(direction[0], direction[1]))
    if sine > np.sin(NEARLY_PARALLEL):
        normal = _nearest(np.array([-direction[1], direction[0]]) / sine, x)
        across = np.array([-normal[1], normal[0]])
        forward = float(direction[:2] @ across)
        d = float(point[2] - (point[:2] @ across) / forward * direction[2])
        a, alpha, beta = float(point[:2] @ normal), np.arctan2(-forward, direction[2]), 0.0
    else:
        d, a, normal = float(point[2]), float(np.hypot(point[0], point[1])), np.array([1.0, 0.0])
        if a >= SAME:
            normal = _nearest(point[:2] / a, x)
            a = float(point[:2] @ normal)
        elif last:
            normal, a = x[:2] / np.hypot(x[0], x[1]), 0.0
        else:
            a = 0.0
        u, v = (_zero_if_near(float(direction[:2] @ one)) for one in (normal, np.array([-normal[1], normal[0]])))
        alpha, beta = np.arctan2(-v, direction[2]), np.arctan2(u, np.hypot(v, direction[2]))
    return np.array([np.arctan2(normal[1], normal[0]), d, a, alpha, beta])


def _zero_if_near(value: float) -> float:
    return 0.0 if abs(value) < SAME else value


def _nearest(normal: Floats, x: Floats) -> Floats:
    """The direction (2,) or its opposite, whichever is nearer to x."""
    side = normal @ x[:2]
    return -normal if side < -1e-9 or (abs(side) <= 1e-9 and normal[1] < 0) else normal


def distal_dh_rows_of_modified_dh_rows(modified: Floats) -> PlacedRows:
    """Distal Denavit-Hartenberg rows (PlacedRows) of rows in Craig's modified convention.

    That is Rx(alpha) Tx(a) Rz(theta + q) Tz(d) for each row.
    modified : (n, 4) theta, d, a, alpha, rad and m. The first row's a and alpha are the base; a row here takes those of
    the next. Raises ValueError for another shape. Source: Craig, Introduction to Robotics, ch. 3
    """
    modified = np.asarray(modified, float)
    if modified.ndim != 2 or modified.shape[1] != 4 or not len(modified):
        raise ValueError(f"expected rows (n, 4), got {modified.shape}")
    rows = np.zeros((len(modified), 5))
    rows[:, :2] = modified[:, :2]
    rows[:-1, 2:4] = modified[1:, 2:]
    a, alpha = modified[0, 2:]
    base = RigidTransform.from_components([a, 0.0, 0.0], Rotation.from_rotvec([alpha, 0.0, 0.0]))
    return PlacedRows(rows, _identity_if_near(base), RigidTransform.identity())


def urdf_arm_with_several_hands_and_its_joint_chains(
    path: Path, tips: tuple[str, ...], root: str | None = None
) -> tuple[Arm, tuple[JointChain, ...]]:
    """Arm with several hands of a URDF, and its joint chains, one to each hand.

    The joints are those from a root link to several tips, by which the hands are named.
    The first tip's joints come first, and then those of each further one that are not listed yet. Where joints stand on
    a link that an earlier joint moves, they are a branch; a row of a shared joint is that of the first tip.
    Raises FileError as `load_joint_chain`, and for a tip named twice or by no name that a column of a table can hold
    """
    for number, tip in enumerate(tips):
        if tip in tips[:number]:
            raise FileError(path, f"--tip {tip!r} is named twice")
        if rig_part_name_problem(tip):
            raise FileError(path, f"--tip {tip!r} names a hand: {rig_part_name_problem(tip)}")
    chains = tuple(load_joint_chain(path, tip, root) for tip in tips)
    points, directions, T = chains[0].axes_at_zero()
    placed = denavit_hartenberg_rows_of_joint_axes(points, directions, T)
    first = chains[0].moving
    arm = Arm(placed.rows, _stated_limits(first), placed.base, placed.tool, _slides(first))
    names, hands = [joint.name for joint in first], [Hand(tips[0], len(first) - 1, placed.tool)]
    for chain in chains[1:]:
        arm = _with_hand(arm, chain, names, hands)
    joints = {joint.name: joint for chain in chains for joint in chain.moving}
    couplings, limits = couplings_and_limits_of_joints(path, tuple(joints[name] for name in names))
    return replace(arm, hands=tuple(hands), couplings=couplings, limits=limits), chains


def couplings_and_limits_of_joints(path: Path, joints: tuple[UrdfJoint, ...]) -> tuple[tuple[Coupling, ...], Floats]:
    """Couplings and limits (n, 2) rad or m of a URDF's moving joints.

    Couplings are of joints that mimic others.
    A joint that mimics a follower follows its leader. A leader's limits are narrowed to where its followers are within
    theirs. Raises FileError for a leader that is not among the joints, joints that follow each other, and limits that
    leave a leader no travel
    """
    names, limits = [joint.name for joint in joints], _stated_limits(joints)
    out = []
    for k, joint in enumerate(joints):
        if joint.mimicked is None:
            continue
        leader, multiplier, offset = joint.mimicked
        passed = [joint.name]
        while True:
            if leader not in names:
                raise FileError(
                    path,
                    f"joint {joint.name!r} follows {leader!r} (mimic), which does not move between root and tip: name "
                    "links with --root and --tip that take it in, or write the joint as fixed",
                    joint.line,
                )
            if leader in passed:
                raise FileError(path, f"joint {joint.name!r} follows itself (mimic), by {leader!r}", joint.line)
            above = joints[names.index(leader)].mimicked
            if above is None:
                break
            passed.append(leader)
            leader, multiplier, offset = above[0], multiplier * above[1], multiplier * above[2] + offset
        at = names.index(leader)
        ends = np.sort((limits[k] - offset) / multiplier)
        limits[at] = max(limits[at, 0], ends[0]), min(limits[at, 1], ends[1])
        if not limits[at, 0] < limits[at, 1]:
            raise FileError(path, f"the limits of joint {joint.name!r} leave its leader {leader!r} none", joint.line)
        out.append(Coupling(k, at, multiplier, offset))
    return tuple(out), limits


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
    inverse = here.inv()
    rows = denavit_hartenberg_rows_of_joint_axes(
        inverse.apply(points[len(shared) :]), inverse.rotation.apply(directions[len(shared) :]), inverse * T
    )
    branch = Branch(len(names), parent, rows.base)
    names += [joint.name for joint in own]
    hands.append(Hand(chain.tip, len(names) - 1, rows.tool))
    return replace(
        arm,
        joints=np.concatenate([arm.rows, rows.rows]),
        limits=np.concatenate([arm.limits, _stated_limits(own)]),
        slides=np.concatenate([arm.slides, _slides(own)]),
        branches=(*arm.branches, branch),
    )


def _stated_limits(joints: tuple[UrdfJoint, ...]) -> Floats:
    return np.array([joint.limits for joint in joints], float)


def _slides(joints: tuple[UrdfJoint, ...]) -> Booleans:
    return np.array([joint.kind == "prismatic" for joint in joints])
