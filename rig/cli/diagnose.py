"""rig diagnose: diagnose recordings: which effects the model leaves out, where, how large, the evidence."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared import calibration_and_effect_files, experiment_planning, recording_checks
from rig.cli.shared.command_options import (
    Progress,
    add_json_result_option,
    add_overwrite_option,
    add_recordings_argument,
    page_links,
)
from rig.errors import RigError
from rig.formats import json_file
from rig.report.verdict import State

if TYPE_CHECKING:
    from calib.certify.calibration_evidence import OfCalibrations
    from calib.diagnose.engine.selection_inputs import StatedTerms
    from calib.diagnose.report.diagnosis_report import Report
    from calib.files.calibration_file import Calibration
    from calib.samples.recording_samples import Sampled
    from rig.effects.framework.effect import Effect
    from rig.effects.texts.effect_text import Kinds
    from rig.effects.texts.user_effect_files import Plugin
    from rig.recording.recording_folder import Recording

MENTIONED = 4  # remarks, and rows that were left out, in the terminal


@dataclass(frozen=True, slots=True)
class Beforehand:
    """calibration : of another recording, or None; given : what is said beforehand; own : files of effects; kinds : all
    that are asked for.
    """

    calibration: Calibration | None
    given: StatedTerms
    own: tuple[Plugin, ...]
    kinds: tuple[type[Effect], ...]


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    add_recordings_argument(parser)
    parser.add_argument(
        "--out", metavar="DIR", type=Path, required=True, help="diagnosis.json and the page are written there"
    )
    parser.add_argument(
        "--calibration",
        metavar="FILE",
        type=Path,
        help="of the same rig from another recording: its joints are taken as known, so that less can hide in them",
    )
    parser.add_argument(
        "--only",
        metavar="EFFECT",
        action="append",
        help="ask for this effect alone (or 'EFFECT PLACE'); may be given again",
    )
    parser.add_argument(
        "--without", metavar="EFFECT", action="append", default=[], help="leave this effect out; may be given again"
    )
    parser.add_argument(
        "--assume",
        metavar="'EFFECT PLACE'",
        action="append",
        default=[],
        help="take this effect to be there: it is fitted from the "
        "start and stays, whatever the recording says of it; may be given again",
    )
    parser.add_argument(
        "--from",
        metavar="DIR",
        type=Path,
        dest="before",
        help="what another diagnosis found: begin with its findings, each of which has to stand here as well",
    )
    calibration_and_effect_files.add_effects_option(parser)
    experiment_planning.add_next_experiment_options(parser)
    add_overwrite_option(parser)
    recording_checks.add_anyway_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Diagnose a recording and write what was found."""
    from rig.effects.texts.effect_text import require_known_effect
    from rig.recording import frame_content_hashes

    experiment_planning.refuse_invalid_experiment_options(arguments)
    progress = Progress()
    progress("reading the recording", 0, 1)
    recording, look, several = recording_checks.load_and_check_recordings(arguments, progress)
    corners = (
        recording.corners
        if recording.corners is not None or several
        else recording_checks.corners_of_image_sample(recording)
    )
    if corners is not None:
        look(corners)
    own = calibration_and_effect_files.load_effect_files(arguments)
    kinds = calibration_and_effect_files.known_effects(own)
    for text in (arguments.only or []) + arguments.without:
        require_known_effect(text, recording.design, kinds)
    out = arguments.outputs.folder(arguments.out)

    calibration = None if arguments.calibration is None else _known(arguments.calibration, recording, own)
    _print(
        _diagnose(
            recording,
            arguments,
            Beforehand(calibration, _given(arguments, recording, kinds), own, tuple(kinds.values())),
            out,
            progress,
        )
    )
    arguments.outputs.data = frame_content_hashes.hash_lines(frame_content_hashes.content_hashes(recording))
    arguments.result = json.loads((out / "diagnosis.json").read_text())
    print(f"written: {arguments.out / 'diagnosis.json'}; look at {arguments.out / 'diagnosis.html'}")


def _given(arguments: Namespace, recording: Recording, kinds: Kinds) -> StatedTerms:
    """What the operator says beforehand. Raises RigError for what this rig cannot have, FileError for what is no
    diagnosis.
    """
    from calib.diagnose.engine.selection_inputs import StatedTerms
    from calib.diagnose.report.diagnosis_json import UNKNOWN
    from rig.effects.texts.effect_text import parse_effect_and_place

    before = []
    if arguments.before is not None:
        path = arguments.before / "diagnosis.json"
        table = json_file.load(path, "diagnosis", "diagnosis/1")
        for finding in table.tables("findings"):
            name, place = finding.text("effect"), finding.text("place")
            if name not in (*kinds, UNKNOWN):
                raise RigError(
                    f"{path} found {name}, and there is no such effect; of your own, name its file with --effects"
                )
            if name in kinds and not kinds[name].discrete:
                try:
                    before.append(parse_effect_and_place(f"{name} {place}", recording.design, kinds))
                except RigError as error:
                    raise RigError(f"{path} is of another rig: {error}") from None
    return StatedTerms(
        tuple(parse_effect_and_place(text, recording.design, kinds) for text in arguments.assume), tuple(before)
    )


def _said(arguments: Namespace) -> tuple[str, ...]:
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


def _diagnose(recording: Recording, arguments: Namespace, known: Beforehand, out: Path, progress: Progress) -> Report:
    """Report of a recording, written to a folder with its page."""
    from calib.diagnose.recording_diagnosis import DiagnosisOptions, diagnose
    from calib.diagnose.report.diagnosis_page import diagnosis_page, machine_view
    from calib.diagnose.report.report_entries import diagnosis_report, write_diagnosis
    from calib.samples.recording_samples import sample_recording

    commanded = recording.commands is not None and recording.design.mechanism.kind != "free"
    sampled = sample_recording(recording, progress=progress) if commanded else None
    options = DiagnosisOptions(
        only=None if arguments.only is None else tuple(arguments.only),
        without=tuple(arguments.without),
        given=known.given,
        calibration=known.calibration,
        sampled=sampled,
        kinds=known.kinds,
        own=known.own,
        said=_said(arguments),
    )
    found = diagnose(recording, options, progress)
    report = diagnosis_report(found)
    report = replace(report, calibrations=_of_calibrations(report, recording, sampled, arguments))
    write_diagnosis(out, found, recording, report)
    diagnosis_page(
        out / "diagnosis.html",
        report,
        machine_view(found, recording, report),
        page_links(arguments, arguments.out / "diagnosis.html"),
    )
    if arguments.next is not None:
        from calib.experiment.diagnosis_questions import diagnosis_questions

        experiment_planning.write_next_experiment_plan(
            arguments, diagnosis_questions(found), recording.design, out, progress
        )
    return report


def _of_calibrations(
    report: Report, recording: Recording, sampled: Sampled | None, arguments: Namespace
) -> OfCalibrations:
    """OfCalibrations beside the recording or the diagnosis that were made from it; each that knows nothing of a finding
    is marked.
    """
    from calib.certify.calibration_evidence import OfCalibrations
    from calib.diagnose.calibration_left_out_physics import refuted_calibrations, unexplained_and_refuted_calibrations
    from rig.recording import frame_content_hashes

    of, paths = (
        frame_content_hashes.content_hashes(recording),
        calibration_and_effect_files.neighbouring_json_files(recording.folder, arguments.out),
    )
    refuted = []
    for path, state, finding in refuted_calibrations(report, of, paths, None if sampled is None else sampled.samples):
        calibration_and_effect_files.write_refutation(arguments, path, recording.name, finding, state)
        refuted += [f"{path.name} is refuted: {finding}"] if state == State.BAD else []
    return OfCalibrations(tuple(refuted), unexplained_and_refuted_calibrations(of, paths, False).unexplained)


def _print(report: Report) -> None:
    """Say what was found, the biggest first, and what was held out."""
    from calib.diagnose.report.diagnosis_verdict import diagnosis_verdict
    from calib.diagnose.report.report_sentences import (
        excluded_row_texts,
        finding_line,
        formula_suggestion_sentences,
        many_outliers_sentence,
        suggestion_rows,
    )

    print(diagnosis_verdict(report).line)
    for finding in report.findings:
        print(finding_line(finding) + (f" [{finding.said}]" if finding.said else ""))
        if finding.unusual:
            print(f"  {finding.unusual}")
        for other in finding.cannot_be_told_from:
            print(f"  cannot be told from {other.effect} at {other.place}; {other.experiment}")
    for entry in report.suggestions:
        values = ", ".join(f"{name} {value}" for name, value, _ in suggestion_rows(entry))
        print(
            f"a formula for it at {entry.place}: {formula_suggestion_sentences(entry)} {values}; `rig "
            "effects --new NAME --from DIR` writes it"
        )
    if report.remarks:
        places = ", ".join(f"{r.effect} at {r.place}" for r in report.remarks[:MENTIONED])
        more = f" and {len(report.remarks) - MENTIONED} more" if len(report.remarks) > MENTIONED else ""
        print(f"there, and within tolerances: {places}{more}; see remarks")
    for one in report.left_out[:MENTIONED]:
        frame, place, off, _ = excluded_row_texts(one)
        print(f"left out: frame {frame}, {place}: {off}")
    if len(report.left_out) > MENTIONED:
        print(f"left out: {len(report.left_out) - MENTIONED} more rows that agree with no others; see left_out")
    if report.crowd is not None and report.findings:
        print(many_outliers_sentence(report.crowd))
    for what, fit in report.fits.items():
        scale, unit = (1e6, "um") if fit.unit == "m" else (1, fit.unit)
        before, after, floor = (value * scale for value in (fit.heldout_before, fit.heldout_after, fit.noise_floor))
        print(f"held out, {what}: {before:.4g} {unit} before, {after:.4g} after; noise {floor:.4g}")
    if report.confounds is not None:
        print(report.confounds.line())


def _known(path: Path, recording: Recording, own: tuple[Plugin, ...]) -> Calibration:
    """Calibration of a file. Raises RigError where it was made from this very recording, which would count twice."""
    from calib.files import calibration_file

    calibration = calibration_and_effect_files.load_calibration(path, own)
    same = calibration_file.frames_used_in_calibration(calibration, recording)
    if same:
        raise RigError(
            f"{path} was made from {len(same)} of the frames of {recording.folder}, which would count twice; "
            "diagnose without it, or "
            "take another recording's"
        )
    return calibration
