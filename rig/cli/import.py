"""rig import: import foreign files as a recording.

Images, tables and camera files; the recipe of the import is written.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from rig.array_and_json_types import Json
from rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion import parse_tolerance
from rig.cli.shared.shared_output_controller_hand_and_worker_options import add_json_result_option, add_overwrite_option
from rig.errors import RigError
from rig.formats.numbers_and_units import count_text

if TYPE_CHECKING:
    from rig.formats.importers import ImportedRecording, Recipe

TABLES = {
    "commands": "table of the commands: time, lengths or angles; CSV, Parquet, YAML or MATLAB's .mat",
    "poses": "table of measured poses; a pose may be one cell, as [x, y, z, rx, ry, rz] or a 4x4 matrix",
    "sensors": "log of sensors",
    "frames": "table of the images' times: frame or image, time",
}


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `rig import` to a parser."""
    parser.add_argument(
        "images",
        metavar="IMAGES",
        type=Path,
        nargs="*",
        help="folders of images: a folder per camera, or the camera in the names",
    )
    parser.add_argument("--rig", metavar="rig.toml", type=Path, help="the rig as assumed")
    for name, text in TABLES.items():
        parser.add_argument(f"--{name}", metavar="FILE.csv", type=Path, help=text)
    parser.add_argument(
        "--cameras",
        metavar="FILE",
        type=Path,
        nargs="+",
        help="cameras as Kalibr, multical, caliscope, ROS (camera_info), RealSense or OpenCV "
        "calibrated them, in place of rig.toml's; with nothing else to import, --out FILE.toml is a rig.toml",
    )
    parser.add_argument(
        "--bag",
        metavar="BAG",
        type=Path,
        nargs="+",
        help="bags of ROS 1 or 2, or an MCAP file: images, joint states, poses, "
        "temperatures by the topics' types (bag.topics.commands=/joint_states states one)",
    )
    parser.add_argument(
        "--tpoint",
        metavar="FILE",
        type=Path,
        help="pointing data of TPOINT: a recording of directions of a telescope's mount, with its rig.toml",
    )
    parser.add_argument(
        "--sigma",
        metavar="ANGLE",
        type=parse_tolerance,
        help="noise of a star's direction along each of two axes, for --tpoint, as 3arcsec",
    )
    parser.add_argument(
        "--set",
        dest="settings",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="state what files do not, as "
        "commands.unit=mm, commands.columns.l1=Leg1, images.tolerance=0.01, poses.rotation=zyx; may be "
        "repeated (docs/check.md)",
    )
    parser.add_argument(
        "--recipe", metavar="FILE.toml", type=Path, help="repeat an import by the recipe next to its result"
    )
    parser.add_argument(
        "--out", metavar="REC", type=Path, required=True, help="the recording; REC.import.toml next to it is the recipe"
    )
    parser.add_argument("--skip-unreadable", action="store_true", help="exclude, and list, unusable images")
    add_overwrite_option(parser)
    add_json_result_option(parser)


def run(arguments: argparse.Namespace) -> None:
    """Run `rig import`.

    Import foreign files as a recording, and save the recipe.
    """
    from rig.api import import_recording
    from rig.formats import importers
    from rig.formats.output_files import write_text

    given = {name: getattr(arguments, name) for name in TABLES}
    if arguments.tpoint is not None or arguments.sigma is not None:
        _pointing(arguments)
        return
    if arguments.recipe is not None and (
        arguments.images or arguments.rig or arguments.cameras or arguments.bag or any(given.values())
    ):
        raise RigError("--recipe names all files; --set changes its entries")
    if arguments.recipe is None and arguments.rig is None:
        raise RigError("--rig rig.toml states the rig of the files; `rig new design` lays one out")
    settings = tuple(arguments.settings)
    recipe = (
        importers.load_recipe(arguments.recipe, settings)
        if arguments.recipe is not None
        else importers.recipe_of_options(
            arguments.rig, arguments.images, given, settings, arguments.cameras or (), arguments.bag or ()
        )
    )
    arguments.outputs.inputs += _read(recipe)
    if recipe.cameras is not None and arguments.out.suffix == ".toml":
        _rig(arguments, recipe)
        return
    out = arguments.outputs.folder(arguments.out)
    imported, remarks = import_recording(recipe, out, arguments.out, arguments.skip_unreadable)
    recipe_file = arguments.out.parent / f"{arguments.out.name}.import.toml"
    if arguments.recipe is None:
        write_text(arguments.outputs.file(recipe_file), importers.recipe_toml(imported.recipe, recipe_file.parent))
    _print_verdict(imported)
    arguments.result = _result(
        imported, [str(remark) for remark in remarks], recipe_file if arguments.recipe is None else arguments.recipe
    )
    _print_camera_places(out)
    for remark in remarks:
        print(f"{'wrong' if remark.spoils else 'to look at'}: {remark}")
    print(
        f"written: {arguments.out}"
        + (f"; {recipe_file} repeats it (rig import --recipe)" if arguments.recipe is None else "")
        + f"; `rig check {arguments.out}` checks it in detail"
    )


def _pointing(arguments: argparse.Namespace) -> None:
    """Write a recording of directions of TPOINT's pointing data. Raises RigError where anything else is named too"""
    from rig.formats.importers.tpoint_pointing_data_import_and_refraction import (
        read_pointing_data,
        write_pointing_recording,
    )

    others = [name for name in (*TABLES, "images", "rig", "cameras", "bag", "recipe", "settings", "skip_unreadable")]
    named = [name for name in others if getattr(arguments, name)]
    if arguments.tpoint is None or named:
        raise RigError("--tpoint FILE stands with --sigma and --out alone: the file has the mount and all directions")
    if arguments.sigma is None or arguments.sigma[0] != "rotation":
        raise RigError("--tpoint takes --sigma, the noise of a star's direction, as --sigma 3arcsec: no file states it")
    arguments.outputs.inputs.append(arguments.tpoint)
    data = read_pointing_data(arguments.tpoint)
    write_pointing_recording(data, arguments.sigma[1], arguments.outputs.folder(arguments.out))
    assumed = (*data.assumed, "no times are stated, so a star is assumed every 10 s, in the order of the file")
    arguments.result = {
        "schema": "imported/1",
        "frames": len(data.star),
        "images": 0,
        "commands": len(data.star),
        "poses": len(data.star),
        "sensors": [],
        "assumed": list(assumed),
        "remarks": [],
        "recipe": "",
    }
    print(f"imported: {len(data.star)} stars of an {data.mount} mount, {data.caption}")
    _print_assumptions(assumed)
    print(f"written: {arguments.out}")


def _print_camera_places(folder: Path) -> None:
    """Print where a few images of the recording in a folder put its cameras, of which poses are stated by hand."""
    from rig.recording.recording_folder import load_recording
    from vision.checks.image_sample_corners_and_dictionary_mistakes import corners_of_sampled_frame_images
    from vision.checks.mistake_search_by_trial_corrections import misplaced_or_exchanged_camera_sentences

    recording = load_recording(folder)
    corners = corners_of_sampled_frame_images(recording) if recording.has_images else None
    for line in () if corners is None else misplaced_or_exchanged_camera_sentences(recording, corners):
        print(f"found: {line}")


def _read(recipe: "Recipe") -> list[Path]:
    """The files and folders that a recipe reads, which are never written over."""
    tables = [getattr(recipe, name) for name in TABLES]
    seen = [*(recipe.images.folders if recipe.images else ()), *(recipe.cameras.files if recipe.cameras else ())]
    seen += recipe.bag.files if recipe.bag else ()
    return [recipe.rig, *seen, *(table.file for table in tables if table is not None)]


def _result(imported: "ImportedRecording", remarks: list[str], recipe: Path) -> Json:
    """What --json prints."""
    e, c, p, s = imported.exposed, imported.commanded, imported.posed, imported.logged
    return {
        "schema": "imported/1",
        "frames": len(set(e.frame)),
        "images": sum(bool(name) for name in e.camera),
        "commands": 0 if c is None else len(c.values),
        "poses": 0 if p is None else len(p.T),
        "sensors": [] if s is None else [name for name, _ in s.channels],
        "assumed": list(imported.remarks),
        "remarks": remarks,
        "recipe": str(recipe),
    }


def _rig(arguments: argparse.Namespace, recipe: "Recipe") -> None:
    """Write a rig.toml with the cameras of another program. Raises RigError where more than cameras is to be
    imported.
    """
    from rig.formats import importers
    from rig.formats.output_files import write_text

    if recipe.images or any(getattr(recipe, name) for name in TABLES):
        raise RigError(
            f"--out {arguments.out} is a rig.toml, which holds cameras only; images and tables make a folder, --out REC"
        )
    out = arguments.outputs.file(arguments.out)
    design, text, lines = importers.design_with_imported_cameras(recipe)
    write_text(out, text or "")
    arguments.result = {
        "schema": "imported/1",
        "cameras": [camera.name for camera in design.cameras],
        "assumed": list(lines),
    }
    print(f"imported: {len(design.cameras)} cameras")
    _print_assumptions(lines)
    print(f"written: {arguments.out}")


def _print_verdict(imported: "ImportedRecording") -> None:
    """Print the verdict, then what was assumed."""
    e, parts = imported.exposed, []
    pictures = sum(bool(name) for name in e.camera)
    parts.append(
        f"{count_text(len(set(e.frame)), 'frame')}"
        + (f", {count_text(pictures, 'image')} of {count_text(len(set(e.camera)), 'camera')}" if pictures else "")
    )
    commanded, posed, logged = imported.commanded, imported.posed, imported.logged
    for count, word in (
        (commanded and len(commanded.values), "commands"),
        (posed and len(posed.T), "poses"),
        (logged and len(logged.t), "rows of sensors"),
    ):
        if count is not None:
            parts.append(f"{count} {word}")
    if e.t:
        parts[-1] += f", over {float(max(e.t) - min(e.t)):.6g} s"
    print(f"imported: {', '.join(parts)}")
    _print_assumptions(imported.remarks)


def _print_assumptions(assumptions: tuple[str, ...]) -> None:
    if assumptions:
        print("assumed, as nothing states otherwise:" if len(assumptions) > 1 else "assumed:")
    for line in assumptions:
        print(f"  {line}")
