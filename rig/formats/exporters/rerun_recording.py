"""A recording as Rerun shows it: images with corners, cameras and cubes in place, the platform along its way, commands
and sensors as curves.

Rerun's image coordinates begin at the first pixel's corner, ours in its middle: half a pixel is added. Its pinhole
knows no distortion: images are shown as they were taken, corners as they were found in them; a projection into an image
is off by what the lens bends.
"""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.errors import MissingLibrary
from rig.formats.input_files import read_bytes
from rig.model.design import Camera, Target
from rig.model.mechanism_geometry import Hexapod
from rig.recording.recording_folder import Recording

MEDIA = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}  # what its viewer decodes
LARGEST = 1 << 28  # bytes of an image
BLACK, GREY = (20, 20, 20), (150, 150, 150)


def import_rerun() -> Any:
    """The module rerun. Raises MissingLibrary that says how to install it."""
    try:
        import rerun
    except ImportError:
        raise MissingLibrary("Rerun's files need the package rerun-sdk: pip install 'rig[rerun]'") from None
    return rerun


def write_rerun(recording: Recording, out: Path, rr: Any) -> int:
    """Write all that a recording holds into an .rrd file; the number of images that the viewer cannot decode and that
    were left out.

    rr : the module rerun
    """
    stream = rr.RecordingStream("rig")
    stream.save(str(out))
    design = recording.design
    stream.log("base", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for camera in design.cameras:
        _camera(stream, rr, camera)
    for target in design.targets:
        _target(stream, rr, target)
    left_out = _exposures(stream, rr, recording)
    _moved(stream, rr, recording)
    _curves(stream, rr, recording)
    stream.flush()
    stream.disconnect()
    return left_out


def _placed(rr: Any, T: RigidTransform) -> Any:
    return rr.Transform3D(translation=T.translation, mat3x3=T.rotation.as_matrix())


def _camera(stream: Any, rr: Any, camera: Camera) -> None:
    """A camera where rig.toml has it: in the base frame, or on the platform."""
    stream.log(_place(camera), _placed(rr, camera.pose), static=True)
    matrix = camera.matrix.copy()
    matrix[:2, 2] += 0.5
    lens = rr.Pinhole(
        image_from_camera=matrix, resolution=[camera.width, camera.height], camera_xyz=rr.ViewCoordinates.RDF
    )
    stream.log(f"{_place(camera)}/image", lens, static=True)


def _place(camera: Camera) -> str:
    return f"base/platform/{camera.name}" if camera.mount == "hand" else f"base/{camera.name}"


def _target(stream: Any, rr: Any, target: Target) -> None:
    """A cube as a box; of a target that is no cube its markers as thin ones."""
    body = "base" if target.body == "base" else f"base/{target.body.replace(' ', '_')}"
    boxes = (
        [(target.pose, [target.edge / 2] * 3)]
        if target.pose is not None and target.edge
        else [(marker.pose, [marker.side / 2, marker.side / 2, 1e-4]) for marker in target.listed]
    )
    for number, (T, half) in enumerate(boxes):
        place = f"{body}/{target.name}/{number}"
        stream.log(place, _placed(rr, T), static=True)
        stream.log(
            f"{place}/box", rr.Boxes3D(half_sizes=[half], colors=[GREY if body == "base" else BLACK]), static=True
        )


def _at(stream: Any, frame: int, t: float) -> None:
    stream.set_time("t", duration=t)
    stream.set_time("frame", sequence=frame)


def _exposures(stream: Any, rr: Any, recording: Recording) -> int:
    """Images and corners; the number of images left out."""
    cameras, e, left_out = {camera.name: camera for camera in recording.design.cameras}, recording.exposures, 0
    for frame, t, name, image in zip(e.frame.tolist(), e.t.tolist(), e.camera, e.image):
        _at(stream, frame, t)
        media = MEDIA.get(Path(image).suffix.lower())
        left_out += bool(image) and media is None
        if image and media is not None:
            stream.log(
                f"{_place(cameras[name])}/image",
                rr.EncodedImage(contents=read_bytes(recording.folder / image, LARGEST), media_type=media),
            )
    corners = recording.corners
    if corners is not None:
        at = dict(zip(*(values.tolist() for values in recording.exposures.times())))
        seen = np.array([f"{frame}/{name}" for frame, name in zip(corners.frame, corners.camera)])
        for key in dict.fromkeys(seen.tolist()):
            frame, _, name = key.partition("/")
            _at(stream, int(frame), at[int(frame)])
            stream.log(f"{_place(cameras[name])}/image/corners", rr.Points2D(corners.uv[seen == key] + 0.5, radii=2.0))
    return left_out


def _moved(stream: Any, rr: Any, recording: Recording) -> None:
    """The platform, its way, and a hexapod's struts, at every pose; a chain's stages below the last at theirs."""
    poses, m = recording.poses, recording.design.mechanism
    at = dict(zip(*(values.tolist() for values in recording.exposures.times())))
    for number, own in recording.stages.items():
        for k, frame in enumerate(own.frame.tolist()):
            _at(stream, frame, at[frame])
            stream.log(f"base/stage_{number}", _placed(rr, own.T_base_platform[k]))
    if poses is None:
        return
    order = sorted(range(len(poses.frame)), key=lambda k: at[int(poses.frame[k])])
    for k in order:
        T = poses.T_base_platform[k]
        _at(stream, int(poses.frame[k]), at[int(poses.frame[k])])
        stream.log("base/platform", _placed(rr, T))
        if isinstance(m, Hexapod):
            ends = T.apply(m.platform_joints)
            stream.log(
                "base/struts", rr.LineStrips3D([[base, end] for base, end in zip(m.base_joints, ends)], radii=0.004)
            )
    way = poses.T_base_platform.translation.reshape(-1, 3)[order]
    stream.log("base/way", rr.LineStrips3D([way], radii=0.001), static=True)


def _curves(stream: Any, rr: Any, recording: Recording) -> None:
    """Commands and sensors over time."""
    curves = []
    if recording.commands is not None:
        curves += [
            (f"commands/{axis}", recording.commands.t, values)
            for axis, values in zip(recording.design.mechanism.axes, recording.commands.values.T)
        ]
    if recording.sensors is not None:
        curves += [
            (f"sensors/{name}", recording.sensors.t, values) for name, values in recording.sensors.channels.items()
        ]
    for place, t, values in curves:
        stream.send_columns(place, indexes=[rr.TimeColumn("t", duration=t)], columns=rr.Scalars.columns(scalars=values))
