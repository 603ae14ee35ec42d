"""Trials of camera mistakes in rig.toml.

Exchanged cameras, other pose or focal length.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.model.design import Camera
from vision.checks.corner_and_lens_convention_trials import SampledRecording, focal_length_scaler

Candidate = tuple[str, str, SampledRecording]
BEFORE = "camera in base, OpenCV axes (x right, y down, z ahead): state it in this form"
ZOOMS = (
    0.6,
    1.7,
)  # of the stated focal length that adjusting may find: beyond, it found nothing, and half and twice have other causes
ZOOMED = 0.05  # share beyond which that is a mistake


def alternative_camera_poses(pose: RigidTransform) -> Iterator[tuple[str, RigidTransform]]:
    """Alternative readings of a camera's pose in other conventions.

    Returns [(what the stated pose is, the correct pose)]
    """
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
    """Trials with two cameras exchanged.

    Their corners are, or all stated figures.
    """
    names = [camera.name for camera in sample.design.cameras]
    for a, b in combinations(names, 2):
        other = {a: b, b: a}
        yield (
            f"cameras {a} and {b} are exchanged: what corners.csv or frames.csv gives as one's is the other's",
            "Exchange the names, in rig.toml or in frames.csv and corners.csv",
            sample.with_corners(camera=[other.get(name, name) for name in sample.corners.camera]),
        )


def alternative_camera_pose_trials(sample: SampledRecording) -> Iterator[Candidate]:
    """Trials with alternative conventions of camera poses.

    They are of all cameras and then of each.
    """
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


def focal_length_mistakes(sample: SampledRecording, adjusted: tuple[Camera, ...]) -> Iterator[Candidate]:
    """Mistakes of the focal length.

    Adjusted focal lengths far from the stated ones.
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
        sample.with_cameras(
            tuple(focal_length_scaler(off[k])(camera) if k in off else camera for k, camera in enumerate(cameras))
        ),
    )
