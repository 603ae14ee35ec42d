"""Evidence of a platform's recording for its diagnosis.

Corners and closures about an operating point.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import NotTested, Outliers, StatedTerms
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import CrossValidation
from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import Covariate, LackOfFit
from calib.diagnosis.engine.problem_interface import Progress
from calib.diagnosis.engine.term_confirmation_against_alternative_candidates import Finding
from calib.diagnosis.problems.covariate_functions_smoothed_temperatures_and_repeats import (
    Repeats,
    Suggestion,
    repeatability_of_pairs,
    row_pairs_with_same_command,
)
from calib.diagnosis.problems.detectable_effect_sizes import DetectableSize
from calib.diagnosis.problems.evidence_interface_and_requested_effects import (
    ASSUMED_NOISE,
    RESIDUALS,
    STATED,
    Family,
    HeldOutPoses,
    MeasuredFinding,
    Misfit,
    Noise,
    RequestedEffects,
    Tolerable,
    Value,
    onset_time_with_interval,
    require_assumed_effects_testable,
    value_with_interval_cut_at_bounds,
)
from calib.diagnosis.problems.platform.detectable_platform_effect_sizes import detectable_platform_effect_sizes
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import (
    PlatformCandidate,
    platform_candidates_and_untested_effects,
)
from calib.diagnosis.problems.platform.linearisation_operating_point import (
    OperatingPoint,
    operating_point_source_and_measurement,
    remove_corners_far_from_prediction,
)
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import CLOSURES, CORNERS, LinearisedModel
from calib.diagnosis.problems.platform.marker_swap_detection_and_effect_cross_validation import (
    cross_validate_effect_by_regions,
    cross_validate_effects_for_each_residual_block,
    find_marker_swaps,
    find_outliers,
    operating_point_with_marker_swaps_corrected,
    operating_point_without_outliers,
)
from calib.diagnosis.problems.platform.platform_lack_of_fit_excess_scatter_and_covariates import (
    closure_residuals,
    excess_scatter,
    ranked_covariates,
)
from calib.diagnosis.problems.platform.platform_problem import PlatformFit, PlatformProblem, PlatformSelection
from calib.diagnosis.problems.platform.strut_formula_suggestions import FORMULA_PLACES, suggest_strut_formulas
from calib.diagnosis.problems.platform.tolerance_and_temperature_alternatives import (
    add_temperature_effects_as_alternatives_of_findings,
    separate_findings_within_tolerances,
    widen_intervals_by_temperature_logs_and_tolerances,
)
from calib.diagnosis.problems.pose_noise_excess import (
    PoseResiduals,
    noise_covariance_by_kind,
    noise_factors,
    scaled_pose_covariance,
)
from calib.models.platform.platform_identification import PRIOR
from calib.samples.commanded_and_measured_pose_samples import Sampled
from rig.array_and_json_types import Floats, Integers
from rig.effects.catalogue.effect_list import effect_of_tolerance
from rig.effects.framework.effect_base_class import AT_REST, Effect
from rig.formats.csv_and_parquet_tables_and_time_origin import TimeOrigin
from rig.model.arm_hands_effect_places_and_tolerances import PLACES
from rig.model.design import Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    loop_closure_parameter_jacobian,
    strut_or_axis_jacobian_by_pose,
)
from rig.model.pose import pose_difference
from rig.recording.recording_folder import Recording
from rig.report.verdict_refutations_and_result_display import FieldSummaryRepr
from vision.bundle.marker_and_target_displacements import Move, marker_and_target_displacements

FACE_MOTION = effect_of_tolerance(PLACES)  # what a face is off by, however small


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PlatformEvidence(FieldSummaryRepr):
    """point : OperatingPoint with nothing admitted, faces exchanged put right; covariance : (F, 6, 6) of its poses;
    source : of the poses, in words
    requested : RequestedEffects; given : what is said beforehand
    swapped : discrete effects found before all else; moved : [Move] of the faces of a free body's rig that are not
        where it is stated, measured before all else and taken as measured
    noise_times : {position or rotation: Value} by which the poses' covariance was scaled, over what is stated"""

    point: OperatingPoint
    covariance: Floats
    source: str
    requested: RequestedEffects
    given: StatedTerms
    swapped: tuple[Effect, ...] = ()
    moved: tuple[Move, ...] = ()
    noise_times: dict[str, Value] = field(default_factory=dict)

    @property
    def family(self) -> Family:
        return "struts"

    def gross_outliers(self) -> Outliers:
        return find_outliers(self.point, self.covariance)

    def problem(self, outliers: Outliers) -> tuple[PlatformProblem, list[NotTested]]:
        point = remove_corners_far_from_prediction(operating_point_without_outliers(self.point, outliers))
        candidates, not_tested = platform_candidates_and_untested_effects(point, self.requested)
        return PlatformProblem(
            point, candidates, given=require_assumed_effects_testable(self.given, candidates, not_tested)
        ), not_tested

    def outliers(self, fit: PlatformFit, known: Outliers) -> Outliers:
        at, frames = fit.refined.point, self.point.frames
        more = find_outliers(at, self.covariance[np.searchsorted(frames, at.frames)])
        return known.with_more(more, len(frames), "frames")

    def set_apart_tolerable(
        self, selection: PlatformSelection, left: list[LackOfFit]
    ) -> tuple[PlatformSelection, list[LackOfFit], Tolerable]:
        return separate_findings_within_tolerances(_problem(selection), selection, left)

    def with_temperature_alternatives(self, selection: PlatformSelection) -> PlatformSelection:
        return add_temperature_effects_as_alternatives_of_findings(_problem(selection), selection)

    def suggestions(
        self, selection: PlatformSelection, left: list[LackOfFit], progress: Progress | None
    ) -> list[Suggestion]:
        if not any(one.place.kind in FORMULA_PLACES for one in left):
            return []
        return suggest_strut_formulas(_problem(selection), selection.fit, left, progress)

    def with_widened_intervals(self, selection: PlatformSelection) -> PlatformSelection:
        refined = widen_intervals_by_temperature_logs_and_tolerances(
            selection.fit.refined, _problem(selection).sensitivities
        )
        return replace(selection, fit=replace(selection.fit, refined=refined))

    def with_estimated_noise(self, selection: PlatformSelection) -> "PlatformEvidence | None":
        """The same with the noise of its poses as they scatter, where all do by a common factor; see Capability."""
        model = selection.problem.residual(selection.fit)
        k = model.point
        if self.noise_times or self.point.own is None or k.assumed or not k.axes:
            return None
        times = noise_factors(_pose_residuals(model))
        if times is None:
            return None
        point = replace(self.point, own=scaled_pose_covariance(self.point.own, times))
        return replace(self, point=point, covariance=scaled_pose_covariance(self.covariance, times), noise_times=times)

    def repeats(self, selection: PlatformSelection) -> Repeats | None:
        """Repeats of the poses at rest."""
        k = selection.fit.refined.point
        if not k.axes:
            return None
        pairs = _repeated_at_rest(k)
        left = closure_residuals(selection.fit.refined.model)
        apart = pose_difference(k.T[pairs[:, 0]], k.T[pairs[:, 1]]) if len(pairs) else np.zeros((0, 6))
        return repeatability_of_pairs(pairs, (apart, np.zeros_like(apart)), (left[pairs[:, 0]], left[pairs[:, 1]]))

    def detectable_sizes(self, selection: PlatformSelection) -> list[DetectableSize]:
        return detectable_platform_effect_sizes(_problem(selection), selection.fit)

    def validations_by_region(self, selection: PlatformSelection) -> list[list[CrossValidation]]:
        problem, fit = _problem(selection), selection.fit
        k = fit.refined.point
        if not k.axes:
            return []
        numbers = [f.number for f in selection.findings]
        return [
            [cross_validate_effect_by_regions(fit.refined, n, problem.block(fit.terms[n]), along) for n in numbers]
            for along in k.commanded.at(k.t).T
        ]

    def covariates(self, selection: PlatformSelection) -> list[Covariate]:
        return ranked_covariates(selection.before.refined.model, selection.fit.refined.marginalised)

    def scatter_beyond_noise(
        self, selection: PlatformSelection, left: list[LackOfFit], repeats: Repeats | None, covariates: list[Covariate]
    ) -> list[LackOfFit]:
        return excess_scatter(selection.problem.residual(selection.fit), left)

    def misfits(
        self, selection: PlatformSelection, held: list[HeldOutPoses], repeats: Repeats | None
    ) -> tuple[dict[str, Misfit], str]:
        refined, first = selection.fit.refined, selection.findings[:1]
        k = refined.point
        blocks = {"corners": CORNERS} if k.seen is not None else {}
        blocks |= {"closures": CLOSURES} if k.axes else {}
        found = cross_validate_effects_for_each_residual_block(
            refined, set(range(len(k.effects))), tuple(blocks.values())
        )
        seen = "closures" not in blocks or any(f.score.candidate.seen_alone for f in first)
        misfits = {name: Misfit(v.before, v.after, v.floor, v.unit) for name, v in zip(blocks, found)}
        return misfits, "corners" if seen else "closures"

    def effects(self, selection: PlatformSelection) -> tuple[Effect, ...]:
        """The admitted effects, in the findings' order."""
        return tuple(selection.fit.refined.point.effects[f.number] for f in selection.findings)

    def design(self, selection: PlatformSelection) -> Design | None:
        k = selection.fit.refined.point
        return k.design if k.axes else None

    def measured_findings(self, found: tuple[Effect, ...]) -> tuple[MeasuredFinding, ...]:
        swapped = [
            MeasuredFinding(type(e), e.place, {name: Value(value, "") for name, value in e.values().items()})
            for e in self.swapped
        ]
        return (*swapped, *map(_moved_face, self.moved))

    @property
    def effects_shown_by_instruments(self) -> tuple[Effect, ...]:
        return self.swapped

    def parameters(
        self, selection: PlatformSelection, finding: Finding[PlatformCandidate], origin: TimeOrigin
    ) -> dict[str, Value]:
        refined, number = selection.fit.refined, finding.number
        effect, bound = refined.point.effects[number], refined.at_bounds(number)
        known = {p.name: p for p in effect.parameters_at(effect.place)}
        out = {
            name: Value(value, known[name].unit, [low, high])
            if isinstance(value, list) or isinstance(low, list) or isinstance(high, list)
            else value_with_interval_cut_at_bounds(
                value, known[name].unit, (low, high), known[name].bounds, bound.get(name)
            )
            for name, (value, low, high) in refined.intervals(number).items()
        }
        for p in effect.parameters:
            if p.role in ("moment", "choice") and p.size == 1 and np.isfinite(getattr(effect, p.name)):
                value = getattr(effect, p.name)
                out[p.name] = (
                    Value(value, p.unit)
                    if p.role == "choice"
                    else onset_time_with_interval(refined.point.t, value, origin)
                )
        return out

    def noise(self, selection: PlatformSelection) -> Noise:
        model = selection.fit.refined.model
        k, corners = model.point, model.corners
        covariance = k.own if k.own is not None else corners.pose_covariance(corners.to_local[:, :6])
        if k.seen is None:
            source = ASSUMED_NOISE if k.assumed else STATED
        else:
            source = RESIDUALS if k.seen.stated is None else STATED
        return Noise(
            model.corner_noise() or None,
            _length(covariance[:, :3, :3]),
            _length(covariance[:, 3:, 3:]),
            float(np.sqrt(np.mean(model.strut_noise() - model.closures.scatter**2))) if k.axes else None,
            source,
            self.noise_times,
        )


def platform_evidence(
    recording: Recording,
    requested: RequestedEffects,
    stated_terms: StatedTerms,
    calibration: Calibration | None = None,
    sampled: Sampled | None = None,
    progress: Progress | None = None,
) -> PlatformEvidence:
    """PlatformEvidence of a Recording.

    Raises NotEnoughData where too little was measured, and what measuring raises.
    """
    faces = "auto" if requested.name(FACE_MOTION.name) else "stated"
    point, source, measured = operating_point_source_and_measurement(recording, progress, calibration, faces, sampled)
    moved = (
        [m for m in marker_and_target_displacements(measured.adjustment) if m.moved]
        if measured is not None and measured.places_free
        else []
    )
    discrete = [kind for kind in requested.kinds if kind.discrete and requested.name(kind.name)]
    swapped = [s for s in find_marker_swaps(point, discrete) if _is_exchange_requested(s, requested)]
    covariance = (
        measured.covariance if measured is not None else np.zeros((0, 6, 6)) if point.own is None else point.own
    )
    return PlatformEvidence(
        operating_point_with_marker_swaps_corrected(point, swapped),
        covariance,
        source,
        requested,
        stated_terms,
        tuple(swapped),
        tuple(moved),
    )


def _pose_residuals(model: LinearisedModel) -> PoseResiduals:
    """PoseResiduals of a model's closures, in m, with the stated covariance of its poses."""
    k = model.point
    assert k.own is not None
    left, geometry = closure_residuals(model), loop_closure_parameter_jacobian(k.T, k.platform)
    fitted, A = sum(p.size for e in k.effects for p in e.parameters), strut_or_axis_jacobian_by_pose(k.T, k.platform)
    share = min(fitted / max(left.size - geometry.shape[2], 1), 0.8)  # of the squares, what effects take
    sources = np.broadcast_to(np.eye(k.axes)[:, None], (k.axes, *left.shape))
    if k.axes > 6:  # the six combinations of loops that a pose moves; no noise of poses is in the others
        moved = np.swapaxes(np.linalg.svd(A, full_matrices=False)[0], 1, 2)
        A, geometry, left = moved @ A, moved @ geometry, np.einsum("fij,fj->fi", moved, left)
        sources = np.einsum("fij,sfj->sfi", moved, sources)
    noise = {name: A @ C @ np.swapaxes(A, 1, 2) for name, C in noise_covariance_by_kind(k.own).items()}
    return PoseResiduals(
        left / np.sqrt(1 - share),
        geometry,
        np.full(geometry.shape[2], 1 / PRIOR**2),
        noise,
        sources,
        k.commanded.at(k.t),
        _repeated_at_rest(k),
    )


def _repeated_at_rest(k: OperatingPoint) -> Integers:
    """(n, 2) indices of frames at rest that have the same command."""
    still = np.flatnonzero(np.abs(k.motion(()).path.speed).max(axis=1) < AT_REST)
    return still[row_pairs_with_same_command(k.commanded.at(k.t)[still], ("m",) * k.axes)]


def _problem(selection: PlatformSelection) -> PlatformProblem:
    """The PlatformProblem that a selection was made of."""
    assert isinstance(selection.problem, PlatformProblem)
    return selection.problem


def _moved_face(move: Move) -> MeasuredFinding:
    ends = np.stack([move.by, move.by - move.ci95, move.by + move.ci95])
    parameters = {
        p.name: Value(part[0].tolist(), p.unit, part[1:].tolist())
        for p, part in zip(FACE_MOTION.parameters, (ends[:, :3], ends[:, 3:]))
    }
    return MeasuredFinding(FACE_MOTION, str(move.place), parameters)


def _is_exchange_requested(effect: Effect, requested: RequestedEffects) -> bool:
    """Whether an exchange is asked for at one of its two markers, and left out at neither."""
    places = [str(place) for place in effect.sites_touched()]
    return any(requested.place(effect.name, p) for p in places) and not any(
        f"{effect.name} {p}" in requested.without for p in places
    )


def _length(covariance: Floats) -> float:
    return float(np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean()))
