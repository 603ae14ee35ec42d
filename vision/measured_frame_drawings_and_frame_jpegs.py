"""Drawings of measured frames, and JPEGs of frames.

Markers, axes and residuals, as JPEG and PNG.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import cast

import cv2
import numpy as np

from rig.array_and_json_types import Floats, Pixels
from rig.errors import FileError, RigError
from rig.formats.output_files import write_bytes
from rig.model.design import Camera
from rig.recording.exposures_and_image_files import Exposures, read_grey_or_colour_image
from rig.recording.recording_folder import Recording
from vision import opencv_lens_model as lens
from vision.corners.marker_detection_and_corner_fit import grey_images_for_reader_and_fit
from vision.recording_adjustment_with_hand_and_stages import Measurement
from vision.recording_measurement import measure_recording

WIDTH = 960  # px, of images on a page at most
QUALITY = 80


def encode_jpeg_reduced_to_page_width(image: Pixels) -> bytes:
    """JPEG of an image, reduced to the width of a page.

    The image is (height, width) or (height, width, 3) as cameras give it.
    No wider than a page needs.
    """
    eight = grey_images_for_reader_and_fit(image)[0]
    if eight.shape[1] > WIDTH:
        eight = cast(
            Floats,
            cv2.resize(eight, (WIDTH, round(eight.shape[0] * WIDTH / eight.shape[1])), interpolation=cv2.INTER_AREA),
        )
    return cv2.imencode(".jpg", eight, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()


def frame_jpegs(recording: Recording, frame: int) -> dict[str, bytes]:
    """JPEG {camera name: bytes} of each camera's image of a frame.

    Empty where the recording has no images.
    Raises FileError for one that cannot be read.
    """
    e = recording.exposures
    rows = [k for k in np.flatnonzero(e.frame == frame) if e.image[k]]
    return {
        e.camera[k]: encode_jpeg_reduced_to_page_width(read_grey_or_colour_image(recording.folder / e.image[k]))
        for k in rows
    }


FOUND, ASIDE, ARROW = (80, 220, 80), (60, 60, 230), (0, 170, 255)  # BGR
AXES = ((60, 60, 240), (60, 200, 60), (240, 120, 40))
FORMATS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
SHIFT = 4  # binary digits below a pixel that lines are drawn to


def measure_and_draw_frame(
    recording: Recording, frame: int, enlarge: float = 200.0, progress: Callable[[str, int, int], None] | None = None
) -> tuple[list[tuple[str, Pixels]], Measurement]:
    """Measure one frame alone and draw it.

    picture : (height, width, 3) BGR

    recording : Recording; frame : its number; enlarge : how much longer than they are residuals are drawn
    Returns ([(camera name, picture) ..], Measurement)
    Raises RigError for a frame that the recording lacks, and what measuring raises
    """
    if frame not in recording.exposures.frame:
        raise RigError(
            f"{recording.folder} has no frame {frame}; it has {recording.exposures.frame.min()} .. "
            f"{recording.exposures.frame.max()}"
        )
    alone = _only(recording, frame)
    measured, _ = measure_recording(alone, progress=progress)
    pictures = []
    for i, camera in enumerate(measured.design.cameras):
        names = [n for n, c in zip(alone.exposures.image, alone.exposures.camera) if c == camera.name]
        if not names:
            continue
        if names[0]:
            picture = cv2.cvtColor(
                grey_images_for_reader_and_fit(read_grey_or_colour_image(recording.folder / names[0]))[0],
                cv2.COLOR_GRAY2BGR,
            )
        else:
            picture = np.full((camera.height, camera.width, 3), 40, np.uint8)
        _markers(picture, measured, i, enlarge)
        _axes(picture, camera, measured)
        pictures.append((camera.name, picture))
    return pictures, measured


def picture_file_suffix(path: str | Path) -> str:
    """Suffix of a picture file.

    It states its format, PNG's by default.
    Raises FileError for an unknown one.
    """
    suffix = Path(path).suffix.lower()
    if suffix and suffix not in FORMATS:
        raise FileError(path, f"pictures are written as {', '.join(FORMATS)}, not as {suffix!r}")
    return suffix or ".png"


def save_pictures_side_by_side(path: str | Path, pictures: list[tuple[str, Pixels]], measurement: Measurement) -> str:
    """Save named pictures (h, w, 3) side by side in one file.

    Returns a text about the frame
    Raises FileError as `picture_file_suffix` and writing do, RigError for a picture that cannot be coded
    """
    height = max(picture.shape[0] for _, picture in pictures)
    padded = [cv2.copyMakeBorder(p, 0, height - p.shape[0], 0, 4, cv2.BORDER_CONSTANT) for _, p in pictures]
    done, coded = cv2.imencode(picture_file_suffix(path), np.hstack(padded))
    if not done:
        raise RigError(f"{path}: the picture of {padded[0].shape[1]} x {height} px and more beside it cannot be coded")
    write_bytes(path, coded.tobytes())
    if not len(measurement.frames):
        return "; ".join(measurement.unsolved.values())
    position = measurement.T_base_platform[0].translation * 1e3
    rotation = np.degrees(measurement.T_base_platform[0].rotation.as_rotvec())
    lines = [f"platform at {position.round(3).tolist()} mm, rotation vector {rotation.round(4).tolist()} degrees"]
    for i, camera in enumerate(measurement.design.cameras):
        r = measurement.residuals[(measurement.observations.camera == i) & measurement.inliers]
        if len(r):
            lines.append(f"{camera.name}: {len(r)} corners, residual {np.sqrt((r**2).mean()):.4f} px RMS")
    return "\n".join(lines)


def _only(recording: Recording, frame: int) -> Recording:
    e = recording.exposures
    rows = np.flatnonzero(e.frame == frame)
    exposures = Exposures(e.frame[rows], e.t[rows], [e.camera[k] for k in rows], [e.image[k] for k in rows])
    corners = recording.corners
    if corners is not None:
        keep = np.flatnonzero(corners.frame == frame)
        covariance = None if corners.covariance is None else corners.covariance[keep]
        corners = replace(
            corners,
            frame=corners.frame[keep],
            camera=[corners.camera[k] for k in keep],
            marker=corners.marker[keep],
            corner=corners.corner[keep],
            uv=corners.uv[keep],
            covariance=covariance,
        )
    return replace(recording, exposures=exposures, corners=corners)


def _markers(picture: Pixels, m: Measurement, i: int, enlarge: float) -> None:
    o = m.observations
    ids = m.ids()
    for marker in np.unique(o.marker[o.camera == i]):
        rows = np.flatnonzero((o.camera == i) & (o.marker == marker))
        quad = o.uv[rows][np.argsort(o.corner[rows])]
        colour = FOUND if m.inliers[rows].all() else ASIDE
        cv2.polylines(picture, [_fixed(quad)], True, colour, 1, cv2.LINE_AA, SHIFT)
        cv2.circle(picture, _point(quad[0]), 3 << SHIFT, colour, -1, cv2.LINE_AA, SHIFT)
        middle = quad.mean(axis=0).astype(np.int32).tolist()
        cv2.putText(picture, str(ids[marker]), middle, cv2.FONT_HERSHEY_SIMPLEX, 0.45, colour, 1, cv2.LINE_AA)
    for k in np.flatnonzero((o.camera == i) & m.inliers):
        cv2.line(picture, _point(o.uv[k]), _point(o.uv[k] + enlarge * m.residuals[k]), ARROW, 1, cv2.LINE_AA, SHIFT)


def _axes(picture: Pixels, camera: Camera, m: Measurement) -> None:
    size = 0.12 * np.linalg.norm(camera.pose.translation)
    frames = [np.eye(4)] + [T.as_matrix() for T in m.T_base_platform]
    for matrix in frames:
        ends = matrix[:3, 3] + size * np.concatenate([np.zeros((1, 3)), matrix[:3, :3].T])
        ahead = camera.pose.inv().apply(ends)
        if (ahead[:, 2] <= 0).any():
            continue
        uv = lens.project(ahead, camera.matrix, camera.distortion)
        for axis in range(3):
            cv2.arrowedLine(picture, _point(uv[0]), _point(uv[1 + axis]), AXES[axis], 2, cv2.LINE_AA, SHIFT, 0.1)


def _fixed(points: Floats) -> Floats:
    """Pixels as the fixed-point integers that OpenCV draws to fractions of a pixel."""
    return np.clip(np.rint(np.asarray(points) * (1 << SHIFT)), -(1 << 28), 1 << 28).astype(np.int32)


def _point(point: Floats) -> tuple[int, int]:
    """One pixel (2,) so."""
    u, v = _fixed(point).tolist()
    return u, v
