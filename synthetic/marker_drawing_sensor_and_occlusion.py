"""Drawing of marker patterns, image sensor model, and occlusion of markers.

The sensor has noise, vignetting and blur; markers are occluded by other bodies. A pattern is drawn with the exact share
of white in each pixel.

An element's square is carried to the marker's cells by the lens and the homography; over one element both are as good
as affine, so what it sees there is a parallelogram, and what part of that lies on white cells is an area. Where one
line between cells crosses it the area has a closed form, elsewhere polygons are clipped (Sutherland and Hodgman,
Communications of the ACM 17, 1974). No texture and no sampling: an edge lies where geometry puts it, whatever the grid.
"""

import math
from functools import lru_cache
from typing import NamedTuple, cast

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.compute.numba_compilation_and_kernel_cache_folder import njit
from rig.model.design import Design, Sensor
from synthetic.rig_meshes import (
    PLATE,
    ROD_RADIUS,
    SHARE,
    STRUT_RADIUS,
    base_and_stage_body_matrices,
    plate_radius,
    stages_standing_on_struts,
    strut_ends,
)

CACHED = 4  # of what the last cameras' optics do; a falloff is as large as a picture
BLACK = 4.0  # grey level of no light, so that noise is not cut off


def simulate_sensor_exposure(radiance: Floats, sensor: Sensor, rng: np.random.Generator, samples: int = 1) -> Floats:
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


@lru_cache(CACHED)
def _disc(radius: float) -> Floats:
    """A uniform disc of a radius (px), each pixel weighted by the part of it that the disc covers: one pixel alone
    where it is a point.
    """
    reach, fine = int(np.ceil(radius + 0.5)), 17  # odd, so that the middle is looked at: the smallest disc covers that
    at = (np.arange((2 * reach + 1) * fine) + 0.5) / fine - reach - 0.5
    inside = (at[:, None] ** 2 + at**2 <= radius**2).astype(np.float32)
    kernel = inside.reshape(2 * reach + 1, fine, 2 * reach + 1, fine).mean(axis=(1, 3))
    return kernel / kernel.sum()


@lru_cache(CACHED)
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
    poses = base_and_stage_body_matrices(stages)

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


class Footprint(NamedTuple):
    """What an element of the picture sees, in cells: the parallelogram about (X, Y) with the sides (Xu, Yu) and (Xv,
    Yv).
    """

    X: float
    Y: float
    Xu: float
    Xv: float
    Yu: float
    Yv: float


@njit(cache=True, nogil=True)
def bilinear_value(image, x, y, channel) -> float:
    """Bilinear value of a channel of an image (h, w, channels) at (x, y)."""
    x0, y0 = int(x), int(y)
    fx, fy = x - x0, y - y0
    top = image[y0, x0, channel] + fx * (np.float32(image[y0, x0 + 1, channel]) - image[y0, x0, channel])
    bottom = image[y0 + 1, x0, channel] + fx * (np.float32(image[y0 + 1, x0 + 1, channel]) - image[y0 + 1, x0, channel])
    return top + fy * (bottom - top)


@njit(cache=True, nogil=True)
def draw_marker_pattern(image, places, box, ideal, H, cells, part_number, picture) -> None:
    """Draw a marker's pattern into an image whose pixels show its white paper.

    image : (h, w, 3) uint8 pinhole picture: grey with white paper, grey with black paper, number of the marker's part
    places : (k, l, 2) where in it each element of the finer picture looks; box : x0, y0, x1, y1 of the elements about
        the marker
    ideal : (2, y1 - y0 + 2, x1 - x0 + 2) x / z, y / z of the box's elements, widened by one on every side
    H : (3, 3) ideal coordinates to cells; cells : (n, n) 1 white, 0 black; part_number : of the marker in image
    picture : (k, l) float32 grey 0..255 of the finer picture, changed in place
    """
    work = np.empty((4, 12, 2))
    x0, y0, x1, y1 = box
    for y in range(y0, y1):
        for x in range(x0, x1):
            px, py = places[y, x, 0], places[y, x, 1]
            if image[int(py + 0.5), int(px + 0.5), 2] != part_number:
                continue
            j, i = y - y0 + 1, x - x0 + 1
            a, b = ideal[0, j, i], ideal[1, j, i]
            au, av = 0.5 * (ideal[0, j, i + 1] - ideal[0, j, i - 1]), 0.5 * (ideal[0, j + 1, i] - ideal[0, j - 1, i])
            bu, bv = 0.5 * (ideal[1, j, i + 1] - ideal[1, j, i - 1]), 0.5 * (ideal[1, j + 1, i] - ideal[1, j - 1, i])
            w = 1.0 / (H[2, 0] * a + H[2, 1] * b + H[2, 2])
            X, Y = (H[0, 0] * a + H[0, 1] * b + H[0, 2]) * w, (H[1, 0] * a + H[1, 1] * b + H[1, 2]) * w
            Xa, Xb, Ya, Yb = (
                (H[0, 0] - X * H[2, 0]) * w,
                (H[0, 1] - X * H[2, 1]) * w,
                (H[1, 0] - Y * H[2, 0]) * w,
                (H[1, 1] - Y * H[2, 1]) * w,
            )
            seen = Footprint(X, Y, Xa * au + Xb * bu, Xa * av + Xb * bv, Ya * au + Yb * bu, Ya * av + Yb * bv)
            share = white_share(cells, seen, work)
            if share < 1:
                black = bilinear_value(image, px, py, 1)
                picture[y, x] = black + share * (picture[y, x] - black)


@njit(cache=True, nogil=True)
def white_share(cells, footprint, work) -> float:
    """Share of white (0..1) of a pattern's cells in a pixel's Footprint.

    cells : (n, n) 1 white, 0 black, cell (0, 0) from 0 to 1 along both; white beyond; work : (4, 12, 2), overwritten
    """
    n = cells.shape[0]
    half_x, half_y = 0.5 * (abs(footprint.Xu) + abs(footprint.Xv)), 0.5 * (abs(footprint.Yu) + abs(footprint.Yv))
    i0, i1 = max(int(math.floor(footprint.X - half_x)), -1), min(int(math.floor(footprint.X + half_x)), n)
    j0, j1 = max(int(math.floor(footprint.Y - half_y)), -1), min(int(math.floor(footprint.Y + half_y)), n)
    if i0 > n - 1 or j0 > n - 1 or i1 < 0 or j1 < 0:
        return 1.0
    rows_alike, columns_alike = True, True
    for j in range(j0, j1 + 1):
        for i in range(i0, i1 + 1):
            here = _white(cells, i, j)
            rows_alike &= here == _white(cells, i, j0)
            columns_alike &= here == _white(cells, i0, j)
    if rows_alike and columns_alike:
        return _white(cells, i0, j0)
    if rows_alike and i1 == i0 + 1:
        beyond = _beyond(footprint.X - i1, abs(footprint.Xu), abs(footprint.Xv))
        return _white(cells, i0, j0) + beyond * (_white(cells, i1, j0) - _white(cells, i0, j0))
    if columns_alike and j1 == j0 + 1:
        beyond = _beyond(footprint.Y - j1, abs(footprint.Yu), abs(footprint.Yv))
        return _white(cells, i0, j0) + beyond * (_white(cells, i0, j1) - _white(cells, i0, j0))
    return 1.0 - _black_area(cells, footprint, (i0, j0, i1, j1), work)


@njit(cache=True, nogil=True)
def _white(cells, i, j) -> float:
    n = cells.shape[0]
    return cells[j, i] if 0 <= i < n and 0 <= j < n else 1.0


@njit(cache=True, nogil=True)
def _beyond(distance, a, b) -> float:
    """Share of a parallelogram beyond a line: what a sum of two uniform variables of widths a, b about `distance` has
    above zero.
    """
    wide, narrow = max(a, b), min(a, b)
    at = abs(distance)
    if at >= 0.5 * (wide + narrow):
        share = 1.0
    elif at <= 0.5 * (wide - narrow):
        share = 0.5 + at / wide
    else:
        share = 1.0 - (0.5 * (wide + narrow) - at) ** 2 / (2 * wide * narrow)
    return share if distance > 0 else 1.0 - share


@njit(cache=True, nogil=True)
def _black_area(cells, seen, span, work) -> float:
    """Share of black in a Footprint, cell by cell of span i0, j0, i1, j1."""
    n, square, row, cell, part = cells.shape[0], work[0], work[1], work[2], work[3]
    for c in range(4):
        u, v = -0.5 if c == 0 or c == 3 else 0.5, -0.5 if c < 2 else 0.5
        square[c, 0], square[c, 1] = seen.X + u * seen.Xu + v * seen.Xv, seen.Y + u * seen.Yu + v * seen.Yv
    i0, j0, i1, j1 = span
    dark = 0.0
    for j in range(max(j0, 0), min(j1, n - 1) + 1):
        size = _clipped(square, 4, 1, float(j), 1.0, part)
        size = _clipped(part, size, 1, float(j + 1), -1.0, row)
        for i in range(max(i0, 0), min(i1, n - 1) + 1):
            if size > 2 and cells[j, i] < 0.5:
                left = _clipped(row, size, 0, float(i), 1.0, part)
                left = _clipped(part, left, 0, float(i + 1), -1.0, cell)
                dark += _area(cell, left)
    return dark / _area(square, 4)


@njit(cache=True, nogil=True)
def _clipped(points, count, axis, limit, sign, out) -> int:
    """Part of a convex polygon points (count, 2) whose coordinate `axis` is above a limit (sign 1) or below (-1), in
    out; its count.
    """
    retained = 0
    for k in range(count):
        a, b = points[k], points[(k + 1) % count]
        da, db = sign * (a[axis] - limit), sign * (b[axis] - limit)
        if da >= 0:
            out[retained, 0], out[retained, 1] = a[0], a[1]
            retained += 1
        if (da > 0 and db < 0) or (da < 0 and db > 0):
            t = da / (da - db)
            out[retained, 0], out[retained, 1] = a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])
            retained += 1
    return retained


@njit(cache=True, nogil=True)
def _area(points, count) -> float:
    total = 0.0
    for k in range(1, count - 1):
        a, b = points[k] - points[0], points[k + 1] - points[0]
        total += a[0] * b[1] - b[0] * a[1]
    return abs(total) / 2
