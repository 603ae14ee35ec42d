"""Diagnosis of an arm's, or a chain's, recording: findings at joints, intervals, and what is unexplained."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from calib.diagnose.engine.cross_validation import CrossValidation, time_stretch_folds
from calib.diagnose.engine.excluded_outliers import Crowd, LeftOut
from calib.diagnose.engine.lack_of_fit import Covariate, LackOfFit
from calib.diagnose.engine.problem_interface import Progress
from calib.diagnose.engine.selection_inputs import NO_STATED_TERMS, NotAsked, StatedTerms
from calib.diagnose.engine.term_selection import Finding, fit_selected_terms, labelled_progress, select_terms
from calib.diagnose.problems.arm.arm_problem import ArmProblem
from calib.diagnose.problems.arm.excess_scatter import excess_scatter
from calib.diagnose.problems.arm.joint_candidates import joint_candidates
from calib.diagnose.problems.arm.lack_of_fit import lack_of_fit
from calib.diagnose.problems.arm.linearised_poses import FEWEST, Arms, Geometry, linearise_poses
from calib.diagnose.problems.arm.outlier_poses import GATE, GROSS, WildPoses, outlier_poses
from calib.diagnose.problems.arm.pose_fit import Fit, fit_poses
from calib.diagnose.problems.arm.remainder_covariates import ranked_covariates
from calib.diagnose.problems.arm.repeated_commands import Repeats, pose_repeatability
from calib.diagnose.problems.arm.unlisted_joint_effects import suggest_joint_formulas
from calib.diagnose.problems.formula_suggestion import Suggestion
from calib.diagnose.problems.requested_effects import RequestedEffects, require_assumed_effects_testable
from calib.diagnose.problems.temperature_smoothing import smooth_temperatures
from calib.samples.confounded_conditions import Confounds, confounds_of_recordings
from calib.samples.recording_samples import Sampled, sample_recording
from rig.compute.parallel_map import parallel_map
from rig.effects.catalogue.effect_list import ALL
from rig.effects.framework.effect import Effect
from rig.effects.texts.user_effect_files import Plugin
from rig.model.design import Arm, Chain
from rig.recording.recording_folder import Part, Recording
from rig.recording.time_origin import Origin
from vision.pose_uncertainty_prediction import predict_pose_uncertainty

PARTS = 3
ROUNDS = 3  # of searching anew without what turned out to be wild
FINE, COARSE = 30, 6  # stretches of time; every third is held out at once


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutPoses:
    """Residuals (n, k), m and rad, of poses by structures chosen and fitted on other stretches: geometry alone, and
    with effects.

    stretches : how many there were; names : per part, what was chosen on the others
    far : (n,) rad, how far the joint that is farthest stood from any angle that it was fitted at"""

    before: np.ndarray
    after: np.ndarray
    stretches: int
    names: tuple[tuple[str, ...], ...]
    far: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class ArmDiagnosis:
    """recording : its name; source : of the poses; arms : Arms; geometry : Geometry that they are linear about
    arm : Arm or Chain, its geometry fitted beside the findings
    before, fit : Fit by the geometry alone and with all findings; findings : [Finding]; cross_validations : one for
        each
    regions : for each joint, [CrossValidation] of the findings with whole regions of its travel held out in turn
    asked : how many candidates were; not_asked : [NotAsked]; held : [HeldOutPoses], fine stretches first;
        repeats : Repeats or None
    left : [LackOfFit]; covariates : [Covariate] that what is left goes with, the one that explained most before first
    origin : of the owner's clock, which moments are told by
    given : what was said beforehand; said : the operator's words, as options; own : files of effects that were asked
        for besides
    left_out : poses that were left out of all this; crowd : poses that are far off in too many to be left out, or
        None"""

    recording: str
    source: str
    arms: Arms
    geometry: Geometry
    arm: Arm | Chain
    before: Fit
    fit: Fit
    findings: list[Finding]
    cross_validations: list[CrossValidation]
    asked: int
    not_asked: list[NotAsked]
    held: list[HeldOutPoses]
    repeats: Repeats | None
    left: list[LackOfFit]
    regions: list[list[CrossValidation]] = field(default_factory=list)
    covariates: list[Covariate] = field(default_factory=list)
    origin: Origin = Origin()
    given: StatedTerms = StatedTerms()
    said: tuple[str, ...] = ()
    parts: tuple[Part, ...] = ()
    own: tuple[Plugin, ...] = ()
    suggestions: tuple[Suggestion, ...] = ()
    confounds: Confounds | None = None
    left_out: tuple[LeftOut, ...] = ()
    crowd: Crowd | None = None

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The Effects found, in the order of the fit's terms."""
        return tuple(
            one.candidate.effect(one.node, self.fit.theta[self.fit.slices[number]])
            for number, one in enumerate(self.fit.terms)
        )


@threadpool_limits.wrap(limits=1)
def diagnose_arm(
    recording: Recording,
    only: list[str] | None = None,
    without: tuple[str, ...] = (),
    progress: Progress | None = None,
    given: StatedTerms = NO_STATED_TERMS,
    kinds: tuple[type[Effect], ...] = ALL,
    sampled: Sampled | None = None,
) -> ArmDiagnosis:
    """ArmDiagnosis of a Recording of an arm or a chain. only, without : effects, or "effect joint 3"; progress : called
    with (label, done, of)
    given : what is in from the start; kinds : the catalogue, with what a user adds to it; sampled : Sampled of the
    recording where it was measured before, or None

    Raises NotEnoughData where too little was measured, and what calibrating raises
    """
    sampled = sample_recording(recording, progress=progress) if sampled is None else sampled
    sensors, _ = smooth_temperatures(recording.sensors)
    sight = None
    if sampled.measurement is not None and isinstance(recording.design.mechanism, Arm):
        sight = partial(predict_pose_uncertainty, sampled.measurement, recording.design)
    design = replace(recording.design, instrument=sampled.instrument)

    def linear(gone: frozenset[int]) -> tuple[Arms, Geometry]:
        some = sampled.samples.take(~np.isin(sampled.samples.frame, sorted(gone))) if gone else sampled.samples
        arms, found = linearise_poses(some, design, recording.commands, sensors, fewest=0 if gone else FEWEST)
        return replace(arms, assumed=sampled.assumed, sight=sight), found

    done = diagnose_linearised_poses(
        linear, recording.name, sampled.source, RequestedEffects.of(only, without, given, kinds), progress, given=given
    )
    return replace(done, origin=recording.origin, parts=recording.parts, confounds=confounds_of_recordings([recording]))


def diagnose_linearised_poses(
    linear: Callable[[frozenset[int]], tuple[Arms, Geometry]],
    name: str,
    source: str,
    asked: RequestedEffects,
    progress: Progress | None = None,
    coarse: bool = True,
    given: StatedTerms = NO_STATED_TERMS,
) -> ArmDiagnosis:
    """ArmDiagnosis of what is linear: frames' numbers left out as wild -> (Arms of all others, Geometry that they are
    linear about), made anew without them, so that all is as if they had never been measured. coarse : whether long
    stretches are held out as well."""
    (arms, found), wild = linear(frozenset()), WildPoses()
    every = len(arms)
    candidates, not_asked = joint_candidates(arms, asked)
    given = require_assumed_effects_testable(given, candidates, not_asked)
    for _ in range(ROUNDS):
        known, wild = wild.frames, wild.with_more(outlier_poses(arms, arms.left, GROSS), every)
        if wild.frames == known:
            break
        arms, found = linear(wild.frames)
    for turn in range(ROUNDS):
        candidates, not_asked = joint_candidates(arms, asked)
        problem = ArmProblem(arms, candidates, given=given)
        selection = select_terms(problem, progress)
        last = turn == ROUNDS - 1  # what would show only now was searched, and is not left out
        both = wild if last else wild.with_more(outlier_poses(arms, selection.fit.left, GATE), every)
        if both.frames == wild.frames:
            break
        wild = both
        arms, found = linear(wild.frames)
    chosen = selection.fit
    held = _nested_held_out_poses(problem, (FINE, COARSE) if coarse else (FINE,), progress)
    again, fitted = pose_repeatability(chosen), found.at(chosen.theta[: found.basis.shape[1]])
    numbers = [f.number for f in selection.findings]
    proofs = [problem.cross_validation(chosen, number) for number in numbers]
    regions = problem.by_regions(chosen, numbers) if numbers else []
    before, cluster = fit_poses(arms, (), problem.train), problem.policy.cluster
    left, goes_with = lack_of_fit(chosen, cluster), ranked_covariates(before, chosen, cluster)
    suggested = tuple(suggest_joint_formulas(chosen, left))
    left += excess_scatter(chosen, again, goes_with)
    return ArmDiagnosis(
        name,
        source,
        arms,
        found,
        fitted,
        before,
        chosen,
        selection.findings,
        proofs,
        selection.asked,
        not_asked,
        held,
        again,
        left,
        regions,
        goes_with,
        given=given,
        suggestions=suggested,
        left_out=both.left_out,
        crowd=both.crowd,
    )


def _nested_held_out_poses(
    problem: ArmProblem, counts: tuple[int, ...], progress: Progress | None = None
) -> list[HeldOutPoses]:
    """HeldOutPoses of what a problem may fit, over each number of stretches of time: effects are chosen, and all is
    fitted, on two thirds of them at a time."""
    arms, kept = problem.arms, np.ones(len(problem.arms), bool) if problem.train is None else problem.train
    parts = [time_stretch_folds(len(arms), count) % PARTS for count in counts]

    def predicted(one: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
        part = parts[one[0]] == one[1]
        with threadpool_limits(1):
            chosen, bare = fit_selected_terms(replace(problem, train=kept & ~part)), fit_poses(arms, (), kept & ~part)
        return (
            bare.left[part],
            chosen.left[part],
            tuple(f"{t.candidate.name} {t.candidate.place}" for t in chosen.terms),
        )

    things = [(i, k) for i in range(len(counts)) for k in range(PARTS)]
    found = dict(
        zip(
            things,
            parallel_map(
                predicted, things, labelled_progress(progress, "choosing anew without stretches"), items_per_process=1
            ),
        )
    )
    out = []
    for i, (count, part) in enumerate(zip(counts, parts)):
        before, after, far = np.empty(arms.left.shape), np.empty(arms.left.shape), np.empty(len(arms))
        for k in range(PARTS):
            before[part == k], after[part == k], _ = found[i, k]
            far[part == k] = _farthest(arms.q[part == k], arms.q[(part != k) & kept])
        out.append(
            HeldOutPoses(before[kept], after[kept], count, tuple(found[i, k][2] for k in range(PARTS)), far[kept])
        )
    return out


def _farthest(q: np.ndarray, fitted: np.ndarray) -> np.ndarray:
    """(m,) rad: over the joints, the greatest distance of angles q (m, joints) from the nearest of fitted (n,
    joints).
    """
    return np.stack([cKDTree(b[:, None]).query(a[:, None])[0] for a, b in zip(q.T, fitted.T)]).max(axis=0)
