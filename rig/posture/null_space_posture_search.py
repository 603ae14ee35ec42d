"""Search in the null space for a better posture.

By gradient, samples or the whole self-motion, hand still.

Three ways: along the gradient, projected on the null space; over postures sampled at random; and over the whole
self-motion, traced densely from end to end, which says how good the others' answer is.
Source: patent on force measurement with redundant manipulators, [0016], [0018]-[0020], [0024].
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.model import mechanisms
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.pose import pose_difference
from rig.posture import arm_force_transmission_and_exertable_wrench
from rig.posture.arm_force_transmission_and_exertable_wrench import ExertionObjective, TransmissionObjective

FIXED_ROWS = {
    "pose": slice(0, 6),
    "position": slice(0, 3),
    "orientation": slice(3, 6),
}  # rows of the Jacobian that must not move
STILL = 1e-11  # m and rad, to which the hand is brought back after a step
ITERATIONS = 400
LONGEST = 0.15  # rad, of slides m; largest step of the gradient search
SHORTEST = 1e-7  # rad; where steps have become smaller than this, the search has arrived
TRACE = 0.02  # rad between postures of a traced self-motion
LAPS = 3000  # postures at most in each direction
# m^2 and rad^2; keeps the step finite at a singularity, where the hand then is not brought back and the step is refused
DAMPING = 1e-12
RANK = 1e-7  # of the largest singular value


@dataclass(frozen=True, slots=True, eq=False)
class SearchResult:
    """m searches. q : (m, n) rad; value, start : (m,) the measure reached and that of the start
    moved : (m, 2) by how much the hand moved, m and rad; at_limit : (m, n) bool, joints at a limit; steps : taken in
        all"""

    q: Floats
    value: Floats
    start: Floats
    moved: Floats
    at_limit: Floats
    steps: int


def search_result_of_given_postures(
    q: Floats, arm: Arm, objective: TransmissionObjective | ExertionObjective
) -> SearchResult:
    """Given postures q (m, n) rad as a SearchResult, without a search.

    Raises RigError outside the joint limits.
    """
    q = np.array(q, float, ndmin=2)
    value = arm_force_transmission_and_exertable_wrench.transmission_measure(q, arm, objective)
    return _found(q, value, value, q, arm, 0)


def gradient_search(
    q: Floats,
    arm: Arm,
    objective: TransmissionObjective | ExertionObjective,
    fixed_hand_part: str = "pose",
    sufficient_value: float | None = None,
) -> SearchResult:
    """SearchResult of a gradient search from postures q (m, n) rad.

    Steepest ascent in the null space.
    fixed_hand_part : "pose", "position" where the hand may turn, "orientation" where it may move; sufficient_value : a
        limit at which it suffices to stop
    Raises RigError where a start lies outside the joint limits, or where the arm has no freedom to spare
    """
    q = _starts(q, arm, fixed_hand_part)
    target, start = (
        mechanism.single_hand_arm_link_frames(q, arm)[:, -1],
        arm_force_transmission_and_exertable_wrench.transmission_measure(q, arm, objective),
    )
    first, now, step = q.copy(), start.copy(), np.full(len(q), 0.05)
    low, high = arm.limits.T
    done = np.zeros(len(q), bool) if sufficient_value is None else now > sufficient_value
    steps = 0
    while steps < ITERATIONS and not done.all():
        steps += 1
        todo = np.flatnonzero(~done)
        ascent = _uphill(q[todo], arm, objective, fixed_hand_part)
        size = np.linalg.norm(ascent, axis=1)
        trial = q[todo] + ascent / np.maximum(size, 1e-300)[:, None] * step[todo, None]
        trial = joint_angles_returning_hand_to_target(np.clip(trial, low, high), target[todo], arm, fixed_hand_part)
        ok = (mechanism.signed_limit_excess(trial, arm) == 0).all(axis=1) & (
            hand_deviation(trial, target[todo], arm, fixed_hand_part) < STILL
        )
        ok &= np.linalg.norm(trial - q[todo], axis=1) < 2 * step[todo] + SHORTEST  # no jump to another branch
        reached = np.full(len(todo), -np.inf)
        if ok.any():
            reached[ok] = arm_force_transmission_and_exertable_wrench.transmission_measure(trial[ok], arm, objective)
        better = reached > now[todo]
        q[todo[better]], now[todo[better]] = trial[better], reached[better]
        step[todo] = np.where(better, np.minimum(1.6 * step[todo], LONGEST), 0.4 * step[todo])
        done[todo] = (step[todo] < SHORTEST) | (size < 1e-12)
        if sufficient_value is not None:
            done |= now > sufficient_value
    return _found(q, now, start, first, arm, steps)


def sampled_search(
    q: Floats,
    arm: Arm,
    objective: TransmissionObjective | ExertionObjective,
    rng: np.random.Generator,
    fixed_hand_part: str = "pose",
    count: int = 200,
    spread: float = 0.6,
) -> SearchResult:
    """SearchResult of a sampled search.

    Best of `count` random postures about each start (m, n) in the null space.
    spread : rad, of one step; rng : numpy Generator
    """
    q = _starts(q, arm, fixed_hand_part)
    target, start = (
        mechanism.single_hand_arm_link_frames(q, arm)[:, -1],
        arm_force_transmission_and_exertable_wrench.transmission_measure(q, arm, objective),
    )
    first, walker, best, now = q.copy(), q.copy(), q.copy(), start.copy()
    for _ in range(count):
        N = null_space_projectors(walker, arm, fixed_hand_part)
        step = np.einsum("mij,mj->mi", N, rng.normal(size=q.shape))
        trial = walker + spread * rng.uniform(size=(len(q), 1)) * step / np.maximum(
            np.linalg.norm(step, axis=1, keepdims=True), 1e-300
        )
        trial = joint_angles_returning_hand_to_target(trial, target, arm, fixed_hand_part)
        ok = (mechanism.signed_limit_excess(trial, arm) == 0).all(axis=1) & (
            hand_deviation(trial, target, arm, fixed_hand_part) < STILL
        )
        walker[ok] = trial[ok]
        reached = arm_force_transmission_and_exertable_wrench.transmission_measure(walker, arm, objective)
        better = reached > now
        best[better], now[better] = walker[better], reached[better]
    return _found(best, now, start, first, arm, count)


def whole_self_motion_search(
    q: Floats, arm: Arm, objective: TransmissionObjective | ExertionObjective, fixed_hand_part: str = "pose"
) -> SearchResult:
    """SearchResult of a search over the whole self-motion.

    Best posture of the whole self-motion through each start (m, n) rad.

    Steps of TRACE rad; the best one is polished by the gradient. Raises RigError where the null space is not
    one-dimensional
    """
    q = _starts(q, arm, fixed_hand_part)
    if redundant_joint_count(arm, fixed_hand_part) != 1:
        raise RigError(
            f"the self-motion has {redundant_joint_count(arm, fixed_hand_part)} dimensions; it is traced where it has "
            "one; use the sampled search"
        )
    start = arm_force_transmission_and_exertable_wrench.transmission_measure(q, arm, objective)
    best, now, steps = q.copy(), start.copy(), 0
    for side in (1.0, -1.0):
        for index, walker in _walk(q, arm, fixed_hand_part, side):
            reached = arm_force_transmission_and_exertable_wrench.transmission_measure(walker, arm, objective)
            better = reached > now[index]
            best[index[better]], now[index[better]], steps = walker[better], reached[better], steps + 1
    polished = gradient_search(best, arm, objective, fixed_hand_part)
    return _found(polished.q, polished.value, start, q, arm, steps + polished.steps)


def trace_self_motion(q: Floats, arm: Arm, fixed_hand_part: str = "pose") -> Floats:
    """Trace the self-motion (k, n) rad through a posture q (n,).

    From end to end, or once round.
    """
    q = _starts(np.atleast_2d(q), arm, fixed_hand_part)
    ahead, behind = [[walker[0] for _, walker in _walk(q, arm, fixed_hand_part, side)] for side in (1.0, -1.0)]
    return np.array([*behind[::-1], q[0], *ahead])


def _walk(q: Floats, arm: Arm, fixed_hand_part: str, side: float) -> Iterator[tuple[Floats, Floats]]:
    """Yield (index (k,), postures (k, n)) of the walkers still under way along the self-motion; the last few steps
    shrink towards the joint limit that ends it."""
    target, index, walker = mechanism.single_hand_arm_link_frames(q, arm)[:, -1], np.arange(len(q)), q.copy()
    size, before = np.full(len(q), TRACE), None
    for count in range(LAPS):
        tangent = _tangent(walker, arm, fixed_hand_part)
        tangent *= (
            side * np.sign(tangent[np.arange(len(tangent)), np.abs(tangent).argmax(axis=1)])
            if before is None
            else np.where(np.einsum("mi,mi->m", tangent, before) < 0, -1.0, 1.0)
        )[:, None]
        trial = joint_angles_returning_hand_to_target(
            walker + size[:, None] * tangent, target[index], arm, fixed_hand_part
        )
        ok = (mechanism.signed_limit_excess(trial, arm) == 0).all(axis=1) & (
            hand_deviation(trial, target[index], arm, fixed_hand_part) < STILL
        )
        ok &= np.linalg.norm(trial - walker, axis=1) < 2 * TRACE  # no jump to another branch
        walker = np.where(ok[:, None], trial, walker)
        size = np.where(ok, size, size / 4)
        going = size > TRACE / 100
        if count > 10:
            apart = walker - q[index]
            apart -= 2 * np.pi * np.round(apart / (2 * np.pi))
            going &= np.linalg.norm(apart, axis=1) > 0.6 * TRACE
        if ok.any():
            yield index[ok], walker[ok]
        index, walker, size, before = index[going], walker[going], size[going], tangent[going]
        if not len(index):
            return


def _starts(q: Floats, arm: Arm, fixed_hand_part: str) -> Floats:
    q = np.array(q, float, ndmin=2)
    if fixed_hand_part not in FIXED_ROWS:
        raise ValueError(f"fixed_hand_part must be one of {', '.join(FIXED_ROWS)}, not {fixed_hand_part!r}")
    if redundant_joint_count(arm, fixed_hand_part) < 1:
        raise RigError(
            f"{q.shape[1]} joints hold the hand's {fixed_hand_part} without redundancy: "
            "there is no other posture nearby"
        )
    outside = np.argwhere(mechanism.signed_limit_excess(q, arm) != 0)
    if len(outside):
        i, j = outside[0]
        scale, unit = (1e3, "mm") if arm.slides[j] else (np.degrees(1), "degrees")
        low, high = scale * arm.limits[j]
        raise RigError(
            f"posture {i} has {mechanisms.axis_place_texts(arm)[j]} at {scale * q[i, j]:.3f} {unit}, outside its "
            f"limits {low:.3f} .. {high:.3f}"
        )
    return q


def redundant_joint_count(arm: Arm, fixed_hand_part: str) -> int:
    """Count of an arm's redundant joints, beyond those that fix the hand.

    It is 0 or less for none.
    """
    return len(arm.axes) - (FIXED_ROWS[fixed_hand_part].stop - FIXED_ROWS[fixed_hand_part].start)


def _rows(q: Floats, arm: Arm, fixed_hand_part: str) -> Floats:
    return mechanism.jacobian(q, arm, "base")[..., FIXED_ROWS[fixed_hand_part], :]


def null_space_projectors(q: Floats, arm: Arm, fixed_hand_part: str, fixed_joints: Floats | None = None) -> Floats:
    """Projectors (m, n, n) on the null space at postures q (m, n) rad.

    Joints in fixed (m, n) do not move.
    """
    J = _rows(q, arm, fixed_hand_part)
    if fixed_joints is not None:
        J = np.concatenate([J, np.eye(q.shape[1]) * fixed_joints[:, :, None]], axis=1)
    return np.eye(q.shape[1]) - np.linalg.pinv(J, rcond=RANK) @ J


def _tangent(q: Floats, arm: Arm, fixed_hand_part: str) -> Floats:
    """(m, n) unit vectors along one-dimensional null spaces."""
    return np.linalg.svd(_rows(q, arm, fixed_hand_part))[2][:, -1].copy()


def _uphill(q: Floats, arm: Arm, wish: TransmissionObjective | ExertionObjective, fixed_hand_part: str) -> Floats:
    """(m, n) projected gradient; joints at a limit that it would leave are held, and the projection is made anew."""
    slope = arm_force_transmission_and_exertable_wrench.transmission_gradient(q, arm, wish)
    low, high = arm.limits.T
    fixed = np.zeros(q.shape, bool)
    for _ in range(q.shape[1]):
        ascent = np.einsum("mij,mj->mi", null_space_projectors(q, arm, fixed_hand_part, fixed), slope)
        beyond = ((q >= high - 1e-9) & (ascent > 0)) | ((q <= low + 1e-9) & (ascent < 0))
        beyond &= np.abs(ascent) > 1e-9 * np.abs(ascent).max(axis=1, keepdims=True)
        if not (beyond & ~fixed).any():
            break
        fixed |= beyond
    return np.where(fixed, 0.0, ascent)


def joint_angles_returning_hand_to_target(q: Floats, target: Floats, arm: Arm, fixed_hand_part: str) -> Floats:
    """Joint angles near q (m, n) that return the hand to its target (m, 4, 4).

    By Newton's method.
    """
    for _ in range(6):
        frames = mechanism.joint_frames(q, arm)
        e = _error(frames.tip, target, fixed_hand_part)
        if np.abs(e).max(initial=0) < 0.1 * STILL:
            break
        J = mechanism.geometric_jacobian(frames, arm, "base")[:, FIXED_ROWS[fixed_hand_part]]
        T = np.swapaxes(J, 1, 2)
        q = q + (T @ np.linalg.solve(J @ T + DAMPING * np.eye(T.shape[2]), e[..., None]))[..., 0]
    return q


def _error(now: Floats, target: Floats, fixed_hand_part: str) -> Floats:
    """(m, 3 or 6) what is missing to the target, in the axes of poses; small turns as half the difference of axes."""
    move = target[:, :3, 3] - now[:, :3, 3]
    turn = 0.5 * sum(np.cross(now[:, :3, k], target[:, :3, k]) for k in range(3))
    return np.concatenate([move, turn], axis=1)[:, FIXED_ROWS[fixed_hand_part]]


def hand_deviation(q: Floats, target: Floats, arm: Arm, fixed_hand_part: str) -> Floats:
    """Deviation (m,) m or rad of the hand at postures q (m, n) from its targets (m, 4, 4)."""
    return np.abs(_error(mechanism.single_hand_arm_link_frames(q, arm)[:, -1], target, fixed_hand_part)).max(axis=1)


def _found(q: Floats, value: Floats, start: Floats, first: Floats, arm: Arm, steps: int) -> SearchResult:
    moved = pose_difference(mechanism.forward(first, arm), mechanism.forward(q, arm))
    lengths = np.stack([np.linalg.norm(moved[:, :3], axis=1), np.linalg.norm(moved[:, 3:], axis=1)], axis=1)
    low, high = arm.limits.T
    return SearchResult(q, value, start, lengths, (q <= low + 1e-6) | (q >= high - 1e-6), steps)
