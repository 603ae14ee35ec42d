"""Image sensor model, and occlusion of markers.

Noise, vignetting and blur of the sensor; markers are occluded by other bodies.
"""

from functools import lru_cache
from typing import cast

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.model.design import Design, Sensor
from synthetic.rig_meshes import (
    PLATE,
    ROD_RADIUS,
    SHARE,
    STRUT_RADIUS,
    body_matrices,
    plate_radius,
    stages_standing_on_struts,
    strut_ends,
)

KEPT = 4  # of what the last cameras' optics do; a falloff is as large as a picture
BLACK = 4.0  # grey level of no light, so that noise is not cut off


def expose_image(radiance: Floats, sensor: Sensor, rng: np.random.Generator, samples: int = 1) -> Floats:
    """Image (height, width) uint8 or uint16 exposed by a sensor to a radiance 0..1.

    sensor : rig.model.design.Sensor; rng : numpy Generator; samples : of the radiance to the pixel each way. Optics act
    on the finer picture, before pixels take their means: a blur that steps from pixel to pixel has corners of its own.
        The variance of a
    pixel is read_noise^2 + light / electrons, in grey levels of 255, before it is rounded (EMVA Standard 1288, the
    linear camera model).
    """
    if sensor.defocus:
        radiance = cast(
            Floats, cv2.filter2D(radiance, cv2.CV_32F, _disc(sensor.defocus * samples), borderType=cv2.BORDER_REPLICATE)
        )
    if sensor.blur:
        radiance = cast(Floats, cv2.GaussianBlur(radiance, (0, 0), sensor.blur * samples))
    if samples > 1:
        radiance = cast(
            Floats, cv2.resize(radiance, None, fx=1 / samples, fy=1 / samples, interpolation=cv2.INTER_AREA)
        )
    light = sensor.gain * radiance
    if sensor.vignetting:
        light = light * _falloff(radiance.shape, sensor.vignetting)
    grey = light + np.float32(BLACK)
    if sensor.read_noise or sensor.electrons:
        noise = rng.standard_normal(grey.shape, dtype=np.float32)
        if sensor.electrons:
            noise *= np.sqrt(np.float32(sensor.read_noise**2) + light / np.float32(sensor.electrons))
        else:
            noise *= np.float32(sensor.read_noise)
        grey = grey + noise
    top = 2**sensor.bits - 1
    return np.clip(np.rint(grey * np.float32(top / 255)), 0, top).astype(np.uint8 if sensor.bits == 8 else np.uint16)


@lru_cache(KEPT)
def _disc(radius: float) -> Floats:
    """A uniform disc of a radius (px), each pixel weighted by the part of it that the disc covers: one pixel alone
    where it is a point.
    """
    reach, fine = int(np.ceil(radius + 0.5)), 17  # odd, so that the middle is looked at: the smallest disc covers that
    at = (np.arange((2 * reach + 1) * fine) + 0.5) / fine - reach - 0.5
    inside = (at[:, None] ** 2 + at**2 <= radius**2).astype(np.float32)
    kernel = inside.reshape(2 * reach + 1, fine, 2 * reach + 1, fine).mean(axis=(1, 3))
    return kernel / kernel.sum()


@lru_cache(KEPT)
def _falloff(shape: tuple[int, ...], lost: float) -> Floats:
    """(height, width) share of the light that arrives: 1 in the middle, 1 - lost in the corners, with the square of the
    radius.
    """
    v, u = (np.linspace(-1, 1, n, dtype=np.float32) for n in shape)
    return cast(Floats, 1 - np.float32(lost / 2) * (v[:, None] ** 2 + u**2))


OWN_DEPTH = 2e-3  # m; what is nearer to the marker than this is the marker itself


def is_occluded(design: Design, stages: list[RigidTransform], frame: Integers, eye: Floats, points: Floats) -> Booleans:
    """Whether each point (k,) is occluded from an eye.

    The straight line between them is blocked.
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

    for stands in stages_standing_on_struts(design.mechanism):
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
