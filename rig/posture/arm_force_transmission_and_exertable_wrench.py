"""Force transmission of an arm, and exertable wrench.

How a posture transmits forces to the joints; the wrench it can exert within torque limits.

Torques within their limits, less what the arm's own weight takes, are a box; forces that map into it by J^T are a
polytope, so that the greatest force along a direction is where the ray leaves it, the least greatest force the radius
of the ball inside it, and the greatest of all a corner. Source: patent on force measurement and generation with
redundant manipulators, [0005], [0014]; Chiacchio, Bouffard-Vercelli and Pierrot, Force polytope and force ellipsoid for
redundant manipulators, 1997.

tau = J^T f, so a direction whose column of J^T is small is hardly felt and hardly pushed in. Directions are those of
the frame of poses. Source: patent on force measurement with redundant manipulators, [0011]-[0020], [0037]-[0041].
"""

from dataclasses import dataclass
from io import BytesIO
from itertools import combinations, product

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from scipy.spatial import ConvexHull

from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.mechanisms.arm_dynamics_and_step_by_step_kinematics import LinkMasses

FELT = 1e-9  # of the largest entry; a joint that a direction loads less than that does not limit it
INSIDE = 1e-9  # of a limit, by which a corner may lie outside and still be one
DIFFERENCE = 1e-6  # rad or m, of the slope


@dataclass(frozen=True, slots=True, eq=False)
class TorqueBounds:
    """What bounds an arm of n joints. limits : (n,) N m, of slides N; links : Links, or None for an arm whose weight is
    not stated
    gravity : (3,) m/s^2 in the axes of poses"""

    limits: Floats
    links: LinkMasses | None
    gravity: Floats

    def weight(self, q: Floats, arm: Arm) -> Floats:
        """(..., n) N m that hold the arm itself at joint values q (..., n) rad."""
        q = np.asarray(q, float)
        if self.links is None:
            return np.zeros(q.shape)
        flat = q.reshape(-1, q.shape[-1])
        each = np.column_stack([self.links.mass, self.links.mass[:, None] * self.links.centre]).ravel()  # kg and kg m
        return (mechanism.link_weight_loads(mechanism.forward(flat, arm), flat, arm, self.gravity) @ each).reshape(
            q.shape
        )

    def box(self, q: Floats, arm: Arm) -> tuple[Floats, Floats]:
        """(low, high (..., n) N m) between which torques for a wrench may lie at joint values q (..., n) rad."""
        weight = self.weight(q, arm)
        return -self.limits - weight, self.limits - weight


@dataclass(frozen=True, slots=True, eq=False)
class ExertionObjective:
    """A posture is chosen for the greatest multiple of a wrench (6,) N, Nm that it can exert, at the hand's origin, in
    the axes of poses.

    strength : Strength. Raises ValueError for a wrench of nothing
    """

    wrench: Floats
    strength: TorqueBounds

    def __post_init__(self) -> None:
        if np.shape(self.wrench) != (6,) or not np.any(self.wrench):
            raise ValueError(f"expected a nonzero wrench (6,), got {np.asarray(self.wrench).tolist()}")

    def value(self, q: Floats, arm: Arm) -> Floats:
        """(...,) the multiple at joint values q (..., n) rad; negative, by how much of a limit, where the arm's own
        weight is too much.
        """
        low, high = self.strength.box(q, arm)
        return np.where(
            (low <= 0).all(axis=-1) & (high >= 0).all(axis=-1),
            greatest_load_multiple(joint_torques_for_wrench(q, arm, self.wrench), low, high),
            (np.minimum(high, -low) / self.strength.limits).min(axis=-1),
        )

    def slope(self, q: Floats, arm: Arm) -> Floats:
        """(..., n) derivative of the value with the joint values, by differences: where two joints give out at once it
        has a corner.
        """
        steps = DIFFERENCE * np.eye(np.shape(q)[-1])
        ahead, behind = (self.value(np.asarray(q)[..., None, :] + sign * steps, arm) for sign in (1, -1))
        return (ahead - behind) / (2 * DIFFERENCE)


def joint_torques_for_wrench(q: Floats, arm: Arm, wrench: Floats) -> Floats:
    """Joint torques (..., n) N m that exert a wrench (6,) N, N m on the surroundings.

    Weight excluded.
    """
    return np.swapaxes(mechanism.jacobian(q, arm, "base"), -1, -2) @ wrench


def greatest_load_multiple(load: Floats, low: Floats, high: Floats) -> Floats:
    """Greatest multiple (...,) of a load (..., n) within torque limits low, high (..., n) N m."""
    size = np.abs(load)
    loaded = size > FELT * size.max(axis=-1, keepdims=True)
    room = np.where(load > 0, high, -low)
    return np.min(np.where(loaded, room / np.where(loaded, size, 1.0), np.inf), axis=-1)


def force_polytope_corners(A: Floats, low: Floats, high: Floats) -> Floats:
    """Corners (k, 3) N of the force polytope.

    low <= A f <= high, with A (n, 3) m, low and high (n,) N m.
    Raises RigError where some force loads no joint, so that the posture bears any amount of it
    """
    if np.linalg.matrix_rank(A, tol=FELT * np.abs(A).max()) < 3:
        blind = np.linalg.svd(A)[2][-1]
        raise RigError(
            f"the posture bears any force along ({', '.join(f'{part:+.2f}' for part in blind)}): it loads no "
            "joint, and there is no "
            "greatest one"
        )
    found = []
    for rows in combinations(range(len(A)), 3):
        part = A[list(rows)]
        if np.linalg.cond(part) > 1 / FELT:
            continue
        sides = np.array(list(product(*((low[i], high[i]) for i in rows))))
        found.append(np.linalg.solve(part, sides.T).T)
    every = np.concatenate(found)
    torque = every @ A.T
    slack = INSIDE * (high - low)
    return every[((torque >= low - slack) & (torque <= high + slack)).all(axis=1)]


def greatest_force_in_all_directions_and_weakest_direction(
    A: Floats, low: Floats, high: Floats
) -> tuple[float, Floats]:
    """Greatest force, N, exertable in every direction, and the weakest direction (3,).

    In that direction no more is.
    """
    size = np.linalg.norm(A, axis=1)
    bearing = np.where(size > FELT * size.max(), np.minimum(high, -low) / np.maximum(size, 1e-300), np.inf)
    i = int(bearing.argmin())
    return float(bearing[i]), A[i] / size[i] * (1.0 if high[i] <= -low[i] else -1.0)


DIRECTIONS = ("fx", "fy", "fz", "mx", "my", "mz")


@dataclass(frozen=True, slots=True)
class TransmissionObjective:
    """What a posture is chosen for.

    directions : of force and moment ("fx" .. "mz"), none for all of them together
    norm : 2 or inf, of a column of J^T; with several directions the smallest column counts, so that none is lost
    whole : with no directions, "det" for det(J J^T), "norm" for the matrix norm ||J^T|| that goes with `norm` (2:
        largest singular
    value, inf: largest sum over a joint's entries); the determinant alone keeps every direction from zero
    length : m; a moment's column (dimensionless) counts like a force's (m) times this
    """

    directions: tuple[str, ...] = ()
    norm: float = 2
    whole: str = "det"
    length: float = 1.0

    def __post_init__(self) -> None:
        unknown = [name for name in self.directions if name not in DIRECTIONS]
        if unknown or len(set(self.directions)) < len(self.directions):
            raise ValueError(
                f"directions must be distinct ones of {', '.join(DIRECTIONS)}, not {', '.join(self.directions)}"
            )
        if self.norm not in (2, np.inf) or self.whole not in ("det", "norm") or not self.length > 0:
            raise ValueError(
                f"expected norm 2 or inf, whole 'det' or 'norm' and a positive length, got {self.norm}, "
                f"{self.whole!r}, {self.length}"
            )

    @property
    def rows(self) -> list[int]:
        """Indices of the directions among DIRECTIONS."""
        return [DIRECTIONS.index(name) for name in self.directions]


def _scaled_jacobian(q: Floats, arm: Arm, wish: TransmissionObjective) -> Floats:
    """(..., 6, n) Jacobian in the axes of poses, m/rad, moments' rows weighed by the wish's length."""
    return mechanism.jacobian(q, arm, "base") * np.repeat([1.0, wish.length], 3)[:, None]


def transmission_measure(q: Floats, arm: Arm, objective: TransmissionObjective | ExertionObjective) -> Floats:
    """Measure (...,) of the force transmission at joint angles q (..., n) rad for an objective."""
    if isinstance(objective, ExertionObjective):
        return objective.value(q, arm)
    return _value(_scaled_jacobian(q, arm, objective), objective)


def torque_norms_by_direction(q: Floats, arm: Arm, objective: TransmissionObjective) -> Floats:
    """Norms (..., k) m of joint torques per unit force in each direction.

    Columns of J^T.
    """
    J = _scaled_jacobian(q, arm, objective)
    return np.linalg.norm(J[..., objective.rows or list(range(6)), :], ord=objective.norm, axis=-1)


def transmission_gradient(q: Floats, arm: Arm, objective: TransmissionObjective | ExertionObjective) -> Floats:
    """Gradient (..., n) of the transmission measure with the joint angles.

    It is analytic.
    """
    if isinstance(objective, ExertionObjective):
        return objective.slope(q, arm)
    J = _scaled_jacobian(q, arm, objective)
    H = _jacobian_derivative(q, arm) * np.repeat([1.0, objective.length], 3)[:, None, None]
    if objective.directions:
        norms = np.linalg.norm(J[..., objective.rows, :], ord=objective.norm, axis=-1)
        least = np.array(objective.rows)[np.argmin(norms, axis=-1)]
        row = np.take_along_axis(J, least[..., None, None], axis=-2)[..., 0, :]
        slope = np.take_along_axis(H, least[..., None, None, None], axis=-3)[..., 0, :, :]
        return np.einsum("...i,...ik->...k", _norm_slope(row, objective.norm), slope)
    if objective.whole == "det":
        JJt = J @ np.swapaxes(J, -1, -2)
        return 2 * np.einsum("...ai,...aik->...k", _adjugate(JJt) @ J, H)
    if objective.norm == 2:
        U, _, V = np.linalg.svd(J, full_matrices=False)
        return np.einsum("...a,...i,...aik->...k", U[..., :, 0], V[..., 0, :], H)
    joint = np.abs(J).sum(axis=-2).argmax(axis=-1)[..., None, None]
    sign = np.sign(np.take_along_axis(J, joint, axis=-1))
    return np.einsum("...a,...ak->...k", sign[..., 0], np.take_along_axis(H, joint[..., None], axis=-2)[..., 0, :])


def _value(J: Floats, wish: TransmissionObjective) -> Floats:
    if wish.directions:
        return np.linalg.norm(J[..., wish.rows, :], ord=wish.norm, axis=-1).min(axis=-1)
    if wish.whole == "det":
        return np.linalg.det(J @ np.swapaxes(J, -1, -2))
    return np.linalg.norm(np.swapaxes(J, -1, -2), ord=wish.norm, axis=(-2, -1))


def _norm_slope(v: Floats, norm: float) -> Floats:
    if norm == 2:
        return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-300)
    out = np.zeros(v.shape)
    at = np.abs(v).argmax(axis=-1)[..., None]
    np.put_along_axis(out, at, np.sign(np.take_along_axis(v, at, axis=-1)), axis=-1)
    return out


def _adjugate(A: Floats) -> Floats:
    """(..., 6, 6) of symmetric A: det(A) inv(A), also where A is singular."""
    values, vectors = np.linalg.eigh(A)
    count = values.shape[-1]
    others = np.stack([np.prod(np.delete(values, i, axis=-1), axis=-1) for i in range(count)], axis=-1)
    return (vectors * others[..., None, :]) @ np.swapaxes(vectors, -1, -2)


def _jacobian_derivative(q: Floats, arm: Arm) -> Floats:
    """(..., 6, n, n) derivative of the Jacobian (axes of poses), its column i, with joint k.

    A joint k before i turns axis and lever with it; one behind i only moves the hand.
    """
    J = mechanism.jacobian(q, arm, "base")
    v, z = np.swapaxes(J[..., :3, :], -1, -2), np.swapaxes(J[..., 3:, :], -1, -2)
    n = z.shape[-2]
    zi, zk = z[..., :, None, :], z[..., None, :, :]
    before = (np.arange(n)[:, None] >= np.arange(n))[..., None]  # k <= i
    linear = np.where(before, np.cross(zk, v[..., :, None, :]), np.cross(zi, v[..., None, :, :]))
    angular = np.where(before, np.cross(zk, zi), 0.0)
    return np.moveaxis(np.concatenate([linear, angular], axis=-1), -1, -3)


PLANES = ((0, 1), (0, 2), (1, 2))
NAMES = ("fx", "fy", "fz")
ROUND = 181  # points of an ellipse


def force_polytope_svg(A: Floats, limits: Floats, corners: Floats, wanted_force: Floats) -> str:
    """SVG of the force polytope.

    Corners (k, 3) N, and ellipsoid of A (n, 3) m with torque limits (n,) N m.
    wanted_force : (3,) N
    """
    figure = Figure(figsize=(11, 3.9), layout="constrained")
    shape = np.linalg.inv((A / limits[:, None]).T @ (A / limits[:, None]))  # |torques over their limits| = 1
    for axes, plane in zip(figure.subplots(1, 3), PLANES):
        flat = corners[:, plane]
        around = flat[ConvexHull(flat).vertices]
        axes.fill(
            *around.T, facecolor="tab:blue", alpha=0.15, edgecolor="tab:blue", label="every torque within its limit"
        )
        angle = np.linspace(0, 2 * np.pi, ROUND)
        ellipse = np.linalg.cholesky(shape[np.ix_(plane, plane)]) @ np.stack([np.cos(angle), np.sin(angle)])
        axes.plot(*ellipse, color="tab:green", lw=1.2, label="torques together as large as one limit")
        axes.plot(
            [0, wanted_force[plane[0]]],
            [0, wanted_force[plane[1]]],
            color="tab:red",
            marker="o",
            markevery=[1],
            label="wanted",
        )
        axes.plot(0, 0, "k+")
        axes.set(xlabel=f"{NAMES[plane[0]]}, N", ylabel=f"{NAMES[plane[1]]}, N")
        axes.set_aspect("equal")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8)
    out = BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "rig"}):
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue().decode()
