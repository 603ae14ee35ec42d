"""Exposures of a recording, and its image files.

Images are checked before decoding: format, size, completeness, location.
"""

import os
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from rig.array_and_json_types import Floats, Integers, Pixels
from rig.errors import FileError
from rig.formats import local_and_remote_input_files
from rig.formats.csv_and_parquet_tables_and_time_origin import Table, TimeOrigin
from rig.formats.local_and_remote_input_files import open_regular_file, read_bytes
from rig.model.design import Camera, Design

PNG, JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"
FORMATS = "PNG, JPEG, TIFF, BMP, PGM and PPM"  # whose size can be looked at before decoding
MOST_PIXELS = 1 << 27  # of an image: 134 million, more than machine cameras have
MOST_OF_A_PHOTOGRAPH = 1 << 26  # of a picture that no stated camera took: 67 million
HEAD = 4096  # bytes
SEGMENTS = 10_000  # of a JPEG before its frame, entries of a TIFF's directory
FRAME = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # markers of a JPEG that give its size
PNM = re.compile(rb"P[2356](?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})\s")


def image_file_problem(path: Path, camera: Camera | None = None) -> str | None:
    """Problem of an image file as text, or None.

    path : file; camera : the Camera that took it, whose size it must have, or None for any. A PNG must end with its end
    chunk, a JPEG with its end marker. Nothing is decoded
    """
    try:
        with open_regular_file(path, "no such image") as file:
            return problem_of_open_image_file(file, camera)
    except FileError as error:
        return str(error).split(": ", 1)[1]
    except OSError as error:
        return f"cannot be read: {error.strerror}"


def problem_of_open_image_file(
    file: BinaryIO, camera: Camera | None = None, max_pixels: int = MOST_PIXELS
) -> str | None:
    """Problem of an open image file as text, or None.

    max_pixels : px that it may have. Raises OSError where it cannot be read.
    """
    head = file.read(HEAD)
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - 64))
    tail = file.read()
    try:
        got = _size(file, head) if size else None
    except (struct.error, ValueError):
        got = None
    if not size:
        return "is an empty file"
    if head.startswith(PNG) and (b"IEND\xaeB`\x82" not in tail or size < 57):
        return f"is cut off after {size} bytes (a PNG without its end)"
    if head.startswith(JPEG) and b"\xff\xd9" not in tail:
        return f"is cut off after {size} bytes (a JPEG without its end)"
    if got is None:
        return f"contains no image of readable size; images are {FORMATS}"
    if camera is not None and got != (camera.width, camera.height):
        return f"is {got[0]} x {got[1]} px, but camera {camera.name!r} has {camera.width} x {camera.height} px"
    if not 0 < got[0] * got[1] <= max_pixels:
        return f"claims {got[0]} x {got[1]} px; an image has at most {max_pixels}"
    return None


def image_size_from_header(path: Path) -> tuple[int, int] | None:
    """Image size (width, height) px from an image file's header.

    None where it is no image.
    Raises FileError where it cannot be opened.
    """
    with open_regular_file(path, "no such image") as file:
        try:
            return _size(file, file.read(HEAD))
        except (struct.error, ValueError):
            return None


def _size(file: BinaryIO, head: bytes) -> tuple[int, int] | None:
    """(width, height) px that an image claims, or None for what is none. Raises struct.error where it is cut off."""
    if head.startswith(PNG):
        return struct.unpack(">II", head[16:24]) if head[12:16] == b"IHDR" else None
    if head.startswith(JPEG):
        return _size_of_jpeg(file)
    if head.startswith((b"II*\0", b"MM\0*")):
        return _size_of_tiff(file, "<" if head[:2] == b"II" else ">", head)
    if head.startswith(b"BM"):
        if struct.unpack("<I", head[14:18])[0] == 12:
            return struct.unpack("<HH", head[18:22])
        width, height = struct.unpack("<ii", head[18:26])
        return width, abs(height)
    found = PNM.match(head)
    return (int(found[1]), int(found[2])) if found else None


def _size_of_jpeg(file: BinaryIO) -> tuple[int, int] | None:
    at = 2
    for _ in range(SEGMENTS):
        file.seek(at)
        marker, kind, length = struct.unpack(">BBH", file.read(4))
        if marker != 0xFF:
            return None
        if kind in FRAME:
            _, height, width = struct.unpack(">BHH", file.read(5))
            return width, height
        at += 1 if kind == 0xFF else 2 if kind == 0x01 or 0xD0 <= kind <= 0xD8 else 2 + length
    return None


def _size_of_tiff(file: BinaryIO, order: str, head: bytes) -> tuple[int, int] | None:
    at, found = struct.unpack(order + "I", head[4:8])[0], {}
    file.seek(at)
    count = struct.unpack(order + "H", file.read(2))[0]
    for _ in range(min(count, SEGMENTS)):
        tag, kind, _, value = struct.unpack(order + "HHI4s", file.read(12))
        if tag in (256, 257) and kind in (3, 4):
            found[tag] = struct.unpack(order + ("H2x" if kind == 3 else "I"), value)[0]
    return (found[256], found[257]) if len(found) == 2 else None


def image_path_problem(folder: Path, name: str) -> str | None:
    """Problem of an image's path as text, or None.

    It must lie in the recording's folder.
    """
    if not name.isprintable() or len(name) > 1000:
        return "is not a file name"
    if local_and_remote_input_files.is_remote(folder):
        return (
            "lies outside the recording, whose images are in its folder"
            if ".." in Path(name).parts or name.startswith("/")
            else None
        )
    try:
        away = Path(name).is_absolute() or not (folder / name).resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError) as error:  # a ring of links
        return f"cannot be followed: {error}"
    return "lies outside the recording, whose images are in its folder" if away else None


LARGEST_IMAGE_FILE = 1 << 31  # bytes
LISTED = 20  # images that a message names


@dataclass(frozen=True, slots=True)
class UnreadableImage:
    """An image that cannot be used: of which frame and camera, its path, and why."""

    frame: int
    camera: str
    path: Path
    problem: str


def unusable_images_error(unusable: list[UnreadableImage]) -> FileError:
    """Error that names unusable images.

    LISTED of them at most.
    """
    more = [f"  {b.path}: {b.problem}" for b in unusable[1:LISTED]] + (
        [f"  and {len(unusable) - LISTED} more"] if len(unusable) > LISTED else []
    )
    first = unusable[0].problem + (
        f"; {len(unusable)} images cannot be used (--skip-unreadable excludes them):" if more else ""
    )
    return FileError(unusable[0].path, "\n".join([first, *more]))


def undecodable_image_problem(path: Path) -> str | None:
    """Problem of an undecodable image, or None."""
    try:
        read_grey_or_colour_image(path)
    except FileError as error:
        return str(error).split(": ", 1)[1]
    return None


def read_grey_or_colour_image(path: Path, max_pixels: int = MOST_PIXELS) -> Pixels:
    """Read an image as it is stored: grey (rows, columns), or colour (rows, columns, 3).

    max_pixels : px that it may have.

    Raises FileError for one that cannot be decoded
    """
    return decode_image(read_bytes(path, LARGEST_IMAGE_FILE, "no such image"), path, max_pixels)


def decode_image(data: bytes, path: Path, max_pixels: int = MOST_PIXELS) -> Pixels:
    """Decode the bytes of an image file to (rows, columns) or (rows, columns, 3).

    path : its name in errors.
    Raises FileError for one that has more than `max_pixels` or cannot be decoded
    """
    import cv2

    problem = problem_of_open_image_file(BytesIO(data), max_pixels=max_pixels)
    if problem:
        raise FileError(path, problem)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise FileError(path, f"cannot be decoded as an image: {error.err}") from None
    if image is None:
        raise FileError(path, "cannot be decoded as an image")
    return image


SIMULTANEOUS = 1e-3  # s; exposures of one frame that differ by more were not exposed together
ONE_FRAME = 0.1  # s; the same where commands state how the machine moved between them


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

    def delays(self, cameras: Sequence[str]) -> Floats:
        """(F, cameras) s by which each camera exposed a frame after the frame's time; 0 for one that did not."""
        (frames, t), column = self.times(), {name: i for i, name in enumerate(cameras)}
        out = np.zeros((len(frames), len(cameras)))
        seen = np.array([column.get(name, -1) for name in self.camera], int)
        row, known = np.searchsorted(frames, self.frame), seen >= 0
        out[row[known], seen[known]] = (self.t - t[row])[known]
        return out


def undecodable_images(folder: Path, exposures: Exposures) -> list[UnreadableImage]:
    """Images of exposures that cannot be decoded."""
    found = []
    for frame, camera, name in zip(exposures.frame.tolist(), exposures.camera, exposures.image):
        problem = undecodable_image_problem(folder / name) if name else None
        if problem:
            found.append(UnreadableImage(frame, camera, folder / name, problem))
    return found


def load_exposures_and_unreadable_images(
    folder: Path,
    design: Design,
    frames_table: Table,
    origin: TimeOrigin,
    skip_unreadable: bool = False,
    largest_time_difference: float = SIMULTANEOUS,
) -> tuple[Exposures, list[UnreadableImage]]:
    """Load (Exposures, [UnreadableImage]) of a frames.csv.

    From its rows.
    largest_time_difference : s that those of a frame may differ by
    skip_unreadable : whether images that cannot be used are left out, which takes decoding every one; else they are
        errors, all of them named in one. Raises FileError with line and column.
    """
    written = frames_table.text("t")
    frame, t, camera, image = (
        frames_table.whole("frame"),
        frames_table.times("t", origin),
        frames_table.text("camera"),
        frames_table.text("image"),
    )
    cameras = {c.name: c for c in design.cameras}
    seen: dict[Any, Any] = {}
    start: dict[Any, Any] = {}
    last = (-1, -np.inf, "")
    for i in range(len(frames_table)):
        if camera[i] and camera[i] not in cameras:
            frames_table.fail(
                f"unknown camera {camera[i]!r}; rig.toml has {', '.join(map(repr, cameras)) or 'none'}",
                i,
                "camera",
                camera[i],
            )
        if image[i] and not camera[i]:
            frames_table.fail(f"image {image[i]!r} without a camera", i, "camera")
        if (frame[i], camera[i]) in seen:
            frames_table.fail(
                f"frame {frame[i]} of camera {camera[i]!r} is listed twice, first in line {seen[frame[i], camera[i]]}",
                i,
                "frame",
            )
        seen[frame[i], camera[i]] = frames_table.lines[i]
        if frame[i] in start:
            if abs(t[i] - start[frame[i]]) > largest_time_difference:
                frames_table.fail(
                    f"frame {frame[i]} at t = {written[i]} s, but its first exposure was at "
                    f"{origin.text(start[frame[i]])} s: "
                    f"exposures of one frame are simultaneous, to {largest_time_difference:g} s",
                    i,
                    "t",
                    written[i],
                )
            continue
        if frame[i] < last[0]:
            frames_table.fail(
                f"frame {frame[i]} follows frame {last[0]}: frames must come in order", i, "frame", frame[i]
            )
        if t[i] < last[1]:
            frames_table.fail(f"time runs backwards: t = {written[i]} s follows {last[2]} s", i, "t", written[i])
        start[frame[i]], last = t[i], (frame[i], t[i], written[i])
    looked_at = (
        _unusable(folder, image[i], frame[i], cameras[camera[i]], frames_table.lines[i], skip_unreadable)
        for i in range(len(frames_table))
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
        or (undecodable_image_problem(folder / name) if decode else None)
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
