"""rig run: run a plan on the real machine.

Move, settle, expose, journal; frames are measured during the run.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion import (
    make_quantity_parser,
    parse_length_and_angle,
)
from rig.cli.shared.input_file_options_and_loading import add_limb_options, limb_source
from rig.cli.shared.shared_output_controller_hand_and_worker_options import SEED, add_rig_toml_port_and_trace_arguments
from rig.errors import RigError
from rig.formats.numbers_and_units import count_text, parse_number, parse_whole_number

if TYPE_CHECKING:
    from calib.api.execute_plan_at_machine import PlannedRun, RunOptions

KINDS = ("jump", "camera", "covered", "unseen", "drift", "limbs")


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig run` to a parser."""
    add_rig_toml_port_and_trace_arguments(parser)
    parser.add_argument(
        "--plan",
        required=True,
        help="as for rig simulate, of parts at whose exposures the struts rest: "
        "sobol:40,ladder,repeat:20, or commands:FILE (frame,l1..l6 as rig correct and rig plan --for write it)",
    )
    parser.add_argument("--seed", type=parse_whole_number, default=SEED, help="of the plan")
    parser.add_argument(
        "--out",
        metavar="REC",
        type=Path,
        required=True,
        help="the recording; a new folder, or with --resume the one to continue",
    )
    parser.add_argument("--resume", action="store_true", help="resume REC from the current positions")
    parser.add_argument(
        "--dry-run", action="store_true", help="check the plan, print what would be done, and move nothing"
    )
    parser.add_argument("--no-home", action="store_true", help="trust the position that the controller reports")
    parser.add_argument(
        "--settle",
        default="time:1",
        metavar="HOW",
        help="time:SECONDS, images (until they no longer change), limbs:20um "
        "(until measuring limbs agree to this; a plain number is in m) or, without cameras, ask (until the operator at "
        "the terminal or on the page has measured); default time:1",
    )
    parser.add_argument(
        "--in-motion",
        metavar="3mm/s",
        type=make_quantity_parser("m/s", "mm/s"),
        help="expose during the moves, at this speed of the strut that moves most (a plain number is in mm/s); "
        "the plan's places are passed "
        "without waiting; rig measure and rig calibrate find by how much the clocks of cameras and controller differ",
    )
    parser.add_argument(
        "--interval",
        metavar="SECONDS",
        type=parse_number,
        help="of --in-motion: from one exposure to the next, at least (default 0.25)",
    )
    parser.add_argument(
        "--exposure",
        metavar="SECONDS",
        help='of all cameras; by default so that markers are bright and do not clip; "keep" leaves them as they are',
    )
    parser.add_argument(
        "--calibration", metavar="FILE", type=Path, help="predicts the poses, which are tested for drift"
    )
    parser.add_argument("--tolerance", nargs=2, metavar=("20um", "50urad"), help="reported drift from the calibration")
    parser.add_argument(
        "--stop-on",
        default="",
        metavar="WHAT,..",
        help=f"end the run on {', '.join(KINDS)}; by default they are only reported",
    )
    parser.add_argument(
        "--no-cameras",
        action="store_true",
        help="take no images: places are visited for another instrument, and visits.csv says when the struts stood "
        "where; as by itself where rig.toml has no camera. --settle time:SECONDS leaves it its time, --settle ask "
        "waits for an operator and records readings",
    )
    parser.add_argument("--no-measure", action="store_true", help="take images only")
    add_limb_options(parser)
    parser.add_argument(
        "--page",
        nargs="?",
        type=parse_whole_number,
        const=0,
        metavar="PORT",
        help="show the run on a page of this computer, with a button to stop it",
    )


def run(arguments: Namespace) -> None:
    """Run `rig run`.

    Run a plan on the machine and record it, or resume such a run.
    """
    from calib.api.execute_plan_at_machine import plan_run
    from rig.driving.driver_opening_and_settling import design_with_controller_port

    design = design_with_controller_port(arguments.design, arguments.port)
    planned = plan_run(design, arguments.design, arguments.plan, _options(arguments))
    if arguments.dry_run:
        _print_plan(planned)
        for line in planned.compare_with_controller():
            print(line)
        return
    from rig.cli.shared.terminal_run_display_and_printed_controller_status import (
        is_operator_at_terminal,
        open_terminal_and_page_run_displays,
    )

    out, asked = arguments.out, arguments.settle == "ask"
    if asked and arguments.page is None and not is_operator_at_terminal():
        raise RigError("--settle ask takes somebody who answers: a terminal in the foreground, or --page")
    frames = planned.carry_out(out, partial(open_terminal_and_page_run_displays, arguments.page, asked), print)
    if planned.options.uses_cameras(design):
        print(f"{count_text(frames, 'frame')} in {out}; rig measure {out} --out DIR measures them all jointly")
    elif (out / "poses.csv").exists():
        print(
            f"{count_text(frames, 'visit')} in {out / 'visits.csv'}, readings in {out / 'poses.csv'}; "
            f"state [instrument] in {out / 'rig.toml'}"
        )
    else:
        print(
            f"{count_text(frames, 'visit')} in {out / 'visits.csv'}; join an instrument's poses to them by frame, as "
            f"{out / 'poses.csv'}"
        )


def _options(arguments: Namespace) -> RunOptions:
    """How a run goes, by the arguments. Raises RigError for what cannot be meant, before anything moves."""
    from calib.api.execute_plan_at_machine import RunOptions
    from calib.files import calibration_file

    exposure, known, speed = arguments.exposure, arguments.calibration, arguments.in_motion
    if arguments.interval is not None and speed is None:
        raise RigError("--interval is of --in-motion; at rest a plan states how often cameras expose")
    if arguments.tolerance and not known:
        raise RigError("--tolerance takes a --calibration to compare the poses with")
    return RunOptions(
        arguments.seed,
        arguments.settle,
        exposure if exposure in (None, "keep") else _seconds(exposure),
        calibration_file.load(known) if known and not arguments.dry_run else None,
        str(known),
        parse_length_and_angle(arguments.tolerance) if arguments.tolerance else None,
        frozenset(filter(None, arguments.stop_on.split(","))),
        not arguments.no_measure,
        limb_source(arguments),
        arguments.no_home,
        arguments.resume,
        arguments.trace,
        not arguments.no_cameras,
        speed,
        0.25 if arguments.interval is None else arguments.interval,
    )


def _seconds(text: str) -> float:
    """An exposure, s. Raises RigError for what is none."""
    try:
        exposure = parse_number(text)
    except ValueError:
        exposure = 0.0
    if not 0 < exposure <= 10:
        raise RigError(f"--exposure takes seconds or keep, not {text!r}")
    return exposure


def _print_plan(planned: PlannedRun) -> None:
    """Check the whole plan from home and print what it would do."""
    import numpy as np

    from rig.driving.axis_display_units_and_controller_counts import axis_values_text, greatest_distance_text

    m, steps, travel = planned.design.mechanism, planned.steps, planned.travel()
    cameras = planned.design.cameras if planned.options.cameras else ()
    for k, step in enumerate(steps):
        exposed = f"{step.frames} frame{'s' * (step.frames != 1)}" if step.frames else "passed on the way"
        exposed = exposed if step.speed is None else "exposed on the way"
        print(
            f"step {k + 1}: {axis_values_text(step.goal, m)}, {greatest_distance_text(travel[k], m, 1)} to go, "
            f"{exposed}"
        )
    pixels = sum(camera.width * camera.height for camera in cameras)
    seconds = planned.seconds()
    frames, most = planned.frames, ""
    if planned.options.in_motion is not None:
        frames, most = int(seconds / max(planned.options.interval, 1e-3)), "at most "
    print(
        f"{count_text(len(steps), 'step')}, {most}{count_text(frames, 'frame')} of "
        f"{count_text(len(cameras), 'camera')}, {greatest_distance_text(np.abs(travel).sum(axis=0), m, 0)} of the "
        f"busiest {'strut' if m.strut_joints is not None else 'axis'}, {seconds / 60:.1f} min of moving; at most "
        f"{frames * pixels / 1e9:.2f} GB of images; nothing was moved"
    )
