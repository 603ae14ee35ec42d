"""rig diagnose: diagnose recordings.

Which effects the model leaves out, where, how large, the evidence.
"""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared import escaped_output_progress_error_table_and_refutations, input_file_options_and_loading
from rig.cli.shared.escaped_output_progress_error_table_and_refutations import Progress, printer_with_joint_names
from rig.cli.shared.input_file_options_and_loading import (
    add_continue_despite_mistakes_option,
    add_recordings_argument,
    notice_printing_function,
    read_recordings,
)
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    SEED,
    add_json_result_option,
    add_overwrite_option,
    page_links,
)
from rig.errors import RigError
from rig.formats.local_and_remote_input_files import json_files_in_same_folders_as
from rig.formats.numbers_and_units import parse_number
from rig.report.axis_places_with_joint_names import text_with_joint_names

if TYPE_CHECKING:
    from calib.api.diagnose import DiagnoseOptions
    from calib.api.next_experiment import ExperimentOptions
    from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import Report
    from rig.recording.recording_folder import Recording

MENTIONED = 4  # remarks, and rows that were left out, in the terminal


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig diagnose` to a parser."""
    add_recordings_argument(parser)
    parser.add_argument(
        "--out", metavar="DIR", type=Path, required=True, help="diagnosis.json and the page are written there"
    )
    parser.add_argument(
        "--calibration",
        metavar="FILE",
        type=Path,
        help="of the same rig from another recording: its joints are assumed known, so that they absorb less",
    )
    parser.add_argument(
        "--only", metavar="EFFECT", action="append", help="test only this effect (or 'EFFECT PLACE'); may be repeated"
    )
    parser.add_argument(
        "--without", metavar="EFFECT", action="append", default=[], help="exclude this effect; may be repeated"
    )
    parser.add_argument(
        "--assume",
        metavar="'EFFECT PLACE'",
        action="append",
        default=[],
        help="assume this effect is present: it is fitted from the "
        "start and retained, whatever the evidence; may be repeated",
    )
    parser.add_argument(
        "--from",
        metavar="DIR",
        type=Path,
        dest="before",
        help="another diagnosis: begin with its findings, each of which must be confirmed here as well",
    )
    input_file_options_and_loading.add_user_effect_files_option(parser)
    _add_experiment_options(parser)
    add_overwrite_option(parser)
    add_continue_despite_mistakes_option(parser)
    add_json_result_option(parser)


def _add_experiment_options(parser: ArgumentParser) -> None:
    """Add --next, how long it may take and what it may do."""
    parser.add_argument(
        "--next",
        metavar="FILE",
        type=Path,
        help="write the plan of the experiment that best distinguishes what is "
        "still ambiguous (frame,t,payload_mass_kg,l1..l6; `rig simulate --plan commands:FILE` simulates it); "
        "next.json states its probability",
    )
    parser.add_argument(
        "--minutes",
        metavar="MIN",
        type=parse_number,
        default=60.0,
        help="for --next: that the experiment may take (default 60)",
    )
    parser.add_argument(
        "--may",
        action="append",
        metavar="payload|wait|'turn cube NAME'",
        help="for --next: what may be requested of an operator, in place of [experiment] in rig.toml; may be repeated",
    )
    parser.add_argument(
        "--standing",
        action="store_true",
        help="for --next: only plans at whose exposures the struts rest, as rig run takes them",
    )


def run(arguments: Namespace) -> None:
    """Run `rig diagnose`.

    Diagnose recordings and write what the model leaves out.
    """
    if arguments.next is None and (arguments.standing or arguments.may):
        raise RigError("--standing and --may are for --next FILE")
    progress = Progress()
    progress("reading the recording", 0, 1)
    recordings = read_recordings(arguments)
    experiment = _experiment_options(arguments)
    from calib.api.diagnose import diagnose
    from rig.recording import frame_selection_and_content_hashes

    out, options = arguments.outputs.folder(arguments.out), _options(arguments, recordings)
    notice = notice_printing_function(progress)
    result = diagnose(recordings, options, progress, notice)
    for path, state, finding in result.against:
        escaped_output_progress_error_table_and_refutations.write_refutation(
            arguments, path, result.recording.name, finding, state
        )
    result.write(out)
    result.write_page(out / "diagnosis.html", page_links(arguments, arguments.out / "diagnosis.html"))
    if experiment is not None:
        found = result.next_experiment(experiment, progress)
        progress.close()
        print("\n".join(found.lines()))
        (out / "next.json").write_text(json.dumps(found.tree(), indent=1) + "\n", encoding="utf-8")
        if found.experiments:
            found.write_plan(arguments.outputs.file(arguments.next))
            print(f"written: {arguments.next}")
    print(text_with_joint_names(str(result), result.recording.design.joint_names))
    _print_report(result.report, result.recording.design.joint_names)
    arguments.outputs.data = frame_selection_and_content_hashes.manifest_lines_of_frame_hashes(
        frame_selection_and_content_hashes.content_hashes_of_frames(result.recording)
    )
    arguments.result = json.loads((out / "diagnosis.json").read_text())
    print(f"written: {arguments.out / 'diagnosis.json'}; look at {arguments.out / 'diagnosis.html'}")


def _options(arguments: Namespace, recordings: list[Recording]) -> DiagnoseOptions:
    """Settings of a diagnosis, from the arguments."""
    from calib.api.diagnose import DiagnoseOptions

    effects = input_file_options_and_loading.load_effect_files(arguments)
    known = arguments.calibration
    return DiagnoseOptions(
        None if arguments.only is None else tuple(arguments.only),
        tuple(arguments.without),
        tuple(arguments.assume),
        arguments.before,
        effects,
        None if known is None else input_file_options_and_loading.load_calibration(known, effects),
        str(known),
        tuple(json_files_in_same_folders_as([recordings[0].folder, arguments.out])),
        arguments.anyway,
        _words(arguments),
    )


def _words(arguments: Namespace) -> tuple[str, ...]:
    """The operator's words, as options."""
    words = (
        ("--only", arguments.only or []),
        ("--without", arguments.without),
        ("--assume", arguments.assume),
        ("--from", [arguments.before]),
        ("--mask", [arguments.mask]),
        ("--effects", arguments.effects),
        ("--calibration", [arguments.calibration]),
    )
    return tuple(f"{option} {text}" for option, texts in words for text in texts if text is not None)


def _print_report(report: Report, joint_names: Sequence[str]) -> None:
    """Print what was found, the biggest first, and what was held out."""
    from calib.diagnosis.report.detectable_size_entries_and_table_rows import detectable_size_line
    from calib.diagnosis.report.diagnosis_sentences_and_table_rows import (
        excluded_outlier_texts,
        finding_line,
        formula_suggestion_sentences,
        outliers_not_excluded_sentence,
        parameter_rows_of_suggested_formula,
    )

    print_line = printer_with_joint_names(joint_names)
    for finding in report.findings:
        print_line(finding_line(finding) + (f" [{finding.said}]" if finding.said else ""))
        if finding.unusual:
            print_line(f"  {finding.unusual}")
        for other in finding.cannot_be_told_from:
            print_line(f"  cannot be distinguished from {other.effect} at {other.place}; {other.experiment}")
    for size in () if report.named else report.detectable:
        print_line(detectable_size_line(size))
    for entry in report.suggestions:
        values = ", ".join(f"{name} {value}" for name, value, _ in parameter_rows_of_suggested_formula(entry))
        print_line(
            f"a formula for it at {entry.place}: {formula_suggestion_sentences(entry)} {values}; `rig "
            "effects --new NAME --from DIR` writes it"
        )
    if report.remarks:
        places = ", ".join(f"{r.effect} at {r.place}" for r in report.remarks[:MENTIONED])
        more = f" and {len(report.remarks) - MENTIONED} more" if len(report.remarks) > MENTIONED else ""
        print_line(f"present, and within tolerances: {places}{more}; see remarks")
    for one in report.left_out[:MENTIONED]:
        frame, place, off, _ = excluded_outlier_texts(one)
        print_line(f"left out: frame {frame}, {place}: {off}")
    if len(report.left_out) > MENTIONED:
        print_line(f"left out: {len(report.left_out) - MENTIONED} more outlying rows; see left_out")
    if report.crowd is not None and report.findings:
        print_line(outliers_not_excluded_sentence(report.crowd))
    for what, fit in report.fits.items():
        scale, unit = (1e6, "um") if fit.unit == "m" else (1, fit.unit)
        before, after, floor = (value * scale for value in (fit.heldout_before, fit.heldout_after, fit.noise_floor))
        print_line(f"held out, {what}: {before:.4g} {unit} before, {after:.4g} after; noise {floor:.4g}")
    if report.confounds is not None:
        print_line(report.confounds.line())


def _experiment_options(arguments: Namespace) -> ExperimentOptions | None:
    """What the next experiment may require, None where none is requested. Raises RigError for what cannot be meant"""
    from calib.api.next_experiment import ExperimentOptions

    may = None if arguments.may is None else tuple(arguments.may)
    found = ExperimentOptions(arguments.minutes, may, arguments.standing, SEED + 1 + len(arguments.further))
    return None if arguments.next is None else found
