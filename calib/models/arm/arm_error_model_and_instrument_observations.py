"""Error model of an arm, and observations by an instrument.

Independent parameters and pose Jacobians.

Parameters stand in one vector of 12 + 5 n: the base (where the arm stands in the instrument's frame; tangent x y z rx
ry rz on the right, m and rad), then theta, d, a, alpha, beta of every row (rad, m, m, rad, rad), then the tool (where
the target sits on the last link; tangent on the right). To first order the target's pose moves by tangent =
J_parameters dp + J_joints dq. Of an arm with several hands the mounts of its branches follow the rows, then the tool of
each hand: 6 + 5 n + 6 (branches + hands) parameters, one vector that all hands share.
Source: lecture on the manipulator Jacobian, eqs 4.63 and 4.64 (d = M_theta dtheta + M_d dd + M_a da + M_alpha dalpha +
M_beta dbeta and the rotational rows); Hayati, CDC 1983.

A complete model of R joints that turn and P that slide has 4 R + 2 P + 6 parameters, of which an instrument of whole
poses tells all: of a slide only the direction counts. Which ones stand for the others is chosen in an order: the
places of base and tool, zeros, angles, then lengths. Sources: Mooring, Roth and Driels, Fundamentals of manipulator
calibration, 1991 (the count); Hayati, CDC 1983 (beta for d where axes are parallel)
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import qr
from scipy.spatial.transform import RigidTransform

from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.model.base_and_link_tilt_sensors import TiltReadings
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.pose import direction_difference, exp, pose, pose_difference, skew

ROW = ("theta", "d", "a", "alpha", "beta")
TANGENT = ("x", "y", "z", "rx", "ry", "rz")


def joint_zeros(arm: Arm) -> Floats:
    """Joint zeros (n,) rad, m for slides: the offset of each joint's value in its row, theta or d."""
    return np.where(arm.slides, arm.rows[:, 1], arm.rows[:, 0])


def joint_zero_indices(arm: Arm) -> Integers:
    """Index (n,) of each joint's zero among the parameters."""
    return 6 + 5 * np.arange(len(arm.joints)) + arm.slides


def parameter_names(arm: Arm) -> tuple[str, ...]:
    """Names of an arm's parameters, in order.

    base x .. base rz, theta 1, d 1, a 1, alpha 1, beta 1, theta 2 .., tool x ..
    """
    rows = [f"{name} {i + 1}" for i in range(len(arm.joints)) for name in ROW]
    mounts = [f"mount {branch.joint + 1} {name}" for branch in arm.branches for name in TANGENT]
    ends = [f"{hand.name} tool" for hand in arm.hands] or ["tool"]
    return tuple([f"base {name}" for name in TANGENT] + rows + mounts + [f"{end} {x}" for end in ends for x in TANGENT])


def parameter_units(arm: Arm) -> tuple[str, ...]:
    """Unit of each parameter, "m" or "rad"."""
    end = ["m"] * 3 + ["rad"] * 3
    ends = end * (len(arm.branches) + max(len(arm.hands), 1))
    return tuple(end + ["rad", "m", "m", "rad", "rad"] * len(arm.joints) + ends)


def tool_parameter_slice(arm: Arm) -> slice:
    """Slice of the tool's six among the parameters: of the hand that the arm is seen at."""
    start = 6 + 5 * len(arm.joints) + 6 * (len(arm.branches) + arm.hand)
    return slice(start, start + 6)


def arm_with_parameter_step(arm: Arm, step: Floats) -> Arm:
    """Arm with its parameters changed by a step (p,)."""
    ends = 6 + 5 * len(arm.joints)
    changed = replace(arm, base=arm.base * exp(step[:6]), joints=arm.rows + np.reshape(step[6:ends], (-1, 5)))
    if not arm.hands:
        return replace(changed, tool=arm.tool * exp(step[-6:]))
    parts = step[ends:].reshape(-1, 6)
    mounts, tools = np.split(parts, [len(arm.branches)])
    branches = tuple(replace(one, mount=one.mount * exp(part)) for one, part in zip(arm.branches, mounts))
    hands = tuple(replace(one, tool=one.tool * exp(part)) for one, part in zip(arm.hands, tools))
    return replace(changed, branches=branches, hands=hands)


def predicted_target_poses(q: Floats, arm: Arm, hand: Integers | None = None) -> RigidTransform:
    """Predicted poses (...) of the instrument's target in the instrument's frame, at joint values q (..., n).

    hand : (m,) number of the hand that each row of q is of, None where it is the one that the arm is seen at
    """
    return mechanism.hand_pose_of_each_row(q, arm, hand)


def joint_jacobian(q: Floats, arm: Arm, hand: Integers | None = None) -> Floats:
    """Joint Jacobian (..., 6, n) of the target's pose.

    It is the change (m, rad) with joint values q (..., n). hand : as there
    """
    return mechanism.evaluate_with_hand_of_each_row(mechanism.jacobian, q, arm, hand)


def parameter_jacobian(q: Floats, arm: Arm, hand: Integers | None = None) -> Floats:
    """Parameter Jacobian (..., 6, p): change of the target's pose (m, rad) with the parameters.

    q : (..., n) rad or m; hand : as there. At the tool the columns are the identity; all others are axis x lever over
        axis, seen in the target.
    """
    return mechanism.evaluate_with_hand_of_each_row(_parameter_jacobian, q, arm, hand)


def _parameter_jacobian(q: Floats, arm: Arm) -> Floats:
    """The same of the hand that the arm is seen at."""
    before, after, tip = mechanism.joint_frames(q, arm)
    n = len(arm.joints)
    R, p = tip[..., :3, :3], tip[..., :3, 3]
    rows = arm.rows
    turn = (mechanism.joint_values_with_zero_for_slides(q, arm) + rows[:, 0])[..., None]
    along = (
        np.cos(turn) * before[..., :3, 0] + np.sin(turn) * before[..., :3, 1]
    )  # the common normal, x of the turned frame
    across, origin = after[..., :3, 1], after[..., :3, 3]
    z = before[..., :3, 2]
    lever = p[..., None, :] - origin
    out = np.zeros((*p.shape[:-1], len(parameter_units(arm)), 6))  # columns as rows first
    base = arm.base.as_matrix()
    out[..., :6, :] = _at_frame(base[:3, :3], p - base[:3, 3])
    joints = np.zeros((*p.shape[:-1], n, 5, 6))
    joints[..., 0, :3], joints[..., 0, 3:] = np.cross(z, p[..., None, :] - before[..., :3, 3]), z
    joints[..., 1, :3] = z
    joints[..., 2, :3] = along
    joints[..., 3, :3], joints[..., 3, 3:] = np.cross(along, lever), along
    joints[..., 4, :3], joints[..., 4, 3:] = np.cross(across, lever), across
    moving = arm.moving
    joints[..., ~moving, :, :] = 0.0
    out[..., 6 : 6 + 5 * n, :] = joints.reshape(*p.shape[:-1], 5 * n, 6)
    for k, branch in enumerate(arm.branches):
        if moving[branch.joint]:
            at = before[..., branch.joint, :3, :]
            part = slice(6 + 5 * n + 6 * k, 12 + 5 * n + 6 * k)
            out[..., part, :] = _at_frame(at[..., :3], p - at[..., 3])
    out[..., :3], out[..., 3:] = out[..., :3] @ R, out[..., 3:] @ R
    out[..., tool_parameter_slice(arm), :] = np.eye(6)
    return np.swapaxes(out, -1, -2)


def _at_frame(R: Floats, lever: Floats) -> Floats:
    """(..., 6, 6), one parameter a row: the tangent on the right of a frame, the base's or a mount's, seen in the frame
    of poses; lever (..., 3) m.
    """
    out = np.zeros((*lever.shape[:-1], 6, 6))
    out[..., :3, :3] = np.swapaxes(R, -1, -2)
    out[..., 3:, :3] = np.swapaxes(R, -1, -2) @ skew(lever)
    out[..., 3:, 3:] = np.swapaxes(R, -1, -2)
    return out


KINDS = {"pose": 6, "position": 3, "orientation": 3, "distance": 1, "direction": 2}  # rows that one observation gives


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """m observations of one arm by one instrument.

    kind : "pose" (laser tracker with a 6D probe, CMM, vision), "position" (tracker with a reflector, CMM touching a
    ball), "orientation" (inclinometers, an autocollimator, a camera whose target's size is not known: eq. 4.64 alone)
    "distance" (a drawn wire; it runs from the origin of the frame of poses to the target) or "direction" (a telescope
    at stars, a theodolite: where the target's z axis points, by two angles across it)
    q : (m, n) rad, commanded, or what that became by the physics that is known
    value : RigidTransform (m,), also of orientations and directions, (m, 3) m or (m,) m
    covariance : (m, k, k) of an observation's own error, k = 6 (tangent on the right), 3 (positions: frame of poses;
        orientations: on the
    right), 2 (about x and y, on the right) or 1, m and rad
    common : (m, k, j) factor of errors that all share (error = common z + own, z ~ N(0, I)); j = 0 where there are none
    tilts : TiltReadings beside them, None without tilt sensors
    hand : (m,) number of the hand that each is of, None where all are of the one that an arm is seen at
    """

    kind: str
    q: Floats
    value: RigidTransform | Floats
    covariance: Floats
    common: Floats
    tilts: TiltReadings | None = None
    hand: Integers | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"kind must be one of {', '.join(KINDS)}, not {self.kind!r}")
        k, m = KINDS[self.kind], len(self.q)
        if self.covariance.shape != (m, k, k) or self.common.shape[:2] != (m, k):
            raise ValueError(
                f"expected covariance ({m}, {k}, {k}) and common ({m}, {k}, j), got {self.covariance.shape} "
                f"and {self.common.shape}"
            )

    def __len__(self) -> int:
        return len(self.q)

    def take(self, index: Integers | slice) -> "Observations":
        """The observations of an index or mask (m,)."""
        tilts = None if self.tilts is None else self.tilts.take(index)
        hand = None if self.hand is None else self.hand[index]
        return Observations(
            self.kind, self.q[index], self.value[index], self.covariance[index], self.common[index], tilts, hand
        )

    def residuals(self, arm: Arm) -> Floats:
        """(m, k): observed less predicted."""
        T = predicted_target_poses(self.q, arm, self.hand)
        if self.kind in ("pose", "orientation"):
            left = pose_difference(T, self.value)
            return left if self.kind == "pose" else left[:, 3:]
        if self.kind == "direction":
            return direction_difference(T, self.value)
        if self.kind == "position":
            return self.value - T.translation
        return (self.value - np.linalg.norm(T.translation, axis=-1))[:, None]

    def jacobian(self, arm: Arm) -> Floats:
        """(m, k, p) change of what is predicted with the parameters."""
        J = parameter_jacobian(self.q, arm, self.hand)
        return observation_jacobian(self.kind, J, self.q, arm, self.hand)

    def joint_jacobian(self, arm: Arm) -> Floats:
        """(m, k, n) change of what is predicted with the joint angles."""
        J = joint_jacobian(self.q, arm, self.hand)
        return observation_jacobian(self.kind, J, self.q, arm, self.hand)


def observation_jacobian(kind: str, pose_jacobian: Floats, q: Floats, arm: Arm, hand: Integers | None = None) -> Floats:
    """Jacobian (m, k, p) of observations of a kind, from that of the target's pose (m, 6, p). hand : as there"""
    if kind == "pose":
        return pose_jacobian
    if kind == "orientation":
        return pose_jacobian[:, 3:]
    if kind == "direction":
        return pose_jacobian[:, 3:5]
    T = predicted_target_poses(q, arm, hand)
    pose_jacobian = T.rotation.as_matrix() @ pose_jacobian[:, :3]
    if kind == "position":
        return pose_jacobian
    u = T.translation / np.linalg.norm(T.translation, axis=-1, keepdims=True)
    return u[:, None, :] @ pose_jacobian


def observations_of_samples(samples: Samples) -> Observations:
    """Observations of Samples: whole poses, or the part of them that was measured, with what tilt sensors showed."""
    return replace(_instrument_observations(samples), tilts=samples.tilts, hand=samples.hand)


def _instrument_observations(samples: Samples) -> Observations:
    if samples.measured == "pose":
        return pose_observations(samples)
    if samples.measured == "orientation":
        return orientation_observations(
            samples.effective, samples.T_base_platform, np.sqrt(samples.covariance[:, 3, 3])
        )
    if samples.measured == "direction":
        return direction_observations(samples.effective, samples.T_base_platform, np.sqrt(samples.covariance[:, 3, 3]))
    if samples.measured == "distance":
        return distance_observations(
            samples.effective, samples.T_base_platform.translation[:, 0], np.sqrt(samples.covariance[:, 0, 0])
        )
    seen = position_observations(
        samples.effective, samples.T_base_platform.translation, np.sqrt(samples.covariance[:, 0, 0])
    )
    return replace(seen, common=samples.common[:, :3])


def pose_observations(samples: Samples) -> Observations:
    """Pose observations of Samples: whole poses, with their covariance and common errors."""
    return Observations("pose", samples.effective, samples.T_base_platform, samples.covariance, samples.common)


def position_observations(q: Floats, positions: Floats, sigma: float | Floats) -> Observations:
    """Position observations: the target's positions (m, 3) m at joint angles q (m, n)."""
    variance = np.broadcast_to(np.square(sigma), len(q))[:, None, None]
    return Observations(
        "position", np.asarray(q, float), np.asarray(positions, float), variance * np.eye(3), np.zeros((len(q), 3, 0))
    )


def orientation_observations(q: Floats, orientations: RigidTransform, sigma: float | Floats) -> Observations:
    """Orientation observations: rotations (m,) of the target at joint angles q (m, n); sigma (rad) about each axis."""
    variance = np.broadcast_to(np.square(sigma), len(q))[:, None, None]
    return Observations(
        "orientation", np.asarray(q, float), orientations, variance * np.eye(3), np.zeros((len(q), 3, 0))
    )


def direction_observations(q: Floats, pointing: RigidTransform, sigma: float | Floats) -> Observations:
    """Direction observations: poses (m,), their z axes along the target's axis at q (m, n); sigma (rad) across."""
    variance = np.broadcast_to(np.square(sigma), len(q))[:, None, None]
    return Observations("direction", np.asarray(q, float), pointing, variance * np.eye(2), np.zeros((len(q), 2, 0)))


def distance_observations(q: Floats, distances: Floats, sigma: float | Floats) -> Observations:
    """Distance observations: a drawn wire's lengths (m,) m at joint angles q (m, n)."""
    variance = np.broadcast_to(np.square(sigma), len(q))[:, None, None]
    return Observations(
        "distance", np.asarray(q, float), np.asarray(distances, float), np.array(variance), np.zeros((len(q), 1, 0))
    )


PLAUSIBLE = {
    "m": 5e-3,
    "rad": 2e-2,
}  # what a maker's figure may be wrong by; data that tell less than this tell nothing
NAMED = 0.1  # share of the greatest coefficient from which a parameter is named as a partner


@dataclass(frozen=True, slots=True, eq=False)
class Rank:
    """free : (p,) bool, parameters fitted; dependent : pairs (held parameter, those it cannot be distinguished from)
    condition : of the columns that were fitted, scaled by what is plausible; requested : parameters asked for."""

    free: Booleans
    dependent: tuple[tuple[str, tuple[str, ...]], ...]
    condition: float
    requested: int

    def report(self) -> list[str]:
        """Lines for a reader."""
        if not self.requested:
            return ["no parameters were fitted"]
        lines = [f"{self.free.sum()} of {self.requested} parameters fitted; condition number {self.condition:.0f}"]
        lines += [
            f"{name} cannot be distinguished from {', '.join(others)} and remains as stated"
            if others
            else f"{name} has no effect on what was measured and remains as stated"
            for name, others in self.dependent
        ]
        return lines


def parameter_rank(whitened_columns: Floats, free: Booleans, names: tuple[str, ...], units: tuple[str, ...]) -> Rank:
    """Rank of the parameter columns (rows, p), whitened, of the requested parameters: free (p,) bool.

    A column is dependent where, those before it given, the data leave its parameter less certain than PLAUSIBLE: a
    plain zero of the pivoted QR, but also a direction in which only rounding or noise would be fitted.
    """
    requested = np.flatnonzero(free)
    scaled = whitened_columns[:, requested] * np.array([PLAUSIBLE[unit] for unit in units])[requested]
    dead = np.linalg.norm(scaled, axis=0) < 1
    live = requested[~dead]
    R, order = qr(scaled[:, ~dead], mode="r", pivoting=True)
    diagonal = np.abs(np.diag(R)[: min(R.shape)])
    rank = int((diagonal >= 1).sum())
    keep = np.zeros(len(free), bool)
    keep[live[order[:rank]]] = True
    dependent = [(names[i], ()) for i in requested[dead]]
    if rank < len(live):
        partners = np.linalg.solve(R[:rank, :rank], R[:rank, rank:])
        for j, column in enumerate(partners.T):
            strong = np.abs(column) > NAMED * np.abs(column).max()
            dependent.append((names[live[order[rank + j]]], tuple(names[i] for i in live[order[:rank]][strong])))
    values = np.linalg.svd(R[:rank, :rank], compute_uv=False)
    return Rank(keep, tuple(dependent), float(values[0] / values[-1]), len(requested))


CONFIGURATIONS = 60
SEED = 0
INDEPENDENT = 1e-7  # of a column's own length, m and rad alike, that must be left of it beside those before it
PARALLEL = float(np.cos(np.radians(5)))  # neighbouring axes nearer to parallel than this take beta for d


def generally_independent_parameters(arm: Arm, observation_kind: str) -> Booleans:
    """Parameters (p,) bool of an Arm that a kind of observation determines independently in general.

    observation_kind : as of Observations. "In general": at configurations all over the limits, with the arm's own rows,
    and instrument and target standing anywhere: where they really stand, what cannot be told there is for
    calib.models.arm.arm_error_model_and_instrument_observations
    """
    rng, (low, high) = np.random.default_rng(SEED), arm.limits.T
    for k in range(max(len(arm.hands), 1)):
        base, tool = pose(rng.normal(size=3), rng.normal(size=3)), pose(0.1 * rng.normal(size=3), rng.normal(size=3))
        arm = replace(arm, hand=k).with_ends(base, tool)
    q = rng.uniform(low, high, (CONFIGURATIONS * max(len(arm.hands), 1), len(low)))
    hand = np.arange(len(q)) % len(arm.hands) if arm.hands else None
    J = observation_jacobian(observation_kind, parameter_jacobian(q, arm, hand), q, arm, hand)
    columns = J.reshape(-1, J.shape[-1])
    free, basis = np.zeros(columns.shape[1], bool), np.zeros((len(columns), 0))
    for k in _order(arm):
        length = np.linalg.norm(columns[:, k])
        rest = columns[:, k] - basis @ (basis.T @ columns[:, k])
        rest = rest - basis @ (basis.T @ rest)  # once more, for the digits
        left = np.linalg.norm(rest)
        if left > INDEPENDENT * max(float(length), 1.0):
            free[k], basis = True, np.column_stack([basis, rest / left])
    return free


def is_next_axis_near_parallel(arm: Arm) -> Booleans:
    """Whether (n,) the next axis is near parallel to each row's axis, so that beta (Hayati) replaces d."""
    return np.asarray(np.abs(np.cos(arm.rows[:, 3]) * np.cos(arm.rows[:, 4])) > PARALLEL)


def _order(arm: Arm) -> list[int]:
    """Indices of the parameters, the preferred first; d of near parallel axes that turn, and beta of others, come
    last.
    """
    n = len(arm.joints)
    index = 6 + np.arange(5 * n).reshape(n, 5)
    parallel = is_next_axis_near_parallel(arm)
    zeros = joint_zero_indices(arm)
    angles = [*index[:, 3], *index[parallel, 4]]
    lengths = [*index[:, 2], *index[~parallel, 1]]
    count = len(parameter_units(arm))
    ends = [*range(6), *range(6 + 5 * n, count)]
    first = [*ends, *zeros[1:].tolist(), *angles, *lengths]
    return [int(k) for k in first] + [k for k in range(count) if k not in first]
