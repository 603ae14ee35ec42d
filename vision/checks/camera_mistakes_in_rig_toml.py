"""Camera mistakes in rig.toml as trials: exchanged cameras, other pose, matrix or distortion conventions."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats
from rig.model.design import Camera
from vision import lens
from vision.checks.corner_convention_trials import SampledRecording

Candidate = tuple[str, str, SampledRecording]
BEFORE = "camera in base, OpenCV axes (x right, y down, z ahead): state it in this form"
ZOOMS = (
    0.6,
    1.7,
)  # of the stated focal length that adjusting may find: beyond, it found nothing, and half and twice have other causes
ALIKE = (0.015, 0.01, 1.0)  # of the focal length, of the width, px: within which two lenses are one
ZOOMED = 0.05  # share beyond which that is a mistake


def alternative_camera_poses(pose: RigidTransform) -> Iterator[tuple[str, RigidTransform]]:
    """Alternative camera poses, each with its convention: (what the stated pose is, the correct pose)."""
    t, R = pose.translation, pose.rotation
    v = R.as_rotvec()
    yield "its pose is inverted (base in camera, not camera in base)", pose.inv()
    yield "its rotation is inverted", RigidTransform.from_components(t, R.inv())
    yield (
        "its position is base in camera, its rotation camera in base",
        RigidTransform.from_components(-(R.apply(t)), R),
    )
    yield (
        "its position is base in camera, and its rotation is right",
        RigidTransform.from_components(-(R.inv().apply(t)), R),
    )
    yield (
        "its axes are OpenGL's (y up, z back)",
        pose * RigidTransform.from_rotation(Rotation.from_euler("x", 180, degrees=True)),
    )
    yield "its rotation is in degrees", RigidTransform.from_components(t, Rotation.from_rotvec(np.radians(v)))
    for angle in (90, 180, 270):
        yield (
            f"its images are turned by {angle} degrees",
            pose * RigidTransform.from_rotation(Rotation.from_euler("z", angle, degrees=True)),
        )
    for seq in ("xyz", "zyx", "XYZ", "ZYX"):
        for degrees in (False, True):
            for w in (
                v,
                v * (1 - 2 * np.pi / max(float(np.linalg.norm(v)), 1e-9)),
            ):  # a pose keeps its vector shorter than pi
                yield (
                    f"its rotation is Euler angles ({seq.lower()} {'fixed' if seq.islower() else 'moving'} "
                    f"axes{', degrees' if degrees else ''}"
                    f"{'' if w is v else ', long'}), not a rotation vector",
                    RigidTransform.from_components(t, Rotation.from_euler(seq, w, degrees=degrees)),
                )
    for unit, factor in (("centimetres", 1e-2), ("inches", 0.0254), ("feet", 0.3048), ("decimetres", 0.1)):
        yield f"its position is in {unit}", RigidTransform.from_components(t * factor, R)
    for order, names in (((1, 0, 2), "x and y"), ((0, 2, 1), "y and z"), ((2, 1, 0), "x and z")):
        yield f"{names} of its position are exchanged", RigidTransform.from_components(t[list(order)], R)
    for axis in range(3):
        yield (
            f"the sign of {'xyz'[axis]} of its position is reversed",
            RigidTransform.from_components(t * np.where(np.arange(3) == axis, -1, 1), R),
        )


def exchanged_camera_trials(sample: SampledRecording) -> Iterator[Candidate]:
    """Trials with the corners, or all stated figures, of two cameras exchanged."""
    names = [camera.name for camera in sample.design.cameras]
    for a, b in combinations(names, 2):
        other = {a: b, b: a}
        yield (
            f"cameras {a} and {b} are exchanged: what corners.csv or frames.csv gives as one's is the other's",
            "Exchange the names, in rig.toml or in frames.csv and corners.csv",
            sample.with_corners(camera=[other.get(name, name) for name in sample.corners.camera]),
        )


def alternative_camera_pose_trials(sample: SampledRecording) -> Iterator[Candidate]:
    """Trials with alternative conventions of camera poses, of all cameras and then of each."""
    cameras = sample.design.cameras
    for k, (what, _) in enumerate(alternative_camera_poses(cameras[0].pose)):
        turned = [list(alternative_camera_poses(camera.pose))[k][1] for camera in cameras]
        yield (
            f"rig.toml: cameras: {what.replace('its', 'their')}",
            BEFORE,
            sample.with_cameras(tuple(replace(camera, pose=pose) for camera, pose in zip(cameras, turned))),
        )
        for i, camera in enumerate(cameras if len(cameras) > 1 else ()):
            yield (
                f"rig.toml: camera {camera.name}: {what}",
                BEFORE,
                sample.with_cameras((*cameras[:i], replace(camera, pose=turned[i]), *cameras[i + 1 :])),
            )


def alternative_lens_trials(sample: SampledRecording) -> Iterator[Candidate]:
    """Trials with alternative lenses: matrix and distortion in another order, sign or image size."""
    cameras = sample.design.cameras
    for what, do, other in _LENSES:
        mended = [other(camera) for camera in cameras]
        if all(_same(a, b) for a, b in zip(mended, cameras)):
            continue
        said = f"rig.toml: {what} of all cameras" if len(cameras) > 1 else f"rig.toml: camera {cameras[0].name}: {what}"
        yield said, do, sample.with_cameras(tuple(mended))
        for i, camera in enumerate(cameras if len(cameras) > 1 else ()):
            if not _same(mended[i], camera):
                yield (
                    f"rig.toml: camera {camera.name}: {what}",
                    do,
                    sample.with_cameras((*cameras[:i], mended[i], *cameras[i + 1 :])),
                )


def focal_length_mistakes(sample: SampledRecording, adjusted: tuple[Camera, ...]) -> Iterator[Candidate]:
    """Focal length mistakes: adjusted focal lengths far from the stated ones.
    adjusted : the Cameras of Seen, adjusted to its corners
    """
    ratios = {
        k: float(a.matrix[0, 0] / b.matrix[0, 0]) for k, (a, b) in enumerate(zip(adjusted, sample.design.cameras))
    }
    off = {k: ratio for k, ratio in ratios.items() if ZOOMS[0] < ratio < ZOOMS[1] and abs(ratio - 1) > ZOOMED}
    if not off:
        return
    cameras, mean = sample.design.cameras, float(np.median(list(off.values())))
    of = (
        "all cameras"
        if len(off) == len(cameras) > 1
        else f"camera{'s' * (len(off) > 1)} {', '.join(cameras[k].name for k in off)}"
    )
    yield (
        f"rig.toml: the focal length is about {abs(1 / mean - 1):.0%} too {'large' if mean < 1 else 'small'}, of {of}",
        "State it in pixels, of these images",
        sample.with_cameras(tuple(_focal(off[k])(camera) if k in off else camera for k, camera in enumerate(cameras))),
    )


def alternative_distortion_conventions(camera: Camera) -> Iterator[tuple[str, str, Camera]]:
    """Alternative conventions of a distortion, sign or order: (what, what to do, Camera)."""
    for what, do, other in _LENSES:
        if "distortion" in what and not _same(other(camera), camera):
            yield what, do, other(camera)


def distortion_difference(a: Camera, b: Camera) -> float:
    """Difference of two cameras' distortions, px RMS over the image of a."""
    x, y = np.meshgrid(
        np.linspace(-0.45, 0.45, 9) * a.width / a.matrix[0, 0], np.linspace(-0.45, 0.45, 9) * a.height / a.matrix[1, 1]
    )
    points = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)
    gap = lens.project(points, a.matrix, a.distortion) - lens.project(points, a.matrix, b.distortion)
    return float(np.sqrt((gap**2).sum(axis=1).mean()))


def find_matching_lens_convention(sample: SampledRecording, adjusted: tuple[Camera, ...]) -> Candidate | None:
    """The convention of the stated lenses that matches the adjusted ones, or None.

    adjusted : the Cameras of Seen, adjusted from lenses of which nothing is known
    """
    found = [
        one
        for one in alternative_lens_trials(sample)
        if all(is_same_lens(a, b) for a, b in zip(one[2].design.cameras, adjusted))
    ]
    return found[0] if found and not all(is_same_lens(a, b) for a, b in zip(sample.design.cameras, adjusted)) else None


def is_same_lens(a: Camera, b: Camera) -> bool:
    """Whether two cameras have the same lens within the drift of a calibrated lens."""
    gap = np.abs(a.matrix[:2] - b.matrix[:2])
    return bool(
        gap[[0, 1], [0, 1]].max() < ALIKE[0] * a.matrix[0, 0]
        and gap[:, 2].max() < ALIKE[1] * a.width
        and distortion_difference(a, b) < ALIKE[2]
    )


def _same(a: Camera, b: Camera) -> bool:
    return np.array_equal(a.matrix, b.matrix) and np.array_equal(a.distortion, b.distortion) and a.pose is b.pose


def _matrix(fx: float, fy: float, cx: float, cy: float) -> Floats:
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


def _parts(c: Camera) -> tuple[float, float, float, float]:
    return c.matrix[0, 0], c.matrix[1, 1], c.matrix[0, 2], c.matrix[1, 2]


def _with_matrix(order: tuple[int, int, int, int]) -> Callable[[Camera], Camera]:
    def other(c: Camera) -> Camera:
        parts = _parts(c)
        if min(parts) <= 0:
            return c
        return replace(c, matrix=_matrix(*(parts[k] for k in order)))

    return other


def _scaled(factor: float) -> Callable[[Camera], Camera]:
    return lambda c: replace(
        c,
        matrix=_matrix(
            c.matrix[0, 0] * factor,
            c.matrix[1, 1] * factor,
            (c.matrix[0, 2] + 0.5) * factor - 0.5,
            (c.matrix[1, 2] + 0.5) * factor - 0.5,
        ),
    )


def _focal(factor: float) -> Callable[[Camera], Camera]:
    return lambda c: replace(
        c, matrix=_matrix(c.matrix[0, 0] * factor, c.matrix[1, 1] * factor, c.matrix[0, 2], c.matrix[1, 2])
    )


def _terms(change: Callable[[Floats], Floats]) -> Callable[[Camera], Camera]:
    def other(c: Camera) -> Camera:
        d = np.zeros(max(5, len(c.distortion)))
        d[: len(c.distortion)] = c.distortion
        return replace(c, distortion=change(d)) if len(d) == 5 else c

    return other


_ORDER = "Write matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
_LENS = "Write k1, k2, p1, p2, k3 as OpenCV has them"
_LENSES = (
    ("fx, fy and cx, cy are exchanged in the matrix", _ORDER, _with_matrix((2, 3, 0, 1))),
    ("the matrix has fx, cx, fy, cy in another order", _ORDER, _with_matrix((0, 2, 1, 3))),
    ("cx and cy are exchanged in the matrix", _ORDER, _with_matrix((0, 1, 3, 2))),
    ("the matrix is of images of half the size", "Scale the matrix with the images", _scaled(2.0)),
    ("the matrix is of images of twice the size", "Scale the matrix with the images", _scaled(0.5)),
    ("the focal length is half of what it should be", "State it in pixels", _focal(2.0)),
    ("the focal length is twice what it should be", "State it in pixels", _focal(0.5)),
    ("the sign of the distortion is reversed", _LENS, _terms(lambda d: -d)),
    ("distortion is in another order (k1 k2 k3 p1 p2)", _LENS, _terms(lambda d: d[[0, 1, 3, 4, 2]])),
    ("distortion is in another order (k1 p1 k2 p2 k3)", _LENS, _terms(lambda d: d[[0, 2, 1, 3, 4]])),
    ("distortion is in another order (p1 p2 k1 k2 k3)", _LENS, _terms(lambda d: d[[2, 3, 0, 1, 4]])),
    ("k1 and k2 of the distortion are exchanged", _LENS, _terms(lambda d: d[[1, 0, 2, 3, 4]])),
)
