"""rig calibrate: calibrate a rig.

It writes calibration.json with held-out errors, and a page. `rig calibrate online` learns pose by pose: the poses of a
recording are learnt one by one, and sudden changes of the machine are reported.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared import escaped_output_progress_error_table_and_refutations, input_file_options_and_loading
from rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion import make_quantity_parser, parse_length
from rig.cli.shared.escaped_output_progress_error_table_and_refutations import Progress
from rig.cli.shared.input_file_options_and_loading import (
    add_continue_despite_mistakes_option,
    add_limb_options,
    add_recording_argument,
    add_recordings_argument,
    limb_source,
    notice_printing_function,
    read_recording,
    read_recordings,
)
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    add_json_result_option,
    add_overwrite_option,
    add_page_option,
    file_or_stdout,
    page_links,
    page_path,
)
from rig.errors import RigError
from rig.formats.numbers_and_units import parse_number

if TYPE_CHECKING:
    from calib.api.calibrate import CalibrateOptions
    from calib.api.correction_extension_over_configuration_or_pose_space import ExtendOptions
    from calib.api.parameter_learning_pose_by_pose_from_recording import LearningResult, LearnOptions
    from calib.online.measuring_limb_poses_checked_by_vision import LimbSource
    from rig.array_and_json_types import Floats
    from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism


WAYS = ("linear", "simplex", "delaunay", "axes", "radial", "polynomial", "auto")
SPACES = ("configuration", "pose", "both")


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig calibrate` to a parser."""
    add_recordings_argument(parser)
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=file_or_stdout,
        required=True,
        help="calibration.json; the report is written next to it",
    )
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument(
        "--diagnosis",
        metavar="DIR",
        type=Path,
        help="include the effects that `rig diagnose` identified there, refined with the "
        "geometry; rig correct compensates them",
    )
    kind.add_argument("--find", action="store_true", help="diagnose this recording first and include the effects found")
    input_file_options_and_loading.add_user_effect_files_option(parser)
    parser.add_argument(
        "--quick",
        action="store_true",
        help="do not search for unmodelled effects as `rig diagnose` does: the verdict is then at best check",
    )
    parser.add_argument(
        "--joint", action="store_true", help="estimate cameras, lenses and geometry jointly from all corners"
    )
    _add_extension_options(parser)
    parser.add_argument(
        "--promise",
        type=parse_length,
        metavar="20um",
        help="state whether this position error, RMS over the workspace, is met",
    )
    add_limb_options(parser)
    add_overwrite_option(parser)
    add_continue_despite_mistakes_option(parser)
    add_json_result_option(parser)


def _add_extension_options(parser: ArgumentParser) -> None:
    """Add the arguments about --extend to a parser."""
    parser.add_argument(
        "--extend",
        choices=WAYS,
        metavar="WAY",
        help="extend the corrections at the recorded configurations over all of them: "
        f"{', '.join(WAYS[:-1])} (linear and simplex take a grid, as the plan division:2 visits one), or "
        "auto, by held-out error",
    )
    parser.add_argument(
        "--alone",
        action="store_true",
        help="of --extend: correct the nominal model itself, with no geometry fitted first",
    )
    parser.add_argument(
        "--onto",
        metavar="CALIBRATION",
        type=Path,
        help="of --extend: one more pass, on the rig that this calibration corrects: "
        "its residual in the recording is corrected on top; order and count are recorded",
    )
    parser.add_argument(
        "--space",
        choices=SPACES,
        help="of --onto: where the pass maps the residual: over configurations (default), "
        "over poses, or over both, poses then correcting the residual of the first",
    )
    parser.add_argument(
        "--within",
        metavar="PART",
        help="of --onto: the part in which the pass holds, fading beyond: bounds of axes (m or rad) "
        "and of poses (x y z in m, rx ry rz in rad from home), as l1=0.40:0.46,z=0.41: ",
    )


def _write_kinematics_file(out: Path, arguments: Namespace, mechanism: Mechanism) -> None:
    """Write the kinematics file of a mechanism beside a file `out`, where it is not there already."""
    from rig.formats.output_files import STANDARD_OUTPUT
    from rig.formats.rig_toml.mechanism_entries import write_kinematics_file

    places = [out.with_name(name) for name in mechanism.files if out != STANDARD_OUTPUT]
    for place in places:
        folder = place.parent if place.exists() else arguments.outputs.file(place).parent
        write_kinematics_file(folder, mechanism)


def run(arguments: Namespace) -> None:
    """Run `rig calibrate`.

    Calibrate a machine from recordings and write calibration.json.
    """
    progress = Progress()
    progress("reading the recording", 0, 1)
    recordings, options = read_recordings(arguments), _options(arguments)
    from calib.api.calibrate import calibrate, has_axis_correction_summands
    from calib.files import calibration_file
    from rig.cli.shared.measurement_calibration_and_learning_summary_printing import (
        print_calibration,
        print_calibration_verdict_errors_and_corrections,
    )

    out = arguments.outputs.file(arguments.out)
    _write_kinematics_file(arguments.out, arguments, recordings[0].design.mechanism)
    page = arguments.outputs.stage_file(out, ".html")
    links = page_links(arguments, arguments.out.with_suffix(".html")) if page else []
    separate = page is not None and has_axis_correction_summands(recordings[0].design)
    values = arguments.outputs.file(arguments.out.with_name(_values_name(arguments.out))) if separate else None
    missing = arguments.out.with_name(f"{arguments.out.stem}.lost.csv")
    plan = arguments.outputs.file(missing) if options.extend is not None and page is not None else None
    result = calibrate(recordings, options, progress, notice_printing_function(progress))
    calibration_file.write_calibration_json(out, result.calibration)
    if page:
        progress("drawing the page", 0, 1)
        result.write_page(page, links)
    progress.close()
    print_calibration_verdict_errors_and_corrections(result)
    if values is not None:
        try:
            result.write_summands(values)
        except RigError as error:  # the calibration stands without them
            print(f"no correction values: {error}")
    arguments.result = result.tree()
    print_calibration(result, arguments.promise)
    if plan is not None and result.extended is not None:
        _write_lost_vertices(plan, missing, recordings[0].design.mechanism.axes, result.extended.lost)
    print(f"written: {arguments.out}" + (f"; look at {arguments.out.with_suffix('.html')}" if page else ""))


def _write_lost_vertices(plan: Path, path: Path, axes: tuple[str, ...], lost: Floats) -> None:
    """Write and name the plan of a grid's lost vertices (k, axes); without any, remove that of an earlier calibration.

    plan : where it is written until the command ends; path : where it will stand
    """
    from rig.recording.corner_and_pose_csv_tables import write_configurations

    if not len(lost):
        path.unlink(missing_ok=True)
        return
    write_configurations(plan, axes, lost)
    print(f"written: {path}, the plan of the vertices without a pose (rig run --plan commands:{path})")


def _options(arguments: Namespace) -> CalibrateOptions:
    """How a recording is calibrated, by the arguments."""
    from calib.api.calibrate import CalibrateOptions

    return CalibrateOptions(
        arguments.diagnosis,
        arguments.find,
        input_file_options_and_loading.load_effect_files(arguments),
        arguments.quick,
        arguments.joint,
        _extend_options(arguments),
        limb_source(arguments),
        arguments.anyway,
        tuple(arguments.argv),
    )


def _values_name(out: Path) -> str:
    """ksf.csv beside a calibration.json, NAME.ksf.csv beside another NAME.json."""
    return "ksf.csv" if out.stem == "calibration" else f"{out.stem}.ksf.csv"


def _extend_options(arguments: Namespace) -> ExtendOptions | None:
    """How corrections are extended, None where they are not. Raises RigError for incompatible arguments"""
    if not arguments.extend:
        if arguments.alone or arguments.onto:
            raise RigError("--alone and --onto each state the base of --extend; use one of them")
        if arguments.space or arguments.within:
            raise RigError("--space and --within apply to a pass; name with --onto its base")
        return None
    from calib.api.correction_extension_over_configuration_or_pose_space import ExtendOptions
    from calib.files import calibration_file

    onto = None if arguments.onto is None else calibration_file.load(arguments.onto)
    return ExtendOptions(
        arguments.extend, arguments.alone, onto, str(arguments.onto), arguments.space, arguments.within
    )


FILTER = "filter"  # the learner of calib.online.hexapod_information_filter
SETTINGS = {"forgetting": "kept", "drifting": "drift", "first-order": "step"}


def arguments_of_online(parser: ArgumentParser) -> None:
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
    add_continue_despite_mistakes_option(parser)
    _add_learner_options(parser)
    add_limb_options(parser)
    add_json_result_option(parser)


def _add_learner_options(parser: ArgumentParser) -> None:
    """Add the options that choose a learner (--learner) and its setting."""
    parser.add_argument(
        "--learner",
        choices=(FILTER, *SETTINGS),
        help="filter reports sudden changes, for hexapods and their default; drifting is the default of others; "
        "forgetting: "
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
        type=make_quantity_parser("m", "m"),
        metavar="0.1um",
        help="of drifting: random-walk step of a parameter per pose (default 0.1um; a plain number is in m)",
    )
    parser.add_argument(
        "--step",
        type=make_quantity_parser("m", "m"),
        metavar="1mm",
        help="of first-order: how far a parameter may have to go (default 1mm; a plain number is in m)",
    )


def run_online(arguments: Namespace) -> None:
    """Run `rig calibrate online`.

    Learn parameters from a recording pose by pose, and print sudden changes.
    """
    progress = Progress()
    progress("reading the recording", 0, 1)
    limbs = limb_source(arguments)
    recording = read_recording(arguments)
    from calib.api.parameter_learning_pose_by_pose_from_recording import learn

    state = arguments.outputs.file(arguments.state, own=True) if arguments.state else None
    if arguments.state is not None:
        _write_kinematics_file(arguments.state, arguments, recording.design.mechanism)
    page, options = page_path(arguments), _learn_options(arguments, limbs)
    result = learn(recording, options, progress, notice_printing_function(progress))
    if state is not None:
        result.save(state)
    arguments.result = result.tree()
    _print_learnt(arguments, result)
    if page is not None:
        result.write_page(page, page_links(arguments, arguments.page))
        print(f"written: {arguments.page}")


def _print_learnt(arguments: Namespace, result: LearningResult) -> None:
    """Print what was learnt, and where the state is."""
    from rig.cli.shared.measurement_calibration_and_learning_summary_printing import print_online_learning_result

    named = result.is_of_hexapod_filter
    written = [] if arguments.state is None else [f"written: {arguments.state}"]
    found = [result.verdict.line, result.confounds_line]
    print_online_learning_result(result, named)
    print("\n".join([found[1], *written] if named else [*written, *found]))


def _learn_options(arguments: Namespace, limbs: LimbSource | None) -> LearnOptions:
    """How poses are learnt, by the arguments."""
    from calib.api.parameter_learning_pose_by_pose_from_recording import LearnOptions
    from calib.files import calibration_file

    _refuse_other_learners_settings(arguments)
    start = arguments.calibration
    return LearnOptions(
        arguments.state,
        None if start is None else calibration_file.load(start),
        str(start),
        () if start is None else escaped_output_progress_error_table_and_refutations.read_and_print_refutations(start),
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
            raise RigError(f"--{setting} is of --learner {learner}; name that one too")
