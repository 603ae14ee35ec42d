"""Force transmission of a posture: how hand forces and moments load the joints, by norms of J^T's columns.

tau = J^T f, so a direction whose column of J^T is small is hardly felt and hardly pushed in. Directions are those of
the frame of poses. Source: patent on force measurement with redundant manipulators, [0011]-[0020], [0037]-[0041].
"""

from dataclasses import dataclass

import numpy as np

from rig.arrays import Floats
from rig.model.mechanism_geometry import Arm
from rig.model.mechanisms import arm as mechanism
from rig.posture.exertable_wrench import Exertion

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


def transmission_measure(q: Floats, arm: Arm, objective: TransmissionObjective | Exertion) -> Floats:
    """Measure (...,) of the force transmission at joint angles q (..., n) rad for an objective."""
    if isinstance(objective, Exertion):
        return objective.value(q, arm)
    return _value(_scaled_jacobian(q, arm, objective), objective)


def torque_norms_by_direction(q: Floats, arm: Arm, objective: TransmissionObjective) -> Floats:
    """Norms (..., k) m of joint torques per unit force in each direction: columns of J^T."""
    J = _scaled_jacobian(q, arm, objective)
    return np.linalg.norm(J[..., objective.rows or list(range(6)), :], ord=objective.norm, axis=-1)


def transmission_gradient(q: Floats, arm: Arm, objective: TransmissionObjective | Exertion) -> Floats:
    """Gradient (..., n) of the transmission measure with the joint angles, analytic."""
    if isinstance(objective, Exertion):
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
