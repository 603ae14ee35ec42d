"""rig watch: watch a calibration's drift by small visits, recordings repeated from time to time.

Whether it still holds, what changed.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from rig.cli.shared import escaped_output_progress_error_table_and_refutations
from rig.cli.shared.escaped_output_progress_error_table_and_refutations import Progress
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    SEED,
    add_json_option,
    add_overwrite_option,
    add_page_option,
    page_links,
    page_path,
    print_json,
)
from rig.errors import RigError
from rig.formats.numbers_and_units import parse_whole_number
from rig.report.verdict_refutations_and_result_display import exit_status, refutations_of_file

POSES = 12


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig watch` to a parser."""
    parser.add_argument("calibration", metavar="CALIBRATION", type=Path)
    parser.add_argument(
        "visits", metavar="VISIT", type=Path, nargs="*", help="small recordings, in chronological order"
    )
    parser.add_argument(
        "--history",
        metavar="FILE",
        type=Path,
        help="continue from the visits stored there if the file exists, and add these",
    )
    add_json_option(parser)
    parser.add_argument("--skip-unreadable", action="store_true", help="exclude unusable images")
    parser.add_argument("--plan", action="store_true", help="choose the poses of a visit, instead of evaluating visits")
    parser.add_argument(
        "--rig", metavar="RIG.toml", type=Path, help="for --plan: whose platform and gravity set the effect of a load"
    )
    parser.add_argument(
        "--count", type=parse_whole_number, default=POSES, help=f"for --plan: poses of a visit (default {POSES})"
    )
    add_page_option(parser)
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=Path,
        help="for --plan: frame,l1..l6; `rig run RIG.toml --plan commands:FILE` visits them",
    )
    add_overwrite_option(parser)


def run(arguments: Namespace) -> int:
    """Run `rig watch`.

    Choose a visit's poses, or compare visits with a calibration.

    Prints what changed. Exit status 3 where the verdict is bad.
    """
    if arguments.plan:
        if arguments.visits or arguments.history or arguments.page or arguments.out is None:
            raise RigError("--plan takes --out FILE, and neither visits nor a --history nor a --page")
        _plan(arguments)
        return 0
    if arguments.out is not None or arguments.rig is not None:
        raise RigError("--out and --rig are for --plan")
    if not arguments.visits:
        raise RigError("name the visits, recordings in chronological order; or --plan, for the poses that one visits")
    return _watch(arguments)


def _watch(arguments: Namespace) -> int:
    from calib.api.verify_and_watch import watch
    from calib.drift import visit_history
    from calib.drift.visit_history import History
    from calib.files import calibration_file
    from rig.recording import recording_folder as recordings

    progress = Progress()
    calibration, own = (
        calibration_file.load(arguments.calibration),
        visit_history.calibration_file_sha256(arguments.calibration),
    )
    retained = None if arguments.history is None else arguments.outputs.file(arguments.history, own=True)
    page = page_path(arguments)
    known = arguments.history is not None and arguments.history.exists()
    history = visit_history.read_history(arguments.history, own) if known else History(own)
    loaded = [recordings.load_recording(path, arguments.skip_unreadable) for path in arguments.visits]
    refuted = refutations_of_file(arguments.calibration)
    result = watch(calibration, loaded, history, refuted, progress)
    progress.close()
    escaped_output_progress_error_table_and_refutations.print_refutations(arguments.calibration, refuted)
    if retained is not None:
        visit_history.write_history(retained, result.history)
    if page is not None:
        result.write_page(page, arguments.calibration.name, page_links(arguments, arguments.page))
    if result.refutation is not None:
        state, sentence = result.refutation
        escaped_output_progress_error_table_and_refutations.write_refutation(
            arguments, arguments.calibration, result.visits[-1].name, sentence, state
        )
    if arguments.json:
        print_json(result.tree())
    else:
        print("\n".join([result.verdict.line, *result.lines()]))
        if retained is not None:
            print(f"{result.history.number} visits in {arguments.history}")
    return exit_status(result.verdict)


def _plan(arguments: Namespace) -> None:
    from calib.drift.choice_and_order_of_visit_configurations import SIGMAS, choose_visit_configurations
    from calib.files import calibration_file
    from rig.formats.rig_toml import design_from_rig_toml
    from rig.recording import corner_and_pose_csv_tables

    calibration = calibration_file.load(arguments.calibration)
    design = design_from_rig_toml.load_design(arguments.rig) if arguments.rig else None
    out = arguments.outputs.file(arguments.out)
    progress = Progress()
    chosen = choose_visit_configurations(
        calibration, design, arguments.count, SEED, lambda done, of: progress("choosing", done, of)
    )
    progress.close()
    corner_and_pose_csv_tables.write_configurations(out, calibration.correction.fitted.axes, chosen.commands)
    print(
        f"{arguments.count} poses; a pose measured to {SIGMAS[0] * 1e6:g} um and {SIGMAS[1] * 1e6:g} urad, "
        "one visit knows, all "
        "other changes allowed for (k=1; next to it as many evenly spread poses):"
    )
    for name, sigma, even, unit in chosen.expected_accuracy():
        print(f"  {name:24} {sigma:9.3g} {even:9.3g} {unit}")
    print(f"written: {arguments.out}")
