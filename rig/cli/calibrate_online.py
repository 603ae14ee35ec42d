"""rig calibrate online: learn parameters pose by pose.

Of a recording; sudden changes of the machine are reported.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared import refutation_printing_and_writing
from rig.cli.shared.common_options import add_json_result_option, add_page_option, page_links, page_path
from rig.cli.shared.input_options import (
    add_anyway_option,
    add_limb_options,
    add_recording_argument,
    limb_source,
    notice_printer,
    read_recording,
)
from rig.cli.shared.output_display import Progress
from rig.errors import RigError
from rig.formats.numbers_and_units import parse_number

if TYPE_CHECKING:
    from calib.api.online_learning import LearningResult, LearnOptions
    from calib.online.measuring_limb_poses_checked_by_vision import LimbSource

FILTER = "filter"  # the learner of calib.online.information_filter
SETTINGS = {"forgetting": "kept", "drifting": "drift", "first-order": "step"}


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig calibrate online` to a parser."""
    add_recording_argument(parser)
    parser.add_argument(
        "--state",
        metavar="FILE",
        type=Path,
        help="continue from this state if it exists, and save it after the last pose",
    )
    parser.add_argument(
        "--calibration", metavar="FILE", type=Path, help="start from this calibration, not from rig.toml"
    )
    add_page_option(parser)
    add_anyway_option(parser)
    _add_learner_options(parser)
    add_limb_options(parser)
    add_json_result_option(parser)


def _add_learner_options(parser: ArgumentParser) -> None:
    """Add the options that choose a learner (--learner) and its setting."""
    parser.add_argument(
        "--learner",
        choices=(FILTER, *SETTINGS),
        default=FILTER,
        help="filter (the default) reports sudden changes; forgetting: "
        "least squares with directional forgetting; drifting: random-walk parameters; first-order: "
        "gradient steps, no covariance",
    )
    parser.add_argument(
        "--kept",
        type=parse_number,
        metavar="SHARE",
        help="of forgetting: share of the information that a pose retains (default 0.99)",
    )
    parser.add_argument(
        "--drift",
        type=parse_number,
        metavar="M",
        help="of drifting: random-walk step of a parameter per pose (default 1e-7 m)",
    )
    parser.add_argument(
        "--step",
        type=parse_number,
        metavar="M",
        help="of first-order: how far a parameter may have to go (default 1e-3 m)",
    )


def run(arguments: Namespace) -> None:
    """Run `rig calibrate online`.

    Learn parameters from a recording pose by pose, and print sudden changes.
    """
    progress = Progress()
    progress("reading the recording", 0, 1)
    limbs = limb_source(arguments)
    recording = read_recording(arguments)
    from calib.api.online_learning import learn

    state = arguments.outputs.file(arguments.state, own=True) if arguments.state else None
    page, options = page_path(arguments), _options(arguments, limbs)
    result = learn(recording, options, progress, notice_printer(progress))
    if state is not None:
        result.save(state)
    arguments.result = result.tree()
    _print_result(arguments, result)
    if page is not None:
        result.write_page(page, page_links(arguments, arguments.page))
        print(f"written: {arguments.page}")


def _print_result(arguments: Namespace, result: LearningResult) -> None:
    """Print what was learnt, and where the state is."""
    from rig.cli.shared.measurement_and_calibration_summary import print_online_learning_result

    named = arguments.learner == FILTER
    written = [] if arguments.state is None else [f"written: {arguments.state}"]
    found = [result.verdict.line, result.confounds_line]
    print_online_learning_result(result, named)
    print("\n".join([found[1], *written] if named else [*written, *found]))


def _options(arguments: Namespace, limbs: LimbSource | None) -> LearnOptions:
    """How poses are learnt, by the arguments."""
    from calib.api.online_learning import LearnOptions
    from calib.files import calibration_file

    _refuse_other_learners_settings(arguments)
    start = arguments.calibration
    return LearnOptions(
        arguments.state,
        None if start is None else calibration_file.load(start),
        str(start),
        () if start is None else refutation_printing_and_writing.read_and_print_refutations(start),
        arguments.learner,
        getattr(arguments, SETTINGS.get(arguments.learner, ""), None),
        limbs,
        arguments.anyway,
    )


def _refuse_other_learners_settings(arguments: Namespace) -> None:
    """Refuse settings of other learners than the chosen one.

    Raises RigError where one is given
    """
    for learner, setting in SETTINGS.items():
        if learner != arguments.learner and getattr(arguments, setting) is not None:
            raise RigError(f"--{setting} is of --learner {learner}, not of {arguments.learner}")
