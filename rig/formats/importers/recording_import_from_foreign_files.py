"""Import of a recording from foreign files, those of a recipe, assembled and written as one."""

import shlex
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np

from rig.array_and_json_types import Floats, Integers
from rig.errors import FileError, RigError
from rig.formats.csv_and_parquet_tables_and_time_origin import DIGITS
from rig.formats.importers import exposures_from_image_names
from rig.formats.importers.camera_calibrations import rig_toml_with_cameras
from rig.formats.importers.commands_held_at_poses import commands_held_at_poses
from rig.formats.importers.exposures_from_image_names import ImportedExposures
from rig.formats.importers.foreign_command_table import ImportedCommands, read_commands
from rig.formats.importers.foreign_file_import_recipe import Images, Recipe, recipe_with_settings
from rig.formats.importers.foreign_pose_table import ImportedPoses, read_poses
from rig.formats.importers.foreign_sensor_table import ImportedSensors
from rig.formats.importers.foreign_table_units_and_timestamps import UnclearInput
from rig.formats.importers.imported_frame_times_from_names_tables_or_commands import (
    LISTED,
    Like,
    exposures_with_times_and_recipe,
    require_exposures_and_commands_on_one_clock,
    seconds_since_origin,
)
from rig.formats.importers.sensor_columns_of_command_and_pose_tables import sensors_and_unread_columns
from rig.formats.json_toml_and_yaml_loading import toml_entries
from rig.formats.local_and_remote_input_files import read_bytes, read_text
from rig.formats.output_files import write_bytes
from rig.formats.rig_toml import design_from_rig_toml
from rig.formats.rig_toml.mechanism_entries import write_kinematics_file
from rig.model.design import Design
from rig.recording.corner_and_pose_csv_tables import Poses, write_instrument_poses, write_table
from rig.recording.exposures_and_image_files import image_file_problem

LARGEST_IMAGE_FILE = 1 << 31  # bytes
SAME_MOMENT = 0.05  # s that a pose may be from its frame
NO_ROTATIONS = "rotation_sigma is left out of the recording's rig.toml, as no rotations were measured"
HANDS_OR_FINER_TIMES = (
    "Where a column says of which of an arm's reflectors or hands each is, state these in rig.toml as "
    "[[mechanism.hand]] (docs/several-hands.md) and --set poses.columns.hand=HEADER; else write times with "
    "milliseconds at least"
)
SPANS = (0.02, 50.0)  # of another file's span, that a file's may have


@dataclass(frozen=True, slots=True, eq=False)
class ImportedRecording:
    """exposed : with times; commanded, logged : or None; posed : or None, with frames; recipe : with all
    that was found out.
    """

    design: Design
    exposed: ImportedExposures
    commanded: ImportedCommands | None
    posed: ImportedPoses | None
    logged: ImportedSensors | None
    recipe: Recipe
    remarks: tuple[str, ...]
    rig: str | None = None  # rig.toml with other cameras or another instrument; None: as its owner has it


def design_with_imported_cameras(recipe: Recipe) -> tuple[Design, str | None, tuple[str, ...]]:
    """Design with the imported cameras of a recipe.

    Returns (Design, its rig.toml text, sentences)
    Raises RigError for what cannot be used.
    """
    design = design_from_rig_toml.load_design(recipe.rig)
    if recipe.cameras is None:
        return design, None, ()
    text, lines = rig_toml_with_cameras(
        recipe.cameras, read_text(recipe.rig, design_from_rig_toml.LARGEST), design.cameras
    )
    return design_from_rig_toml.design_of_entries(toml_entries(text, recipe.rig)), text, lines


def unpack_recipe_bags(recipe: Recipe, folder: Path) -> Recipe:
    """Unpack the bags of a recipe into a folder.

    Returns the Recipe of the unpacked files
    Raises RigError.
    """
    if recipe.bag is None:
        return recipe
    from rig.formats.importers import ros_bags_to_image_and_table_files

    return ros_bags_to_image_and_table_files.unpack_bags(recipe, design_with_imported_cameras(recipe)[0], folder)


def assemble_recording(recipe: Recipe, skip_unreadable: bool = False) -> ImportedRecording:
    """Assemble an ImportedRecording from a Recipe.

    Unreadable images are skipped if requested.
    skip_unreadable : whether images that cannot be used are left out, and said

    Raises RigError for what cannot be used, for what is missing and for what reads well in two ways. What one error
    leaves open is supposed, to find those behind it, and all are raised together.
    """
    problems: list[str] = []
    supposed: list[str] = []
    is_decided = True
    while is_decided:
        try:
            imported = _assembled(recipe_with_settings(recipe, supposed), skip_unreadable)
        except UnclearInput as error:
            is_decided = error.is_decided and bool(set(error.settings) - set(supposed))
            problems.append(str(error))
            supposed += error.settings
        except RigError as error:
            if not problems:
                raise
            is_decided = False
            problems.append(str(error))
        else:
            break
    if not problems:
        return imported
    if supposed:
        every = "these options state it all" if is_decided else "these options state it; the rest is named above"
        options = " ".join(f"--set {shlex.quote(one)}" for one in supposed)
        problems.append(f"look at what is likely here; if it is right, {every}:\n  {options}")
    raise RigError("\n".join(problems))


def _assembled(recipe: Recipe, skip_unreadable: bool) -> ImportedRecording:
    """The same, up to the first error."""
    design, rig, of_cameras = design_with_imported_cameras(recipe)
    if recipe.bag is not None:
        of_cameras = (*of_cameras, *recipe.bag.remarks)
    if recipe.images is None and recipe.poses is None:
        raise RigError("there are no observations: give folders of images, or --poses FILE.csv")
    commanded = read_commands(recipe.commands, design) if recipe.commands else None
    like = _like(commanded.t if commanded else None)
    exposed = (
        exposures_from_image_names.group_images_into_exposures(
            exposures_from_image_names.list_image_files(recipe.images, design), recipe.images, like
        )
        if recipe.images
        else None
    )
    if exposed is not None:
        exposed, recipe = exposures_with_times_and_recipe(exposed, commanded, recipe, like)
        exposed = _usable(exposed, design, skip_unreadable)
    posed = None
    if recipe.poses is not None:
        of_commands: list[str] = []
        if commanded is not None and commanded.table.file == recipe.poses.file:
            of_commands = [header for name, header in commanded.table.columns if name in design.mechanism.axes]
        posed = read_poses(recipe.poses, design, partial(_commanded, exposed, commanded), like, of_commands)
        exposed, posed = _placed_by_hand(exposed, posed, commanded)
    if exposed is None:
        raise RigError("there are no observations")
    _refuse_unused_options(recipe, skip_unreadable)
    if posed is not None and posed.alone and design.instrument is not None and design.instrument.rotation_sigma:
        rig, of_cameras = _without_rotation_sigma(recipe, rig), (*of_cameras, NO_ROTATIONS)
    commanded = _clocked(exposed, commanded)
    at = dict(zip(exposed.frame, exposed.times()))
    logged, unread = sensors_and_unread_columns(recipe, at, commanded, posed, design.mechanism, _like(exposed.t))
    commanded = commands_held_at_poses(exposed, commanded)
    require_exposures_and_commands_on_one_clock(exposed, commanded)
    recipe = replace(
        recipe,
        images=exposed.images if recipe.images else None,
        commands=commanded.table if commanded else None,
        poses=posed.table if posed else None,
        sensors=logged.table if logged else None,
    )
    lines = (
        *of_cameras,
        *dict.fromkeys(line for part in (commanded, exposed, posed, logged) if part for line in part.remarks),
        *unread,
    )
    return ImportedRecording(design, exposed, commanded, posed, logged, replace(recipe, remarks=lines), lines, rig)


def _without_rotation_sigma(recipe: Recipe, text: str | None) -> str:
    """rig.toml of a recording whose instrument measured positions alone. text : with other cameras, or None"""
    import tomlkit

    document = tomlkit.parse(read_text(recipe.rig, design_from_rig_toml.LARGEST) if text is None else text)
    cast(dict[str, object], document["instrument"]).pop("rotation_sigma")
    return tomlkit.dumps(document)


def _refuse_unused_options(recipe: Recipe, skip_unreadable: bool) -> None:
    """Raise RigError for options that nothing here uses."""
    unused = []
    if recipe.images is None and recipe.frames is not None:
        unused.append("--frames states times of images, and there are none")
    if recipe.images is None and skip_unreadable:
        unused.append("--skip-unreadable excludes images, and there are none")
    c = recipe.commands
    if c is not None and c.steps_per_mm is not None and c.unit not in (None, "steps"):
        unused.append(f"commands.steps_per_mm is of lengths in steps, and they are in {c.unit}")
    for name in ("poses", "sensors", "frames"):
        table = getattr(recipe, name)
        if table is not None and table.rows is not None:
            unused.append(f"{name}.rows={table.rows} states what rows are, and only commands.rows does")
    if unused:
        raise RigError("\n".join(f"{one}; leave it out" for one in unused))


def _like(others: list[Decimal] | None) -> Like:
    """Whether times (n,) s from the first can be of the same recording as others, by how long they last."""
    span = 0.0 if others is None else float(max(others) - min(others))
    return lambda t: not span or SPANS[0] <= abs(t[-1] - t[0]) / span <= SPANS[1]


def _usable(exposed: ImportedExposures, design: Design, skip: bool) -> ImportedExposures:
    """The exposures without images that cannot be used. Raises RigError that names all of these where they are not to
    be skipped, or are all.
    """
    problems = [image_file_problem(path, design.camera(name)) for path, name in zip(exposed.path, exposed.camera)]
    bad = [f"{path}: {problem}" for path, problem in zip(exposed.path, problems) if problem]
    if bad and (not skip or len(bad) == len(problems)):
        more = f"; {len(bad)} images cannot be used" if len(bad) > 1 else ""
        more += "" if skip else " (--skip-unreadable excludes them)"
        raise RigError("\n".join([bad[0] + more, *(f"  {line}" for line in bad[1:LISTED])]))
    keep = [k for k, problem in enumerate(problems) if not problem]
    t = exposed.times()
    return replace(
        exposed,
        frame=[exposed.frame[k] for k in keep],
        t=[t[k] for k in keep],
        camera=[exposed.camera[k] for k in keep],
        path=[exposed.path[k] for k in keep],
        remarks=(*exposed.remarks, *(f"left out: {line}" for line in bad)),
    )


def _commanded(
    exposed: ImportedExposures | None,
    commanded: ImportedCommands | None,
    t: list[Decimal] | None,
    frame: Integers | None,
    n: int,
) -> Floats | None:
    """(n, axes) commanded at n poses: at their times, at those of their frames, or row for row; None where none of
    these tells.
    """
    if commanded is None:
        return None
    known = {} if exposed is None else dict(zip(exposed.frame, exposed.times()))
    if t is None and frame is not None and set(frame.tolist()) <= set(known):
        t = [known[int(number)] for number in frame]
    if t is None and len(known) == n:
        t = list(known.values())
    if t is None or commanded.t is None:
        return commanded.values if len(commanded.values) == n else None
    if min(t) < commanded.t[0] or max(t) > commanded.t[-1] + (commanded.t[-1] - commanded.t[0]) / 2:
        return None
    at, rows = (seconds_since_origin(times_of, commanded.t[0]) for times_of in (t, commanded.t))
    return np.stack([np.interp(at, rows, column) for column in commanded.values.T], axis=1)


def _placed_by_hand(
    exposed: ImportedExposures | None, posed: ImportedPoses, commanded: ImportedCommands | None
) -> tuple[ImportedExposures, ImportedPoses]:
    """Poses assigned to frames as `_placed`; of several hands, rows of one frame or time are one frame."""
    if posed.hand is None:
        return _placed(exposed, posed, commanded)
    keys = posed.t if posed.frame is None else posed.frame.tolist()
    if keys is None:
        raise RigError(f"{posed.table.file}: poses of several hands belong to frames by a column frame or t; add one")
    first: dict[object, int] = {}
    back = [first.setdefault(key, len(first)) for key in keys]
    rows = [back.index(number) for number in range(len(first))]
    posed.require_distinct(list(zip(keys, posed.hand.tolist())), "repeat a hand of a frame", "Remove one of them")
    once = posed.rows(rows)
    exposed, placed = _placed(exposed, once, commanded)
    assert placed.frame is not None
    return exposed, replace(posed, frame=placed.frame[back], remarks=placed.remarks)


def _placed(
    exposed: ImportedExposures | None, posed: ImportedPoses, commanded: ImportedCommands | None
) -> tuple[ImportedExposures, ImportedPoses]:
    """Poses assigned to frames: by number, by time, or row for row; without images each pose is a frame."""
    n = len(posed.T)
    if exposed is None:
        t = posed.t or (
            commanded.t if commanded is not None and commanded.t is not None and len(commanded.t) == n else None
        )
        lines = (
            posed.remarks
            if posed.t
            else (*posed.remarks, f"the {n} poses belong to the {n} rows of commands, in order")
        )
        if t is None and commanded is not None and commanded.t is None and len(commanded.values) == n:
            t = [Decimal(k) for k in range(n)]
            lines = (
                *lines,
                "no times are stated, so a row is assumed to be a second: nothing that depends on time can be "
                "determined from this",
            )
        if t is None:
            raise RigError(f"{posed.table.file}: the poses have no times, and the number of commands differs")
        numbers = list(range(n)) if posed.frame is None else posed.frame.astype(int).tolist()
        if posed.frame is None:
            posed.require_distinct(t, "have the time of another", HANDS_OR_FINER_TIMES)
        posed.require_distinct(numbers, "have the frame of another", "Correct their frames, or remove one of them")
        order = sorted(range(n), key=lambda k: (t[k], numbers[k]))
        if [numbers[k] for k in order] != sorted(numbers):
            numbers = [
                int(r) for r in np.argsort(np.argsort(np.array([float(x - t[order[0]]) for x in t]), kind="stable"))
            ]
        empty = ImportedExposures(
            [numbers[k] for k in order], [t[k] for k in order], [""] * n, [Path()] * n, Images(()), ()
        )
        return empty, replace(posed, frame=np.array(numbers), remarks=lines)
    known = dict(zip(exposed.frame, exposed.times()))
    if posed.frame is None and posed.t is not None:
        known_frames, at = list(known), list(known.values())
        nearest = [min(range(len(at)), key=lambda k: abs(at[k] - s)) for s in posed.t]
        far = [k for k, near in enumerate(nearest) if abs(at[near] - posed.t[k]) > SAME_MOMENT]
        if far:
            k = far[0]
            off, frame = abs(at[nearest[k]] - posed.t[k]), known_frames[nearest[k]]
            message = f"{len(far)} of {n} poses are farther than {SAME_MOMENT:g} s from any frame; the first, t "
            message += f"{posed.moments[k]}, is {off:.6g} s from frame {frame}, the nearest"
            raise FileError(posed.table.file, f"{message}; --set poses.shift=S adds S to its times", posed.lines[k])
        posed = replace(posed, frame=np.array([known_frames[k] for k in nearest]))
    elif posed.frame is None:
        if n != len(known):
            raise RigError(
                f"{posed.table.file}: {n} poses and {len(known)} frames: which belongs to which? A column "
                "frame or t says so"
            )
        posed = replace(
            posed,
            frame=np.array(sorted(known)),
            remarks=(*posed.remarks, f"the {n} poses belong to the {n} frames, in order"),
        )
    return exposed, posed


def _clocked(exposed: ImportedExposures, commanded: ImportedCommands | None) -> ImportedCommands | None:
    """Commands with times: those of the frames, where they have none of their own and are as many."""
    if commanded is None or commanded.t is not None:
        return commanded
    at = dict(zip(exposed.frame, exposed.times()))
    if commanded.frame is not None and set(commanded.frame.astype(int).tolist()) <= set(at):
        return replace(commanded, t=[at[int(n)] for n in commanded.frame])
    if len(at) != len(commanded.values):
        raise RigError(
            f"{commanded.table.file} has no times, and {len(commanded.values)} rows for {len(at)} frames; "
            "state the time column with --set 'commands.columns.t=HEADER'"
        )
    return replace(
        commanded,
        t=list(at.values()),
        remarks=(*commanded.remarks, f"the rows of {commanded.table.file.name} are the frames', in order"),
    )


def write_recording(imported: ImportedRecording, folder: Path) -> None:
    """Write the imported recording into an empty folder.
    folder : empty
    """
    e = imported.exposed
    write_bytes(folder / "rig.toml", read_bytes(imported.recipe.rig) if imported.rig is None else imported.rig.encode())
    write_kinematics_file(folder, imported.design.mechanism)
    rows = []
    for frame, t, camera, path in zip(e.frame, e.times(), e.camera, e.path):
        name = f"images/{camera}/{frame:05d}{path.suffix.lower()}" if camera else ""
        if name:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            write_bytes(folder / name, read_bytes(path, LARGEST_IMAGE_FILE))
        rows.append(f"{frame},{_text(t)},{camera},{name}")
    write_table(folder / "frames.csv", ("frame", "t", "camera", "image"), rows)
    c, posed = imported.commanded, imported.posed
    if c is not None and c.t is not None:
        write_table(
            folder / "commands.csv",
            ("t", *imported.design.mechanism.axes),
            [",".join([_text(t), *(_figure(v) for v in values)]) for t, values in zip(c.t, c.values)],
        )
    if posed is not None and posed.frame is not None:
        found = Poses(posed.frame.astype(int), posed.T, None, hand=posed.hand)
        write_instrument_poses(folder / "poses.csv", found, imported.design, posed.alone)
    if imported.logged is not None:
        names, columns_of = zip(*imported.logged.channels)
        write_table(
            folder / "sensors.csv",
            ("t", *names),
            [
                ",".join([_text(t), *(_figure(v) for v in values)])
                for t, values in zip(imported.logged.t, zip(*columns_of))
            ],
        )


def _text(t: Decimal) -> str:
    return f"{DIGITS.plus(t):f}"


def _figure(value: float) -> str:
    """A number to 15 digits: what a float surely has, so that 0.4758518 stays that though it came in millimetres."""
    return repr(float(f"{value:.15g}"))
