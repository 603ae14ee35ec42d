"""Diagnosis of a rig's recordings.

Which physical effects the model leaves out, where and how large.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from calib.api.next_experiment import ExperimentOptions, NextExperiment, diagnosis_questions, next_experiment
from calib.api.recording_check_combination_and_view import check_and_combine_recordings
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.calibration_evidence_verdict_and_claim_check import OfCalibrations
from calib.certification.platform_certification import Progress, ignore_progress
from calib.diagnosis import recording_diagnosis
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import StatedTerms
from calib.diagnosis.left_out_physics_and_refutation_of_calibrations import (
    Refutation,
    refuted_calibrations_of_recording,
    unexplained_findings_and_refutations,
)
from calib.diagnosis.recording_diagnosis import Diagnosis, DiagnosisOptions
from calib.diagnosis.report.diagnosis_json_entries import UNKNOWN
from calib.diagnosis.report.diagnosis_page import figures_of_arm_or_platform, write_diagnosis_page
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import (
    Report,
    diagnosis_report,
    diagnosis_verdict,
    write_diagnosis_json_and_simulation_files,
)
from calib.files import calibration_file
from calib.samples.commanded_and_measured_pose_samples import Sampled, sample_recording
from rig.effects.catalogue.effect_list import Plugin, effect_catalogue_with_user_files
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import (
    Kinds,
    parse_effect_and_place,
    require_known_effect,
)
from rig.errors import RigError
from rig.formats import json_toml_and_yaml_loading
from rig.formats.pandas_tables_of_poses_and_errors import DataFrame, pandas_table
from rig.model.arm_hands_effect_places_and_tolerances import hand_names
from rig.recording.frame_selection_and_content_hashes import content_hashes_of_frames
from rig.recording.recording_folder import Recording
from rig.report.pages.page_templates_and_index_page import Link
from rig.report.verdict_refutations_and_result_display import OneLineRepr, State, Verdict, result_html
from vision.checks.severe_mistake_refusal_and_cube_placement_remarks import (
    Notice,
    ignore_notice,
    recorded_or_sampled_corners,
)

AN_HOUR = ExperimentOptions()
FINDING_COLUMNS = ("effect", "place", "parameter", "value", "low_95", "high_95", "unit")


@dataclass(frozen=True, slots=True, eq=False)
class DiagnoseOptions:
    """only : effects ("EFFECT" or "EFFECT PLACE") that alone are asked for, None for all; without : effects left out
    assume : effects ("EFFECT PLACE") that are there, fitted from the start whatever the recording says of them
    before : folder that another diagnosis wrote, whose findings stand at the beginning; effects : files of effects
    besides the catalogue; calibration : of the same rig from another recording, whose joints count as known; name : of
    that, in words
    calibrations : files that may be calibrations made from this recording, against which findings are held
    anyway : whether to go on though a mistake makes results meaningless; words : the operator's, as options
    """

    only: tuple[str, ...] | None = None
    without: tuple[str, ...] = ()
    assume: tuple[str, ...] = ()
    before: Path | None = None
    effects: tuple[Plugin, ...] = ()
    calibration: Calibration | None = None
    name: str = "the calibration"
    calibrations: tuple[Path, ...] = ()
    anyway: bool = False
    words: tuple[str, ...] = ()

    def stated_terms(self, recording: Recording, kinds: Kinds) -> StatedTerms:
        """What the operator states beforehand. Raises RigError for what this rig cannot have, FileError for what is no
        diagnosis
        """
        before = []
        if self.before is not None:
            path = self.before / "diagnosis.json"
            table = json_toml_and_yaml_loading.load_json(path, "diagnosis", "diagnosis/1")
            for finding in table.tables("findings"):
                name, place = finding.text("effect"), finding.text("place")
                if name not in (*kinds, UNKNOWN):
                    raise RigError(
                        f"{path} found {name}, an unknown effect; if user-defined, name its file with --effects"
                    )
                if name in kinds and not kinds[name].discrete:
                    try:
                        before.append(parse_effect_and_place(f"{name} {place}", recording.design, kinds))
                    except RigError as error:
                        raise RigError(f"{path} is of another rig: {error}") from None
        return StatedTerms(
            tuple(parse_effect_and_place(text, recording.design, kinds) for text in self.assume), tuple(before)
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DiagnosisResult(OneLineRepr):
    """A diagnosis. recording : one, of all; report : Report of it; found : the diagnosis itself; against : what it says
    against calibrations made from the recording
    """

    recording: Recording
    report: Report
    found: Diagnosis
    against: tuple[Refutation, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """The verdict on the recording's model."""
        return diagnosis_verdict(self.report)

    def __str__(self) -> str:
        return self.verdict.line

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(str(self)) + self.report._repr_html_()

    def to_pandas(self) -> DataFrame:
        """DataFrame of FINDING_COLUMNS, a row for each finding's parameter. Raises MissingLibrary without pandas."""
        parameters = [(f, name, value) for f in self.report.findings for name, value in f.parameters.items()]
        rows = [(f.effect, f.place, name, v.value, *(v.ci95 or (None, None)), v.unit) for f, name, v in parameters]
        return pandas_table(FINDING_COLUMNS, rows)

    def write(self, folder: Path) -> None:
        """Write diagnosis.json and what it takes to draw the recording anew."""
        write_diagnosis_json_and_simulation_files(folder, self.found, self.recording, self.report)

    def write_page(self, path: Path, links: Sequence[Link] = ()) -> None:
        """Write the page of it."""
        write_diagnosis_page(
            path,
            self.report,
            figures_of_arm_or_platform(self.found, self.recording, self.report),
            links,
            self.recording.design.joint_names,
        )

    def next_experiment(
        self, options: ExperimentOptions = AN_HOUR, progress: Progress = ignore_progress
    ) -> NextExperiment:
        """NextExperiment that best resolves what is still ambiguous."""
        return next_experiment(diagnosis_questions(self.found), self.recording.design, options, progress)


def diagnose(
    recordings: Recording | Sequence[Recording],
    options: DiagnoseOptions = DiagnoseOptions(),
    progress: Progress | None = None,
    notice: Notice = ignore_notice,
) -> DiagnosisResult:
    """DiagnosisResult of a recording, or of several of one rig jointly, as `rig diagnose` makes it.

    progress : called with (label, done, of), or None; notice : called with lines on what is unlikely in the recording
    Raises RigError for a name that there is not and for a recording whose results would mean nothing, NotEnoughData
        where the recording determines nothing
    """
    prepared = check_and_combine_recordings(recordings, options.anyway, notice, progress)
    recording = prepared.recording
    corners = recording.corners if prepared.joined else recorded_or_sampled_corners(recording)
    if corners is not None:
        prepared.look(corners)
    kinds = effect_catalogue_with_user_files(options.effects)
    for text in (*(options.only or ()), *options.without):
        require_known_effect(text, recording.design, kinds)
    _refuse_same_data(options, recording)
    found, report, sampled = _diagnosed(recording, options, options.stated_terms(recording, kinds), kinds, progress)
    marks = content_hashes_of_frames(recording)
    several = bool(hand_names(recording.design.mechanism))  # of which each hand has a claim of its own
    tested = None if sampled is None or several else sampled.samples
    against = refuted_calibrations_of_recording(report, marks, () if several else options.calibrations, tested)
    refuted = tuple(f"{one.path.name} is refuted: {one.finding}" for one in against if one.state == State.BAD)
    left = unexplained_findings_and_refutations(marks, options.calibrations, False).unexplained
    return DiagnosisResult(
        recording, replace(report, calibrations=OfCalibrations(refuted, left)), found, tuple(against)
    )


def _refuse_same_data(options: DiagnoseOptions, recording: Recording) -> None:
    """Raise RigError where a calibration was made from this very recording, which would count twice."""
    if options.calibration is None:
        return
    same = calibration_file.frames_used_in_calibration(options.calibration, recording)
    if same:
        raise RigError(
            f"{options.name} was made from {len(same)} of the frames of {recording.folder}, which would count twice; "
            "diagnose without it, or "
            "take another recording's"
        )


def _diagnosed(
    recording: Recording, options: DiagnoseOptions, given: StatedTerms, kinds: Kinds, progress: Progress | None
) -> tuple[Diagnosis, Report, Sampled | None]:
    """(the diagnosis, its Report, Sampled or None where nothing was commanded) of a recording of any machine."""
    mechanism = recording.design.mechanism
    if options.calibration is not None and mechanism.axes and mechanism.plates is None:
        raise RigError(
            "--calibration is for hexapods; the geometry of an arm or a chain is always fitted to the recording"
        )
    if options.calibration is not None:
        options.calibration.refuse_other_machine(mechanism, str(recording.folder))
    commanded = recording.commands is not None and bool(mechanism.axes)
    sampled = sample_recording(recording, progress=progress, several_hands=True) if commanded else None
    found = recording_diagnosis.diagnose(
        recording,
        DiagnosisOptions(
            options.only,
            options.without,
            given,
            options.calibration,
            sampled,
            tuple(kinds.values()),
            options.effects,
            options.words,
        ),
        progress,
    )
    return found, diagnosis_report(found), sampled
