"""Arm motion between postures.

Hand still, hand on a straight line, or to the best posture visited.

Source: patent on force measurement with redundant manipulators, [0021], [0022].

Source: patent on force measurement with redundant manipulators, [0023].
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Slerp

from rig.array_and_json_types import Floats, Integers
from rig.errors import RigError
from rig.model import mechanisms
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.pose import pose_difference
from rig.posture import arm_force_transmission_and_exertable_wrench, null_space_posture_search
from rig.posture.arm_force_transmission_and_exertable_wrench import ExertionObjective, TransmissionObjective
from rig.posture.null_space_posture_search import FIXED_ROWS
from rig.recording.recording_folder import Recording

STEPS = 200  # of a motion on the way
REACHED = 1e-9  # rad; end of a motion


def motion_with_hand_still(q: Floats, goal: Floats, arm: Arm, fixed_hand_part: str = "pose") -> Floats:
    """Motion (k, n) rad from posture q (n,) to goal (n,) with the hand still.

    Raises RigError where none exists.
    """
    if np.abs(goal - q).max() < REACHED:
        return np.array([q])
    if null_space_posture_search.redundant_joint_count(arm, fixed_hand_part) != 1:
        return _within(q, goal, arm, fixed_hand_part)
    path = null_space_posture_search.trace_self_motion(q, arm, fixed_hand_part)
    start = int(np.abs(path - q).max(axis=1).argmin())
    far = np.linalg.norm(path - goal, axis=1)
    stop = int(far.argmin())
    if far[stop] > 2 * null_space_posture_search.TRACE:
        raise RigError(
            "no motion of the elbow alone leads to the posture: it comes no nearer than "
            f"{_greatest_difference_text(path[stop] - goal, arm)}; "
            "take it on the way"
        )
    rows = path[start : stop + 1] if stop >= start else path[stop : start + 1][::-1]
    return np.vstack([rows, goal])


def _within(q: Floats, goal: Floats, arm: Arm, fixed_hand_part: str) -> Floats:
    """(k, n) rad from q (n,) to goal (n,): as straight as what is held of the hand allows, brought back after every
    step.
    """
    target, rows = mechanism.single_hand_arm_link_frames(q[None], arm)[:, -1], [np.array(q, float)]
    for k in range(STEPS):
        now = rows[-1][None]
        pull = (null_space_posture_search.null_space_projectors(now, arm, fixed_hand_part)[0] @ (goal - now[0])) / (
            STEPS - k
        )
        new = null_space_posture_search.joint_angles_returning_hand_to_target(now + pull, target, arm, fixed_hand_part)
        beyond = np.abs(mechanism.signed_limit_excess(new[0], arm))
        if (
            null_space_posture_search.hand_deviation(new, target, arm, fixed_hand_part)[0] > 1e-9
            or beyond.any()
            or np.abs(new - now).max() > 0.5
        ):
            where = (
                f"leaves the limits of {mechanisms.axis_place_texts(arm)[int(beyond.argmax())]}"
                if beyond.any()
                else "is near a singularity"
            )
            raise RigError(
                f"the motion to the posture, the hand's {fixed_hand_part} held, {where} at {k / STEPS:.0%} of the way; "
                "take it on the way"
            )
        rows.append(new[0])
    if np.abs(rows[-1] - goal).max() > 2 * null_space_posture_search.TRACE:
        raise RigError(
            f"no motion with the hand's {fixed_hand_part} held leads to the posture: it comes no nearer than "
            f"{_greatest_difference_text(rows[-1] - goal, arm)}; take it on the way"
        )
    return np.vstack([*rows, goal])


def _greatest_difference_text(apart: Floats, arm: Arm) -> str:
    """The greatest of differences (n,) rad, and of slides the greatest in mm, in words."""
    turned, slid = np.abs(apart[~arm.slides]), np.abs(apart[arm.slides])
    words = [f"{np.degrees(turned.max()):.2f} degrees"] if len(turned) else []
    return " and ".join([*words, f"{slid.max() * 1e3:.2f} mm"] if len(slid) else words)


def motion_with_hand_on_straight_line(q: Floats, goal: Floats, arm: Arm, steps: int = STEPS) -> Floats:
    """Motion (k, n) rad from posture q (n,) to goal (n,) with the hand on a straight line.

    Turning evenly.

    What the elbow has not done when the hand arrives, it does at the end. Raises RigError where the way leaves the
    joint limits or passes too near a singularity to be followed
    """
    start, end = mechanism.forward(q, arm), mechanism.forward(goal, arm)
    share = np.linspace(0, 1, steps + 1)
    turns = Slerp([0, 1], type(start.rotation).concatenate([start.rotation, end.rotation]))(share)
    hands = RigidTransform.from_components(
        start.translation + share[:, None] * (end.translation - start.translation), turns
    ).as_matrix()
    rows = [np.array(q, float)]
    for k in range(1, steps + 1):
        now = rows[-1][None]
        pull = (null_space_posture_search.null_space_projectors(now, arm, "pose")[0] @ (goal - now[0])) / (
            steps - k + 1
        )
        new = null_space_posture_search.joint_angles_returning_hand_to_target(now + pull, hands[k : k + 1], arm, "pose")
        beyond = mechanism.signed_limit_excess(new[0], arm)
        if (
            null_space_posture_search.hand_deviation(new, hands[k : k + 1], arm, "pose")[0] > 1e-9
            or np.abs(new - now).max() > 0.5
        ):
            raise RigError(
                f"the straight path cannot be followed beyond {share[k]:.0%}: the arm is near a singularity there"
            )
        if beyond.any():
            j = int(np.abs(beyond).argmax())
            raise RigError(
                f"the straight path leaves the limits of {mechanisms.axis_place_texts(arm)[j]} at {share[k]:.0%} of it"
            )
        rows.append(new[0])
    return np.vstack([rows, motion_with_hand_still(rows[-1], goal, arm)[1:]])


def posture_times(postures: Floats, speed: float) -> Floats:
    """Times (k,) s of successive postures (k, n) rad when the fastest joint turns at speed (rad/s)."""
    return np.concatenate([[0.0], np.cumsum(np.maximum(np.abs(np.diff(postures, axis=0)).max(axis=1) / speed, 1e-6))])


SAME = np.repeat([1e-3, 2e-3], 3)  # m, rad; a hand that is off by less, as controllers hold it, has stayed


@dataclass(frozen=True, slots=True, eq=False)
class VisitedPostures:
    """k postures taken with the hand where it is wanted. frame, t : (k,) number and s; q : (k, n) rad; value : (k,) the
    measure; best : index
    elsewhere : how many more the recording has, with the hand elsewhere; back : (j, n) rad, the way from where the
        recording ends to the best"""

    frame: Integers
    t: Floats
    q: Floats
    value: Floats
    best: int
    elsewhere: int
    back: Floats


def best_visited_posture_and_motion_to_it(
    recording: Recording,
    arm: Arm,
    objective: TransmissionObjective | ExertionObjective,
    fixed_hand_part: str,
    wanted_hand_pose: RigidTransform | None = None,
) -> VisitedPostures:
    """Best posture visited in a recording, and the motion back to it.

    With the hand where it is wanted.
    wanted_hand_pose : T_base_platform of the hand, by default that of the first exposure

    Raises RigError for an arm of other joints, without commands, and where no posture, or one alone, has the hand there
    """
    frames, t, q = recording.commanded()
    if q.shape[1] != len(arm.axes):
        raise RigError(f"{recording.folder} commands {q.shape[1]} axes; the arm has {len(arm.axes)} joints")
    T = mechanism.forward(q, arm)
    apart = np.abs(pose_difference(T[0] if wanted_hand_pose is None else wanted_hand_pose, T))
    matching = (apart <= SAME)[:, FIXED_ROWS[fixed_hand_part]].all(axis=1)
    if matching.sum() < 2:
        raise RigError(
            f"{recording.folder}: {matching.sum()} of {len(q)} postures have the hand's {fixed_hand_part} where it is "
            "wanted; a comparison requires two"
        )
    value = arm_force_transmission_and_exertable_wrench.transmission_measure(q[matching], arm, objective)
    best = int(value.argmax())
    return VisitedPostures(
        frames[matching],
        t[matching],
        q[matching],
        value,
        best,
        int((~matching).sum()),
        _back(recording, float(t[matching][best])),
    )


def _back(recording: Recording, t: float) -> Floats:
    """(j, n) rad from the last exposure back to a time (s), as commanded between them, turned round."""
    assert recording.commands is not None  # or `commanded` had said so
    last, c = float(recording.exposures.times()[1].max()), recording.commands
    inside = c.t[(c.t > t) & (c.t < last)]
    rows = c.at(np.concatenate([[t], inside, [last]]))[::-1]
    return rows[np.r_[True, np.abs(np.diff(rows, axis=0)).max(axis=1) > 0]]
