"""Occlusion of markers by struts, plates and cubes between them and a camera."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_types import Booleans, Floats, Integers
from rig.model.design import Design
from synthetic.rig_meshes import (
    PLATE,
    ROD_RADIUS,
    SHARE,
    STRUT_RADIUS,
    body_matrices,
    plate_radius,
    strut_ends,
    strut_stages,
)

OWN_DEPTH = 2e-3  # m; what is nearer to the marker than this is the marker itself


def is_occluded(design: Design, stages: list[RigidTransform], frame: Integers, eye: Floats, points: Floats) -> Booleans:
    """Whether each point (k,) is occluded from an eye: the straight line between them is blocked.

    design : Design as it really is; stages : where each stage's platform stands, RigidTransform (F,), the last alone
        but of a chain
    frame : (k,) index
    eye, points : (k, 3) m, base frame
    """
    blocked = np.zeros(len(points), bool)
    length = np.linalg.norm(points - eye, axis=1, keepdims=True)
    ends = points - (points - eye) / length * OWN_DEPTH
    poses = body_matrices(stages)

    def within(body: str) -> tuple[Floats, Floats]:
        """(eyes, ends) (k, 3) m in the frame of a body."""
        return (eye, ends) if body == "base" else (_into(poses[body][frame], eye), _into(poses[body][frame], ends))

    for stands in strut_stages(design.mechanism):
        a, b = within(stands.base)
        low, high = strut_ends(
            stands.stage, RigidTransform.from_matrix(np.linalg.inv(poses[stands.base])) * stages[stands.number]
        )
        radius = np.linalg.norm(stands.stage.base_joints, axis=1).mean() / 2
        for i in range(len(stands.stage.axes)):
            middle = low[:, i] + SHARE * (high[:, i] - low[:, i])
            blocked |= _through_rod(a, b, low[frame, i], middle[frame], STRUT_RADIUS * radius)
            blocked |= _through_rod(a, b, middle[frame], high[frame, i], ROD_RADIUS * radius)
        if stands.stage.plates is not None:
            for body, joints in zip((stands.base, stands.platform), stands.stage.plates):
                blocked |= _through_disc(
                    *within(body), joints[:, 2].mean() - 0.002, plate_radius(body, joints, design), PLATE
                )
    for target in design.targets:
        if target.edge is None or target.pose is None:
            continue
        pose = target.pose.inv().as_matrix()
        a, b = within(target.body)
        blocked |= _through_box(
            a @ pose[:3, :3].T + pose[:3, 3], b @ pose[:3, :3].T + pose[:3, 3], target.edge / 2 - 1e-6
        )
    return blocked


def _into(matrix: Floats, points: Floats) -> Floats:
    """Points (k, 3) in each one's body frame, matrix (k, 4, 4)."""
    return ((points - matrix[:, :3, 3])[:, None] @ matrix[:, :3, :3])[:, 0]


def _through_rod(p: Floats, q: Floats, a: Floats, b: Floats, radius: float | Floats) -> Booleans:
    """(k,) bool, whether segments p-q come within a radius of segments a-b. Source: Ericson, Real-Time Collision
    Detection, 5.1.9
    """
    d1, d2, r = q - p, b - a, p - a
    A, E, F = (np.einsum("ki,ki->k", x, y) for x, y in ((d1, d1), (d2, d2), (d2, r)))
    C, B = np.einsum("ki,ki->k", d1, r), np.einsum("ki,ki->k", d1, d2)
    denominator = A * E - B * B
    s = np.clip(np.where(denominator > 1e-15, (B * F - C * E) / np.where(denominator > 1e-15, denominator, 1), 0), 0, 1)
    t = np.clip((B * s + F) / E, 0, 1)
    s = np.clip((B * t - C) / A, 0, 1)
    gap = p + s[:, None] * d1 - a - t[:, None] * d2
    return np.einsum("ki,ki->k", gap, gap) < radius**2


def _through_disc(p: Floats, q: Floats, top: float, radius: float, thickness: float) -> Booleans:
    """(k,) bool, whether segments p-q cross the faces z = top or z = top - thickness within a radius of the z axis."""
    crossed = np.zeros(len(p), bool)
    for z in (top, top - thickness):
        dz = q[:, 2] - p[:, 2]
        s = (z - p[:, 2]) / np.where(np.abs(dz) > 1e-12, dz, 1e-12)
        at = p[:, :2] + s[:, None] * (q - p)[:, :2]
        crossed |= (s > 0) & (s < 1) & (np.einsum("ki,ki->k", at, at) < radius**2)
    return crossed


def _through_box(p: Floats, q: Floats, half: float | Floats) -> Booleans:
    """(k,) bool, whether segments p-q enter the cube |x|, |y|, |z| < half."""
    d = q - p
    d = np.where(np.abs(d) > 1e-12, d, 1e-12)
    one, two = (-half - p) / d, (half - p) / d
    enter, leave = np.minimum(one, two).max(axis=1), np.maximum(one, two).min(axis=1)
    return (enter < leave) & (leave > 0) & (enter < 1)
