"""Diagnosis of a platform's, or a hand-moved body's, recording: findings, intervals, and what is unexplained."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from calib.certify.calibration import Calibration
from calib.diagnose.engine.cross_validation import CrossValidation
from calib.diagnose.engine.lack_of_fit import Covariate, LackOfFit
from calib.diagnose.engine.problem_interface import Progress
from calib.diagnose.engine.selection_inputs import NO_STATED_TERMS, NotAsked, StatedTerms
from calib.diagnose.engine.term_selection import remove_unsupported_findings, select_terms
from calib.diagnose.problems.formula_suggestion import Suggestion
from calib.diagnose.problems.platform.effect_candidates import platform_candidates
from calib.diagnose.problems.platform.excess_scatter import excess_scatter
from calib.diagnose.problems.platform.exchanged_markers import correct_marker_swaps, find_marker_swaps
from calib.diagnose.problems.platform.held_out_validation import cross_validate_blocks
from calib.diagnose.problems.platform.interval_widening import widen_intervals
from calib.diagnose.problems.platform.linearised_residuals import CLOSURES, CORNERS, LinearisedModel
from calib.diagnose.problems.platform.operating_point import (
    OperatingPoint,
    operating_point_of_recording,
    without_distant_corners,
)
from calib.diagnose.problems.platform.outlier_frames import Outliers, fit_without_outliers
from calib.diagnose.problems.platform.platform_problem import PlatformProblem, PlatformSelection
from calib.diagnose.problems.platform.remainder_covariates import ranked_covariates
from calib.diagnose.problems.platform.temperature_alternatives import add_temperature_alternatives
from calib.diagnose.problems.platform.tolerable_findings import Remarks, separate_tolerable_findings
from calib.diagnose.problems.platform.unlisted_strut_effects import suggest_strut_formulas
from calib.diagnose.problems.requested_effects import RequestedEffects, require_assumed_effects_testable
from calib.samples.confounded_conditions import Confounds, confounds_of_recordings
from calib.samples.recording_samples import Sampled
from rig.effects.catalogue.effect_list import ALL
from rig.effects.catalogue.face_misplacement import FaceMisplacement
from rig.effects.catalogue.marker_swap import MarkerSwap
from rig.effects.framework.effect import Effect
from rig.effects.texts.user_effect_files import Plugin
from rig.recording.recording_folder import Part, Recording
from rig.recording.time_origin import Origin
from vision.bundle.marker_displacements import Move, marker_displacements


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations of what was measured, cameras known: px of a corner, m and rad of a pose, m of a strut; None
    where there is none.
    """

    corner_px: float | None
    pose_m: float
    pose_rad: float | None
    strut_m: float | None = None


class Explained(NamedTuple):
    """problem : PlatformProblem; selection : of what explains it; left : [LackOfFit]; remarks : Remarks;
    not_asked : [NotAsked].
    """

    problem: PlatformProblem
    selection: PlatformSelection
    left: list[LackOfFit]
    remarks: Remarks
    not_asked: list[NotAsked]


@dataclass(frozen=True, slots=True, eq=False)
class PlatformDiagnosis:
    """recording : its name; source : of the poses, in words; swapped : [MarkerSwap] found before all else
    moved : [Move] of the faces of a free body's rig that are not where it is stated, measured before all else and taken
        as measured
    selection : Selection; cross_validations : one for each finding; fits : of all together, for each block that there
        is ("corners", "closures")
    left : [LackOfFit]; remarks : Remarks; not_asked : [NotAsked]; noise : Noise; origin : of the owner's clock, which
        moments are told by
    covariates : [Covariate] that what is left goes with, the one that explained most before first
    given : what was said beforehand; said : the operator's words, as options
    parts : (Part, ..) of several recordings together; own : files of effects that were asked for besides
    suggestions : formulas for what is left; wild : rows that were left out of all this"""

    recording: str
    source: str
    swapped: list[MarkerSwap]
    moved: list[Move]
    selection: PlatformSelection
    cross_validations: list[CrossValidation]
    fits: dict[str, CrossValidation]
    left: list[LackOfFit]
    remarks: Remarks
    not_asked: list[NotAsked]
    noise: Noise
    covariates: list[Covariate]
    origin: Origin = Origin()
    given: StatedTerms = StatedTerms()
    said: tuple[str, ...] = ()
    parts: tuple[Part, ...] = ()
    own: tuple[Plugin, ...] = ()
    suggestions: tuple[Suggestion, ...] = ()
    confounds: Confounds | None = None
    wild: Outliers = Outliers()

    @property
    def effects(self) -> list[Effect]:
        """The admitted effects, in the findings' order."""
        return [self.selection.fit.refined.point.effects[f.number] for f in self.selection.findings]

    @property
    def fit(self) -> CrossValidation:
        """Of all together, where the first finding shows: in closures where there is none."""
        found = self.selection.findings
        seen = "closures" not in self.fits or bool(found) and found[0].score.candidate.seen_alone
        return self.fits["corners" if seen else "closures"]


@threadpool_limits.wrap(limits=1)
def diagnose_platform(
    recording: Recording,
    only: list[str] | None = None,
    without: tuple[str, ...] = (),
    progress: Progress | None = None,
    calibration: Calibration | None = None,
    given: StatedTerms = NO_STATED_TERMS,
    sampled: Sampled | None = None,
    kinds: tuple[type[Effect], ...] = ALL,
) -> PlatformDiagnosis:
    """PlatformDiagnosis of a Recording.

    only, without : names of effects, or "effect place", to which the catalogue is confined or which are left out
    progress : called with (label, done, of), or None
    calibration : of another recording, whose joints are taken as known to its covariance: what it has not swallowed
    shows, and what has changed since; given : what is in from the start
    sampled : Sampled of the recording where it was measured before, or None; kinds : the catalogue, with what a user
        adds to it
    Raises NotEnoughData where too little was measured, RigError where what is assumed cannot be asked, and what
        measuring raises
    """
    asked = RequestedEffects.of(only, without, given, kinds)
    point, source, measured = operating_point_of_recording(
        recording, progress, calibration, "auto" if asked.name(FaceMisplacement.name) else "stated", sampled
    )
    moved = (
        [m for m in marker_displacements(measured.adjustment) if m.moved]
        if measured is not None and measured.places_free
        else []
    )
    swapped = [s for s in find_marker_swaps(point) if _exchange_asked(s, asked)] if asked.name(MarkerSwap.name) else []
    covariance = (
        measured.covariance if measured is not None else np.zeros((0, 6, 6)) if point.own is None else point.own
    )

    def explained(at: OperatingPoint) -> tuple[Explained, OperatingPoint]:
        found = _explained(without_distant_corners(at), asked, given, progress)
        return found, found.selection.fit.refined.point

    (problem, selection, left, remarks, not_asked), wild = fit_without_outliers(
        correct_marker_swaps(point, swapped), covariance, explained
    )
    selection = add_temperature_alternatives(problem, selection)
    suggested = tuple(suggest_strut_formulas(problem, selection.fit, left, progress))
    selection = replace(
        selection, fit=replace(selection.fit, refined=widen_intervals(selection.fit.refined, problem.sensitivities))
    )
    refined = selection.fit.refined
    left += excess_scatter(problem.residual(selection.fit), left)
    proofs = [problem.cross_validation(selection.fit, f.number) for f in selection.findings]
    blocks = {"corners": CORNERS} if point.seen is not None else {}
    blocks |= {"closures": CLOSURES} if point.axes else {}
    fits = cross_validate_blocks(refined, set(range(len(refined.point.effects))), tuple(blocks.values()))
    return PlatformDiagnosis(
        recording.name,
        source,
        swapped,
        moved,
        selection,
        proofs,
        dict(zip(blocks, fits)),
        left,
        remarks,
        not_asked,
        _noise(refined.model),
        ranked_covariates(selection.before.refined.model, refined.marginalised),
        recording.origin,
        given,
        parts=recording.parts,
        suggestions=suggested,
        confounds=confounds_of_recordings([recording]),
        wild=wild,
    )


def _explained(
    point: OperatingPoint, asked: RequestedEffects, given: StatedTerms, progress: Progress | None
) -> Explained:
    """Explained of an OperatingPoint with nothing admitted."""
    candidates, not_asked = platform_candidates(point, asked)
    problem = PlatformProblem(point, candidates, given=require_assumed_effects_testable(given, candidates, not_asked))
    selection = select_terms(problem, progress)
    left = problem.lack_of_fit(problem.residual(selection.fit))
    stood = len(selection.findings)
    selection = remove_unsupported_findings(problem, selection, left)
    if len(selection.findings) < stood:
        left = problem.lack_of_fit(problem.residual(selection.fit))
    selection, left, remarks = separate_tolerable_findings(problem, selection, left)
    return Explained(problem, selection, left, remarks, not_asked)


def _exchange_asked(effect: MarkerSwap, asked: RequestedEffects) -> bool:
    """Whether an exchange is asked for at one of its two markers, and left out at neither."""
    places = [effect.place, *([f"marker {int(effect.other)}"] if effect.other >= 0 else [])]
    return any(asked.place(effect.name, p) for p in places) and not any(
        f"{effect.name} {p}" in asked.without for p in places
    )


def _noise(model: LinearisedModel) -> Noise:
    k, to_local = model.point, model.corners.to_local[:, :6]
    covariance = k.own if k.own is not None else to_local @ np.swapaxes(to_local, 1, 2)
    return Noise(
        model.corner_noise() or None,
        _length(covariance[:, :3, :3]),
        _length(covariance[:, 3:, 3:]),
        float(np.sqrt(np.mean(model.strut_noise() - model.closures.scatter**2))) if k.axes else None,
    )


def _length(covariance: np.ndarray) -> float:
    return float(np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean()))
