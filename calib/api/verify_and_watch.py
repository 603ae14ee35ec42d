"""Verification of a calibration by another recording, and watch of its drift by repeated small visits."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration, refutation_sentence
from calib.certification.calibration_evidence_verdict_and_claim_check import (
    calibration_evidence,
    verify_claim_on_samples,
)
from calib.certification.claim_verification import Verification
from calib.certification.held_out_pose_error_statistics import (
    Figures,
    compare_errors,
    error_statistics,
    errors_before_and_after_correction,
    pose_errors,
)
from calib.certification.held_out_pose_errors_and_distinct_configurations import (
    axis_travel_limits,
    configuration_numbers,
)
from calib.certification.platform_certification import Progress, ignore_progress
from calib.certification.redundant_strut_length_conflict_causing_internal_forces import strut_conflict
from calib.drift import machine_change_hypotheses_verdict_and_sentences
from calib.drift.drift_visits_page import (
    Visit,
    change_alarm_sentence,
    last_visit_verdict,
    sentence_on_effect_omitted_by_calibration,
    write_visits_page,
)
from calib.drift.machine_change_hypotheses_verdict_and_sentences import Verdict as ChangeVerdict
from calib.drift.visit_history import History, add_visit_and_judge_change
from calib.files import calibration_file
from calib.files.calibration_file import SEED
from calib.models.base_and_tool_displacement_between_recordings import samples_without_displacement
from calib.models.base_and_tool_placement import Placement
from calib.models.machine_parameters_and_file_entries import corrected_pose_covariance
from calib.report.verification_page import Verified, refutes_claim, verification_verdict, write_verification_page
from calib.samples.commanded_and_measured_pose_samples import Sampled, Samples, sample_recording
from calib.samples.position_confounds_and_poses_on_one_clock import Confounds, confounds_of_recordings
from rig.array_and_json_types import Floats, Json
from rig.errors import RigError
from rig.formats.numbers_and_units import count_text
from rig.formats.pandas_tables_of_poses_and_errors import DataFrame, pandas_table_of_errors
from rig.model.pose import rms_uncertainty
from rig.recording.corner_and_pose_csv_tables import Poses
from rig.recording.recording_folder import Recording
from rig.report.pages.page_templates_and_index_page import Link
from rig.report.verdict_refutations_and_result_display import OneLineRepr, Refutation, State, Verdict, result_html


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class VerificationResult(OneLineRepr):
    """A verification. recording; sampled : its poses; figures : Verified, all that was found; placement : Placement of
    base and tool that was removed, None where none was
    """

    recording: Recording
    sampled: Sampled
    figures: Verified
    placement: Placement | None = None

    @property
    def verdict(self) -> Verdict:
        """The verdict on the calibration, or where poses were wanted on these."""
        return verification_verdict(self.figures)

    @property
    def refutation(self) -> str | None:
        """Sentence that refutes the calibration's claim, without its full stop; None where nothing does."""
        found = self.figures.found
        return refutation_sentence(found) if found is not None and refutes_claim(self.figures) else None

    def __str__(self) -> str:
        return self.verdict.line

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        held = self.figures.held
        rows = [
            (name, *(f"{x * 1e3:.4f}" for x in figures.position), f"{figures.rotation[0] * 1e3:.4f}")
            for name, figures in (("nominal model", held.before), ("corrected", held.after))
        ]
        head = (f"{count_text(held.after.n, 'pose')}", "position RMS, mm", "95 %, mm", "max, mm", "rotation RMS, mrad")
        return result_html(str(self), self.verdict.rests_on, [head, *rows])

    def to_pandas(self) -> DataFrame:
        """DataFrame of the errors of each pose, `nominal_x_m` .. `corrected_rz_rad`. Raises MissingLibrary without
        pandas.
        """
        shown = self.figures
        errors = {"nominal": shown.before, "corrected": shown.after}
        return pandas_table_of_errors(shown.samples.frame, errors)

    def write_page(self, path: Path, links: Sequence[Link] = ()) -> None:
        """Write the page of it."""
        write_verification_page(path, self.recording.name, self.figures, links)

    def tree(self) -> Json:
        """What `rig verify --json` prints."""
        shown = self.figures
        held, same, claim = shown.held, shown.same, shown.calibration.claim
        tree: Json = {
            "schema": "verification/1",
            "verdict": self.verdict.tree(),
            "unit": {"position": "m", "rotation": "rad"},
            "held_out": not same,
            "frames_used_in_fitting": same,
            "n": held.after.n,
            "before": _side(held.before),
            "after": _side(held.after),
            "measurement_uncertainty": {"position": held.floor[0], "rotation": held.floor[1]},
            "ratio": {"position": held.ratio[0], "ci95": held.ratio[1:]},
            "configurations": held.configurations,
            "unsolved": [{"frame": frame, "reason": reason} for frame, reason in sorted(shown.unsolved.items())],
            "refuted_before": [asdict(one) for one in shown.refutations],
        }
        if claim is not None and claim.after is not None and shown.found is not None:
            parts = {name: {**asdict(part), "kept": part.kept} for name, part in shown.found.parts.items()}
            tree["claim"] = {
                "after": claim.after[0],
                "ratio": claim.ratio,
                "kept": shown.found.kept,
                **parts,
                "offset": shown.found.offset and asdict(shown.found.offset),
                "far": shown.found.far and asdict(shown.found.far),
            }
        if shown.driven is not None:
            tree["wanted"] = {
                **_side(shown.driven[0]),
                "stated_uncertainty": {"position": shown.driven[1][0], "rotation": shown.driven[1][1]},
            }
        if shown.conflict is not None:
            tree["strut_conflict"] = asdict(shown.conflict)
        placement = None if self.placement is None else self.placement.entry()
        return tree | {"placement": placement, "confounds": shown.confounds and shown.confounds.tree()}


def verify(
    calibration: Calibration,
    recording: Recording,
    wanted: Poses | None = None,
    refutations: Sequence[Refutation] = (),
    progress: Progress | None = None,
) -> VerificationResult:
    """VerificationResult of a calibration by a recording, as `rig verify` makes it.

    Of an arm or a chain the errors are without the place of base and tool, as far as that is free or they stand
    elsewhere by more than chance.

    wanted : poses that the recording's frames, in order, were intended to take, or None; refutations : what later
    recordings found against the calibration; progress : called with (label, done, of), or None
    Raises RigError for a recording of another kind of machine and for other poses than frames
    """
    calibration.refuse_other_machine(recording.design.mechanism, str(recording.folder))
    sampled = sample_recording(recording, progress=progress)
    calibration = calibration.of_recorded_hand(recording.design.mechanism)
    recording, sampled, clocks = calibration.on_one_clock(recording, sampled)
    placed = samples_without_displacement(calibration, recording, sampled.samples)
    samples = placed.samples
    label = configuration_numbers(samples.commanded, axis_travel_limits(calibration.correction.nominal))
    before, after = errors_before_and_after_correction(calibration.correction, samples)
    held = compare_errors(before, after, samples.total_covariance(), np.random.default_rng(SEED), label)
    figures = Verified(
        recording.design,
        samples,
        before,
        after,
        held,
        verify_claim_on_samples(calibration, samples, np.random.default_rng(SEED)),
        calibration,
        refutations,
        calibration_file.frames_used_in_calibration(calibration, recording),
        None if wanted is None else _errors_from_wanted_poses(calibration, recording, sampled.samples, wanted),
        sampled.measurement.unsolved if sampled.measurement is not None else {},
        confounds_of_recordings([recording]),
        (*placed.lines, *clocks),
        placed.unexpected,
        strut_conflict(calibration, samples, recording.design.mechanism),
    )
    return VerificationResult(recording, sampled, figures, placed.placement)


def _errors_from_wanted_poses(
    calibration: Calibration, recording: Recording, samples: Samples, wanted: Poses
) -> tuple[Figures, tuple[float, float], Floats]:
    """(Figures of measured against wanted poses, stated standard uncertainty (m, rad) of their difference, the
    differences (n, 6)).
    """
    frames = recording.exposures.times()[0].tolist()
    if len(frames) != len(wanted.frame):
        raise RigError(f"{len(wanted.frame)} poses were wanted, but the recording has {len(frames)} frames")
    T = wanted.T_base_platform[[frames.index(frame) for frame in samples.frame]]
    of_model = corrected_pose_covariance(calibration, T, samples.commanded)
    if wanted.covariance is not None:  # as `rig correct` stated it, of what it knew
        of_model = wanted.covariance[[frames.index(frame) for frame in samples.frame]]
    errors = pose_errors(T, samples)
    return error_statistics(errors), rms_uncertainty(samples.total_covariance() + of_model), errors


def _side(figures: Figures) -> Json:
    """Figures of one side, as JSON has them."""
    names = ("rms", "p95", "max", "mean")
    position, rotation = (*figures.position, figures.mean[0]), (*figures.rotation, figures.mean[1])
    return {"position": dict(zip(names, position)), "rotation": dict(zip(names, rotation)), "bias": figures.bias}


MEASURING = ("camera", "target", "instrument")  # kinds of changes of what measures: the calibration itself stands


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class WatchResult(OneLineRepr):
    """What visits say. history : with these visits; visits : Visit of each; confounds : of each; entries : of each, as
    JSON has them; verdict : on the calibration by the last
    """

    history: History
    visits: tuple[Visit, ...]
    confounds: tuple[Confounds | None, ...]
    entries: tuple[Json, ...]
    verdict: Verdict

    @property
    def refutation(self) -> tuple[State, str] | None:
        """(BAD or CHECK, sentence) of what the last visit says against the calibration, None where it says nothing."""
        last = self.visits[-1]
        if last.allowed:
            return State.CHECK, sentence_on_effect_omitted_by_calibration(last)
        change = last.evidence
        if change.alarm and (change.named is None or change.named.kind not in MEASURING):
            return State.BAD, change_alarm_sentence(change)
        return None

    def __str__(self) -> str:
        return self.verdict.line

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(str(self), self.lines())

    def lines(self) -> list[str]:
        """What each visit says."""
        out: list[str] = []
        for visit, confounds in zip(self.visits, self.confounds):
            out += [*visit.lines, *([] if confounds is None else [f"  {confounds.line()}"])]
        return out

    def tree(self) -> Json:
        """What `rig watch --json` prints."""
        return {"schema": "verdict/1", "verdict": self.verdict.tree(), "visits": list(self.entries)}

    def write_page(self, path: Path, name: str, links: Sequence[Link] = ()) -> None:
        """Write the page of it. name : of the calibration"""
        write_visits_page(path, name, self.visits, self.verdict, links)


def watch(
    calibration: Calibration,
    visits: Sequence[Recording],
    history: History,
    refutations: Sequence[Refutation] = (),
    progress: Progress = ignore_progress,
) -> WatchResult:
    """Watch over a calibration by visits (small recordings, in order).

    Whether it holds and what changed.
    history : of the visits before, `History(calibration_file_sha256(path))` where there are none; refutations : what
    later recordings found against the calibration
    Raises ValueError without visits, and what measuring raises
    """
    if not visits:
        raise ValueError("watching requires at least one visit")
    seen: list[Visit] = []
    entries: list[Json] = []
    of_each: list[Confounds | None] = []
    for k, recording in enumerate(visits):
        progress("visits", k, len(visits))
        scale = history.scale()
        history, change = add_visit_and_judge_change(history, recording, calibration)
        assert history.reference is not None
        confounds = confounds_of_recordings([recording])
        found = _verified(calibration, recording, change)
        claim = None if found is None else {"kept": not found.refutes, "of_limit": found.of_limit}
        entries.append(_tree(change, history, scale) | {"claim": claim, "confounds": confounds and confounds.tree()})
        visit = Visit(history.visits[-1].name, change, (), scale, found)
        names = [one.name for one in history.visits for _ in range(one.visits)]
        lines = machine_change_hypotheses_verdict_and_sentences.change_verdict_lines(
            change, visit.name, names, history.reference, scale, visit.allowed
        )
        seen.append(replace(visit, lines=lines))
        of_each.append(confounds)
    verdict = last_visit_verdict(seen, calibration_evidence(calibration, refutations))
    return WatchResult(history, tuple(seen), tuple(of_each), tuple(entries), verdict)


def _verified(calibration: Calibration, recording: Recording, change: ChangeVerdict) -> Verification | None:
    """The claim held against a first visit that disagrees with the calibration, as `rig verify` holds it; None of other
    visits.
    """
    if not change.alarm or change.chance is None:
        return None
    samples = calibration.with_physics(recording, sample_recording(recording).samples)
    return verify_claim_on_samples(calibration, samples, np.random.default_rng(SEED))


def _tree(verdict: ChangeVerdict, history: History, scale: float) -> Json:
    """What JSON holds of a visit's verdict."""
    named = verdict.named
    return {
        "visit": history.visits[-1].name,
        "number": history.number,
        "changed": verdict.alarm,
        "log_sum": verdict.log_sum,
        "misfit": {"square": verdict.square, "count": verdict.count, "repeats": scale},
        "named": None if named is None or not verdict.alarm else named.name,
        "suspects": [
            {
                "kind": one.kind,
                "name": one.name,
                "since": one.since + 1,
                "odds": one.odds,
                "value": one.value.tolist(),
                "sigma": one.sigma.tolist(),
            }
            for one in verdict.suspects
            if one.odds > 1e-6
        ],
    }
