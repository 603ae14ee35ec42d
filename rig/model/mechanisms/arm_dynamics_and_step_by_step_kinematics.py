"""Arm dynamics, and kinematics step by step.

Joint torques, weights, mass matrix, momentum rate. Forward and inverse kinematics are written out; the steps are for a
reader.

Source: Luh, Walker and Paul, On-line computational scheme for mechanical manipulators, 1980 (sliding joints: there
    too).

d(M v)/dt = tau + C^T v - g + J^T f, which needs no acceleration. Source: De Luca and Mattone, Actuator failure
detection and isolation using generalized momenta, ICRA 2003.

Forward, the hand's points A, B, C (AB along z and AC along y at zero, 1 m each) turn about the axes where these stand
at zero, or move along them, the last joint first. Inverse, joint 1 to joint 6: each is read from a point or a direction
that the joints behind it cannot move, and the points are turned back before the next is read. A moves to where axes 5
and 6 cross; E is the elbow on axis 3, D the point on axis 4 (with three parallel axes; with a spherical wrist it is A
itself); after the last step A, B, C lie where they are at zero.

Where our order of reading differs. The source reads joint 5 after 2, 3 and 4, and joint 4 of a spherical wrist before
5, which its arms allow:
there axis 5 is square to its neighbours, so that D and the turn of 4 can be seen in a front view. With axes that are
not square, how far AB has turned about the parallel axes, or about axis 4, depends on joint 5: so joint 5's two values
are read first (rig.model.mechanisms.closed_form_six_joint_inverse_kernels has
them at once for all branches), from the angle between AB and axis 2, or 4, which joints 2 to 4, or 4, do not change.
Points are returned in the source's order all the same, and every joint is read from them, joint 5 once more.
Source: patent CN111488654A, claims 1 to 5
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats, Json
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.mechanisms.closed_form_and_numerical_arm_inverse import SixJointArm, frame_at_first_axes_crossing
from rig.model.mechanisms.closed_form_six_joint_inverse_kernels import FREE


@dataclass(frozen=True, slots=True, eq=False)
class LinkMasses:
    """mass : (n,) kg; centre : (n, 3) m, centre of mass in the link's Denavit-Hartenberg frame (the one behind its
    joint)
    inertia : (n, 3, 3) kg m^2 about the centre of mass, in that frame's axes. What the hand holds belongs to the last
        link."""

    mass: Floats
    centre: Floats
    inertia: Floats

    def __post_init__(self) -> None:
        n = len(self.mass)
        if np.shape(self.centre) != (n, 3) or np.shape(self.inertia) != (n, 3, 3) or (np.asarray(self.mass) < 0).any():
            raise ValueError(
                f"expected masses (n,) >= 0, centres ({n}, 3) and inertias ({n}, 3, 3), got {np.shape(self.centre)}, "
                f"{np.shape(self.inertia)}"
            )


def joint_torques(
    q: Floats, speed: Floats, acceleration: Floats, arm: Arm, links: LinkMasses, gravity: Floats
) -> Floats:
    """Joint torques (..., n) N m (slides: N) for an arm's weight and motion.

    With nothing at the hand.
    q : (..., n) rad, of slides m; speed, acceleration : (..., n) of these per s and s^2; gravity : (3,) m/s^2 in the
        axes of poses
    """
    chain = mechanism.single_hand_arm_link_frames(q, arm)
    speed, acceleration = np.broadcast_to(speed, np.shape(q)), np.broadcast_to(acceleration, np.shape(q))
    n = len(arm.joints)
    z, o, R = chain[..., :n, :3, 2], chain[..., : n + 1, :3, 3], chain[..., 1 : n + 1, :3, :3]
    centre = np.einsum("...nij,nj->...ni", R, links.centre) + o[..., 1:, :]
    inertia = R @ links.inertia @ np.swapaxes(R, -1, -2)
    zero = np.zeros(z.shape[:-2] + (3,))
    w, dw, a = zero, zero, zero - np.asarray(gravity, float)
    push, turn = [], []
    for k in range(n):
        axis, rate = z[..., k, :], speed[..., k, None]
        to_centre, to_next = centre[..., k, :] - o[..., k, :], o[..., k + 1, :] - o[..., k, :]
        if arm.slides[k]:
            a = a + axis * acceleration[..., k, None] + 2 * np.cross(w, axis * rate)
        else:
            dw = dw + axis * acceleration[..., k, None] + np.cross(w, axis * rate)
            w = w + axis * rate
        push.append(links.mass[k] * (a + np.cross(dw, to_centre) + np.cross(w, np.cross(w, to_centre))))
        spin = np.einsum("...ij,...j->...i", inertia[..., k, :, :], w)
        turn.append(np.einsum("...ij,...j->...i", inertia[..., k, :, :], dw) + np.cross(w, spin))
        a = a + np.cross(dw, to_next) + np.cross(w, np.cross(w, to_next))
    force, moment, out = zero, zero, np.empty(z.shape[:-1])
    for k in range(n - 1, -1, -1):
        moment = (
            moment
            + turn[k]
            + np.cross(centre[..., k, :] - o[..., k, :], push[k])
            + np.cross(o[..., k + 1, :] - o[..., k, :], force)
        )
        force = force + push[k]
        out[..., k] = np.einsum("...i,...i->...", z[..., k, :], force if arm.slides[k] else moment)
    return out


STEP = 1e-5  # rad or m, along the motion, for the mass matrix's rate: its error is of the square, below 1e-10
NO_GRAVITY = np.zeros(3)


def mass_matrix(q: Floats, arm: Arm, links: LinkMasses) -> Floats:
    """Mass matrix (..., n, n) kg m^2 at joint values q (..., n) rad (slides: m, and kg)."""
    columns = [
        joint_torques(q, np.zeros(np.shape(q)), np.broadcast_to(e, np.shape(q)), arm, links, NO_GRAVITY)
        for e in np.eye(np.shape(q)[-1])
    ]
    return np.stack(columns, axis=-1)


def torque_free_momentum_rate(q: Floats, speed: Floats, arm: Arm, links: LinkMasses, gravity: Floats) -> Floats:
    """Rate (..., n) N m of an arm's momentum without joint torques and hand wrench.

    C^T v - g.
    q, speed : (..., n) rad and rad/s; gravity : (3,) m/s^2 in the axes of poses
    """
    still, ahead = np.zeros(np.shape(q)), STEP * np.asarray(speed, float)
    pull = joint_torques(q, speed, still, arm, links, gravity)  # C v + g
    momentum = [joint_torques(q + sign * ahead, still, speed, arm, links, NO_GRAVITY) for sign in (1, -1)]
    return (momentum[0] - momentum[1]) / (2 * STEP) - pull  # C^T v = (dM/dt) v - C v


class KinematicsStep(NamedTuple):
    """What one step does and where points then are, in the global frame. joint : from 1, 0 for a step that moves none;
    value : of the joint, rad or m; axis : (2, 3) a point (m) and the unit space vector about or along which it is
        moved; names : of the points; points : (k, 3) m."""

    joint: int
    value: float
    axis: Floats
    names: tuple[str, ...]
    points: Floats


def three_hand_points_at_zero_joint_values(arm: Arm) -> Floats:
    """Three points A, B, C (3, 3) m of an arm's hand at zero joint values.

    In its global frame.
    """
    F = frame_at_first_axes_crossing(arm)
    a = F.inv().apply(mechanism.forward(np.zeros(len(arm.joints)), arm).translation)
    return np.array([a, a + [0, 0, 1], a + [0, 1, 0]])


def hand_points_after_moving_each_joint(q: Floats, arm: Arm) -> list[KinematicsStep]:
    """Points of an arm's hand at zero, then after each joint is moved, the last joint first.

    Steps of the forward kinematics of any Arm at q (axes,) rad or m.

    Points at zero, then after each joint, the last first
    """
    to_global = frame_at_first_axes_crossing(arm).inv()
    chain = (
        to_global * RigidTransform.from_matrix(mechanism.single_hand_arm_link_frames(np.zeros(len(q)), arm))
    ).as_matrix()
    abc = three_hand_points_at_zero_joint_values(arm)
    steps = [KinematicsStep(0, 0.0, np.zeros((2, 3)), tuple("ABC"), abc)]
    for i in range(len(q) - 1, -1, -1):
        o, u = chain[i, :3, 3], chain[i, :3, 2]
        abc = abc + q[i] * u if arm.slides[i] else rotate_points(abc, o, u, q[i])
        steps.append(KinematicsStep(i + 1, float(q[i]), np.array([o, u]), tuple("ABC"), abc))
    return steps


def steps_of_closed_form_inverse(
    T_base_platform: RigidTransform, six_arm: SixJointArm, q: Floats
) -> list[KinematicsStep]:
    """Steps of the closed-form inverse for a solution q (6,) rad, from joint 1 to 6.

    q : of closed_form_inverse: of two readings the one near it is taken, and what a singular pose leaves free
    """
    path = _PathToZero(six_arm, np.asarray(q, float), T_base_platform)
    path.back(0, path.shoulder())
    if six_arm.kind == "spherical":
        path.elbow(path.abc[0])
        path.back(
            1, _angle(six_arm.points[2] - six_arm.points[1], path.extra["E"] - six_arm.points[1], six_arm.axes[1])
        )
        path.back(2, _angle(six_arm.key - six_arm.points[2], path.abc[0] - six_arm.points[2], six_arm.axes[2]))
        fifth = path.fifth(six_arm.axes[3])
        path.back(
            3, path.about(3, _rotate_vectors(six_arm.axes[5], six_arm.axes[4], fifth), path.carried(six_arm.axes[5]))
        )
    else:
        fifth = path.fifth(six_arm.axes[1])
        turn = path.about(None, _rotate_vectors(six_arm.axes[5], six_arm.axes[4], fifth), path.carried(six_arm.axes[5]))
        last = six_arm.key - six_arm.points[3]
        path.extra["D"] = path.abc[0] - _rotate_vectors(last, six_arm.axes[1], turn)
        path.elbow(path.extra["D"])
        path.back(
            1, _angle(six_arm.points[2] - six_arm.points[1], path.extra["E"] - six_arm.points[1], six_arm.axes[1])
        )
        path.back(
            2, _angle(six_arm.points[3] - six_arm.points[2], path.extra["D"] - six_arm.points[2], six_arm.axes[2])
        )
        path.back(
            3, path.about(3, _rotate_vectors(six_arm.axes[5], six_arm.axes[4], fifth), path.carried(six_arm.axes[5]))
        )
    path.back(4, _angle(six_arm.axes[5], path.carried(six_arm.axes[5]), six_arm.axes[4]))
    mark = np.cross(six_arm.axes[5], six_arm.axes[4])
    path.back(5, _angle(mark, path.carried(mark), six_arm.axes[5]))
    return path.steps


def joint_by_joint_inverse_steps(T_base_platform: RigidTransform, arm: Arm, q: Floats) -> list[KinematicsStep]:
    """Steps of the inverse, joint by joint, for a numerical solution q (n,) of a pose.

    From joint 1 to n.

    The last leaves A, B, C where they are at zero, but for what the solution leaves of the pose.
    """
    frame = frame_at_first_axes_crossing(arm)
    chain = (
        frame.inv() * RigidTransform.from_matrix(mechanism.single_hand_arm_link_frames(np.zeros(len(q)), arm))
    ).as_matrix()
    moved = (
        frame.inv() * T_base_platform * mechanism.forward(np.zeros(len(q)), arm).inv() * frame
    )  # the hand since zero, in the global frame
    abc = moved.apply(three_hand_points_at_zero_joint_values(arm))
    steps = [KinematicsStep(0, 0.0, np.zeros((2, 3)), tuple("ABC"), abc)]
    for i, value in enumerate(q):
        o, u = chain[i, :3, 3], chain[i, :3, 2]
        abc = abc - value * u if arm.slides[i] else rotate_points(abc, o, u, -value)
        steps.append(KinematicsStep(i + 1, float(value), np.array([o, u]), tuple("ABC"), abc))
    return steps


class _PathToZero:
    """The points of one pose on their way back to zero. abc : (3, 3) m; extra : {name: point} that joints still to be
    read move; steps : so far.
    """

    def __init__(self, six: SixJointArm, q: Floats, T: RigidTransform) -> None:
        self.six, self.q = six, q
        turn = (
            six.frame.inv() * T * mechanism.forward(np.zeros(6), six.arm).inv() * six.frame
        )  # of the hand since zero, in the global frame
        R = turn.rotation.as_matrix()
        a = six.frame.inv().apply(T.translation) + R @ (six.key - six.hand[0])
        self.abc = np.array([a, a + R[:, 2], a + R[:, 1]])
        self.extra: dict[str, Floats] = {}
        self.steps = [KinematicsStep(0, 0.0, np.array([six.key, six.key - six.hand[0]]), tuple("ABC"), self.abc)]

    def carried(self, v: Floats) -> Floats:
        """(3,) where a vector of the hand at zero (3,) now points."""
        z, y = self.abc[1] - self.abc[0], self.abc[2] - self.abc[0]
        return np.column_stack([np.cross(y, z), y, z]) @ v

    def back(self, i: int, value: float) -> None:
        """Turn all points back about axis i (from 0) by an angle (rad) that was read, and note the step."""
        o, u = self.six.points[i], self.six.axes[i]
        self.abc = rotate_points(self.abc, o, u, -value)
        self.extra = {name: rotate_points(point, o, u, -value) for name, point in self.extra.items()}
        self.steps.append(KinematicsStep(i + 1, value, np.array([o, u]), **self.seen()))
        self.extra = {
            name: point for name, point in self.extra.items() if i < {"E": 1, "D": 2}[name]
        }  # later joints leave it where it is

    def seen(self) -> Json:
        """names and points of a Step, as they now are."""
        names = ("A", "B", "C", *sorted(self.extra))
        return {"names": names, "points": np.array([*self.abc, *(self.extra[name] for name in names[3:])])}

    def shoulder(self) -> float:
        """rad, joint 1: turned back by it, A lies along axis 2 where it does at zero."""
        (o, *_), (u, w, *_) = self.six.points, self.six.axes
        flat, at = w - (u @ w) * u, self.abc[0] - o
        level = w @ (self.six.key - o) - (u @ w) * (u @ at)
        return self.two(0, flat @ at, -flat @ np.cross(u, at), level)

    def fifth(self, axis: Floats) -> float:
        """rad, joint 5, from how far the hand's axis 6 leans to an axis (3,) that the joints between do not move."""
        u, v = self.six.axes[4], self.six.axes[5]
        tilt = (axis @ u) * (v @ u)
        return self.two(4, float(axis @ v - tilt), float(axis @ np.cross(u, v)), float(axis @ self.carried(v) - tilt))

    def elbow(self, point: Floats) -> None:
        """Find E on axis 3, as far from axis 2 and from a point (3,) m as the links say; of two the one near the
        solution.
        """
        o, u = self.six.points[1:3], self.six.axes[1]
        far = self.six.key if self.six.kind == "spherical" else self.six.points[3]
        arm, fore, d = (v - (u @ v) * u for v in (o[1] - o[0], far - o[1], point - o[0]))
        elbows = [o[0] + _rotate_vectors(o[1] - o[0], u, self.q[1])]  # where joint 2 is free
        reach = np.linalg.norm(d)
        if reach > FREE:
            x = (arm @ arm - fore @ fore + reach**2) / (2 * reach)
            h = np.sqrt(max(arm @ arm - x * x, 0.0))
            foot, side = o[0] + u * (u @ (o[1] - o[0])) + x * d / reach, np.cross(u, d / reach)
            elbows = [foot + h * side, foot - h * side]
        self.extra["E"] = min(elbows, key=lambda e: abs(_wrap_angle(_angle(arm, e - o[0], u) - self.q[1])))
        self.steps[-1] = self.steps[-1]._replace(**self.seen())

    def about(self, i: int | None, start: Floats, end: Floats) -> float:
        """rad about axis i (from 0), or about the three parallel axes together, that takes a vector (3,) to another;
        free ones as in the solution.
        """
        u = self.six.axes[1 if i is None else i]
        free = self.q[i] if i is not None else sum(self.q[k] * (self.six.axes[k] @ u) for k in (1, 2, 3))
        return (
            _angle(start, end, u)
            if np.linalg.norm(np.cross(u, start)) > FREE and np.linalg.norm(np.cross(u, end)) > FREE
            else float(free)
        )

    def two(self, i: int, a: float, b: float, c: float) -> float:
        """rad, joint i (from 0) of a cos + b sin = c: of the two values the one near the solution, which a free joint
        takes.
        """
        r = float(np.hypot(a, b))
        if r < FREE:
            return float(self.q[i])
        middle, half = np.arctan2(b, a), np.arctan2(np.sqrt(max(r - c, 0.0) * max(r + c, 0.0)), c)
        return float(
            min((_wrap_angle(middle + half), _wrap_angle(middle - half)), key=lambda t: abs(_wrap_angle(t - self.q[i])))
        )


def _angle(a: Floats, b: Floats, u: Floats) -> float:
    """rad from vector a (3,) to b (3,) about the unit vector u (3,)."""
    a, b = a - (u @ a) * u, b - (u @ b) * u
    return float(np.arctan2(u @ np.cross(a, b), a @ b))


def _rotate_vectors(v: Floats, u: Floats, t: float) -> Floats:
    """Vectors v (..., 3) turned about the unit vector u (3,) by t rad, right-handed."""
    return Rotation.from_rotvec(t * u).apply(v)


def rotate_points(points: Floats, axis_point: Floats, axis_direction: Floats, angle: float) -> Floats:
    """Points (..., 3) m rotated about an axis through axis_point (3,) m along axis_direction (3,) by angle rad."""
    return axis_point + _rotate_vectors(points - axis_point, axis_direction, angle)


def _wrap_angle(t: float) -> float:
    """An angle (rad) brought to -pi .. pi."""
    return float(t - 2 * np.pi * np.round(t / (2 * np.pi)))


UNSTATED = "needs mass and centre_of_mass of every [[mechanism.hand]] in rig.toml"


def weight_wrench(T: RigidTransform, gravity: Floats, mass: float | Floats, centre: Floats | None) -> Floats:
    """Wrench (n, 6) N and N m of weights on bodies.

    On their origins, in the axes of bodies at poses T (n,).
    gravity : (n, 3) m/s^2 in the frame of poses; mass : kg, of all or (n,) of each; centre : (3,) m, in the body
    Raises ValueError where no centre is stated
    """
    if centre is None:
        raise ValueError("where a weight acts is not stated")
    force = np.reshape(mass, (-1, 1)) * np.einsum("nji,nj->ni", T.rotation.as_matrix(), gravity)
    return np.concatenate([force, np.cross(centre, force)], axis=1)


def loads_by_weight_of_hands(q: Floats, arm: Arm, gravity: Floats) -> Floats:
    """Loads (n, joints) N m of the joints by the weight of all hands, at q (n, joints).

    Of slides N.
    gravity : (n, 3) m/s^2 in the frame of poses. A joint that several hands stand on holds the weight of each.
    """
    out = np.zeros(q.shape)
    for number, hand in enumerate(arm.hands):
        seen = arm.of_hand(number)
        T = mechanism.forward(q, seen)
        out += mechanism.axis_forces_and_torques(
            T, q, seen, weight_wrench(T, gravity, hand.mass or 0.0, hand.centre_of_mass)
        )
    return out


def are_hand_masses_and_centres_stated(arm: Arm) -> bool:
    """Whether mass and centre of mass of every hand are stated."""
    return all(hand.mass is not None and hand.centre_of_mass is not None for hand in arm.hands)
