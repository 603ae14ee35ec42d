"""What an instrument says about an arm's target: whole poses, positions, orientations or one distance, as rows for
least squares.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.models.arm import error_model
from calib.samples.pose_samples import Samples
from rig.model.design import Arm

KINDS = {"pose": 6, "position": 3, "orientation": 3, "distance": 1}  # rows that one observation gives


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """m observations of one arm by one instrument.

    kind : "pose" (laser tracker with a 6D probe, CMM, vision), "position" (tracker with a reflector, CMM touching a
    ball), "orientation" (inclinometers, an autocollimator, a camera whose target's size is not known: eq. 4.64 alone)
    or "distance" (a drawn wire; it runs from the origin of the frame of poses to the target)
    q : (m, n) rad, commanded, or what that became by the physics that is known
    value : RigidTransform (m,), also of orientations, (m, 3) m or (m,) m
    covariance : (m, k, k) of an observation's own error, k = 6 (tangent on the right), 3 (positions: frame of poses;
        orientations: on the
    right) or 1, m and rad
    common : (m, k, j) factor of errors that all share (error = common z + own, z ~ N(0, I)); j = 0 where there are none
    """

    kind: str
    q: np.ndarray
    value: RigidTransform | np.ndarray
    covariance: np.ndarray
    common: np.ndarray

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

    def take(self, index: np.ndarray | slice) -> "Observations":
        """The observations of an index or mask (m,)."""
        return Observations(self.kind, self.q[index], self.value[index], self.covariance[index], self.common[index])

    def residuals(self, arm: Arm) -> np.ndarray:
        """(m, k): observed less predicted."""
        if self.kind in ("pose", "orientation"):
            left = error_model.residuals(self.q, self.value, arm)
            return left if self.kind == "pose" else left[:, 3:]
        position = error_model.predicted(self.q, arm).translation
        if self.kind == "position":
            return self.value - position
        return (self.value - np.linalg.norm(position, axis=-1))[:, None]

    def jacobian(self, arm: Arm) -> np.ndarray:
        """(m, k, 12 + 5 n) change of what is predicted with the parameters."""
        return rows(self.kind, error_model.parameter_jacobian(self.q, arm), self.q, arm)

    def joint_jacobian(self, arm: Arm) -> np.ndarray:
        """(m, k, n) change of what is predicted with the joint angles."""
        return rows(self.kind, error_model.joint_jacobian(self.q, arm), self.q, arm)


def rows(kind: str, J: np.ndarray, q: np.ndarray, arm: Arm) -> np.ndarray:
    """(m, k, p) change of what observations of a kind see, by that of the target's pose J (m, 6, p), m and rad, at
    joint values q (m, n).
    """
    if kind == "pose":
        return J
    if kind == "orientation":
        return J[:, 3:]
    T = error_model.predicted(q, arm)
    J = T.rotation.as_matrix() @ J[:, :3]
    if kind == "position":
        return J
    u = T.translation / np.linalg.norm(T.translation, axis=-1, keepdims=True)
    return u[:, None, :] @ J


def of_samples(samples: Samples) -> Observations:
    """Observations of Samples: whole poses, or what of them was measured (the variance of the rest is infinite), at
    what commands became by the physics that is known."""
    if samples.measured == "pose":
        return of_poses(samples)
    if samples.measured == "orientation":
        return of_orientations(samples.effective, samples.T_base_platform, np.sqrt(samples.covariance[:, 3, 3]))
    if samples.measured == "distance":
        return of_distances(
            samples.effective, samples.T_base_platform.translation[:, 0], np.sqrt(samples.covariance[:, 0, 0])
        )
    return of_positions(samples.effective, samples.T_base_platform.translation, np.sqrt(samples.covariance[:, 0, 0]))


def of_poses(samples: Samples) -> Observations:
    """Observations of Samples: whole poses, with their covariance and their common errors."""
    return Observations("pose", samples.effective, samples.T_base_platform, samples.covariance, samples.common)


def of_positions(q: np.ndarray, positions: np.ndarray, sigma: float | np.ndarray) -> Observations:
    """Observations of target positions (m, 3) m at joint angles q (m, n), standard deviation sigma (m, one or m) per
    axis.
    """
    variance = np.broadcast_to(np.square(sigma), len(q))[:, None, None]
    return Observations(
        "position", np.asarray(q, float), np.asarray(positions, float), variance * np.eye(3), np.zeros((len(q), 3, 0))
    )


def of_orientations(q: np.ndarray, turned: RigidTransform, sigma: float | np.ndarray) -> Observations:
    """Observations of target orientations, the rotations of (m,) transforms, at joint angles q (m, n); sigma (rad, one
    or m) about each axis.
    """
    variance = np.broadcast_to(np.square(sigma), len(q))[:, None, None]
    return Observations("orientation", np.asarray(q, float), turned, variance * np.eye(3), np.zeros((len(q), 3, 0)))


def of_distances(q: np.ndarray, distances: np.ndarray, sigma: float | np.ndarray) -> Observations:
    """Observations of a drawn wire's lengths (m,) m at joint angles q (m, n), standard deviation sigma (m, one or
    m).
    """
    variance = np.broadcast_to(np.square(sigma), len(q))[:, None, None]
    return Observations(
        "distance", np.asarray(q, float), np.asarray(distances, float), np.array(variance), np.zeros((len(q), 1, 0))
    )
