"""rig limbs test and rig limbs closures: tests of measuring limbs, and closures of redundant legs.

Limbs are calibrated in place and checked. Accepted ones are saved, and can replace vision as the source of poses.
Closures tell which six legs give the pose, and the closure errors of the others.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion import parse_length_and_angle
from rig.cli.shared.escaped_output_progress_error_table_and_refutations import Progress, print_frames_without_pose
from rig.cli.shared.input_file_options_and_loading import (
    add_recording_argument,
    notice_printing_function,
    read_recording,
)
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    add_json_result_option,
    add_overwrite_option,
    add_page_option,
    file_or_stdout,
    page_links,
    page_path,
)
from rig.formats.numbers_and_units import count_text

if TYPE_CHECKING:
    from calib.api.loop_closure_check_of_redundant_legs import LoopClosureResult
    from calib.api.measuring_limb_acceptance_and_poses_from_readings import LimbAcceptance
    from calib.certification.measuring_limb_calibration_slips_and_vision_agreement import Agreement


def arguments_of_test(parser: ArgumentParser) -> None:
    """Add the arguments of `rig limbs test` to a parser."""
    add_recording_argument(parser, "with columns m1..mn (m), six or more, in sensors.csv and [insitu] in rig.toml")
    parser.add_argument(
        "--tolerance",
        nargs=2,
        default=("50um", "200urad"),
        metavar=("50um", "200urad"),
        help="that each axis must agree with vision within (default 50um and 200urad)",
    )
    parser.add_argument(
        "--use",
        metavar="LIMBS",
        help="of more limbs than six those that give the pose, as m1,m2,m4,m5,m7,m8, the others being "
        "checks; by default the best-conditioned six",
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=Path,
        help="limbs.json: geometry, covariance, agreement and verdict, for --limbs of measure, "
        "calibrate, online and run",
    )
    add_page_option(parser)
    parser.add_argument(
        "--state",
        metavar="FILE",
        type=Path,
        help="once passed: learn the struts from the limbs' poses, and save that here",
    )
    add_json_result_option(parser)


def run_test(arguments: Namespace) -> int:
    """Run `rig limbs test`.

    Test measuring limbs against vision, and save accepted ones.

    Exit status 1 where one is not accepted.
    """
    from calib.api.measuring_limb_acceptance_and_poses_from_readings import AcceptLimbsOptions, accept_limbs
    from calib.online.accepted_measuring_limbs_file import is_limbs_file
    from rig.cli.shared.measurement_calibration_and_learning_summary_printing import print_online_learning_result

    names = None if arguments.use is None else tuple(arguments.use.split(","))
    options = AcceptLimbsOptions(parse_length_and_angle(arguments.tolerance), names, tuple(arguments.argv))
    recording = read_recording(arguments)
    renewed = arguments.out is not None and is_limbs_file(arguments.out)
    out = arguments.outputs.file(arguments.out, own=renewed) if arguments.out else None
    state = arguments.outputs.file(arguments.state, own=True) if arguments.state else None
    page = page_path(arguments)
    result = accept_limbs(recording, options, Progress())
    _print_acceptance(result)
    arguments.result = result.tree()
    if out is not None:
        result.save(out)
        print(f"written: {arguments.out}, verdict {result.accepted.verdict}")
    if page is not None:
        result.write_page(page, page_links(arguments, arguments.page))
        print(f"written: {arguments.page}")
    if state is not None and result.passed:
        progress = Progress()
        learnt = result.learn(arguments.state, progress, notice_printing_function(progress))
        learnt.save(state)
        print_online_learning_result(learnt)
        print(f"written: {arguments.state}")
    return 0 if result.passed else 1


def _print_acceptance(result: LimbAcceptance) -> None:
    """Print how limbs and vision agree, how the limbs beyond six close, and the verdict."""
    _print_agreement(result.agreement, result.by_vision.source)
    _print_checks(result)
    print_frames_without_pose(result.by_vision.measurement)
    withdrawn = result.accepted.withdrawn
    if withdrawn is not None:
        print(
            f"from frame {withdrawn.frame} on {withdrawn.reason}; limbs that change while they are held "
            "against vision cannot replace it"
        )
    print(
        "the measuring limbs pass: their poses may replace vision's"
        if result.passed
        else "the measuring limbs do not pass"
    )


def _print_checks(result: LimbAcceptance) -> None:
    """Print which six give the pose, and how the others close on stretches left out of fitting them."""
    limbs, channels = result.accepted.limbs, result.channels
    if limbs.checks is None or not len(limbs.checks.limbs):
        return
    print(f"{', '.join(channels[i] for i in limbs.chosen)} give the pose; the others minus prediction, um:")
    print(f"{'':4}{'mean':>9}{'RMS':>9}{'expected':>10}")
    for i, e, s in zip(limbs.checks.limbs, result.check_error.T * 1e6, result.check_sigma.T * 1e6):
        print(f"{channels[i]:4}{e.mean():9.2f}{(e**2).mean() ** 0.5:9.2f}{(s**2).mean() ** 0.5:10.2f}")


def _print_agreement(found: Agreement, source: str) -> None:
    """Print how far each axis agrees with vision, against its tolerance."""
    from calib.certification.measuring_limb_calibration_slips_and_vision_agreement import AXES, MOVES

    print(
        f"measuring limbs minus vision ({source}), {count_text(found.n, 'pose')}, each by limbs "
        f"fitted to other stretches; "
        "um and urad:"
    )
    print(
        f"{'':4}{'bias':>9}{'scatter':>9}{'expected':>9}{'limits of agreement':>24}"
        f"{'surely within':>15}{'tolerance':>11}{'moved over':>14}"
    )
    for i, axis in enumerate(AXES):
        low, high = found.limits[:, i] * 1e6
        moved = f"{found.moved[i] * 1e3:.1f} {'mm' if i < 3 else 'mrad'}"
        message = (
            "passes"
            if found.passed[i]
            else (
                "fails"
                if found.proven_limits[i] > found.tolerance[i]
                else f"not shown: it must move over {MOVES:g} tolerances"
            )
        )
        print(
            f"{axis:4}{found.bias[i] * 1e6:9.2f}{found.scatter[i] * 1e6:9.2f}{found.expected[i] * 1e6:9.2f}"
            f"{f'{low:.2f} .. {high:.2f}':>24}{found.proven_limits[i] * 1e6:15.2f}{found.tolerance[i] * 1e6:11.1f}"
            f"{moved:>14}  {message}"
        )


def arguments_of_closures(parser: ArgumentParser) -> None:
    """Add the arguments of `rig limbs closures` to a parser."""
    add_recording_argument(
        parser, "with measuring limbs next to its struts (m1..mn in sensors.csv and [insitu] in rig.toml)"
    )
    parser.add_argument(
        "--use",
        metavar="LEGS",
        help="the six legs that give the pose, as l1,l2,l3,m4,m5,m6; by default the best-conditioned six",
    )
    parser.add_argument(
        "--calibration", metavar="FILE", type=Path, help="struts as calibrated, not as rig.toml states them"
    )
    parser.add_argument(
        "--limbs",
        metavar="FILE",
        type=Path,
        help="limbs as `rig limbs test` estimated them, not as rig.toml states them",
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=file_or_stdout,
        help="closures.csv: frame, reading of each other leg minus that predicted from the pose "
        "(e_..), its expected standard deviation (u_..), m",
    )
    add_overwrite_option(parser)
    add_json_result_option(parser)


def run_closures(arguments: Namespace) -> int:
    """Run `rig limbs closures`.

    Choose six of redundant limbs and print the closure errors of the others.

    Exit status 1 where one is worse than its errors and geometry allow.
    """
    from calib.api.loop_closure_check_of_redundant_legs import LoopClosureOptions, close_loops
    from calib.files import calibration_file
    from calib.online.accepted_measuring_limbs_file import load_limbs_of_any_verdict

    recording = read_recording(arguments)
    out = arguments.outputs.file(arguments.out) if arguments.out else None
    options = LoopClosureOptions(
        tuple(arguments.use.split(",")) if arguments.use else None,
        None if arguments.calibration is None else calibration_file.load(arguments.calibration),
        None if arguments.limbs is None else load_limbs_of_any_verdict(arguments.limbs),
    )
    result = close_loops(recording, options)
    _print_closures(result)
    arguments.result = result.tree()
    if out:
        result.write(out)
        print(f"written: {arguments.out}")
    return int(result.strange)


def _print_closures(result: LoopClosureResult) -> None:
    """Print which legs give the pose, how each other one closes, and which one leg would explain what does not."""
    import numpy as np

    from calib.api.loop_closure_check_of_redundant_legs import STRANGE

    legs, found, condition = result.legs, result.closures, result.condition
    print(
        f"{len(legs.names)} legs for six freedoms; {', '.join(legs.names[i] for i in result.chosen)} give the pose, "
        f"{'as requested' if result.requested else 'the best-conditioned six'} (condition number "
        f"{np.median(condition):.3g} in the middle, {condition.max():.3g} at most); closures of the others "
        f"at {count_text(len(result.frames), 'pose')}, um:"
    )
    print(f"{'':4}{'mean':>10}{'RMS':>10}{'expected':>10}{'largest':>10}{'at frame':>10}")
    for k, (i, ratio) in enumerate(zip(found.checks, result.ratio)):
        e = found.error[:, k] * 1e6
        expected = np.sqrt(found.covariance[:, k, k].mean()) * 1e6
        print(
            f"{legs.names[i]:4}{e.mean():10.2f}{np.sqrt((e**2).mean()):10.2f}{expected:10.2f}"
            f"{e[np.abs(e).argmax()]:10.2f}{result.frames[np.abs(e).argmax()]:10d}"
            + (f"  {ratio:.1f} times what is expected" if ratio > STRANGE else "")
        )
    if result.strange:
        i = result.explaining_leg
        print(
            f"one leg explains most of it: {legs.names[i]}, were it longer by {-found.off[i] * 1e6:+.2f} um "
            f"than it reads ({found.share[i]:.0%} of the squares)"
        )
