"""Report of a diagnosis, its verdict, and its folder with diagnosis.json (pages are written elsewhere).

The report holds its data, summary, doubts and actions; the folder diagnosis.json, and files to simulate by.
"""

import json
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

from calib.certification.calibration_evidence_verdict_and_claim_check import ALONE, OfCalibrations
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import Crowd, LeftOut
from calib.diagnosis.problems.evidence_interface_and_requested_effects import (
    ASSUMED_NOISE,
    STATED,
    NestedSelection,
    RegionValidation,
    RepeatedCommands,
    ScatterSize,
    Value,
    WeighedPoses,
)
from calib.diagnosis.recording_diagnosis import Diagnosis
from calib.diagnosis.report import diagnosis_sentences_and_table_rows, residual_figures_and_finding_contributions
from calib.diagnosis.report.detectable_size_entries_and_table_rows import DetectableEntry, detectable_size_entries
from calib.diagnosis.report.diagnosis_json_entries import (
    SCHEMA,
    UNKNOWN,
    CovariateEntry,
    EffectsFile,
    FindingEntry,
    FitEntry,
    NotTestedEntry,
    RecordingEntry,
    RemarkEntry,
    SuggestionEntry,
    Unexplained,
    effect_file_entries,
    finding_entry,
    finding_entry_before_search,
    json_tree_of_dataclasses,
    largest_unexplained_part,
    misfit_before_and_after_entry,
    negligible_finding_remark_entries,
    ranked_covariate_entries,
    recording_entries,
    suggested_formula_entries,
    unnamed_finding_entries,
)
from calib.diagnosis.report.diagnosis_sentences_and_table_rows import (
    as_sentence,
    assumed_or_seen_before_suffix,
    finding_size_text,
    finding_title,
    value_text,
)
from calib.diagnosis.report.residual_figures_and_finding_contributions import (
    errors_at_and_beyond_fitted_joint_angles,
    position_error_statistics_and_mean_rotation_error,
)
from calib.samples.position_confounds_and_poses_on_one_clock import Confounds, confound_sentences
from rig.array_and_json_types import Json
from rig.formats import local_and_remote_input_files, machine_geometry_and_effects_json_file
from rig.formats.local_and_remote_input_files import read_text
from rig.formats.output_files import write_text
from rig.model import mechanisms
from rig.recording.recording_folder import Recording
from rig.report.verdict_refutations_and_result_display import (
    Evidence,
    MissingEvidence,
    OneLineRepr,
    Verdict,
    judge_evidence,
    result_html,
)

ROWS = "Examine the excluded rows below: record those configurations again"
TAKE_IN = "Include it in the calibration: `rig calibrate REC --diagnosis DIR --out calibration.json`"

STATE_NOISE = "State the noise that the poses have, position_sigma and rotation_sigma in [instrument] of rig.toml"


@dataclass(frozen=True, slots=True, repr=False)
class Report(OneLineRepr):
    """Of one recording, or of several. start_s : s, by the owner's clock; noise : corner_px, pose_m, pose_rad, strut_m

    findings : biggest first; unexplained : the largest of what has no name; not_asked : what the recording cannot show
    fits : {"corners" | "closures" | "poses": FitEntry}; fit : that of the first finding
    remarks : what is there and is no fault; said : what the operator stated beforehand, as options
    covariates : what the remainder goes with, the one that explained most before first
    recordings : of several, which; own_effects : files of effects that were requested besides the catalogue
    suggestions : formulas for what has no name; confounds : None where nothing was commanded
    left_out : rows that agree with no others, left out before the search
    crowd : what is far off in too many to be left out, or None
    noise_from : "stated", "residuals" (which determine a corner's noise) or "assumed" (that of poses)
    calibrations : of those made from the recording that are beside it
    asked : how many hypotheses, an effect at a place each, were tested
    noise_times : {position or rotation: Value} by which all poses scatter more than is stated, where they do
    detectable : how large each effect would have to be to be found"""

    recording: str
    start_s: float
    noise: dict[str, float | None]
    findings: tuple[FindingEntry, ...]
    unexplained: Unexplained | None
    fits: dict[str, FitEntry]
    fit: FitEntry
    not_asked: tuple[NotTestedEntry, ...]
    remarks: tuple[RemarkEntry, ...] = ()
    covariates: tuple[CovariateEntry, ...] = ()
    said: tuple[str, ...] = ()
    recordings: tuple[RecordingEntry, ...] = ()
    own_effects: tuple[EffectsFile, ...] = ()
    suggestions: tuple[SuggestionEntry, ...] = ()
    more: Json = field(default_factory=dict)
    confounds: Confounds | None = None
    noise_from: str = STATED
    left_out: tuple[LeftOut, ...] = ()
    crowd: Crowd | None = None
    calibrations: OfCalibrations = ALONE
    asked: int = 0
    noise_times: dict[str, Value] = field(default_factory=dict)
    detectable: tuple[DetectableEntry, ...] = ()

    def __str__(self) -> str:
        return summary_sentence(self)

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        rows = [(finding_title(f), finding_size_text(f).removeprefix(", "), f.action or "") for f in self.findings]
        return result_html(str(self), [], [("what", "size", "what to do"), *rows] if rows else [])

    @property
    def named(self) -> list[FindingEntry]:
        """The findings that have a name."""
        return [f for f in self.findings if f.effect != UNKNOWN]

    @property
    def mattering(self) -> list[FindingEntry]:
        """Of those, the ones that change what was held out."""
        return [f for f in self.named if f.matters]

    @property
    def unknown(self) -> list[FindingEntry]:
        """The findings that have none."""
        return [f for f in self.findings if f.effect == UNKNOWN]

    def tree(self) -> Json:
        """The tree of diagnosis.json, without the verdict."""
        apart = ("more", "confounds", "calibrations", "asked", *(() if self.recordings else ("recordings",)))
        own = {f.name: json_tree_of_dataclasses(getattr(self, f.name)) for f in fields(self) if f.name not in apart}
        return {
            "schema": SCHEMA,
            **own,
            "unexplained": json_tree_of_dataclasses(self.unexplained),
            **self.more,
            "crowd": json_tree_of_dataclasses(self.crowd),
            "confounds": self.confounds and self.confounds.tree(),
        }


def summary_sentence(report: Report) -> str:
    """Summary sentence of a Report."""
    worst, left = report.unexplained, ""
    if worst is not None:
        left = (
            f"something at {worst.place} that no catalogued effect explains, {value_text(worst.magnitude, worst.unit)}"
        )
        left += f", correlated with {' and '.join(worst.depends_on)}" if worst.depends_on else ""
    if not report.named:
        clear = diagnosis_sentences_and_table_rows.nothing_found_sentence(
            report.crowd, report.noise_from, report.noise_times
        )
        return f"There is {left}." if left else clear
    main = report.mattering or report.named
    lines = [f"{finding_title(f)}{finding_size_text(f)}{assumed_or_seen_before_suffix(f)}" for f in main]
    fewer = len(report.named) - len(main)
    slight = "1 more is significant but changes" if fewer == 1 else f"{fewer} more are significant but change"
    lines += [f"{slight} held-out errors negligibly"] if fewer else []
    text = "; ".join([*lines, *([f"besides, {left}"] if left else [])])
    doubtful = dict.fromkeys(f.effect.replace("_", " ") for f in main if f.cannot_be_told_from)
    text += (
        f". This recording alone cannot distinguish the {' and the '.join(doubtful)} from alternatives: see its entry"
        if doubtful
        else ""
    )
    return as_sentence(text)


def diagnosis_verdict(report: Report) -> Verdict:
    """Verdict of a Report.

    Check where something that matters is left out of the model or has no name, or where a calibration made from the
    recording leaves something unexplained; bad where the recording refutes such a calibration.
    """
    left, rest, steps = unexplained_sentences(report), missing_evidence_of_report(report), recommended_actions(report)
    besides = tuple(
        MissingEvidence(text, TAKE_IN)
        for text in report.calibrations.unexplained
        if text not in (*left, *(one.text for one in rest))
    )
    message = summary_sentence(report).removesuffix(".")
    return judge_evidence(
        Evidence(
            message[0].lower() + message[1:],
            tuple(steps),
            unexplained=left,
            confounds=confound_sentences(report.confounds),
            missing=(*rest, *besides),
            refuted=report.calibrations.refuted,
            look=TAKE_IN if report.mattering else steps[0],
            named=True,
        )
    )


def unexplained_sentences(report: Report) -> tuple[str, ...]:
    """Sentences on what a Report leaves unexplained."""
    named = [f"the model omits {diagnosis_sentences_and_table_rows.finding_title(f)}" for f in report.mattering]
    unknown = [f"no catalogued effect explains the residual at {f.place}" for f in report.unknown]
    if not report.unknown and report.unexplained is not None:
        unknown = [f"no catalogued effect explains the residual at {report.unexplained.place}"]
    if report.crowd is not None:
        unknown.append("too many rows agree with no others for any to be excluded")
    return tuple(dict.fromkeys([*named, *unknown]))


def missing_evidence_of_report(report: Report) -> tuple[MissingEvidence, ...]:
    """Evidence that a Report lacks ([MissingEvidence]).

    Noise that is not stated, rows left out.

    That is what it assumes and nobody has shown.
    """
    missing = []
    if report.noise_from == ASSUMED_NOISE:
        missing.append(MissingEvidence("the noise is not stated, so unmodelled effects cannot be tested"))
    if report.noise_times:
        missing.append(
            MissingEvidence(diagnosis_sentences_and_table_rows.noise_excess_text(report.noise_times), STATE_NOISE)
        )
    if report.left_out:
        count = len(report.left_out)
        agreeing = f"{count} rows agree with no others and were" if count > 1 else "1 row agrees with no others and was"
        missing.append(MissingEvidence(f"{agreeing} left out", ROWS))
    return tuple(missing)


def write_diagnosis_json(folder: Path, report: Report) -> None:
    """Write diagnosis.json into a folder."""
    tree = report.tree()
    write_text(
        folder / "diagnosis.json",
        json.dumps({"schema": tree["schema"], "verdict": diagnosis_verdict(report).tree(), **tree}, indent=1) + "\n",
    )


def recommended_actions(report: Report) -> list[str]:
    """Recommended actions of a Report."""
    actions = [
        f"{title[0].upper()}{title[1:]}: {f.action}".removesuffix(".")
        for f in report.mattering or report.named
        if f.action and (title := diagnosis_sentences_and_table_rows.finding_title(f))
    ]
    if report.named:
        return [*actions, TAKE_IN]
    if report.suggestions:
        return [
            "Generate its formula and edit it: `rig effects --new NAME --from DIR`, then `rig "
            "diagnose --effects NAME.py`"
        ]
    if report.findings or report.crowd is not None:
        return ["See the correlated covariates below, and record possible causes: temperature, load, time"]
    if report.noise_times:
        return [STATE_NOISE]
    if report.noise_from == ASSUMED_NOISE:
        return [
            "State the noise of the poses, position_sigma and rotation_sigma in [instrument] of rig.toml, "
            "and diagnose again"
        ]
    return ["Nothing: calibrate from this recording, `rig calibrate REC --out calibration.json`"]


def diagnosis_report(diagnosis: Diagnosis) -> Report:
    """Report of a Diagnosis."""
    found = [finding_entry_before_search(one) for one in diagnosis.measured_findings]
    found += [finding_entry(diagnosis, f, proof) for f, proof in zip(diagnosis.findings, diagnosis.cross_validations)]
    fits = {name: misfit_before_and_after_entry(fit) for name, fit in diagnosis.misfits.items()}
    noise = asdict(diagnosis.noise)
    noise_from = noise.pop("source")
    del noise["times"]
    return Report(
        diagnosis.recording,
        diagnosis.origin.shown(0.0),
        noise,
        (*found, *unnamed_finding_entries(diagnosis.left)),
        largest_unexplained_part(diagnosis),
        fits,
        fits[diagnosis.shown_in],
        tuple(NotTestedEntry(s.effect, s.reason) for s in diagnosis.not_tested),
        tuple(negligible_finding_remark_entries(diagnosis)),
        ranked_covariate_entries(diagnosis.covariates),
        diagnosis.options.operator_statements,
        recording_entries(diagnosis.parts),
        effect_file_entries(diagnosis.options.own),
        suggested_formula_entries(diagnosis.suggestions),
        more=held_out_entries(diagnosis),
        confounds=diagnosis.confounds,
        noise_from=noise_from,
        left_out=diagnosis.outliers.left_out,
        crowd=diagnosis.outliers.crowd,
        asked=diagnosis.selection.candidate_count,
        noise_times=diagnosis.noise.times,
        detectable=detectable_size_entries(diagnosis.detectable),
    )


def write_diagnosis_json_and_simulation_files(
    folder: Path, diagnosis: Diagnosis, recording: Recording, report: Report
) -> None:
    """Write diagnosis.json and the files to simulate its findings by into a folder.

    It holds diagnosis.json, and files to simulate its findings by.

    Those where a machine was commanded: machine.json, the recording's own rig.toml, commands, frames and sensors, and
    what each finding does to each pose where that is known.
    report : Report of d
    """
    write_diagnosis_json(folder, report)
    if diagnosis.design is None:
        return
    tree = machine_geometry_and_effects_json_file.machine_dict(diagnosis.design, diagnosis.machine_effects)
    write_text(folder / "machine.json", json.dumps(tree) + "\n")
    copy_recording_files_without_images(folder, recording)
    residual_figures_and_finding_contributions.write_finding_contributions_table(
        folder / "contributions.csv", diagnosis
    )


def copy_recording_files_without_images(folder: Path, recording: Recording) -> None:
    """Copy a recording's files, but no images, into a folder.

    They are rig.toml, commands, frames and sensors, no images.

    Of several recordings, the first one's.
    """
    recording = recording.apart[0].recording
    for name in ("rig.toml", "commands.csv", "frames.csv", "sensors.csv"):
        if local_and_remote_input_files.exists(recording.folder / name):
            write_text(folder / name, read_text(recording.folder / name))


def held_out_entries(diagnosis: Diagnosis) -> Json:
    """Entries of diagnosis.json {key: tree} on held-out errors, and on scatter beyond what is stated."""
    out: Json = {}
    if isinstance(diagnosis.evidence, ScatterSize):
        unit = diagnosis.misfits[diagnosis.shown_in].unit
        out[f"scatter_beyond_stated_{unit}"] = diagnosis.evidence.scatter_beyond_stated(diagnosis.selection)[0]
    if isinstance(diagnosis.evidence, NestedSelection):
        out["held_out"] = [
            {
                "stretches": h.stretches,
                "before": position_error_statistics_and_mean_rotation_error(h.before),
                "after": position_error_statistics_and_mean_rotation_error(h.after),
                **errors_at_and_beyond_fitted_joint_angles(h),
                "chosen": [list(n) for n in h.names],
            }
            for h in diagnosis.held
        ]
    if isinstance(diagnosis.evidence, RegionValidation):
        out["held_out_by_region"] = finding_gains_by_held_out_region(diagnosis)
    if isinstance(diagnosis.evidence, RepeatedCommands):
        out["repeats"] = repeatability_entry(diagnosis)
    if isinstance(diagnosis.evidence, WeighedPoses):
        out["set_aside"] = diagnosis.evidence.frames_set_aside(diagnosis.selection)
    return out


def repeatability_entry(diagnosis: Diagnosis) -> Json | None:
    """Entry on repeatability.

    It says how well poses repeat; None where too few commands were repeated.
    """
    repeats = diagnosis.repeats
    if repeats is None:
        return None
    return {
        "pairs": repeats.pairs,
        f"mean_{repeats.unit}": repeats.mean,
        f"rms_{repeats.unit}": repeats.rms,
        **({} if repeats.unit == "rad" else {"mean_rad": repeats.mean_rad}),
        "remainder_that_repeats": repeats.recurring_share,
    }


def finding_gains_by_held_out_region(diagnosis: Diagnosis) -> list[Json]:
    """Gains by each finding, regions of an axis' travel held out: misfit before and after, m, and standard errors."""
    if diagnosis.design is None:
        return []
    places = mechanisms.axis_place_texts(diagnosis.design.mechanism)
    return [
        {
            "joint": j + 1,
            "place": places[j],
            "findings": [
                {"heldout_before": v.before, "heldout_after": v.after, "gain_sigma": v.gain, "unit": v.unit}
                for v in row
            ],
        }
        for j, row in enumerate(diagnosis.regions)
    ]
