"""Exposures of a recording: loading of frames.csv, with checks of times, cameras and images."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rig.array_and_json_types import Floats, Integers
from rig.formats import local_and_remote_input_files
from rig.formats.csv_and_parquet_tables_and_time_origin import Table, TimeOrigin
from rig.model.design import Camera, Design
from rig.recording.image_file_check_and_reading import (
    UnreadableImage,
    image_file_problem,
    image_path_problem,
    undecodable_image_problem,
    unusable_images_error,
)

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


def load_exposures(
    folder: Path,
    design: Design,
    table: Table,
    origin: TimeOrigin,
    skip_unreadable: bool = False,
    apart: float = SIMULTANEOUS,
) -> tuple[Exposures, list[UnreadableImage]]:
    """Load (Exposures, [UnreadableImage]) from the rows of a frames.csv. apart : s that those of a frame may differ by
    skip_unreadable : whether images that cannot be used are left out, which takes decoding every one; else they are
        errors, all of them named in one. Raises FileError with line and column.
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
            if abs(t[i] - start[frame[i]]) > apart:
                table.fail(
                    f"frame {frame[i]} at t = {written[i]} s, but its first exposure was at "
                    f"{origin.text(start[frame[i]])} s: "
                    f"exposures of one frame are simultaneous, to {apart:g} s",
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
