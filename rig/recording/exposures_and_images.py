"""Exposures of a recording (frames.csv) and their images, checked before decoding."""

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from rig.array_and_json_types import Floats, Integers, Pixels
from rig.errors import FileError
from rig.formats import local_and_remote_input_files
from rig.formats.csv_and_parquet_tables_and_time_origin import Table, TimeOrigin
from rig.formats.local_and_remote_input_files import read_bytes
from rig.model.design import Camera, Design
from rig.recording.image_file_check import MOST_PIXELS, image_file_problem, image_path_problem, open_image_file_problem

SIMULTANEOUS = 1e-3  # s; exposures of one frame that differ by more were not exposed together
LARGEST_IMAGE_FILE = 1 << 31  # bytes
LISTED = 20  # images that a message names


@dataclass(frozen=True, slots=True, eq=False)
class Exposures:
    """One row per exposure. frame : (n,) int; t : (n,) s; camera, image : n names ("" where there is none)."""

    frame: Integers
    t: Floats
    camera: list[str]
    image: list[str]

    def times(self) -> tuple[Integers, Floats]:
        """(frames, t) : the distinct frames in order and their times (s)."""
        frames, first = np.unique(self.frame, return_index=True)
        return frames, self.t[first]


@dataclass(frozen=True, slots=True)
class UnreadableImage:
    """An image that cannot be used: of which frame and camera, its path, and why."""

    frame: int
    camera: str
    path: Path
    problem: str


def unusable_images_error(unusable: list[UnreadableImage]) -> FileError:
    """Error that names the unusable images, LISTED of them at most."""
    more = [f"  {b.path}: {b.problem}" for b in unusable[1:LISTED]] + (
        [f"  and {len(unusable) - LISTED} more"] if len(unusable) > LISTED else []
    )
    first = unusable[0].problem + (
        f"; {len(unusable)} images cannot be used (--skip-unreadable excludes them):" if more else ""
    )
    return FileError(unusable[0].path, "\n".join([first, *more]))


def undecodable_images(folder: Path, exposures: Exposures) -> list[UnreadableImage]:
    """Images of exposures that cannot be decoded."""
    found = []
    for frame, camera, name in zip(exposures.frame.tolist(), exposures.camera, exposures.image):
        problem = _undecodable(folder / name) if name else None
        if problem:
            found.append(UnreadableImage(frame, camera, folder / name, problem))
    return found


def _undecodable(path: Path) -> str | None:
    try:
        read_image(path)
    except FileError as error:
        return str(error).split(": ", 1)[1]
    return None


def load_exposures(
    folder: Path, design: Design, table: Table, origin: TimeOrigin, skip_unreadable: bool = False
) -> tuple[Exposures, list[UnreadableImage]]:
    """Load (Exposures, [UnreadableImage]) from the rows of a frames.csv.
    skip_unreadable : whether images that cannot be used are left out, which takes decoding every one; else they are
        errors,
    all of them named in one. Raises FileError with line and column. every one; else they are errors, all of them
    named in one. Raises FileError with line and
    column.
    """
    written = table.text("t")
    frame, t, camera, image = table.whole("frame"), table.times("t", origin), table.text("camera"), table.text("image")
    cameras = {c.name: c for c in design.cameras}
    seen: dict[Any, Any] = {}
    start: dict[Any, Any] = {}
    last = (-1, -np.inf, "")
    for i in range(len(table)):
        if camera[i] and camera[i] not in cameras:
            table.fail(
                f"unknown camera {camera[i]!r}; rig.toml has {', '.join(map(repr, cameras)) or 'none'}",
                i,
                "camera",
                camera[i],
            )
        if image[i] and not camera[i]:
            table.fail(f"image {image[i]!r} without a camera", i, "camera")
        if (frame[i], camera[i]) in seen:
            table.fail(
                f"frame {frame[i]} of camera {camera[i]!r} is listed twice, first in line {seen[frame[i], camera[i]]}",
                i,
                "frame",
            )
        seen[frame[i], camera[i]] = table.lines[i]
        if frame[i] in start:
            if abs(t[i] - start[frame[i]]) > SIMULTANEOUS:
                table.fail(
                    f"frame {frame[i]} at t = {written[i]} s, but its first exposure was at "
                    f"{origin.text(start[frame[i]])} s: "
                    "exposures of one frame are simultaneous",
                    i,
                    "t",
                    written[i],
                )
            continue
        if frame[i] < last[0]:
            table.fail(f"frame {frame[i]} follows frame {last[0]}: frames must come in order", i, "frame", frame[i])
        if t[i] < last[1]:
            table.fail(f"time runs backwards: t = {written[i]} s follows {last[2]} s", i, "t", written[i])
        start[frame[i]], last = t[i], (frame[i], t[i], written[i])
    looked_at = (
        _unusable(folder, image[i], frame[i], cameras[camera[i]], table.lines[i], skip_unreadable)
        for i in range(len(table))
        if image[i]
    )
    bad = [found for found in looked_at if found]
    if bad and (not skip_unreadable or len(bad) == sum(map(bool, image))):
        raise unusable_images_error(bad)
    out = {(b.frame, b.camera) for b in bad}
    return Exposures(
        frame, t, camera, ["" if (f, c) in out else name for f, c, name in zip(frame.tolist(), camera, image)]
    ), bad


def _unusable(folder: Path, name: str, frame: int, camera: Camera, line: int, decode: bool) -> UnreadableImage | None:
    """UnreadableImage of an image named in a line of frames.csv, or None. decode : whether it is decoded too"""
    look = _listed if local_and_remote_input_files.is_remote(folder) else image_file_problem
    problem = (
        image_path_problem(folder, name)
        or look(folder / name, camera)
        or (_undecodable(folder / name) if decode else None)
    )
    if problem is None:
        return None
    return UnreadableImage(int(frame), camera.name, folder / name, f"{problem} (frames.csv, line {line})")


def _listed(path: Path, _: Camera) -> str | None:
    """What is wrong with an image behind a URL, as far as its folder's listing tells; the rest is seen when it is
    fetched to be measured.
    """
    size = local_and_remote_input_files.file_size(path)
    return "no such image" if size is None else "is an empty file" if not size else None


def read_image(path: Path, max_pixels: int = MOST_PIXELS) -> Pixels:
    """Read an image (rows, columns) or (rows, columns, 3), `max_pixels` at most.
    max_pixels : px that it may have.

    Raises FileError for one that cannot be decoded
    """
    import cv2

    data = read_bytes(path, LARGEST_IMAGE_FILE, "no such image")
    problem = open_image_file_problem(BytesIO(data), max_pixels=max_pixels)
    if problem:
        raise FileError(path, problem)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise FileError(path, f"cannot be decoded as an image: {error.err}") from None
    if image is None:
        raise FileError(path, "cannot be decoded as an image")
    return image
