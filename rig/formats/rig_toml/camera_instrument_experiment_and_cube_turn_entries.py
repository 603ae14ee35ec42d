"""Camera, instrument, experiment and cube turn entries of rig.toml.

Tables [[camera]], [instrument], [experiment] and [turned] (cubes), read; [[camera]] written.
"""

import math
import re
from collections.abc import Iterable
from dataclasses import fields, replace
from pathlib import PurePosixPath

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.formats.checked_toml_and_json_entries import Entries
from rig.formats.numbers_and_units import SI, LengthAndAngleUnits, stated_units
from rig.model.design import (
    DISTORTION_TERMS,
    PERMITTED,
    TURN,
    Camera,
    CaptureSettings,
    Instrument,
    Marker,
    Permission,
    Target,
)
from rig.model.design_contradictions_and_cube_quarter_turns import cube_name_or_problem, cube_turn_permission_or_problem
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism, has_links
from rig.model.pose import pose_to_vector
from rig.model.protocol_port_and_user_program_name_checks import USER_PROGRAMS, is_user_file_or_package

LARGEST_IMAGE = 100_000  # px along a side
NETWORK = ("http", "https", "rtsp")  # of cameras that a URL names
SOURCES = ("uvc", "gstreamer", "genicam", "folder", "emulator", "command", *NETWORK, *USER_PROGRAMS)  # of cameras
GENICAM = ("pixel_format", "gain", "trigger", "strobe", "ptp")  # what [camera.capture] may set of such a camera


def cameras_of_tables(tables: list[Entries]) -> tuple[Camera, ...]:
    """The Cameras of [[camera]] tables.

    Raises FileError with line and column for anything that is no camera.
    """
    found: list[Camera] = []
    for table in tables:
        table.refuse_misspelt(
            (
                "name",
                "width",
                "height",
                "matrix",
                "distortion",
                "pose",
                "shutter",
                "row_time",
                "mount",
                "source",
                "capture",
            )
        )
        name = table.identifier("name")
        if name in [camera.name for camera in found]:
            table.fail(f"camera {name!r} is listed twice", "name", value=name)
        matrix = table.array("matrix", (3, 3), unit="px")
        for (i, j), want in {(0, 1): 0, (1, 0): 0, (2, 0): 0, (2, 1): 0, (2, 2): 1}.items():
            if matrix[i, j] != want:
                table.fail(
                    f"{table.name('matrix')} must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]; "
                    f"row {i + 1}, column {j + 1} is {matrix[i, j]:g}",
                    "matrix",
                    i,
                    j,
                    value=matrix[i, j],
                )
        for i in (0, 1):
            if matrix[i, i] <= 0:
                table.fail(
                    f"{table.name('matrix')}: the focal length must be positive px, not {matrix[i, i]:g}",
                    "matrix",
                    i,
                    i,
                )
        distortion = table.array("distortion", (None,))
        if len(distortion) not in DISTORTION_TERMS:
            table.fail(
                f"{table.name('distortion')} must have {', '.join(map(str, DISTORTION_TERMS))} terms (OpenCV order), "
                f"got {len(distortion)}",
                "distortion",
            )
        shutter = table.text("shutter", ("global", "rolling"), default="global")
        row_time = table.number("row_time", None if shutter == "rolling" else 0.0, least=-1, most=1, unit="s")
        width, height = (table.whole(key, 1, most=LARGEST_IMAGE) for key in ("width", "height"))
        found.append(
            Camera(
                name,
                width,
                height,
                matrix,
                distortion,
                table.pose("pose"),
                shutter,
                row_time,
                table.text("mount", ("fixed", "moving", "hand"), default="fixed"),
                source := _source(table),
                _capture(table.table("capture", optional=True), source),
            )
        )
    return tuple(found)


def _capture(table: Entries, source: str | None) -> CaptureSettings:
    """How a run sets a camera. Raises FileError for a setting that its kind of source does not have."""
    settings = {"uvc": ("pixel_format", "gain", "focus", "white_balance"), "genicam": GENICAM}
    kind = (source or "").partition(":")[0]
    table.refuse_misspelt([field.name for field in fields(CaptureSettings)])
    for key in table.tree:
        if source is not None and key not in settings.get(kind, ()):
            table.fail(
                f"{table.name(key)}: a camera of source {kind} takes {' '.join(settings.get(kind, ('none',)))}", key
            )
    text = table.text("pixel_format", default="")
    if kind == "uvc" and text and len(text) != 4:
        table.fail(
            f"{table.name('pixel_format')} of a UVC camera is four letters, as MJPG, not {text!r}", "pixel_format"
        )
    return CaptureSettings(
        text,
        table.number("gain", None),
        table.number("focus", None, least=0),
        table.number("white_balance", None, least=1000, most=20000, unit="K"),
        table.text("trigger", default=""),
        table.text("strobe", default=""),
        table.flag("ptp", default=False),
    )


def require_supported_hand_mounted_cameras(
    root: Entries, cameras: tuple[Camera, ...], targets: tuple[Target, ...], mechanism: Mechanism
) -> None:
    """Require that hand-mounted cameras are supported.

    Raises FileError for those that these targets or this mechanism do not support
    """
    held = [camera.mount == "hand" for camera in cameras]
    for table, camera, mine in zip(root.tables("camera"), cameras, held):
        if any(held) and not mine:
            table.fail(
                f"camera {camera.name!r} is {camera.mount} and others are in the hand: a rig has all of its "
                "cameras there, or none",
                "name",
            )
        if mine and camera.shutter != "global":
            table.fail(
                f"camera {camera.name!r} is in the hand, where rows of a rolling shutter cannot be distinguished from "
                "the hand's own way",
                "shutter",
            )
        if mine and not mechanism.axes:
            table.fail(
                f'camera {camera.name!r}: a mechanism of kind "free" has no hand; a camera that is moved '
                'about is "moving"',
                "mount",
            )
    for table, target in zip(root.tables("target"), targets):
        if any(held) and target.body != "base":
            table.fail(
                f"target {target.name!r} is on the {target.body}, and the platform carries the cameras: they "
                "see the base's targets alone",
                "body",
            )


def refuse_stage_targets_of_moving_cameras(
    root: Entries, cameras: tuple[Camera, ...], targets: tuple[Target, ...]
) -> None:
    """Raise FileError for targets on a stage of a chain that a moving camera sees."""
    moving = [camera.name for camera in cameras if camera.mount == "moving"]
    for table, target in zip(root.tables("target"), targets):
        if moving and target.stage:
            table.fail(
                f"target {target.name!r} is on {target.body}, which cameras that stand still measure, and "
                f"camera {moving[0]!r} moves",
                "body",
            )


def _source(table: Entries) -> str | None:
    """What a run opens a camera by. Raises FileError for a kind that there is not."""
    source = table.text("source", default=None)
    if source is None:
        return None
    kind, _, place = source.partition(":")
    if kind not in SOURCES or not place:
        table.fail(
            f'{table.name("source")} must be written as "KIND:PLACE" with a kind out of '
            f"{', '.join(SOURCES)}, not {source!r}",
            "source",
            value=source,
        )
    return (
        user_program_with_path_beside_rig_toml(table, "source", source) if is_user_file_or_package(source) else source
    )


INSTRUMENT_KINDS = ("pose", "orientation", "distance", "direction")
ROTATIONS_ALONE = ("orientation", "direction")


def instrument_of_table(table: Entries, mechanism: Mechanism) -> Instrument:
    """Instrument of the table [instrument] that measures a mechanism.

    Raises FileError for figures that are missing, implausible or of what its kind does not see, and for a part of poses
    where whole ones are required.
    """
    table.refuse_misspelt([field.name for field in fields(Instrument)])
    kind = table.text("kind", INSTRUMENT_KINDS, default="pose")
    if kind != "pose" and not has_links(mechanism):
        table.fail(
            f"an instrument of kind {kind!r} measures arms; a mechanism of kind {mechanism.kind!r} takes "
            'whole poses (kind = "pose") or cameras',
            "kind",
            value=kind,
        )
    for key, seen in (("position_sigma", kind not in ROTATIONS_ALONE), ("rotation_sigma", kind != "distance")):
        if key in table.tree and not seen:
            table.fail(
                f"an instrument of kind {kind!r} sees no "
                f"{'positions' if key == 'position_sigma' else 'rotations'}; leave out "
                f"{table.name(key)}",
                key,
            )
    position = table.number("position_sigma", above=0, most=1, unit="m") if kind not in ROTATIONS_ALONE else math.inf
    rotation: float | None
    if kind in ROTATIONS_ALONE:
        rotation = table.number("rotation_sigma", above=0, most=1, unit="rad")
    else:
        rotation = table.number("rotation_sigma", None, above=0, most=1, unit="rad")
    return Instrument(
        table.text("base", ("free", "rig")), table.text("tool", ("free", "rig")), position, rotation, kind
    )


def experiment_permission(table: Entries, targets: tuple[Target, ...]) -> Permission:
    """Permission for experiments, of the table [experiment].

    What they may do, and to which cubes.
    Raises FileError for what is none of it.
    """
    table.refuse_misspelt(("may",))
    may = table.get("may", [])
    words = (*map(repr, PERMITTED), f"'{TURN}NAME'")
    if not isinstance(may, list) or not all(
        isinstance(word, str) and (word in PERMITTED or word.startswith(TURN)) for word in may
    ):
        table.fail(
            f"{table.name('may')} must list what experiments may do, of {', '.join(words)}, not {may!r}",
            "may",
            value=may,
        )
    out = []
    for i, word in enumerate(may):
        allowed, problem = cube_turn_permission_or_problem(word, targets)
        if problem:
            table.fail(f"{table.name('may')}[{i + 1}]: {problem}", "may", i, value=word)
        out.append(allowed)
    return Permission(tuple(out))


def targets_with_cubes_turned_by_table(table: Entries, targets: tuple[Target, ...]) -> tuple[Target, ...]:
    """The targets with the quarter turns of the table [turned] applied to their cubes.
    Raises FileError for one that there is not.
    """
    out, places = list(targets), {}
    for key in table.tree:
        name, problem = cube_name_or_problem(key, targets)
        if problem:
            table.fail(f"turned: {problem}", key, value=key)
        at = places[key] = next(k for k, target in enumerate(targets) if target.name == name)
        out[at] = replace(targets[at], turned=table.whole(key, 0, most=3))
    for key, at in places.items():
        body = targets[at].body
        if all(target.turned is not None for target in out if target.body == body):
            table.fail(
                f"turned: all targets of the {body} were removed, so that nothing defines its frame", key, value=key
            )
    return tuple(out)


def rig_toml_with_camera_values_replaced(text: str, cameras: Iterable[Camera]) -> str:
    """The rig.toml text with the matrix, distortion and pose of each camera replaced, and row times added where found.

    text : a valid rig.toml; cameras : Camera objects, matched by name. Raises KeyError for one that is not in the text.
    """
    import tomlkit

    document = tomlkit.parse(text)
    units = stated_units(document)
    tables = {table["name"]: table for table in document["camera"]}
    for camera in cameras:
        table = tables[camera.name]
        table["matrix"] = np.round(camera.matrix, 6).tolist()
        table["distortion"] = np.round(camera.distortion, 9).tolist()
        entry = tomlkit.inline_table()
        entry.update(_pose_entry(camera.pose, units))
        table["pose"] = entry
        if camera.shutter == "rolling" and camera.row_time is not None and "row_time" not in table:
            table["row_time"] = round(camera.row_time, 12)
    return tomlkit.dumps(document)


def _pose_entry(pose: RigidTransform, units: LengthAndAngleUnits) -> dict[str, list[float]]:
    """A pose as the tables of a file in these units state it."""
    position, rotvec = np.split(pose_to_vector(pose), 2)
    scaled = (position * units.per_si("m"), rotvec * units.per_si("rad"))
    return {name: np.round(one, 10).tolist() for name, one in zip(("position", "rotvec"), scaled)}


def camera_toml(camera: Camera, has_pose: bool = False, units: LengthAndAngleUnits = SI) -> str:
    """TOML text of a [[camera]] table.

    With its pose or a blank to fill in.
    has_pose : whether its pose is known; else it is a place to fill in; units : of the file that it is for
    """
    place = _pose_entry(camera.pose if has_pose else RigidTransform.identity(), units)
    remark = "" if has_pose else "   # camera in base: enter its pose"
    matrix, distortion = np.round(camera.matrix, 6).tolist(), np.round(camera.distortion, 9).tolist()
    return (
        f'[[camera]]\nname = "{camera.name}"\nwidth = {camera.width}\nheight = {camera.height}\nmatrix = {matrix}\n'
        f"distortion = {distortion}\n"
        f"pose = {{ position = {place['position']}, rotvec = {place['rotvec']} }}{remark}\n"
        'shutter = "global"\n'
    )


def rig_toml_with_target_markers_replaced(text: str, markers: dict[str, tuple[Marker, ...]]) -> str:
    """The rig.toml text with the markers of each target replaced.

    Cubes and boards become lists of markers.
    text : a valid rig.toml; markers : {target name: (Marker, ...)}
    A marker that is not among them and whose pose is not stated remains so.
    """
    import tomlkit

    document = tomlkit.parse(text)
    units = stated_units(document)
    for table in (table for table in document["target"] if table["name"] in markers):
        found = {marker.id for marker in markers[table["name"]]}
        listed = table["marker"] if isinstance(table.get("marker"), list) else []
        unplaced = [row for row in listed if "pose" not in row and row["id"] not in found]
        if "board" in table:
            table["dictionary"] = str(table["board"]).rpartition(":")[2]
        for key in ("edge", "marker", "faces", "pose", "board", "first", "legacy"):
            table.pop(key, None)
        rows = tomlkit.aot()
        for marker in markers[table["name"]]:
            row, entry = tomlkit.table(), tomlkit.inline_table()
            entry.update(_pose_entry(marker.T_body_marker, units))
            row.update(
                {
                    "id": int(marker.id),
                    "side": float(np.round(marker.side * units.per_si("m"), 12)),
                    "margin": float(np.round(marker.margin * units.per_si("m"), 9)),
                    "pose": entry,
                }
            )
            rows.append(row)
        for row in unplaced:
            rows.append(row)
        table["marker"] = rows
    return tomlkit.dumps(document)


ENTRY_POINT = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}")  # of a package's entry point


def user_program_with_path_beside_rig_toml(table: Entries, key: str, file_or_package: str) -> str:
    """User's program that an entry of rig.toml names, its path joined to the folder of rig.toml.

    A file_or_package "file:PATH" with PATH joined to the folder of rig.toml, or "package:NAME" as it is.
    Raises FileError.
    """
    kind, _, place = file_or_package.partition(":")
    if kind == "package":
        if not ENTRY_POINT.fullmatch(place):
            table.fail(f"{table.name(key)}: expected package:NAME, an entry point's name, not {file_or_package!r}", key)
        return file_or_package
    path = PurePosixPath(place)
    if path.is_absolute() or path.suffix != ".py" or not place.isprintable():
        table.fail(
            f"{table.name(key)}: expected file:NAME.py, a path relative to this file's folder, not {file_or_package!r}",
            key,
            value=file_or_package,
        )
    return f"{kind}:{table.file.parent / path}"
