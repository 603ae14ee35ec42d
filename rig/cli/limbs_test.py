"""rig limbs test: test measuring limbs against vision.

Limbs are calibrated in place and checked; accepted ones are saved.

Accepted limbs can replace vision as the source of poses.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.common_options import add_json_result_option, add_page_option, page_links, page_path
from rig.cli.shared.input_options import add_recording_argument, notice_printer, read_recording
from rig.cli.shared.option_value_parsing import length_and_angle
from rig.cli.shared.output_display import Progress
from rig.cli.shared.printing_of_held_out_errors import print_frames_without_pose

if TYPE_CHECKING:
    from calib.api.measuring_limb_acceptance_and_platform_poses import LimbAcceptance
    from calib.certification.measuring_limb_identification_and_agreement import Agreement


def arguments(parser: ArgumentParser) -> None:
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


def run(arguments: Namespace) -> int:
    """Run `rig limbs test`.

    Test measuring limbs against vision, and save accepted ones.
    """
    from calib.api.measuring_limb_acceptance_and_platform_poses import AcceptLimbsOptions, accept_limbs
    from calib.online.accepted_limbs_file import is_limbs_file
    from rig.cli.shared.measurement_and_calibration_summary import print_online_learning_result

    names = None if arguments.use is None else tuple(arguments.use.split(","))
    options = AcceptLimbsOptions(length_and_angle(arguments.tolerance), names, tuple(arguments.argv))
    recording = read_recording(arguments)
    renewed = arguments.out is not None and is_limbs_file(arguments.out)
    out = arguments.outputs.file(arguments.out, own=renewed) if arguments.out else None
    state = arguments.outputs.file(arguments.state, own=True) if arguments.state else None
    page = page_path(arguments)
    result = accept_limbs(recording, options, Progress())
    _print_result(result)
    arguments.result = result.tree()
    if out is not None:
        result.save(out)
        print(f"written: {arguments.out}, verdict {result.accepted.verdict}")
    if page is not None:
        result.write_page(page, page_links(arguments, arguments.page))
        print(f"written: {arguments.page}")
    if state is not None and result.passed:
        progress = Progress()
        learnt = result.learn(arguments.state, progress, notice_printer(progress))
        learnt.save(state)
        print_online_learning_result(learnt)
        print(f"written: {arguments.state}")
    return 0 if result.passed else 1


def _print_result(result: LimbAcceptance) -> None:
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
    from calib.certification.measuring_limb_identification_and_agreement import AXES, MOVES

    print(
        f"measuring limbs minus vision ({source}), {found.n} poses, each by limbs fitted to other stretches; "
        "um and urad:"
    )
    print(
        f"{'':4}{'bias':>9}{'scatter':>9}{'expected':>9}{'limits of agreement':>24}"
        f"{'surely within':>15}{'tolerance':>11}{'moved over':>14}"
    )
    for i, axis in enumerate(AXES):
        low, high = found.limits[:, i] * 1e6
        moved = f"{found.moved[i] * 1e3:.1f} {'mm' if i < 3 else 'mrad'}"
        said = (
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
            f"{moved:>14}  {said}"
        )
