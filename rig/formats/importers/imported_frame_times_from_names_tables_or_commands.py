"""Times of imported frames, from names, tables or commands.

Of image names, a table or the commands' rows; one clock with the commands.
"""

from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import numpy as np

from rig.array_and_json_types import Floats
from rig.checks.mistake_dataclass_and_clock_mistakes import clock_shift_putting_most_frames_into_dwells
from rig.errors import FileError, RigError
from rig.formats.csv_and_parquet_tables_and_time_origin import DIGITS
from rig.formats.importers import exposures_from_image_names
from rig.formats.importers.exposures_from_image_names import ImportedExposures
from rig.formats.importers.foreign_command_table import ImportedCommands
from rig.formats.importers.foreign_csv_dialect_detection import read_foreign_table_header_and_cells
from rig.formats.importers.foreign_file_import_recipe import ForeignTable, Recipe
from rig.formats.importers.foreign_table_column_search_and_completion import (
    CAMERA,
    FRAME,
    IMAGE,
    TIME,
    Cells,
    column_headers_for_import_recipe,
    column_indices_by_headers,
)
from rig.formats.importers.foreign_table_units_and_timestamps import UnclearInput
from rig.recording.exposures_and_image_files import ONE_FRAME, SIMULTANEOUS
from rig.recording.recording_folder import LAST_DWELL

LISTED = 20  # of what is missing, in a message
Like = Callable[[Floats], bool]


def exposures_with_times_and_recipe(
    exposed: ImportedExposures, commanded: ImportedCommands | None, recipe: Recipe, are_plausible: Like
) -> tuple[ImportedExposures, Recipe]:
    """Exposures with times from image names, a table of frames or commands, and the Recipe as it was resolved.

    The commands' rows are those of the frames one for one.
    are_plausible : whether times (n,) s from the first can be so. Raises RigError where nothing tells the times
    """
    if recipe.frames is not None:
        timed, recipe = _by_table(exposed, recipe, recipe.frames, are_plausible)
        return _with_times_of_one_frame(timed, commanded), recipe
    if exposed.t is not None:
        return _with_times_of_one_frame(exposed, commanded), recipe
    numbers = sorted(set(exposed.frame))
    if exposed.images.shift:
        raise RigError(
            f"--set images.shift={exposed.images.shift:g} moves times that images have none of their own: "
            "they are taken at those of the "
            "commands' rows; leave it out, or give a table of times (--frames FILE.csv)"
        )
    if commanded is None or commanded.t is None:
        raise RigError(
            "the images' names have no times, and there is no table of them: --frames FILE.csv (frame or "
            "image, t), or times in names: "
            "--set 'images.names={camera}_{time}'"
        )
    if commanded.frame is not None:
        at = dict(zip(commanded.frame.astype(int).tolist(), commanded.t))
        missing = [n for n in numbers if n not in at]
        if missing:
            raise RigError(f"{commanded.table.file}: frame {missing[0]}, of which there are images, has no row")
        message = (
            f"images belong to the rows of {commanded.table.file.name} with their number, and were taken at the "
            "rows' times"
        )
    elif len(numbers) == len(commanded.t):
        at = dict(zip(numbers, commanded.t))
        message = (
            f"the {len(numbers)} frames belong to the {len(numbers)} rows of {commanded.table.file.name}, in "
            "order, and were taken at the rows' "
            "times"
        )
    else:
        raise RigError(
            f"there are {len(numbers)} frames and {len(commanded.t)} rows of {commanded.table.file}: which "
            "belongs to which? Give a table of the frames' times: --frames FILE.csv (frame or image, t); `rig why` "
            "takes it as frames.csv beside the images"
        )
    return replace(exposed, t=[at[n] for n in exposed.frame], remarks=(*exposed.remarks, message)), recipe


def _with_times_of_one_frame(exposed: ImportedExposures, commanded: ImportedCommands | None) -> ImportedExposures:
    """The exposures with each camera's own times where a recording takes these; else with the middle of a frame's.

    A recording takes them up to ONE_FRAME apart where commands state how the machine moved, else to SIMULTANEOUS.
    """
    own: dict[int, list[Decimal]] = {}
    for frame, t in zip(exposed.frame, exposed.times()):
        own.setdefault(frame, []).append(t)
    widest = max(float(max(times) - min(times)) for times in own.values())
    if not widest:
        return exposed
    most = ONE_FRAME if commanded is not None else SIMULTANEOUS
    if widest <= most:
        remark = f"each camera's own times are kept: those of a frame differ by up to {widest * 1e3:.3g} ms"
        return replace(exposed, remarks=(*exposed.remarks, remark))
    middle = {frame: min(times) + (max(times) - min(times)) / 2 for frame, times in own.items()}
    reason = "more than a frame's may" if commanded is not None else "and no commands state how the machine moved"
    remark = f"times of a frame differ by up to {widest * 1e3:.3g} ms, {reason}: each frame is at the middle of them"
    return replace(exposed, t=[middle[frame] for frame in exposed.frame], remarks=(*exposed.remarks, remark))


def _by_table(
    exposed: ImportedExposures, recipe: Recipe, table: ForeignTable, like: Like
) -> tuple[ImportedExposures, Recipe]:
    """The exposures with the times that a table gives frames or images."""
    cells = read_foreign_table_header_and_cells(table, "frames")
    found = column_indices_by_headers(cells, "frames", {**TIME, **FRAME, **IMAGE, **CAMERA}, ("t",))
    if "frame" not in found and "image" not in found:
        found |= column_indices_by_headers(cells, "frames", IMAGE, ("image",))
    if "image" not in found and any(
        Path(cell).suffix.lower() in exposures_from_image_names.KINDS for cell in cells.column(found["frame"])
    ):
        found["image"] = found.pop("frame")  # a column such as Bild may number images or name their files
    of_images = recipe.images
    if table.shift and of_images is not None and of_images.shift:
        raise RigError(
            f"--set frames.shift={table.shift:g} and images.shift={of_images.shift:g} both move the times of "
            f"{table.file.name}; state one"
        )
    zone = table.zone or (of_images.zone if of_images is not None else None)
    shift = table.shift or (of_images.shift if of_images is not None else 0.0)
    t = cells.times(found["t"], "frames", replace(table, zone=zone, shift=shift), like)
    resolved = replace(
        cells.table, columns=column_headers_for_import_recipe(table, cells, found), time_unit=t.unit, zone=t.zone
    )
    if "image" in found:
        at, keys = _times_of_image_names(cells, found, t.seconds, exposed)
        gone = [name for name in at if name not in set(keys)]
    else:
        ours = {theirs.lower(): name for theirs, name in exposed.images.cameras}
        cameras = (
            [ours.get(word.lower(), word) for word in cells.column(found["camera"])] if "camera" in found else None
        )
        keys = [f"{n}{'' if cameras is None else f' of {c}'}" for n, c in zip(exposed.frame, exposed.camera)]
        at = {}
        for k, (line, number, seconds) in enumerate(zip(cells.lines, cells.whole_numbers(found["frame"]), t.seconds)):
            key = f"{number}{'' if cameras is None else f' of {cameras[k]}'}"
            if at.setdefault(key, seconds) != seconds:
                message = f"frame {key} has the time {seconds:f} s here, and {at[key]:f} s in a line above"
                raise FileError(cells.path, f"{message}; correct one of them", line)
        gone = []
    missing = [str(path) for path, key in zip(exposed.path, keys) if key not in at]
    if missing:
        raise RigError(
            f"{cells.path}: {missing[0]} has no row"
            + (f", nor have {len(missing) - 1} more" if len(missing) > 1 else "")
        )
    absent = (
        (f"{table.file.name} names images that are not there, {len(gone)} of {len(at)}: {', '.join(gone[:LISTED])}",)
        if gone
        else ()
    )
    lines = (*exposed.remarks, *cells.remarks, *t.remarks, *absent)
    return replace(exposed, t=[at[key] for key in keys], remarks=lines), replace(recipe, frames=resolved)


def _times_of_image_names(
    cells: Cells, found: dict[str, int], seconds: list[Decimal], exposed: ImportedExposures
) -> tuple[dict[str, Decimal], list[str]]:
    """({name: exact s} of a table, the name of each exposure). A name without folder is of that image of every camera,
    or of the camera that a column names.

    Raises FileError where one name has two times
    """
    images = [Path(cell) for cell in cells.column(found["image"])]
    ours = {theirs.lower(): name for theirs, name in exposed.images.cameras}
    if "camera" in found:
        cameras = [ours.get(word.lower(), word) for word in cells.column(found["camera"])]
        names = [f"{camera}/{path.name}" for camera, path in zip(cameras, images)]
        keys = [f"{camera}/{path.name}" for camera, path in zip(exposed.camera, exposed.path)]
    else:
        unique = len({path.name for path in exposed.path}) == len(exposed.path)
        parts = 1 if unique or all(len(path.parts) == 1 for path in images) else 2  # that tell images apart
        names = ["/".join(path.parts[-parts:]) for path in images]
        keys = ["/".join(path.parts[-parts:]) for path in exposed.path]
    at: dict[str, Decimal] = {}
    for name, s, line in zip(names, seconds, cells.lines):
        if at.setdefault(name, s) != s:
            raise FileError(
                cells.path,
                f"{name} has two times; a column camera, or its folder before its name, separates them",
                line,
            )
    return at, keys


def require_exposures_and_commands_on_one_clock(
    exposures: ImportedExposures, commands: ImportedCommands | None
) -> None:
    """Raise RigError unless exposures and commands are on one clock."""
    if commands is None or commands.t is None:
        return
    t = sorted(set(exposures.times()))
    section = "images" if any(exposures.camera) else "poses"
    first, last = commands.t[0], commands.t[-1]
    after = sum(s > last for s in t)
    if t[0] >= first and (after <= 1 or after <= LAST_DWELL * len(t)):
        return
    clash = (
        f"frames and commands are on different clocks: frames run from {t[0]:f} to {t[-1]:f} s, commands from "
        f"{first:f} to {last:f} s"
    )
    standing = clock_shift_putting_most_frames_into_dwells(
        seconds_since_origin(t, first), seconds_since_origin(commands.t, first), commands.values, need_distinct=False
    )
    if standing is not None:
        raise UnclearInput(
            f"{clash}; --set {section}.shift={standing.shift:.3f} is what puts {standing.frames} of {len(t)} "
            "frames where the commands "
            f"stand still, the middle of what does, +-{standing.room:.2g} s (any other shift at most {standing.fewer})",
            (f"{section}.shift={standing.shift:.3f}",),
            True,
        )
    by = first - t[0]
    raise RigError(
        f"{clash}; state the unit or what is to be added: --set {section}.shift={by:.6f} brings the first "
        "frame to the first command"
        "; --set commands.shift=S moves the commands"
    )


def seconds_since_origin(t: list[Decimal], origin: Decimal) -> Floats:
    """Seconds (n,) of times since an origin."""
    return np.array([float(DIGITS.subtract(one, origin)) for one in t])
