"""Observations of an arm by an instrument (poses, positions, orientations, distances) and their Jacobians."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.models.arm import error_model
from calib.samples.pose_samples import Samples
from rig.arrays import Floats, Integers
from rig.model.mechanism_geometry import Arm

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
    q: Floats
    value: RigidTransform | Floats
    covariance: Floats
    common: Floats

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
        return Observations(self.kind, self.q[index], self.value[index], self.covariance[index], self.common[index])

    def residuals(self, arm: Arm) -> Floats:
        """(m, k): observed less predicted."""
        if self.kind in ("pose", "orientation"):
            left = error_model.pose_residuals(self.q, self.value, arm)
            return left if self.kind == "pose" else left[:, 3:]
        position = error_model.predicted_target_poses(self.q, arm).translation
        if self.kind == "position":
            return self.value - position
        return (self.value - np.linalg.norm(position, axis=-1))[:, None]

    def jacobian(self, arm: Arm) -> Floats:
        """(m, k, 12 + 5 n) change of what is predicted with the parameters."""
        return observation_jacobian(self.kind, error_model.parameter_jacobian(self.q, arm), self.q, arm)

    def joint_jacobian(self, arm: Arm) -> Floats:
        """(m, k, n) change of what is predicted with the joint angles."""
        return observation_jacobian(self.kind, error_model.joint_jacobian(self.q, arm), self.q, arm)


def observation_jacobian(kind: str, pose_jacobian: Floats, q: Floats, arm: Arm) -> Floats:
    """Jacobian (m, k, p) of observations of a kind, from that of the target's pose (m, 6, p)."""
    if kind == "pose":
        return pose_jacobian
    if kind == "orientation":
        return pose_jacobian[:, 3:]
    T = error_model.predicted_target_poses(q, arm)
    pose_jacobian = T.rotation.as_matrix() @ pose_jacobian[:, :3]
    if kind == "position":
        return pose_jacobian
    u = T.translation / np.linalg.norm(T.translation, axis=-1, keepdims=True)
    return u[:, None, :] @ pose_jacobian


def sample_observations(samples: Samples) -> Observations:
    """Observations of Samples: whole poses, or the part of them that was measured."""
    if samples.measured == "pose":
        return pose_observations(samples)
    if samples.measured == "orientation":
        return orientation_observations(
            samples.effective, samples.T_base_platform, np.sqrt(samples.covariance[:, 3, 3])
        )
    if samples.measured == "distance":
        return distance_observations(
            samples.effective, samples.T_base_platform.translation[:, 0], np.sqrt(samples.covariance[:, 0, 0])
        )
    return position_observations(
        samples.effective, samples.T_base_platform.translation, np.sqrt(samples.covariance[:, 0, 0])
    )


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


def distance_observations(q: Floats, distances: Floats, sigma: float | Floats) -> Observations:
    """Distance observations: a drawn wire's lengths (m,) m at joint angles q (m, n)."""
    variance = np.broadcast_to(np.square(sigma), len(q))[:, None, None]
    return Observations(
        "distance", np.asarray(q, float), np.asarray(distances, float), np.array(variance), np.zeros((len(q), 1, 0))
    )
