"""Diagnosis of a recording of any machine.

Effects, places, sizes with uncertainty, and what has no known effect.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from threadpoolctl import threadpool_limits

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import (
    NO_STATED_TERMS,
    C,
    NotTested,
    Outliers,
    Site,
    StatedTerms,
)
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import CrossValidation
from calib.diagnosis.engine.forward_and_backward_term_selection import Selection, search_further_terms, select_terms
from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import Covariate, LackOfFit
from calib.diagnosis.engine.problem_interface import Fit, Model, Problem, Progress
from calib.diagnosis.engine.removal_of_findings_insignificant_beside_smooth_functions import (
    remove_findings_insignificant_with_smooth_functions,
)
from calib.diagnosis.engine.term_confirmation_against_alternative_candidates import Finding
from calib.diagnosis.problems.covariate_functions_smoothed_temperatures_and_repeats import Repeats, Suggestion
from calib.diagnosis.problems.detectable_effect_sizes import DetectableSize, EffectDetection
from calib.diagnosis.problems.evidence_interface_and_requested_effects import (
    Evidence,
    HeldOutPoses,
    IntervalWidening,
    MeasuredFinding,
    MeasuredFindings,
    Misfit,
    NestedSelection,
    Noise,
    NoiseEstimation,
    RegionValidation,
    RepeatedCommands,
    RequestedEffects,
    TemperatureAlternatives,
    Tolerable,
    ToleratedFindings,
)
from calib.models.platform.platform_identification import require_followers_of_redundant_platform
from calib.samples.commanded_and_measured_pose_samples import Sampled
from calib.samples.position_confounds_and_poses_on_one_clock import Confounds, confounds_of_recordings
from rig.effects.catalogue.effect_list import ALL, Plugin
from rig.effects.framework.effect_base_class import Effect
from rig.formats.csv_and_parquet_tables_and_time_origin import TimeOrigin
from rig.model.design import Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import is_parallel
from rig.recording.recording_folder import Recording, RecordingPart
from rig.report.verdict_refutations_and_result_display import OneLineRepr

ROUNDS = 3  # of explaining anew without what turned out to be wild


@dataclass(frozen=True, slots=True)
class DiagnosisOptions:
    """only, without : names of effects, or "effect place", to which the catalogue is confined or which are left out;
    given : what is in from the start
    calibration : of another recording, whose joints are taken as known to its covariance: what it has not swallowed
    shows, and what has changed since; sampled : Sampled of the recording where it was measured before, or None
    kinds : the catalogue, with what a user adds to it; own : the files that this comes from; operator_statements : the
    operator's words, as options
    detectable_sizes : whether it is determined from which size on each effect would have been found"""

    only: tuple[str, ...] | None = None
    without: tuple[str, ...] = ()
    given: StatedTerms = NO_STATED_TERMS
    calibration: Calibration | None = None
    sampled: Sampled | None = None
    kinds: tuple[type[Effect], ...] = ALL
    own: tuple[Plugin, ...] = ()
    operator_statements: tuple[str, ...] = ()
    detectable_sizes: bool = True


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Diagnosis(OneLineRepr):
    """recording : its name; evidence : what was measured; selection : Selection of the terms that explain it
    design : Design as fitted with the findings, None where nothing was commanded
    cross_validations : one for each finding; regions : for each axis, [CrossValidation] of the findings with whole
        regions of its travel held out in turn, none where nobody holds regions out
    misfits : of all together, by what is looked at; shown_in : in which of them the first finding shows
    held : [HeldOutPoses], fine stretches first; repeats : Repeats or None
    left : [LackOfFit]; tolerable : Tolerable; not_tested : [NotAsked]; noise : Noise
    covariates : [Covariate] that what is left goes with, the one that explained most before first
    suggestions : formulas for what is left; outliers : rows that were left out of all this
    origin : of the owner's clock, which moments are told by; parts : (Part, ..) of several recordings together
    detectable : [DetectableSize] of each effect and place that was asked for and not found, beside the findings
    options : DiagnosisOptions that it was asked with; confounds : of the recording, None where nothing was commanded"""

    recording: str
    evidence: Evidence[Any, Any]
    selection: Selection[Any, Any]
    design: Design | None
    cross_validations: list[CrossValidation]
    regions: list[list[CrossValidation]]
    misfits: dict[str, Misfit]
    shown_in: str
    held: list[HeldOutPoses]
    repeats: Repeats | None
    left: list[LackOfFit]
    tolerable: Tolerable
    not_tested: list[NotTested]
    noise: Noise
    covariates: list[Covariate]
    suggestions: tuple[Suggestion, ...]
    outliers: Outliers
    detectable: list[DetectableSize]
    options: DiagnosisOptions = DiagnosisOptions()
    origin: TimeOrigin = TimeOrigin()
    parts: tuple[RecordingPart, ...] = ()
    confounds: Confounds | None = None

    def __str__(self) -> str:
        terms = self.selection.problem.terms(self.selection.fit)
        found = [f"{terms[f.number].name} at {terms[f.number].place}" for f in self.findings]
        return f"{self.recording}, {len(found)} findings" + (f": {', '.join(found)}" if found else "")

    @property
    def findings(self) -> list[Finding[Any]]:  # Any: candidates, of each kind of machine their own
        """The findings, in the order of their weight."""
        return self.selection.findings

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects found by the search, with their values."""
        return self.evidence.effects(self.selection)

    @property
    def measured_findings(self) -> tuple[MeasuredFinding, ...]:
        """The findings that were measured before anything was searched."""
        return self.evidence.measured_findings(self.effects) if isinstance(self.evidence, MeasuredFindings) else ()

    @property
    def machine_effects(self) -> tuple[Effect, ...]:
        """All effects that make another machine: measured before the search, and found by it."""
        before = self.evidence.effects_shown_by_instruments if isinstance(self.evidence, MeasuredFindings) else ()
        return (*before, *self.effects)


class Explained(NamedTuple):
    """selection : of what explains the evidence; left : [LackOfFit]; tolerable : Tolerable; not_tested : [NotAsked]."""

    selection: Selection[Any, Any]
    left: list[LackOfFit]
    tolerable: Tolerable
    not_tested: list[NotTested]


@threadpool_limits.wrap(limits=1)
def diagnose(
    recording: Recording, options: DiagnosisOptions = DiagnosisOptions(), progress: Progress | None = None
) -> Diagnosis:
    """Diagnosis of a Recording.

    options : DiagnosisOptions; progress : called with (label, done, of), or None
    Raises NotEnoughData where too little was measured, RigError where what is assumed cannot be asked, and what
    measuring and calibrating raise
    """
    if is_parallel(recording.design.mechanism):
        require_followers_of_redundant_platform(recording.design.mechanism)
    requested = RequestedEffects.of(options.only, options.without, options.given, options.kinds)
    evidence = _measured_evidence(recording)(
        recording, requested, options.given, options.calibration, options.sampled, progress
    )
    return replace(
        diagnose_evidence(evidence, recording.name, progress, options.detectable_sizes),
        options=options,
        origin=recording.origin,
        parts=recording.parts,
        confounds=confounds_of_recordings([recording]),
    )


# Any: fits and candidates, of each kind of machine their own
def _measured_evidence(recording: Recording) -> Callable[..., Evidence[Any, Any]]:
    """The function that makes Evidence of a recording of its kind of machine: only what that takes is imported."""
    mechanism = recording.design.mechanism
    if mechanism.axes and not mechanism.closes_loops:
        from calib.diagnosis.problems.arm.arm_recording_evidence import arm_evidence

        return arm_evidence
    from calib.diagnosis.problems.platform.platform_recording_evidence import platform_evidence

    return platform_evidence


def diagnose_evidence(
    evidence: Evidence[Fit, C], name: str, progress: Progress | None = None, detectable_sizes: bool = True
) -> Diagnosis:
    """Diagnosis of Evidence.

    name : of the recording; detectable_sizes : whether they are determined
    """
    explained, outliers = _explained_without_outliers(evidence, progress)
    if isinstance(evidence, NoiseEstimation):
        estimated = evidence.with_estimated_noise(explained.selection)
        if estimated is not None:
            evidence = estimated
            explained, outliers = _explained_without_outliers(evidence, progress, _sites(explained.selection))
    selection, left, tolerable, not_tested = explained
    if isinstance(evidence, TemperatureAlternatives):
        selection = evidence.with_temperature_alternatives(selection)
    held = evidence.held_out_poses(selection, progress) if isinstance(evidence, NestedSelection) else []
    suggestions = tuple(evidence.suggestions(selection, left, progress))
    if isinstance(evidence, IntervalWidening):
        selection = evidence.with_widened_intervals(selection)
    repeats = evidence.repeats(selection) if isinstance(evidence, RepeatedCommands) else None
    covariates = evidence.covariates(selection)
    scatter = evidence.scatter_beyond_noise(selection, left, repeats, covariates)
    regions: list[list[CrossValidation]] = []
    if isinstance(evidence, RegionValidation) and selection.findings:
        regions = evidence.validations_by_region(selection)
    misfits, shown_in = evidence.misfits(selection, held, repeats)
    return Diagnosis(
        recording=name,
        evidence=evidence,
        selection=selection,
        design=evidence.design(selection),
        cross_validations=selection.problem.cross_validations(selection.fit, [f.number for f in selection.findings]),
        regions=regions,
        misfits=misfits,
        shown_in=shown_in,
        held=held,
        repeats=repeats,
        left=[*left, *scatter],
        tolerable=tolerable,
        not_tested=not_tested,
        noise=evidence.noise(selection),
        covariates=covariates,
        suggestions=suggestions,
        outliers=outliers,
        detectable=evidence.detectable_sizes(selection)
        if detectable_sizes and isinstance(evidence, EffectDetection)
        else [],
    )


def _explained_without_outliers(
    evidence: Evidence[Fit, C], progress: Progress | None, first: Sequence[Site] = ()
) -> tuple[Explained, Outliers]:
    """(Explained without outliers, Outliers): beside what explains the evidence, rows show as wild that a large effect
    hid; then all is explained anew without them, from what was found on.
    """
    known = evidence.gross_outliers()
    for turn in range(ROUNDS):
        explained = _explained(evidence, known, progress, first)
        first = _sites(explained.selection)
        # what would show only in the last turn was searched, and is not left out
        found = known if turn == ROUNDS - 1 else evidence.outliers(explained.selection.fit, known)
        if found.left_out == known.left_out:
            break
        known = found
    return explained, found


def _sites(selection: Selection[Fit, C]) -> list[Site]:
    return [(f.score.candidate.name, f.score.candidate.place) for f in selection.findings]


def _without_insignificant_findings(
    problem: Problem[Fit, Model, C], selection: Selection[Fit, C], progress: Progress | None
) -> tuple[Selection[Fit, C], list[LackOfFit]]:
    """(Selection without findings that are none beside smooth functions of what is left, what is left then).

    What such findings hid beside others is searched for once they are gone, and found where it leaves less and is what
    no alternative to one finding would have shown: more names than before, or others for several that explain more.
    """
    left = problem.lack_of_fit(problem.residual(selection.fit))
    retained = remove_findings_insignificant_with_smooth_functions(problem, selection, left)
    removed = {(c.name, c.place) for c in problem.terms(selection.fit)} - set(_sites(retained))
    if not removed:
        return retained, left
    left = problem.lack_of_fit(problem.residual(retained.fit))
    further = search_further_terms(problem, retained, removed, progress) if retained.findings else retained
    if not _exceeds(problem, selection, further, len(removed)):
        return retained, left
    further_left = problem.lack_of_fit(problem.residual(further.fit))
    further = remove_findings_insignificant_with_smooth_functions(problem, further, further_left)
    further_left = problem.lack_of_fit(problem.residual(further.fit))
    is_more = _exceeds(problem, selection, further, len(removed)) and len(further_left) < len(left)
    return (further, further_left) if is_more else (retained, left)


def _exceeds(
    problem: Problem[Fit, Model, C], selection: Selection[Fit, C], further: Selection[Fit, C], removed_count: int
) -> bool:
    """Whether a further Selection has more names than the one that it replaces, or explains more with others for
    several that were removed, by what the numbers of both cost."""
    if len(further.findings) > len(selection.findings):
        return True
    size = problem.size(selection.fit)
    cost, further_cost = (sum(f.score.complexity(size) for f in s.findings) for s in (selection, further))
    return removed_count > 1 and problem.likelihood_ratio(selection.fit, further.fit) > further_cost - cost


def _explained(
    evidence: Evidence[Fit, C], outliers: Outliers, progress: Progress | None, first: Sequence[Site]
) -> Explained:
    """Explained of Evidence without outliers, from terms of these names and places on."""
    problem, not_tested = evidence.problem(outliers)
    selection = select_terms(problem, progress, first)
    problem = selection.problem
    selection, left = _without_insignificant_findings(problem, selection, progress)
    if not isinstance(evidence, ToleratedFindings):
        return Explained(selection, left, Tolerable(), not_tested)
    selection, left, tolerable = evidence.set_apart_tolerable(selection, left)
    return Explained(selection, left, tolerable, not_tested)
