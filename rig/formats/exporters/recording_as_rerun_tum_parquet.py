"""Recording as Rerun, TUM or Parquet files.

All of it as a Rerun file, its poses as a TUM trajectory, its tables as Parquet.

Rerun's image coordinates begin at the first pixel's corner, ours in its middle: half a pixel is added. Its pinhole
knows no distortion: images are shown as they were taken, corners as they were found in them; a projection into an
image is off by what the lens bends.

TUM: a line for each pose, `t x y z qx qy qz qw`, s and m, the quaternion's real part last, of the platform in the
base frame. Source: TUM RGB-D benchmark, file formats
"""

from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.errors import MissingLibrary, RigError
from rig.formats import csv_and_parquet_tables_and_time_origin
from rig.formats.csv_and_parquet_tables_and_time_origin import parquet_bytes
from rig.formats.local_and_remote_input_files import read_bytes
from rig.model.design import Camera, Target
from rig.recording.recording_folder import Recording

MEDIA = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}  # what its viewer decodes
LARGEST = 1 << 28  # bytes of an image
BLACK, GREY = (20, 20, 20), (150, 150, 150)


class RecordingStream(Protocol):
    """What is called of rerun's RecordingStream, which has no types here."""

    def log(self, place: str, thing: object, *, static: bool = False) -> None:
        """Write a thing at a place of the tree."""

    def set_time(self, timeline: str, *, duration: float | None = None, sequence: int | None = None) -> None:
        """Set the time (s) or the number of what is written next."""

    def send_columns(self, place: str, indexes: Sequence[object], columns: object) -> None:
        """Write values over time at a place of the tree."""


def import_rerun() -> ModuleType:
    """Import the module rerun.

    Raises MissingLibrary that says how to install it.
    """
    try:
        import rerun
    except ImportError:
        raise MissingLibrary("Rerun's files need the package rerun-sdk: pip install 'rig[rerun]'") from None
    return rerun


def write_rerun_file(recording: Recording, out: Path, rerun: ModuleType) -> int:
    """Write a recording to a Rerun file (.rrd).

    rerun : the module rerun
    Returns the number of images left out
    """
    stream = rerun.RecordingStream("rig")
    stream.save(str(out))
    design = recording.design
    stream.log("base", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for camera in design.cameras:
        _camera(stream, rerun, camera)
    for target in design.targets:
        _target(stream, rerun, target)
    left_out = _exposures(stream, rerun, recording)
    _moved(stream, rerun, recording)
    _curves(stream, rerun, recording)
    stream.flush()
    stream.disconnect()
    return left_out


def _placed(rr: ModuleType, T: RigidTransform) -> object:
    return rr.Transform3D(translation=T.translation, mat3x3=T.rotation.as_matrix())


def _camera(stream: RecordingStream, rr: ModuleType, camera: Camera) -> None:
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


def _target(stream: RecordingStream, rr: ModuleType, target: Target) -> None:
    """A cube as a box; of a target that is no cube its markers as thin ones."""
    body = "base" if target.body == "base" else f"base/{target.body.replace(' ', '_')}"
    boxes = (
        [(target.pose, [target.edge / 2] * 3)]
        if target.pose is not None and target.edge
        else [(marker.T_body_marker, [marker.side / 2, marker.side / 2, 1e-4]) for marker in target.listed]
    )
    for number, (T, half) in enumerate(boxes):
        place = f"{body}/{target.name}/{number}"
        stream.log(place, _placed(rr, T), static=True)
        stream.log(
            f"{place}/box", rr.Boxes3D(half_sizes=[half], colors=[GREY if body == "base" else BLACK]), static=True
        )


def _at(stream: RecordingStream, frame: int, t: float) -> None:
    stream.set_time("t", duration=t)
    stream.set_time("frame", sequence=frame)


def _exposures(stream: RecordingStream, rr: ModuleType, recording: Recording) -> int:
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


def _moved(stream: RecordingStream, rr: ModuleType, recording: Recording) -> None:
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
        if m.plates is not None:
            low, high = m.plates[0], T.apply(m.plates[1])
            stream.log("base/struts", rr.LineStrips3D([[base, end] for base, end in zip(low, high)], radii=0.004))
    path = poses.T_base_platform.translation.reshape(-1, 3)[order]
    stream.log("base/way", rr.LineStrips3D([path], radii=0.001), static=True)


def _curves(stream: RecordingStream, rr: ModuleType, recording: Recording) -> None:
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


RECORDING_TABLES = ("commands", "frames", "sensors", "corners", "poses")
WHOLE, TEXT = ("frame", "marker", "corner"), ("camera", "image")  # columns; all others are numbers


def tum_trajectory(recording: Recording) -> str:
    """TUM trajectory text of a recording's poses, sorted by time.

    Raises RigError where it has none.
    """
    poses = recording.poses
    if poses is None or not len(poses.frame):
        raise RigError(f"{recording.folder}: has no poses.csv; rig measure writes one")
    frames, times = recording.exposures.times()
    at = dict(zip(frames.tolist(), times.tolist()))
    lines = ["# t x y z qx qy qz qw"]
    rows = sorted(zip((at[int(frame)] for frame in poses.frame), poses.T_base_platform), key=lambda row: row[0])
    for t, T in rows:
        figures = (*T.translation.tolist(), *T.rotation.as_quat(canonical=True).tolist())
        lines.append(" ".join([recording.origin.text(t), *(f"{value:.12g}" for value in figures)]))
    return "\n".join(lines) + "\n"


def parquet_tables(recording_folder: Path) -> dict[str, bytes]:
    """Parquet files {name: bytes} of the tables in a recording's folder.

    Raises MissingLibrary without pyarrow, FileError for a table that cannot be read
    """
    found = [name for name in RECORDING_TABLES if (recording_folder / f"{name}.csv").is_file()]
    return {
        name: parquet_bytes(
            _columns(csv_and_parquet_tables_and_time_origin.read_csv_table(recording_folder / f"{name}.csv", ()))
        )
        for name in found
    }


def _columns(rows: csv_and_parquet_tables_and_time_origin.Table) -> dict[str, list[int] | list[float] | list[str]]:
    return {
        name: rows.text(name) if name in TEXT else (rows.whole(name) if name in WHOLE else rows.numbers(name)).tolist()
        for name in rows.columns
    }
