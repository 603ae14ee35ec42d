"""rig export: export a calibrated geometry to other formats: genhexkins, URDF, SDF, LinuxCNC, JSON, CSV, a grid."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.command_options import add_json_result_option, add_overwrite_option, file_or_stdout
from rig.errors import RigError
from rig.formats.number_parsing_and_rounding import parse_number, parse_whole_number

if TYPE_CHECKING:
    from rig.model.mechanism_geometry import Arm, Hexapod
    from rig.model.mechanism_kinds import Mechanism

TABLES = ("linuxcnc-comp", "grid")  # of corrections, not of the geometry
CAMERAS = ("camera-info", "opencv")  # of a rig.toml, a file each
SEEN = ("tum", "parquet")  # of a recording
FORMATS = {
    "genhexkins": ("hexapod",),
    "urdf": ("hexapod", "arm"),
    "sdf": ("hexapod",),
    "json": ("hexapod", "arm"),
    "csv": ("hexapod", "arm"),
}


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument(
        "machine",
        metavar="CALIBRATION",
        type=Path,
        help="calibration.json, or a rig.toml for the machine as its owner has it; for tum and parquet a recording",
    )
    parser.add_argument(
        "--format",
        choices=(*FORMATS, *TABLES, *CAMERAS, *SEEN),
        required=True,
        help="genhexkins: HAL settings of LinuxCNC; "
        "urdf, sdf: for simulators, a hexapod's URDF as a tree; linuxcnc-comp: what goes on top of "
        "genhexkins, a file for each joint "
        "in the folder OUT; grid: a CSV of what is to be added to the owner's model; camera-info, opencv: "
        "lenses of a rig.toml, a "
        "YAML file for each camera in the folder OUT; tum, parquet: the poses, or all tables, of a recording "
        "or of what "
        "`rig measure` wrote",
    )
    parser.add_argument("--out", metavar="FILE", type=file_or_stdout, help="written here, or printed")
    parser.add_argument("--units", choices=("mm", "m"), default="mm", help="machine units of genhexkins (default mm)")
    parser.add_argument(
        "--coupling",
        type=parse_number,
        default=0.0,
        metavar="GAIN",
        help="of genhexkins: share of the cardans' twist that turns the screws",
    )
    parser.add_argument(
        "--lead",
        type=parse_number,
        metavar="M",
        help="of genhexkins: the screws' lead, m per revolution, for "
        "--coupling (default [actuator] screw_lead of a rig.toml)",
    )
    parser.add_argument(
        "--parts",
        type=parse_whole_number,
        metavar="Q",
        help="of linuxcnc-comp and grid: parts of each actuator's interval (default 64, and 3)",
    )
    add_overwrite_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Write or print the geometry."""
    if arguments.json and arguments.out is None:
        raise RigError(
            "--json says what was written: name a file or a folder with --out; without it what is exported "
            "is printed itself"
        )
    arguments.result = {
        "schema": "exported/1",
        "format": arguments.format,
        "out": str(arguments.out),
        "left_out": _export(arguments),
    }


def _export(arguments: Namespace) -> list[str]:
    """Write or print what is asked for; what it leaves out of a calibration, in words, which is said."""
    from rig.model.mechanism_kinds import require_arm, require_hexapod

    if arguments.format in TABLES:
        _tables(arguments)
        return []
    if arguments.format in CAMERAS or arguments.format in SEEN:
        (_cameras if arguments.format in CAMERAS else _seen)(arguments)
        return []
    from rig.formats.exporters import geometry_and_camera_files, urdf_and_sdf
    from rig.formats.output_files import write_text

    mechanism, left_out, lead = _machine(arguments.machine)
    lead = lead if arguments.lead is None else arguments.lead
    if arguments.coupling and lead is None:
        raise RigError(
            f"--coupling takes the screws' lead, m per revolution: give --lead, since {arguments.machine} "
            "does not state it"
            + (
                " ([actuator] screw_lead)"
                if arguments.machine.suffix == ".toml"
                else " (a rig.toml may, as [actuator] screw_lead)"
            )
        )
    if not -10 <= arguments.coupling <= 10 or (lead is not None and not 0 < lead <= 1):
        raise RigError(
            "--coupling is a share between -10 and 10 and --lead is in metres, above 0 and at most 1, not "
            f"{arguments.coupling:g} and "
            f"{lead:g}"
            if lead is not None
            else f"--coupling is a share between -10 and 10, not {arguments.coupling:g}"
        )
    kinds = FORMATS[arguments.format]
    if mechanism.kind not in kinds:
        raise RigError(
            f"{arguments.format} takes a mechanism of kind {' or '.join(kinds)}; {arguments.machine} has one "
            f"of kind {mechanism.kind!r}"
        )
    out = arguments.outputs.file(arguments.out) if arguments.out else None
    text = {
        "genhexkins": lambda: geometry_and_camera_files.genhexkins_settings(
            require_hexapod(mechanism), arguments.units, lead, arguments.coupling
        ),
        "urdf": lambda: (
            urdf_and_sdf.arm_urdf(require_arm(mechanism), arguments.machine.stem)
            if mechanism.link_rows is not None
            else urdf_and_sdf.hexapod_urdf(require_hexapod(mechanism), arguments.machine.stem)
        ),
        "sdf": lambda: urdf_and_sdf.hexapod_sdf(require_hexapod(mechanism), arguments.machine.stem),
        "json": lambda: geometry_and_camera_files.geometry_json(_exported(mechanism)),
        "csv": lambda: geometry_and_camera_files.geometry_csv(_exported(mechanism)),
    }[arguments.format]()
    for line in left_out:
        print(f"rig export: {line}; use `rig correct` where it matters", file=sys.stderr)
    if out is None:
        print(text, end="")
        return left_out
    write_text(out, text)
    print(f"written: {arguments.out}")
    return left_out


def _tables(arguments: Namespace) -> None:
    """Write corrections as tables, and say what they leave out."""
    import numpy as np

    from calib.correction.correction_tables import axis_correction_tables, grid_correction_table
    from calib.files import calibration_file
    from rig.formats.exporters import geometry_and_camera_files
    from rig.formats.output_files import write_text
    from rig.model import mechanisms

    if arguments.machine.suffix == ".toml" or arguments.out is None:
        raise RigError(f"{arguments.format} takes a calibration.json and --out")
    correction = calibration_file.load(arguments.machine).correction
    mechanism = correction.nominal
    if mechanism.link_rows is not None:
        raise RigError(f"{arguments.format} takes a hexapod's calibration; an arm's is corrected by `rig correct`")
    parts = arguments.parts if arguments.parts is not None else 3 if arguments.format == "grid" else 64
    most = 9 if arguments.format == "grid" else geometry_and_camera_files.MOST - 1
    if not 1 <= parts <= most:
        raise RigError(f"--parts is 1 to {most} for {arguments.format}, not {parts}")
    if arguments.format == "grid":
        out = arguments.outputs.file(arguments.out)
        write_text(
            out,
            geometry_and_camera_files.correction_grid_csv(
                *grid_correction_table(correction, parts), mechanism.axes, mechanisms.kinematics_of(mechanism).UNIT
            ),
        )
        print(
            f"{(parts + 1) ** len(mechanism.axes)} rows; command = x + k, x as the owner's model has it; "
            f"written: {arguments.out}"
        )
        return
    folder = arguments.outputs.folder(arguments.out)
    found = axis_correction_tables(correction, parts + 1)
    for i, (levels, trims) in enumerate(zip(found.levels, found.trims)):
        write_text(
            folder / f"joint_{i}.comp",
            geometry_and_camera_files.linuxcnc_compensation_file(
                levels + correction.fitted.strut_zeros[i], trims, arguments.units
            ),
        )
    print(
        f"COMP_FILE_TYPE = 0, units {arguments.units}, on top of genhexkins with the calibration's geometry; "
        "a table for each joint alone leaves "
        f"{np.sqrt((found.left**2).mean()) * 1e6:.3f} um RMS of the correction; written: {arguments.out}"
    )


def _cameras(arguments: Namespace) -> None:
    """Write the lenses of a rig.toml, a file for each camera."""
    from rig.formats.exporters import geometry_and_camera_files
    from rig.formats.output_files import write_text
    from rig.formats.rig_toml import design_file

    if arguments.machine.suffix != ".toml" or arguments.out is None:
        raise RigError(f"{arguments.format} takes a rig.toml, as `rig measure` writes it too, and --out DIR")
    found = design_file.load_design(arguments.machine).cameras
    if not found:
        raise RigError(f"{arguments.machine} has no cameras")
    texts = {
        camera.name: (
            geometry_and_camera_files.ros_camera_info
            if arguments.format == "camera-info"
            else geometry_and_camera_files.opencv_camera_yaml
        )(camera)
        for camera in found
    }
    folder = arguments.outputs.folder(arguments.out)
    for name, text in texts.items():
        write_text(folder / f"{name}.yaml", text)
    print(f"written: {arguments.out}: {', '.join(f'{name}.yaml' for name in texts)}")


def _seen(arguments: Namespace) -> None:
    """Write the poses or the tables of a recording."""
    from rig.formats.exporters import recording_as_rerun_tum_parquet
    from rig.formats.output_files import write_bytes, write_text
    from rig.recording import recording_folder as recordings

    found = recordings.load_recording(arguments.machine)
    if arguments.format == "tum":
        text = recording_as_rerun_tum_parquet.tum_trajectory(found)
        if arguments.out is None:
            print(text, end="")
            return
        write_text(arguments.outputs.file(arguments.out), text)
        print(f"{len(text.splitlines()) - 1} poses; written: {arguments.out}")
        return
    if arguments.out is None:
        raise RigError("parquet takes --out DIR")
    files = recording_as_rerun_tum_parquet.parquet_tables(arguments.machine)
    folder = arguments.outputs.folder(arguments.out)
    for name, data in files.items():
        write_bytes(folder / f"{name}.parquet", data)
    print(f"written: {arguments.out}: {', '.join(f'{name}.parquet' for name in files)}")


def _machine(path: Path) -> tuple[Mechanism, list[str], float | None]:
    """(mechanism, what corrects beyond it, in lines, the screws' lead in m or None) of a calibration.json or a
    rig.toml.
    """
    if path.suffix == ".toml":
        from rig.formats.rig_toml import design_file

        design = design_file.load_design(path)
        return design.mechanism, [], design.actuator.screw_lead
    from calib.files import calibration_file

    calibration = calibration_file.load(path)
    correction, left_out = calibration.correction, []
    if calibration.physics is not None and calibration.physics.compensable_effects():
        names = ", ".join(f"{e.label()} at {e.place}" for e in calibration.physics.compensable_effects())
        left_out.append(f"the calibration undoes {names} beside the geometry, which no export holds")
    if correction.posed:
        left_out.append(f"maps in pose space ({len(correction.posed)}) are in no export")
    every = correction.extension is not None
    axes = [str(i + 1) for i, part in enumerate(correction.remainder) if part is not None or every]
    if axes:
        left_out.append(f"the calibration corrects axes {', '.join(axes)} beyond the geometry, which no geometry holds")
    return correction.fitted, left_out, None


def _exported(mechanism: Mechanism) -> Hexapod | Arm:
    """The mechanism, which has a geometry that can be written."""
    from rig.model.mechanism_kinds import require_arm, require_hexapod

    return require_arm(mechanism) if mechanism.link_rows is not None else require_hexapod(mechanism)
