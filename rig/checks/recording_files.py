"""Checks of a recording's files without vision: all of them in order; image files, cameras, corners."""

import tomllib
from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from rig.checks import clock_mistakes, environment_values, rig_toml_values, units_and_conventions
from rig.checks.mistake_report import Mistake, sort_mistakes
from rig.formats import remote_folders
from rig.formats.input_files import read_text
from rig.formats.output_files.folder_manifest import file_digest
from rig.recording.recording_folder import Recording

OUTSIDE = 0.02  # share of corners beyond their images, from which it is no outlier's doing
STILL = 1e-6  # m or rad; commands that differ by less leave the same picture


def unused_cameras(recording: Recording) -> Iterator[Mistake]:
    """Mistakes of unused cameras: cameras of rig.toml without any frame."""
    e, c = recording.exposures, recording.corners
    for camera in recording.design.cameras:
        if camera.name not in e.camera:
            yield Mistake(
                f"rig.toml: camera {camera.name} is unused: frames.csv has no exposure of it",
                "Add its rows to frames.csv, or take the camera out of rig.toml",
                False,
                0.5,
            )
        elif c is not None and not recording.has_images and camera.name not in set(c.camera):
            yield Mistake(
                f"rig.toml: camera {camera.name} is unused: corners.csv has no corner of it",
                "Look whether its corners have another name, or take the camera out of rig.toml",
                False,
                0.5,
            )


def duplicate_images(recording: Recording) -> Iterator[Mistake]:
    """Mistakes of duplicate images: identical bytes in two frames, though the machine moved between them."""
    e, sizes = recording.exposures, defaultdict(list)
    for i, name in enumerate(e.image):
        if name:
            sizes[remote_folders.file_size(recording.folder / name)].append(i)
    alike = defaultdict(list)
    for rows in sizes.values():
        for i in rows if len(rows) > 1 else ():
            alike[file_digest(recording.folder / e.image[i])].append(i)
    twice = [rows for rows in alike.values() if len(rows) > 1 and _moved(recording, rows)]
    if twice:
        a, b = twice[0][:2]
        other = sum(len(rows) - 1 for rows in twice)
        yield Mistake(
            f"frames.csv: an image is there twice: {e.image[b]} (frame {e.frame[b]}, camera {e.camera[b]}) "
            "is the same picture as "
            f"{e.image[a]} (frame {e.frame[a]}, camera {e.camera[a]})"
            + (f", and {other - 1} more are repeated" if other > 1 else ""),
            "Give each exposure its own image; a camera that stalls repeats its last one",
            True,
            0.9,
        )


def _moved(recording: Recording, rows: list[int]) -> bool:
    """Whether exposures (rows of frames.csv) cannot show the same: of different cameras, or after a move."""
    e = recording.exposures
    if len({e.camera[i] for i in rows}) > 1 or recording.commands is None:
        return True
    q = np.stack([np.interp(e.t[rows], recording.commands.t, column) for column in recording.commands.values.T], axis=1)
    return bool(np.ptp(q, axis=0).max() > STILL)


def corners_outside_images(recording: Recording) -> Iterator[Mistake]:
    """Mistakes of corners outside their images: u and v exchanged, another image size, no pixels."""
    c = recording.corners
    if c is None or not len(c.frame):
        return
    names = np.array(c.camera)
    for camera in recording.design.cameras:
        uv, w, h = c.uv[names == camera.name], camera.width, camera.height
        if not len(uv):
            continue
        if uv.min() > -1.01 and uv.max() < 2:
            yield Mistake(
                f"corners.csv: u, v of camera {camera.name} are no pixels: all lie within {uv.min():.3g} to "
                f"{uv.max():.3g}",
                "Write pixels, not shares of the image or normalised coordinates",
                True,
                0.95,
            )
            continue
        outside = ((uv < -1) | (uv > [w, h])).any(axis=1).mean()
        if outside < OUTSIDE:
            continue
        reach = np.quantile(uv, 0.995, axis=0)
        if w != h and ((uv > [h, w]).any(axis=1) | (uv < -1).any(axis=1)).mean() < OUTSIDE < outside:
            yield Mistake(
                f"corners.csv: u and v are exchanged in camera {camera.name}, or width and height are in "
                f"rig.toml: {outside:.0%} of the "
                f"corners lie outside {w} x {h} px, none outside {h} x {w}",
                "u runs to the right along the width, v down",
                True,
                0.85,
            )
        else:
            yield Mistake(
                f"corners.csv: corners of camera {camera.name} are of another image size than {w} x {h} px: "
                f"{outside:.0%} lie outside it, "
                f"up to u = {reach[0]:.0f}, v = {reach[1]:.0f}",
                "State width, height and matrix of the images that the corners were read from",
                True,
                0.85,
            )


def recording_file_mistakes(recording: Recording) -> tuple[Mistake, ...]:
    """Mistakes in a Recording's files, sorted, found without looking at images."""
    return sort_mistakes(_all(recording))


def _all(recording: Recording) -> Iterator[Mistake]:
    r, design = recording, recording.design
    yield from rig_toml_values.overlong_rotation_vectors(tomllib.loads(read_text(r.folder / "rig.toml")))
    yield from rig_toml_values.implausible_values(design)
    yield from environment_values.environment_mistakes(design)
    times = {"frames.csv": r.exposures.times()[1]}
    if r.commands is not None:
        times["commands.csv"] = r.commands.t
        odd = list(units_and_conventions.command_unit_mistakes(r.commands, design))
        yield from odd
        if not odd:
            unit = design.mechanism.axis_unit
            yield from clock_mistakes.speed_mistakes(
                r.commands.t,
                r.commands.values,
                times["frames.csv"],
                unit,
                design.actuator.max_speed if unit == "m" else None,
            )
    if r.sensors is not None:
        times["sensors.csv"] = r.sensors.t
        yield from environment_values.sensor_mistakes(r.sensors, design)
    apart = list(clock_mistakes.time_range_mistakes(times))
    yield from apart
    if r.commands is not None and not apart:
        yield from clock_mistakes.clock_offset_mistake(times["frames.csv"], r.commands.t, r.commands.values)
    yield from clock_mistakes.repeated_time_mistakes(times["frames.csv"])
    yield from unused_cameras(r)
    yield from duplicate_images(r)
    yield from corners_outside_images(r)
