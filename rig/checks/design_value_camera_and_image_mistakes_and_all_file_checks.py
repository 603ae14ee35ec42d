"""Implausible design values, camera and image mistakes, and all checks of files.

Values of rig.toml; unused cameras, duplicate images, corners outside images.
"""

import tomllib
from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from rig.array_and_json_types import Json
from rig.checks import mistake_dataclass_and_clock_mistakes, unit_and_convention_mistakes
from rig.checks.mistake_dataclass_and_clock_mistakes import Mistake, sort_mistakes
from rig.formats import local_and_remote_input_files
from rig.formats.local_and_remote_input_files import read_text
from rig.formats.numbers_and_units import stated_units
from rig.formats.output_files.staged_folder_and_manifest import file_sha256_or_empty
from rig.model.design import Camera, Design
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms.mechanism_kinds_and_kinematics import has_links
from rig.recording.recording_folder import Recording

TURN = 2.2 * np.pi  # rad; nobody writes a rotation vector that is longer
WIDE = (0.15, 20.0)  # focal length in image widths that lenses have
SQUARE = 0.15  # share by which pixels may differ from square
CENTRE = 0.2  # share of the image by which the principal point may be off its middle
SLIP = 0.06  # likewise, where exchanging cx and cy brings it to the middle
MIDDLE = 0.03  # likewise, of one that is in the middle
TANGENTIAL = 0.03


def implausible_design_value_mistakes(design: Design) -> Iterator[Mistake]:
    """Mistakes of implausible values in a Design.

    Camera matrices, lenses, an arm's rows and limits.
    """
    if has_links(design.mechanism):
        yield from _arm(design.mechanism)
    for camera in design.cameras:
        yield from _matrix(camera)
        yield from _lens(camera)


def overlong_rotation_vector_mistakes(rig_toml_tree: Json) -> Iterator[Mistake]:
    """Mistakes of overlong rotation vectors in the tree of a rig.toml.

    Beyond one turn, so in degrees.
    None where it states the unit of angles.
    """
    if stated_units(rig_toml_tree).angle != "rad":
        return
    found = []
    for kind in ("camera", "target"):
        for entry in rig_toml_tree.get(kind, []):
            for part in [entry, *(entry["marker"] if isinstance(entry.get("marker"), list) else [])]:
                rotvec = part.get("pose", {}).get("rotvec")
                if rotvec is not None and np.linalg.norm(rotvec) > TURN:
                    found.append((f"{kind} {entry.get('name')}", float(np.linalg.norm(rotvec))))
    home = rig_toml_tree.get("mechanism", {}).get("home", {}).get("rotvec")
    if home is not None and np.linalg.norm(home) > TURN:
        found.append(("mechanism.home", float(np.linalg.norm(home))))
    if found:
        name, length = found[0]
        others = f", and of {len(found) - 1} more" if len(found) > 1 else ""
        yield Mistake(
            f"rig.toml: rotations are in degrees: rotvec of {name} is {length:.4g} long{others}",
            "State every rotvec in radians: axis times angle",
            True,
            0.9,
        )


def _matrix(camera: Camera) -> Iterator[Mistake]:
    (fx, _, cx), (_, fy, cy), _ = camera.matrix
    w, h, name = camera.width, camera.height, f"rig.toml: camera {camera.name}"
    aside = abs(cx / w - 0.5), abs(cy / h - 0.5)
    off, turned = max(aside), max(abs(cy / w - 0.5), abs(cx / h - 0.5))
    if min(aside) < MIDDLE and off > SLIP and abs(np.log(fx / fy)) <= SQUARE:
        which, other = (
            ("width", f"{2 * cx + 1:.0f} x {h}") if aside[0] > MIDDLE else ("height", f"{w} x {2 * cy + 1:.0f}")
        )
        yield Mistake(
            f"{name}: {which} is of another image size than the matrix: the principal point ({cx:g}, {cy:g}) "
            f"is the middle of {other} px, "
            f"not of {w} x {h}",
            "State width, height and matrix of the same images; images cropped to one side are correct",
            False,
            0.85,
        )
        return
    if off <= CENTRE and not (off > SLIP and turned < off / 4) and abs(np.log(fx / fy)) <= SQUARE:
        if not WIDE[0] < fx / w < WIDE[1]:
            yield Mistake(
                f"{name}: a focal length of {fx:g} px is implausible for an image of {w} px (in millimetres, "
                "or another image's?)",
                "State the matrix in pixels of the images that are used",
                True,
                0.8,
            )
        return
    if turned < min(off, 0.1) and w != h:
        exchanged = "cx and cy are exchanged" if abs(np.log(fx / fy)) <= SQUARE else "width and height are exchanged"
        yield Mistake(
            f"{name}: {exchanged}, or width and height are: the principal point ({cx:g}, {cy:g}) lies far "
            "from the middle of "
            f"{w} x {h} px",
            "Write matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] and width, height of its images",
            True,
            0.85,
        )
    elif max(abs(fx / w - 0.5), abs(fy / h - 0.5)) < 0.1 and off > CENTRE:
        yield Mistake(
            f"{name}: fx, fy and cx, cy are exchanged: ({fx:g}, {fy:g}) is the middle of the image, ({cx:g}, "
            f"{cy:g}) is not",
            "Write matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]",
            True,
            0.9,
        )
    elif abs(cx / w / (cy / h) - 1) < 0.2:
        yield Mistake(
            f"{name}: width and height are of another image size than the matrix: the principal point "
            f"({cx:g}, {cy:g}) is {cx / w * 2:.3g} "
            f"times as far out as the middle of {w} x {h} px",
            "Scale the matrix with the images, or state the images' width and height",
            True,
            0.85,
        )
    else:
        yield Mistake(
            f"{name}: the matrix is in another order: f ({fx:g}, {fy:g}), principal point ({cx:g}, {cy:g}) "
            f"of {w} x {h} px",
            "Write matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]",
            True,
            0.8,
        )


def _lens(camera: Camera) -> Iterator[Mistake]:
    d = camera.distortion
    if np.abs(d[2:4]).max() > TANGENTIAL:
        yield Mistake(
            f"rig.toml: camera {camera.name}: distortion is in another order: p1, p2 (the third and fourth) "
            f"are ({d[2]:g}, {d[3]:g}), and "
            "no lens has such",
            "Write k1, k2, p1, p2, k3 (OpenCV's order; others put k3 before p1)",
            True,
            0.7,
        )


def _arm(arm: Arm) -> Iterator[Mistake]:
    rows = arm.rows
    if np.abs(rows[:, [0, 3]]).max() > TURN:
        yield Mistake(
            "rig.toml: angles of mechanism.joints are in degrees: theta or alpha is "
            f"{np.abs(rows[:, [0, 3]]).max():.4g}",
            "State theta and alpha in radians",
            True,
            0.95,
        )
    widest = np.abs(arm.limits[~arm.slides]).max(initial=0.0)
    if widest > 12 * np.pi:
        yield Mistake(f"rig.toml: mechanism.limits are in degrees: {widest:.4g}", "State limits in radians", False, 0.9)


OUTSIDE = 0.02  # share of corners beyond their images, from which it is no outlier's doing
STILL = 1e-6  # m or rad; commands that differ by less leave the same picture


def unused_camera_mistakes(recording: Recording) -> Iterator[Mistake]:
    """Mistakes: cameras of rig.toml without any frame or corner in the recording."""
    e, c = recording.exposures, recording.corners
    for camera in recording.design.cameras:
        if camera.name not in e.camera:
            yield Mistake(
                f"rig.toml: camera {camera.name} is unused: frames.csv has no exposure of it",
                "Add its rows to frames.csv, or remove the camera from rig.toml",
                False,
                0.5,
            )
        elif c is not None and not recording.has_images and camera.name not in set(c.camera):
            yield Mistake(
                f"rig.toml: camera {camera.name} is unused: corners.csv has no corner of it",
                "Check whether its corners have another name, or remove the camera from rig.toml",
                False,
                0.5,
            )


def duplicate_image_mistakes(recording: Recording) -> Iterator[Mistake]:
    """Mistakes of duplicate images.

    Identical bytes in two frames, though the machine moved between them.
    """
    e, sizes = recording.exposures, defaultdict(list)
    for i, name in enumerate(e.image):
        if name:
            sizes[local_and_remote_input_files.file_size(recording.folder / name)].append(i)
    alike = defaultdict(list)
    for rows in sizes.values():
        for i in rows if len(rows) > 1 else ():
            alike[file_sha256_or_empty(recording.folder / e.image[i])].append(i)
    twice = [rows for rows in alike.values() if len(rows) > 1 and _moved(recording, rows)]
    if twice:
        a, b = twice[0][:2]
        other = sum(len(rows) - 1 for rows in twice)
        yield Mistake(
            f"frames.csv: an image occurs twice: {e.image[b]} (frame {e.frame[b]}, camera {e.camera[b]}) "
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


def corner_outside_image_mistakes(recording: Recording) -> Iterator[Mistake]:
    """Mistakes of corners outside their images.

    The two coordinates u and v exchanged, another image size, no pixels.
    """
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


def mistakes_found_without_looking_at_images(recording: Recording) -> tuple[Mistake, ...]:
    """Mistakes in a Recording's files, sorted, found without looking at images."""
    return sort_mistakes(_all(recording))


def _all(recording: Recording) -> Iterator[Mistake]:
    r, design = recording, recording.design
    yield from overlong_rotation_vector_mistakes(tomllib.loads(read_text(r.folder / "rig.toml")))
    yield from implausible_design_value_mistakes(design)
    yield from unit_and_convention_mistakes.gravity_and_platform_mass_mistakes(design)
    times = {"frames.csv": r.exposures.times()[1]}
    if r.commands is not None:
        times["commands.csv"] = r.commands.t
        odd = list(unit_and_convention_mistakes.command_unit_mistakes(r.commands, design))
        yield from odd
        if not odd:
            unit = design.mechanism.axis_unit
            yield from mistake_dataclass_and_clock_mistakes.implausible_axis_speed_and_frame_rate_mistakes(
                r.commands.t,
                r.commands.values,
                times["frames.csv"],
                unit,
                design.actuator.max_speed if unit == "m" else None,
            )
    if r.sensors is not None:
        times["sensors.csv"] = r.sensors.t
        yield from unit_and_convention_mistakes.sensor_channel_unit_and_name_mistakes(r.sensors, design)
    apart = list(mistake_dataclass_and_clock_mistakes.time_unit_and_clock_origin_mistakes(times))
    yield from apart
    if r.commands is not None and not apart:
        yield from mistake_dataclass_and_clock_mistakes.clock_offset_mistakes_of_frames_in_motion(
            times["frames.csv"], r.commands.t, r.commands.values
        )
    yield from mistake_dataclass_and_clock_mistakes.repeated_time_mistakes(times["frames.csv"])
    yield from unused_camera_mistakes(r)
    yield from duplicate_image_mistakes(r)
    yield from corner_outside_image_mistakes(r)
