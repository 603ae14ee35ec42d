"""Evidence of an arm's recording for its diagnosis.

Measured poses, linearised about the calibrated geometry.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial

import numpy as np
from scipy.special import chdtri

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import (
    NO_STATED_TERMS,
    Crowd,
    LeftOut,
    NotTested,
    Outliers,
    StatedTerms,
)
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import CrossValidation
from calib.diagnosis.engine.forward_and_backward_term_selection import Selection
from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import Covariate, LackOfFit
from calib.diagnosis.engine.problem_interface import Progress
from calib.diagnosis.engine.term_confirmation_against_alternative_candidates import Finding
from calib.diagnosis.problems.arm.arm_lack_of_fit_covariates_and_joint_formulas import (
    excess_scatter_over_stated_noise,
    ranked_covariates,
    suggest_joint_formulas,
)
from calib.diagnosis.problems.arm.arm_problem import (
    COARSE_PARTS,
    FINE_PARTS,
    ArmProblem,
    held_out_poses_by_nested_selection,
)
from calib.diagnosis.problems.arm.detectable_joint_effect_sizes import detectable_joint_effect_sizes
from calib.diagnosis.problems.arm.finding_parameter_optimisation_and_intervals import (
    finding_parameters,
    term_errors_by_temperature_logs,
)
from calib.diagnosis.problems.arm.joint_effect_candidates_and_effects_seen_by_instruments import (
    JointCandidate,
    findings_of_effects_fitted_before_search,
    fit_of_effects_shown_by_instruments,
    joint_candidates_and_untested_effects,
)
from calib.diagnosis.problems.arm.linearised_poses_and_whitened_columns import (
    Arms,
    Geometry,
    linearised_arm_poses_and_geometry,
)
from calib.diagnosis.problems.arm.robust_fit_of_effect_terms_to_arm_poses import Fit, term_columns
from calib.diagnosis.problems.covariate_functions_smoothed_temperatures_and_repeats import (
    Repeats,
    Suggestion,
    axis_speeds,
    repeatability_of_pairs,
    smoothed_temperatures_and_errors,
    time_cosines,
)
from calib.diagnosis.problems.detectable_effect_sizes import DetectableSize
from calib.diagnosis.problems.evidence_interface_and_requested_effects import (
    ASSUMED_NOISE,
    LEFT,
    STATED,
    Family,
    HeldOutPoses,
    MeasuredFinding,
    Misfit,
    Noise,
    RequestedEffects,
    Value,
    require_assumed_effects_testable,
)
from calib.diagnosis.problems.pose_noise_excess import (
    PoseResiduals,
    noise_covariance_by_kind,
    noise_factors,
    scaled_pose_covariance,
)
from calib.identify.bounded_and_robust_least_squares_fit import MOST, isolated_outlier_rows, robust_fit
from calib.models.arm.joint_effect_fit_and_held_out_scatter import UNSTATED, JointFit
from calib.samples.commanded_and_measured_pose_samples import Sampled, sample_recording
from rig.array_and_json_types import Floats, Integers
from rig.effects.framework.effect_base_class import Effect
from rig.errors import RigError
from rig.formats.csv_and_parquet_tables_and_time_origin import TimeOrigin
from rig.model.design import Design
from rig.model.mechanism_geometry_classes import Arm
from rig.recording.recording_folder import Recording
from rig.report.verdict_refutations_and_result_display import FieldSummaryRepr
from vision.pose_uncertainty_prediction import predict_pose_uncertainty

GROSS, GATE = (
    20.0,
    7.0,
)  # times the scatter of the others, from which a pose may be wild before anything is admitted, and after
SLOW = 4  # cosines of time that are free at each joint
ROWS = 4  # numbers measured for each that is free
REASON = (
    "measured pose and command agree with no other pose, neither the previous and next ones nor those at "
    "joint angles near it"
)
ROUNDS = 3  # of making poses linear anew without what is grossly wild
ArmSelection = Selection[Fit, JointCandidate]


def outlier_poses(arms: Arms, residuals: Floats, gate: float) -> Outliers:
    """Poses that are outliers: their residuals (n, k), m and rad, lie beyond a gate."""
    W = np.linalg.inv(np.linalg.cholesky(arms.own))
    columns = np.concatenate([arms.freedoms, _smooth(arms)], axis=2)[..., : residuals.size // ROWS]
    found = robust_fit([((W @ residuals[..., None])[..., 0], W @ columns)])
    all_off = _relative(found.residual)
    far = isolated_outlier_rows(all_off, arms.t, arms.q, gate)
    if far.sum() > MOST * len(arms):
        return Outliers(crowd=Crowd("poses", int(far.sum()), len(arms)))
    residual = np.linalg.solve(W[far], found.residual[far, :, None])[..., 0]
    left_out = []
    for frame, off, relative in zip(arms.frame[far].tolist(), residual, np.abs(all_off[far])):
        turned = arms.unit == "rad" or int(relative.argmax()) >= 3
        size = float(np.linalg.norm(off[-3:] if turned else off[:3]))
        left_out.append(LeftOut(frame, "pose", "rig", size, "rad" if turned else "m", float(relative.max()), REASON))
    return Outliers(frozenset(arms.frame[far].tolist()), left_out=tuple(left_out))


def _relative(residual: Floats) -> Floats:
    """(n, k) whitened residuals over one scatter of positions and one of rotations, by their middle length: what a
    joint does shows along other axes in every pose."""
    out = np.empty_like(residual)
    for part in (slice(0, 3), slice(3, 6)):
        if residual[:, part].size:
            middle = chdtri(residual[:, part].shape[1], 0.5)
            out[:, part] = residual[:, part] / max(
                float(np.median(np.linalg.norm(residual[:, part], axis=1))) / np.sqrt(middle), 1e-300
            )
    return out


def _smooth(arms: Arms) -> Floats:
    """(n, k, q) what joints may do besides their geometry to what is measured, the plainest first."""
    path = arms.context.moved().path
    functions = [path.direction, axis_speeds(arms.commands, arms.t), path.last_step]
    functions += [np.broadcast_to(c[:, None], arms.q.shape) for c in (*time_cosines(arms.t, SLOW).T, *_varying(arms))]
    scaled = [values / np.abs(values).max() for values in functions if np.any(values)]
    return np.concatenate([arms.joints * values[:, None, :] for values in scaled], axis=2)


def _varying(arms: Arms) -> list[Floats]:
    """[(n,)] of the log's channels that vary, about their means."""
    return [values - values.mean() for values in arms.channels.values() if np.ptp(values) > 0]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ArmEvidence(FieldSummaryRepr):
    """linear : frames' numbers left out as wild -> (Arms of all others, Geometry that they are linear about), made anew
    without them, so that all is as if they had never been measured
    source : of the poses; requested : RequestedEffects; given : what is said beforehand
    stretches : of time, how many are held out, one number for each HeldOutPoses
    log_errors : {channel: (rows, q) K} of the smoothed temperatures, see `smoothed_temperatures_and_errors`
    stated : whether rig.toml or poses.csv state the noise of the poses, which cameras do not measure
    noise_times : {kind of noise: Value} by which the poses' covariance was scaled, over what is stated
    instrument_fit : JointFit of what instruments show by themselves, which was fitted before the search, or None"""

    linear: Callable[[frozenset[int]], tuple[Arms, Geometry]]
    source: str
    requested: RequestedEffects = RequestedEffects()
    given: StatedTerms = NO_STATED_TERMS
    stretches: tuple[int, ...] = (FINE_PARTS, COARSE_PARTS)
    log_errors: Mapping[str, Floats] = field(default_factory=dict)
    stated: bool = False
    noise_times: dict[str, Value] = field(default_factory=dict)
    instrument_fit: JointFit | None = None

    def measured_findings(self, found: tuple[Effect, ...]) -> tuple[MeasuredFinding, ...]:
        fit = self.instrument_fit
        return () if fit is None else findings_of_effects_fitted_before_search(fit, found)

    @property
    def effects_shown_by_instruments(self) -> tuple[Effect, ...]:
        return () if self.instrument_fit is None else self.instrument_fit.effects

    @property
    def family(self) -> Family:
        return "joints"

    def gross_outliers(self) -> Outliers:
        known = Outliers()
        arms, _ = self.linear(known.frames)
        every = len(arms)
        for _ in range(ROUNDS):
            found = known.with_more(outlier_poses(arms, arms.left, GROSS), every, "poses")
            if found.frames == known.frames:
                return found
            known = found
            arms, _ = self.linear(known.frames)
        return known

    def problem(self, outliers: Outliers) -> tuple[ArmProblem, list[NotTested]]:
        arms, geometry = self.linear(outliers.frames)
        candidates, not_tested = joint_candidates_and_untested_effects(arms, self.requested)
        given = require_assumed_effects_testable(self.given, candidates, not_tested)
        return ArmProblem(arms, candidates, given=given, geometry=geometry), not_tested

    def outliers(self, fit: Fit, known: Outliers) -> Outliers:
        every = len(self.linear(frozenset())[0])
        return known.with_more(outlier_poses(fit.arms, fit.left, GATE), every, "poses")

    def with_estimated_noise(self, selection: ArmSelection) -> "ArmEvidence | None":
        """The same with the noise of its poses as they scatter, where nothing shows but scatter; see Capability."""
        fit = selection.fit
        if self.noise_times or not self.stated:
            return None
        scatter = excess_scatter_over_stated_noise(fit, self.repeats(selection), self.covariates(selection))
        if not scatter or any(one.depends_on for one in scatter) or selection.problem.lack_of_fit(fit):
            return None
        times = noise_factors(_pose_residuals(fit))
        if times is None:
            return None
        stated = self.linear

        def linear(gone: frozenset[int]) -> tuple[Arms, Geometry]:
            arms, geometry = stated(gone)
            return replace(arms, own=scaled_pose_covariance(arms.own, times)), geometry

        return replace(self, linear=linear, noise_times=times)

    def held_out_poses(self, selection: ArmSelection, progress: Progress | None) -> list[HeldOutPoses]:
        return held_out_poses_by_nested_selection(_problem(selection), self.stretches, progress)

    def repeats(self, selection: ArmSelection) -> Repeats | None:
        return pose_repeatability(selection.fit)

    def validations_by_region(self, selection: ArmSelection) -> list[list[CrossValidation]]:
        return _problem(selection).by_regions(selection.fit, [f.number for f in selection.findings])

    def covariates(self, selection: ArmSelection) -> list[Covariate]:
        return ranked_covariates(selection.before, selection.fit, selection.problem.policy.cluster)

    def suggestions(
        self, selection: ArmSelection, left: list[LackOfFit], progress: Progress | None
    ) -> list[Suggestion]:
        return suggest_joint_formulas(selection.fit, left)

    def scatter_beyond_noise(
        self, selection: ArmSelection, left: list[LackOfFit], repeats: Repeats | None, covariates: list[Covariate]
    ) -> list[LackOfFit]:
        return excess_scatter_over_stated_noise(selection.fit, repeats, covariates)

    def scatter_beyond_stated(self, selection: ArmSelection) -> tuple[float, bool]:
        beyond, stated = float(np.linalg.norm(selection.fit.scatter[:3])), _length(selection.fit.arms, slice(0, 3))
        return beyond, bool(np.hypot(beyond, stated) > UNSTATED * stated)

    def misfits(
        self, selection: ArmSelection, held: list[HeldOutPoses], repeats: Repeats | None
    ) -> tuple[dict[str, Misfit], str]:
        """Mean position errors, m, or of directions, rad; the floor is that of commands given twice or, without any,
        the instrument's own.
        """
        floor = _length(selection.fit.arms, slice(0, 3)) if repeats is None else repeats.mean
        before, after = (float(np.linalg.norm(left[:, :3], axis=1).mean()) for left in (held[0].before, held[0].after))
        return {"poses": Misfit(before, after, floor, selection.fit.arms.unit)}, "poses"

    def detectable_sizes(self, selection: ArmSelection) -> list[DetectableSize]:
        return detectable_joint_effect_sizes(_problem(selection), selection.fit)

    def frames_set_aside(self, selection: ArmSelection) -> list[int]:
        fit = selection.fit
        return [int(frame) for frame in fit.arms.frame[fit.aside]]

    def contributions(self, selection: ArmSelection) -> tuple[Integers, list[str], Floats]:
        fit, names, sizes = selection.fit, [], []
        for finding in selection.findings:
            candidate, moved = fit.terms[finding.number].candidate, fit.part(finding.number)
            if candidate.joint is not None:
                moved = np.linalg.norm(fit.arms.joints[:, :3, candidate.joint], axis=1) * np.abs(moved)
            names.append(f"{candidate.name} {candidate.place}")
            sizes.append(moved)
        remains = np.linalg.norm(fit.left[:, :3], axis=1)
        return fit.arms.frame, [*names, LEFT], np.stack([*sizes, remains], axis=1)

    def effects(self, selection: ArmSelection) -> tuple[Effect, ...]:
        """The effects found, in the order of the fit's terms."""
        fit = selection.fit
        return tuple(
            one.candidate.effect(one.node, fit.theta[fit.slices[number]]) for number, one in enumerate(fit.terms)
        )

    def design(self, selection: ArmSelection) -> Design:
        """The Design, its arm's or chain's geometry fitted with the findings."""
        geometry, fit = _problem(selection).geometry, selection.fit
        assert geometry is not None
        return replace(fit.arms.context.design, mechanism=geometry.at(fit.theta[: geometry.basis.shape[1]]))

    def parameters(
        self, selection: ArmSelection, finding: Finding[JointCandidate], origin: TimeOrigin
    ) -> dict[str, Value]:
        off = term_errors_by_temperature_logs(selection.fit, finding.number, self.log_errors)
        return finding_parameters(selection.fit, finding, origin, off @ off.T)

    def noise(self, selection: ArmSelection) -> Noise:
        """The instrument's own standard uncertainty of a position and rotation, by length."""
        arms = selection.fit.arms
        return Noise(
            None,
            None if arms.unit == "rad" else _length(arms, slice(0, 3)),
            _length(arms, slice(0, 3) if arms.unit == "rad" else slice(3, 6)) or None,
            None,
            ASSUMED_NOISE if arms.assumed else STATED,
            self.noise_times,
        )


def arm_evidence(
    recording: Recording,
    requested: RequestedEffects,
    stated_terms: StatedTerms,
    calibration: Calibration | None = None,
    sampled: Sampled | None = None,
    progress: Progress | None = None,
) -> ArmEvidence:
    """ArmEvidence of a Recording.

    It is of an arm or a chain, as `diagnose` takes it.
    Raises RigError for a calibration, NotEnoughData where too little was measured, and what calibrating raises.
    """
    if calibration is not None:
        raise RigError(
            "--calibration is for hexapods; the geometry of an arm or a chain is always fitted to the recording"
        )
    known = sample_recording(recording, progress=progress, several_hands=True) if sampled is None else sampled
    shown = known.samples.tilts is not None or known.samples.measured == "direction"
    fresh = known.samples.known is None and shown
    instrument_fit = fit_of_effects_shown_by_instruments(recording, known) if fresh else None
    if instrument_fit is not None:
        known = replace(known, samples=instrument_fit.samples)
    sensors, log_errors = smoothed_temperatures_and_errors(recording.sensors)
    sight = None
    if known.measurement is not None and isinstance(recording.design.mechanism, Arm):
        sight = partial(predict_pose_uncertainty, known.measurement, recording.design)
    design = replace(recording.design, instrument=known.instrument)

    @lru_cache(maxsize=2)
    def linear(gone: frozenset[int]) -> tuple[Arms, Geometry]:
        some = known.samples.take(~np.isin(known.samples.frame, sorted(gone))) if gone else known.samples
        arms, found = linearised_arm_poses_and_geometry(some, design, recording.commands, sensors, refuse_few=not gone)
        return replace(arms, assumed=known.assumed, sight=sight), found

    stated = known.measurement is None and not known.assumed
    return ArmEvidence(
        linear,
        known.source,
        requested,
        stated_terms,
        log_errors=log_errors,
        stated=stated,
        instrument_fit=instrument_fit,
    )


def pose_repeatability(fit: Fit) -> Repeats | None:
    """Repeatability of poses (Repeats).

    They are those that a Fit used; None where too few commands were given twice.
    Residuals under one command differ as the poses do.
    """
    used = np.flatnonzero(fit.used & ~fit.aside)
    pairs = fit.arms.repeated(used)
    one, two = (fit.left[used[pairs[:, which]]] for which in (0, 1))
    return repeatability_of_pairs(pairs, (one, two), (one[:, :3], two[:, :3]), fit.arms.unit)


def _pose_residuals(fit: Fit) -> PoseResiduals:
    """PoseResiduals of a Fit's poses, whitened by what is stated, without what agrees with no model."""
    arms, used = fit.arms, fit.used & ~fit.aside
    W = np.linalg.inv(np.linalg.cholesky(arms.own[used]))
    columns = term_columns(arms, fit.terms).take(used)
    noise = {name: W @ C @ np.swapaxes(W, 1, 2) for name, C in noise_covariance_by_kind(arms.own[used]).items()}
    return PoseResiduals(
        (W @ arms.left[used, :, None])[..., 0],
        W @ columns.at(np.eye(columns.count)),
        fit.prior(),
        noise,
        np.moveaxis(W @ arms.joints[used], 2, 0),
        arms.q[used],
        arms.repeated(used),
    )


def _problem(selection: ArmSelection) -> ArmProblem:
    """The ArmProblem that a selection was made of."""
    assert isinstance(selection.problem, ArmProblem)
    return selection.problem


def _length(arms: Arms, part: slice) -> float:
    """Standard uncertainty by length, of part of what was measured."""
    return float(np.sqrt(np.trace(arms.own[:, part, part], axis1=1, axis2=2).mean()))
