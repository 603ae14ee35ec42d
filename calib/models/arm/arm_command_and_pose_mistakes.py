"""Mistakes in an arm's commands and measured poses.

Swapped joints, links, poses or frame conventions.

Source: rotations as
calib.models.arm.arm_base_and_tool_placement_in_instrument_frame.solve_robot_world_hand_eye_rotations; positions by
Kabsch in turn with the target's place
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.models.arm import (
    arm_base_and_tool_placement_in_instrument_frame,
    arm_error_model_and_instrument_observations,
)
from calib.models.arm.arm_base_and_tool_placement_in_instrument_frame import (
    nearest_rotation,
    rigid_transform,
    solve_robot_world_hand_eye_rotations,
)
from calib.models.arm.arm_error_model_and_instrument_observations import Observations, position_observations
from rig.array_and_json_types import Floats, Integers
from rig.checks.mistake_dataclass_and_clock_mistakes import Mistake, sort_mistakes
from rig.checks.platform_command_and_pose_mistakes import LIKELY, pose_columns_of_poses_csv_as_written
from rig.checks.unit_and_convention_mistakes import poses_in_other_conventions
from rig.errors import RigError
from rig.model.arm_hands_effect_places_and_tolerances import hand_names
from rig.model.design import Instrument
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.mechanisms.mechanism_kinds_and_kinematics import has_links
from rig.model.pose import pose_to_vector
from rig.recording.frame_selection_and_content_hashes import select_hand
from rig.recording.recording_folder import Recording

ROUNDS = 60
STILL = 1e-5  # m


def _place_arm_roughly(q: Floats, T: RigidTransform, positions_only: bool, arm: Arm, base: bool, tool: bool) -> Arm:
    """The Arm with its base and tool where poses T (m,) at angles q (m, n) rad put them. positions_only : of the poses
    positions alone are known.
    """
    if not (base or tool):
        return arm
    links = mechanism.forward(q, arm.with_ends(RigidTransform.identity(), RigidTransform.identity()))
    if positions_only:
        return _from_positions(T.translation, links, arm, base, tool)
    if not base:
        return arm.with_ends(tool=_middle(links.inv() * arm.base.inv() * T))
    if not tool:
        return replace(arm, base=_middle(T * (links * arm.tool).inv()))
    F = links.rotation.as_matrix()
    X, Z, _ = solve_robot_world_hand_eye_rotations(T.rotation.as_matrix(), F)
    A = np.concatenate([X @ F, np.tile(np.eye(3), (len(F), 1, 1))], axis=2).reshape(-1, 6)
    t = np.linalg.lstsq(A, (T.translation - links.translation @ X.T).ravel())[0]
    return arm.with_ends(tool=rigid_transform(Z, t[:3]), base=rigid_transform(X, t[3:]))


def _from_positions(p: Floats, links: RigidTransform, arm: Arm, base: bool, tool: bool) -> Arm:
    F, f = links.rotation.as_matrix(), links.translation
    z, X, t = arm.tool.translation, arm.base.rotation.as_matrix(), arm.base.translation
    for _ in range(ROUNDS if tool and base else 1):
        before = z
        if base:
            reached = F @ z + f
            X = nearest_rotation((p - p.mean(axis=0)).T @ (reached - reached.mean(axis=0)))
            t = p.mean(axis=0) - X @ reached.mean(axis=0)
        if tool:
            z = np.linalg.lstsq((X @ F).reshape(-1, 3), (p - t - f @ X.T).ravel())[0]
        if np.abs(z - before).max() < STILL:
            break
    return replace(arm, base=rigid_transform(X, t), tool=rigid_transform(arm.tool.rotation.as_matrix(), z))


def _middle(T: RigidTransform) -> RigidTransform:
    return RigidTransform.from_components(np.median(T.translation, axis=0), T.rotation.mean())


MOST = 120  # poses looked at
LEAST = 10
AWAY = (0.015, 0.02)  # m, rad, RMS beyond which no calibration is left to do but a mistake to find
OTHER = 3  # times what a zero may be off by, from where on it is another zero, which is a mistake
INSTRUMENT = (1e-4, 3e-4)  # m, rad; any will do
BETTER = 0.35
REACH = 1.0  # m; a radian counts like so much


@dataclass(frozen=True, slots=True, eq=False)
class ReachedPoses:
    """arm : Arm as stated; instrument : Instrument or None; q : (F, n) rad of all frames; index : (m,) of the measured
    ones
    v : (m, 6) m and rad as poses.csv has them; alone : whether positions alone were measured."""

    arm: Arm
    instrument: Instrument | None
    q: Floats
    index: Integers
    v: Floats
    alone: bool
    T: RigidTransform

    def miss(self) -> tuple[float, float]:
        """(m, rad), medians of what poses and arm disagree by, the instrument and the target placed as well as may
        be.
        """
        q, free = self.q[self.index], self.instrument or Instrument("rig", "rig", 1e-4, None)
        try:
            arm = _place_arm_roughly(q, self.T, self.alone, self.arm, free.base == "free", free.tool == "free")
            r = pose_to_vector(mechanism.forward(q, arm).inv() * self.T)
        except (ValueError, np.linalg.LinAlgError):
            return np.inf, np.inf
        position = float(np.median(np.linalg.norm(r[:, :3], axis=1)))
        return position, 0.0 if self.alone else float(np.median(np.linalg.norm(r[:, 3:], axis=1)))

    def stands(self) -> bool:
        """Whether base and tool can be placed where all agrees by a search that zeros a little off or a hand that stays
        level do not mislead.
        """
        q, free = self.q[self.index], self.instrument
        if free is None or not (free.base == "free" or free.tool == "free"):
            return False
        if self.alone:
            seen = position_observations(q, self.T.translation, INSTRUMENT[0])
        else:
            own = np.diag(np.repeat(np.square(INSTRUMENT), 3))
            seen = Observations("pose", q, self.T, np.tile(own, (len(q), 1, 1)), np.zeros((len(q), 6, 0)))
        try:
            found = arm_base_and_tool_placement_in_instrument_frame.place_base_and_tool_of_arm(
                seen, self.arm, free.base == "free", free.tool == "free"
            )
        except RigError:
            return False
        moved = np.abs(
            arm_error_model_and_instrument_observations.joint_zeros(found)
            - arm_error_model_and_instrument_observations.joint_zeros(self.arm)
        )[1:]  # the first joint's zero is the base's
        if moved.max(initial=0.0) > OTHER * arm_base_and_tool_placement_in_instrument_frame.ZERO:
            return False
        r = seen.residuals(found)
        return bool(
            np.median(np.linalg.norm(r[:, :3], axis=1)) < AWAY[0]
            and np.median(np.linalg.norm(r[:, 3:], axis=1)) < AWAY[1]
        )

    def one(self) -> float:
        """m, both in one figure."""
        position, rotation = self.miss()
        return position + REACH * rotation


def find_mistakes_of_several_hands(recording: Recording) -> tuple[Mistake, ...]:
    """Mistakes of several hands of an arm.

    They make commands and poses disagree, hand by hand, or are two hands that are exchanged.
    recording : whose poses are of several hands
    """
    names, poses = hand_names(recording.design.mechanism), recording.poses
    assert poses is not None and poses.hand is not None
    found = {name: find_arm_mistakes(select_hand(recording, name)) for name in names}
    for one, other in combinations([name for name in names if found[name]], 2):
        numbers = np.arange(len(names))
        numbers[[names.index(one), names.index(other)]] = names.index(other), names.index(one)
        changed = replace(recording, poses=replace(poses, hand=numbers[poses.hand]))
        if not any(find_arm_mistakes(select_hand(changed, name)) for name in (one, other)):
            what = f"poses.csv: the hands {one} and {other} are exchanged: each agrees with the other's joints"
            return (Mistake(what, "Exchange their names", True, LIKELY),)
    every = [replace(one, what=f"hand {name}: {one.what}") for name in names for one in found[name]]
    return sort_mistakes(every)


def find_arm_mistakes(recording: Recording) -> tuple[Mistake, ...]:
    """Mistakes in an arm's commands and poses.

    They are none, or the one that makes commands and poses disagree.
    """
    arm = recording.design.mechanism
    instrument = recording.design.instrument
    if (
        recording.commands is None
        or recording.poses is None
        or not has_links(arm)
        or (instrument and instrument.kind != "pose")
    ):
        return ()
    known, t = recording.exposures.times()
    all_q = np.stack([np.interp(t, recording.commands.t, column) for column in recording.commands.values.T], axis=1)
    index = np.searchsorted(known, recording.poses.frame)
    some = np.unique(np.linspace(0, len(index) - 1, min(MOST, len(index))).round().astype(int))
    if len(some) < LEAST:
        return ()
    design, T = recording.design, recording.poses.T_base_platform[some]
    alone = design.instrument is not None and design.instrument.rotation_sigma is None
    v = pose_to_vector(T) if alone or arm.hands else pose_columns_of_poses_csv_as_written(recording)[some]
    return sort_mistakes(_mistakes(ReachedPoses(arm, design.instrument, all_q, index[some], v, alone, T)))


def _mistakes(reached: ReachedPoses) -> Iterator[Mistake]:
    position, rotation = reached.miss()
    if (position < AWAY[0] and rotation < AWAY[1]) or reached.stands():
        return
    before = position + REACH * rotation
    left, what, do = min(((other.one(), what, do) for what, do, other in _candidates(reached)), key=lambda one: one[0])
    message = f"arm and measured poses differ by {position * 1e3:.3g} mm" + (
        "" if reached.alone else f" and {np.degrees(rotation):.3g} degrees"
    )
    if left < BETTER * before:
        yield Mistake(
            f"{what}: {message} as it stands, by {left / before:.1%} of that so", do, True, LIKELY * (1 - left / before)
        )
    else:
        yield Mistake(
            f"{message}, and no common mistake explains it",
            "Check the joints' zeros, signs and order, mechanism.joints, and whether poses and commands match",
            bool(before > 10 * AWAY[0]),
            0.3,
        )


def _candidates(reached: ReachedPoses) -> Iterator[tuple[str, str, ReachedPoses]]:
    yield from _axes(reached)
    yield from _links(reached)
    frames = len(reached.q)
    do = "Check how poses were numbered: one missing or extra at the start shifts all"
    for by in (-2, -1, 1, 2):
        retained = (reached.index + by >= 0) & (reached.index + by < frames)
        yield (
            f"poses.csv: the frames are shifted by {abs(by)}: pose k is of command k "
            f"{'+' if by > 0 else '-'} {abs(by)}",
            do,
            replace(reached, index=reached.index[retained] + by, v=reached.v[retained], T=reached.T[retained]),
        )
    yield "poses.csv: the frames are in reverse order", do, replace(reached, index=frames - 1 - reached.index)
    text = np.array(sorted(range(frames), key=str))
    yield (
        "poses.csv: the frames are in the order of their names as text (1, 10, 2)",
        do,
        replace(reached, index=text[reached.index]),
    )
    for what, T in poses_in_other_conventions(reached.v):
        yield (
            f"poses.csv: {what}",
            "Write the target in the instrument: m, and rotation vectors in rad",
            replace(reached, T=T),
        )


def _axes(reached: ReachedPoses) -> Iterator[tuple[str, str, ReachedPoses]]:
    """Joint angles in another unit, with other signs, zeros or in another order."""
    q, n, slides = reached.q, reached.q.shape[1], reached.arm.slides
    if not slides.all():
        yield (
            "commands.csv: joint angles are in degrees",
            "State them in radians",
            replace(reached, q=np.where(slides, q, np.radians(q))),
        )
        yield (
            "commands.csv: joint angles are in revolutions",
            "State them in radians",
            replace(reached, q=np.where(slides, q, 2 * np.pi * q)),
        )
    if slides.any():
        yield (
            "commands.csv: slides are in millimetres",
            "State them in metres",
            replace(reached, q=np.where(slides, q / 1e3, q)),
        )
    yield "commands.csv: all joints turn backwards (sign)", "Reverse their sign", replace(reached, q=-q)
    for j in range(n):
        turned = q.copy()
        turned[:, j] *= -1
        yield f"commands.csv: joint {j + 1} turns backwards (sign)", "Turn its sign", replace(reached, q=turned)
        if slides[j]:
            continue
        for by in (90, -90, 180, 45, -45, 30, -30):
            moved = q.copy()
            moved[:, j] += np.radians(by)
            yield (
                f"commands.csv: joint {j + 1} has another zero, {abs(by)} degrees off (offset)",
                f"Add {by} degrees to it, or correct theta in rig.toml",
                replace(reached, q=moved),
            )
        single = q.copy()
        single[:, j] = np.radians(single[:, j])
        yield f"commands.csv: joint {j + 1} is in degrees", "State it in radians", replace(reached, q=single)
    for i, j in combinations(range(n), 2):
        order = list(range(n))
        order[i], order[j] = j, i
        yield (
            f"commands.csv: joints {i + 1} and {j + 1} are exchanged (order)",
            "Order the columns as the joints",
            replace(reached, q=q[:, order]),
        )
    yield (
        "commands.csv: the joints are in reverse order",
        "Order the columns as the joints",
        replace(reached, q=q[:, ::-1]),
    )
    for by in (1, n - 1):
        yield (
            "commands.csv: the joints' columns are shifted by one (order)",
            "Order the columns as the joints",
            replace(reached, q=np.roll(q, by, axis=1)),
        )


def _links(reached: ReachedPoses) -> Iterator[tuple[str, str, ReachedPoses]]:
    """Denavit-Hartenberg rows written another way."""
    rows = reached.arm.rows

    def put(what: str, do: str, other: Floats) -> tuple[str, str, ReachedPoses]:
        return f"rig.toml: mechanism.joints: {what}", do, replace(reached, arm=replace(reached.arm, joints=other))

    write = "Write rows of theta, d, a, alpha: distal Denavit-Hartenberg, m and rad"
    yield put("a and d are exchanged", write, rows[:, [0, 2, 1, 3, 4]])
    yield put("theta and alpha are exchanged", write, rows[:, [3, 1, 2, 0, 4]])
    yield put("columns are in the order a, alpha, d, theta", write, rows[:, [3, 2, 0, 1, 4]])
    yield put("columns are in the order alpha, a, theta, d", write, rows[:, [2, 3, 1, 0, 4]])
    yield put("the sign of all alpha is reversed", write, rows * [1, 1, 1, -1, 1])
    yield put("the sign of all a is reversed", write, rows * [1, 1, -1, 1, 1])
    yield put("alpha is in degrees", write, rows * [1, 1, 1, np.pi / 180, 1])
    yield put("theta is in degrees", write, rows * [np.pi / 180, 1, 1, 1, 1])
    for unit, factor in (("millimetres", 1e-3), ("centimetres", 1e-2), ("inches", 0.0254)):
        yield put(f"a and d are in {unit}", write, rows * [1, factor, factor, 1, 1])
    moved = rows.copy()
    moved[:-1, [2, 3]], moved[-1, [2, 3]] = rows[1:, [2, 3]], 0
    yield put("rows are of the modified (proximal) convention", "Write them in the distal one", moved)
    for j in range(len(rows)):
        for column, name in ((1, "d"), (2, "a"), (3, "alpha")):
            if abs(rows[j, column]) > 1e-6:
                turned = rows.copy()
                turned[j, column] *= -1
                yield put(f"the sign of {name} of joint {j + 1} is reversed", write, turned)
    for i, j in combinations(range(len(rows)), 2):
        order = list(range(len(rows)))
        order[i], order[j] = j, i
        yield put(f"rows {i + 1} and {j + 1} are exchanged", "Order the rows as the joints", rows[order])
