"""rig export: export to the formats of other programs.

A calibrated geometry, lenses or a recording.

Formats: genhexkins, URDF, SDF, LinuxCNC, grblHAL, JSON, CSV, a grid, C; of lenses OpenCV and ROS; of a recording TUM
and Parquet.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path

from rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion import (
    make_quantity_parser,
    parse_tolerance,
)
from rig.cli.shared.input_file_options_and_loading import add_deprecated_option_name
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    add_json_result_option,
    add_overwrite_option,
    file_or_stdout,
)
from rig.errors import RigError
from rig.formats.numbers_and_units import parse_number, parse_whole_number

MOST_VALUES = 1000  # of a channel, of a lookup table
LISTED = ("camera-info", "opencv", "parquet")  # of which the files are named
FORMATS = (
    "genhexkins",
    "urdf",
    "sdf",
    "json",
    "csv",
    "linuxcnc-comp",
    "grid",
    "c",
    "lut",
    "linuxcnc-kins",
    "grblhal-kins",
    "camera-info",
    "opencv",
    "tum",
    "parquet",
)


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig export` to a parser."""
    parser.add_argument(
        "machine",
        metavar="CALIBRATION",
        type=Path,
        help="calibration.json, or a rig.toml for the nominal machine; for tum and parquet a recording",
    )
    parser.add_argument(
        "--format",
        choices=FORMATS,
        required=True,
        help="genhexkins: HAL settings of LinuxCNC; "
        "urdf, sdf: for simulators, a hexapod's URDF as a tree; linuxcnc-comp: the correction on top of "
        "genhexkins, a file for each joint "
        "in the folder OUT; grid: a CSV of corrections to the nominal model; c: a C99 file that computes corrected "
        "lengths, or an arm's corrected joint commands, as `rig correct` does, for a controller; "
        "lut: a CSV of commands for --poses over sensor channels, "
        "with covariance; linuxcnc-kins: the C file as LinuxCNC's kinematics module "
        "rigkins, for halcompile; grblhal-kins: the C file as grblHAL's kinematics plug-in; camera-info, opencv: "
        "lenses of a rig.toml, a "
        "YAML file for each camera in the folder OUT; tum, parquet: the poses, or all tables, of a recording "
        "or of what "
        "`rig measure` wrote",
    )
    parser.add_argument("--out", metavar="FILE", type=file_or_stdout, help="written here, or printed")
    parser.add_argument("--units", choices=("mm", "m"), default="mm", help="machine units of LinuxCNC (default mm)")
    parser.add_argument(
        "--coupling",
        type=parse_number,
        default=0.0,
        metavar="GAIN",
        help="of genhexkins: share of the cardans' twist that turns the screws",
    )
    parser.add_argument(
        "--lead",
        type=make_quantity_parser("m", "m"),
        metavar="4mm",
        help="of genhexkins: the screws' lead per revolution, for "
        "--coupling (a plain number is in m; default [actuator] screw_lead of a rig.toml)",
    )
    parser.add_argument(
        "--intervals",
        dest="parts",
        type=parse_whole_number,
        metavar="Q",
        help="of linuxcnc-comp and grid: into how many intervals each actuator's range is divided (default 64, and 3)",
    )
    parser.add_argument("--poses", metavar="FILE", type=Path, help="of lut: the wanted poses, frame,x,y,z,rx,ry,rz")
    parser.add_argument(
        "--over",
        metavar="CHANNEL=LOW:HIGH:STEP",
        nargs="+",
        default=[],
        type=_channel_values,
        help="of lut: sensor channels and their values, such as elevation_deg=0:90:10 ambient_temperature_C=10,25",
    )
    parser.add_argument(
        "--uncertainty",
        metavar="20um",
        nargs="+",
        default=[],
        type=parse_tolerance,
        help="of lut: state how many poses a calibration takes for this standard uncertainty of poses, RMS over the "
        "table, of position, of rotation (0.1mrad, 20arcsec) or of both",
    )
    parser.add_argument(
        "--zero",
        metavar="250mm",
        nargs="+",
        default=[],
        type=make_quantity_parser("m", "m"),
        help="of grblhal-kins: length of the struts where the motors count 0, one or six, as [controller] zero "
        "(plain numbers are in m; default: of the home pose)",
    )
    add_deprecated_option_name(parser, "--parts", "parts", parse_whole_number)
    add_overwrite_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Run `rig export`.

    Export a calibrated geometry to another format.
    """
    from calib.api.export_calibration_or_recording import ExportOptions, export

    _require_out(arguments)
    names = [name for name, _ in arguments.over]
    if len(set(names)) < len(names):
        raise RigError(f"--over states {next(n for n in names if names.count(n) > 1)} twice")
    options = ExportOptions(
        arguments.units,
        arguments.coupling,
        arguments.lead,
        arguments.parts,
        arguments.poses,
        dict(arguments.over),
        tuple(arguments.zero),
        dict(arguments.uncertainty),
    )
    result = export(arguments.machine, arguments.format, options)
    for line in result.left_out:
        print(f"rig export: {line}; use `rig correct` where it matters", file=sys.stderr)
    if arguments.out is None:
        print(result.text, end="")
    else:
        outputs = arguments.outputs
        result.write((outputs.file if result.text is not None else outputs.folder)(arguments.out))
        named = f": {', '.join(result.files)}" if arguments.format in LISTED else ""
        print(f"{result.summary}{'; ' if result.summary else ''}written: {arguments.out}{named}")
    arguments.result = {
        "schema": "exported/1",
        "format": arguments.format,
        "out": str(arguments.out),
        "left_out": list(result.left_out),
    }


def _channel_values(text: str) -> tuple[str, list[float]]:
    """(channel, values) of NAME=LOW:HIGH:STEP or NAME=A,B,..; raises ArgumentTypeError for another text."""
    name, equals, rest = text.partition("=")
    try:
        numbers = [parse_number(part) for part in rest.split(":" if ":" in rest else ",")]
    except ValueError as error:
        raise ArgumentTypeError(f"{text!r}: {error}") from None
    if not name or not equals or (":" in rest and (len(numbers) != 3 or numbers[2] <= 0 or numbers[1] < numbers[0])):
        raise ArgumentTypeError(f"expected CHANNEL=LOW:HIGH:STEP or CHANNEL=A,B,.., got {text!r}")
    if ":" not in rest:
        return name, numbers
    low, high, step = numbers
    count = (high - low) / step
    if abs(count - round(count)) > 1e-6 or count > MOST_VALUES:
        raise ArgumentTypeError(f"{text!r}: STEP must divide HIGH - LOW, into at most {MOST_VALUES} parts")
    return name, [low + step * k for k in range(round(count) + 1)]


def _require_out(arguments: Namespace) -> None:
    """Raise RigError where a format takes --out, or another kind of file."""
    kind, is_design, nowhere = arguments.format, arguments.machine.suffix == ".toml", arguments.out is None
    if arguments.json and nowhere:
        raise RigError(
            "--json reports what was written: name a file or a folder with --out; without it the export "
            "is printed itself"
        )
    if kind in ("linuxcnc-comp", "linuxcnc-kins", "grblhal-kins", "grid", "c", "lut") and (is_design or nowhere):
        raise RigError(f"{kind} takes a calibration.json and --out")
    if kind in ("camera-info", "opencv") and (not is_design or nowhere):
        raise RigError(f"{kind} takes a rig.toml, as `rig measure` writes it too, and --out DIR")
    if kind == "parquet" and nowhere:
        raise RigError("parquet takes --out DIR")
