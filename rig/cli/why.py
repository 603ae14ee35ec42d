"""rig why: why a machine is not where its model says.

It calibrates and diagnoses from data, and prints how wrong, why, how sure, what to do and measure.
"""

import sys
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path

from rig.cli.new import add_user_arm_file_options, arm_file_options
from rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion import parse_length, parse_tolerance
from rig.cli.shared.escaped_output_progress_error_table_and_refutations import Progress
from rig.cli.shared.input_file_options_and_loading import add_continue_despite_mistakes_option
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    add_json_option,
    add_overwrite_option,
    page_links,
    print_json,
)
from rig.report.verdict_refutations_and_result_display import exit_status


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig why` to a parser."""
    parser.add_argument(
        "data",
        metavar="DATA",
        type=Path,
        help="a recording, a table of joint values and measured poses, a ROS bag, or a folder of such files",
    )
    parser.add_argument("--rig", metavar="rig.toml", type=Path, help="the machine, where DATA does not state it")
    add_user_arm_file_options(parser)
    parser.add_argument("--units", metavar="mm,deg", help="of --dh, where the header states none (default m,rad)")
    parser.add_argument(
        "--position-sigma",
        metavar="0.02mm",
        type=parse_length,
        help="standard deviation of a measured coordinate, of --urdf and --dh (default 20um, assumed)",
    )
    parser.add_argument(
        "--rotation-sigma", metavar="0.1mrad", type=_angle, help="the same of a rotation (default 0.2mrad, assumed)"
    )
    parser.add_argument(
        "--set",
        dest="settings",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="state what files do not, as of `rig import`: commands.unit=deg, poses.unit=mm, poses.rotation=zyx",
    )
    parser.add_argument(
        "--out", metavar="DIR", type=Path, help="keeps the recording, calibration.json, and the diagnosis with its page"
    )
    add_continue_despite_mistakes_option(parser)
    add_overwrite_option(parser)
    add_json_option(parser)


def _angle(text: str) -> float:
    kind, value = parse_tolerance(text)
    if kind != "rotation":
        raise ArgumentTypeError(f"{text!r} is a length, and this takes an angle, as 0.1mrad")
    return value


def run(arguments: Namespace) -> int:
    """Run `rig why`.

    Calibrate and diagnose a machine from its data, and print five lines.

    Exit status 3 where the verdict is bad.
    """
    from calib.api.options_and_imported_data_of_why import WhyOptions
    from calib.api.why import why

    progress = Progress()
    progress("reading the data", 0, 1)

    def notice(line: str) -> None:
        progress.close()
        print(line, file=sys.stderr)

    options = WhyOptions(
        arm_file_options(arguments, arguments.units),
        arguments.rig,
        arguments.position_sigma,
        arguments.rotation_sigma,
        tuple(arguments.settings),
        arguments.anyway,
    )
    out = arguments.out
    folder = None if out is None else arguments.outputs.folder(out)
    links = () if out is None else page_links(arguments, out / "diagnosis.html")
    result = why(arguments.data, options, folder, progress, notice, links)
    progress.close()
    if arguments.json:
        print_json(result.tree())
    else:
        print("\n".join(result.lines()))
    if out is not None:
        print(f"written: {out}; look at {out / 'diagnosis.html'}", file=sys.stderr)
    return exit_status(result.verdict)
