"""frames.csv -> exposures; and their images, checked before anybody decodes them: which cannot be used is said of all
at once.
"""

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np

from rig.errors import FileError
from rig.formats import remote_folders
from rig.formats.csv_table import Table
from rig.formats.input_files import read_bytes
from rig.model.design import Camera, Design
from rig.recording.image_file_check import MOST_PIXELS, check_image, check_image_path, check_open_image
from rig.recording.time_origin import Origin

SIMULTANEOUS = 1e-3  # s; exposures of one frame that differ by more were not exposed together
LARGEST_IMAGE_FILE = 1 << 31  # bytes
LISTED = 20  # images that a message names


@dataclass(frozen=True, slots=True, eq=False)
class Exposures:
    """One row per exposure. frame : (n,) int; t : (n,) s; camera, image : n names ("" where there is none)."""

    frame: np.ndarray
    t: np.ndarray
    camera: list[str]
    image: list[str]

    def times(self) -> tuple[np.ndarray, np.ndarray]:
        """(frames, t) : the distinct frames in order and their times (s)."""
        frames, first = np.unique(self.frame, return_index=True)
        return frames, self.t[first]


@dataclass(frozen=True, slots=True)
class Unreadable:
    """An image that cannot be used: of which frame and camera, its path, and why."""

    frame: int
    camera: str
    path: Path
    problem: str


def unusable_images_error(bad: list[Unreadable]) -> FileError:
    """The error that names all of some images, at most LISTED of them."""
    more = [f"  {b.path}: {b.problem}" for b in bad[1:LISTED]] + (
        [f"  and {len(bad) - LISTED} more"] if len(bad) > LISTED else []
    )
    first = bad[0].problem + (
        f"; {len(bad)} images cannot be used (--skip-unreadable leaves them out):" if more else ""
    )
    return FileError(bad[0].path, "\n".join([first, *more]))


def undecodable_images(folder: Path, exposures: Exposures) -> list[Unreadable]:
    """The images among exposures that cannot be decoded."""
    found = []
    for frame, camera, name in zip(exposures.frame.tolist(), exposures.camera, exposures.image):
        problem = _undecodable(folder / name) if name else None
        if problem:
            found.append(Unreadable(frame, camera, folder / name, problem))
    return found


def _undecodable(path: Path) -> str | None:
    try:
        read_image(path)
    except FileError as error:
        return str(error).split(": ", 1)[1]
    return None


def load_exposures(
    folder: Path, design: Design, rows: Table, origin: Origin, skip: bool = False
) -> tuple[Exposures, list[Unreadable]]:
    """(Exposures, [Unreadable]) of a frames.csv, as a Table. skip : whether images that cannot be used are left out,
    which takes decoding every one; else they are errors, all of them named in one. Raises FileError with line and
    column."""
    written = rows.text("t")
    frame, t, camera, image = rows.whole("frame"), rows.times("t", origin), rows.text("camera"), rows.text("image")
    cameras = {c.name: c for c in design.cameras}
    seen: dict = {}
    start: dict = {}
    last = (-1, -np.inf, "")
    for i in range(len(rows)):
        if camera[i] and camera[i] not in cameras:
            rows.fail(
                f"unknown camera {camera[i]!r}; rig.toml has {', '.join(map(repr, cameras)) or 'none'}",
                i,
                "camera",
                camera[i],
            )
        if image[i] and not camera[i]:
            rows.fail(f"image {image[i]!r} without a camera", i, "camera")
        if (frame[i], camera[i]) in seen:
            rows.fail(
                f"frame {frame[i]} of camera {camera[i]!r} is listed twice, first in line {seen[frame[i], camera[i]]}",
                i,
                "frame",
            )
        seen[frame[i], camera[i]] = rows.lines[i]
        if frame[i] in start:
            if abs(t[i] - start[frame[i]]) > SIMULTANEOUS:
                rows.fail(
                    f"frame {frame[i]} at t = {written[i]} s, but its first exposure was at "
                    f"{origin.text(start[frame[i]])} s: "
                    "exposures of one frame are simultaneous",
                    i,
                    "t",
                    written[i],
                )
            continue
        if frame[i] < last[0]:
            rows.fail(f"frame {frame[i]} follows frame {last[0]}: frames must come in order", i, "frame", frame[i])
        if t[i] < last[1]:
            rows.fail(f"time runs backwards: t = {written[i]} s follows {last[2]} s", i, "t", written[i])
        start[frame[i]], last = t[i], (frame[i], t[i], written[i])
    looked_at = (
        _unusable(folder, image[i], frame[i], cameras[camera[i]], rows.lines[i], skip)
        for i in range(len(rows))
        if image[i]
    )
    bad = [found for found in looked_at if found]
    if bad and (not skip or len(bad) == sum(map(bool, image))):
        raise unusable_images_error(bad)
    out = {(b.frame, b.camera) for b in bad}
    return Exposures(
        frame, t, camera, ["" if (f, c) in out else name for f, c, name in zip(frame.tolist(), camera, image)]
    ), bad


def _unusable(folder: Path, name: str, frame: int, camera: Camera, line: int, decode: bool) -> Unreadable | None:
    """Unreadable of an image named in a line of frames.csv, or None. decode : whether it is decoded too"""
    look = _listed if remote_folders.is_remote(folder) else check_image
    problem = (
        check_image_path(folder, name)
        or look(folder / name, camera)
        or (_undecodable(folder / name) if decode else None)
    )
    if problem is None:
        return None
    return Unreadable(int(frame), camera.name, folder / name, f"{problem} (frames.csv, line {line})")


def _listed(path: Path, _: Camera) -> str | None:
    """What is wrong with an image behind a URL, as far as its folder's listing tells; the rest is seen when it is
    fetched to be measured.
    """
    size = remote_folders.file_size(path)
    return "no such image" if size is None else "is an empty file" if not size else None


def read_image(path: Path, most: int = MOST_PIXELS) -> np.ndarray:
    """Image (rows, columns) or (rows, columns, 3) as stored, decoded once its size has been looked at. most : px that
    it may have.

    Raises FileError for one that cannot be decoded
    """
    import cv2

    data = read_bytes(path, LARGEST_IMAGE_FILE, "no such image")
    problem = check_open_image(BytesIO(data), most=most)
    if problem:
        raise FileError(path, problem)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise FileError(path, f"cannot be decoded as an image: {error.err}") from None
    if image is None:
        raise FileError(path, "cannot be decoded as an image")
    return image
