"""Questions that a platform's diagnosis left open.

With predicted outcomes of a plan under each hypothesis.

The rig is taken as the diagnosis has it: cameras where they were last, the geometry and every effect's numbers as sure
as the recordings so far leave them. What is measured anew is corners with the noise that these had (poses, where an
instrument measures), seen by whichever camera sees them; cameras, lenses, geometry and every frame's pose are as free
in it as in a diagnosis.

A question has, for one finding, the hypotheses that are still alike, each fitted with all that is free, and their odds.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from calib.diagnosis.engine.linear_residual_model import Column, join_columns
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import (
    Sensitivities,
    effect_coordinates_and_directions,
)
from calib.diagnosis.problems.platform.joint_refinement_of_cameras_geometry_poses_and_effects import Refinement
from calib.diagnosis.problems.platform.linearisation_operating_point import OperatingPoint, remounted_cube_seats
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import LinearisedModel, linearise
from calib.diagnosis.problems.platform.linearised_corners import remounted_cube_pose_nuisances
from calib.diagnosis.problems.platform.marker_swap_detection_and_effect_cross_validation import (
    residual_change_column_with_only_effects,
)
from calib.diagnosis.problems.platform.platform_problem import PlatformProblem
from calib.diagnosis.problems.platform.tolerance_and_temperature_alternatives import WARM
from calib.diagnosis.recording_diagnosis import Diagnosis
from calib.experiment.arm_diagnosis_questions_and_predicted_recording import (
    design_with_fitted_geometry_and_cameras,
    operating_point_of_last_recording,
    operating_point_with_turned_cubes,
    predicted_operating_point,
    predicted_poses,
    predicted_sensor_log,
)
from calib.experiment.experiment_questions_and_information import (
    Hypothesis,
    PerFrame,
    Prediction,
    Question,
    Rival,
    deviance_of_alternative,
    is_alternative_ruled_out,
    predictions_with_unlisted_hypothesis,
    rival_hypotheses_with_odds,
)
from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.effect_checks_and_fit_coordinates import Coordinate
from rig.errors import RigError
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import SEAT
from rig.planning.timed_plan_and_visiting_order import Plan

WEAK = 1e-12  # of the greatest eigenvalue; directions below are none


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """A plan's recording under each hypothesis. fits : [Refinement] of each; model : LinearisedModel under the first;
    other : OperatingPoint under the last; columns : [Column] of each one's own numbers; moved : [Column (1)] of what is
        seen otherwise than under the first
    shapes : [Column (1)] of what each does"""

    fits: list[Refinement]
    model: LinearisedModel
    other: OperatingPoint
    columns: list[Column]
    moved: list[Column]
    shapes: list[Column]


@dataclass(frozen=True, slots=True, eq=False)
class PlatformQuestion(Question[Refinement]):
    """Of a platform on struts."""

    @property
    def follows_temperature(self) -> bool:
        return any(type(h.fitted.point.effects[h.number]) in WARM for h in self.named)

    def predict_outcomes(self, plan: Plan, warmer: float = 0.0) -> Prediction:
        return _predict_outcomes(self, plan, warmer)

    def predicted_outcomes_of_two_likeliest_hypotheses(self, plan: Plan) -> PerFrame:
        return predicted_outcomes_of_two_likeliest_hypotheses(self, plan)


def _predict_outcomes(question: PlatformQuestion, plan: Plan, temperature_rise: float = 0.0) -> Prediction:
    """Prediction of a question's hypotheses under a plan. temperature_rise : K, than it was in the first recording
    Raises RigError where the rig as found cannot follow it, or no camera sees some of it
    """
    named, seen = question.named, _seen(question, plan, temperature_rise)
    fits, model = seen.fits, seen.model
    counts = [c.count for c in seen.columns]
    everything = join_columns([Column(c.parts) for c in (*seen.columns, *seen.moved, *seen.shapes)])
    found = model.linear.project(everything)
    values, vectors = np.linalg.eigh(found.gram)
    strong = values > WEAK * values[-1]
    beyond = (vectors[:, strong] * np.sqrt(values[strong])).T  # (k, columns) of what nuisances leave
    parts = np.split(np.concatenate([found.onto, beyond]), np.cumsum([*counts, len(named)])[: len(counts) + 1], axis=1)
    nuisances = np.concatenate(
        [np.linalg.pinv(model.nuisances.solve), np.zeros((int(strong.sum()), len(model.nuisances.names)))]
    )
    means, covariances = parts[len(counts)].T, []
    for fit, tangent in zip(fits, parts):
        spread = np.concatenate([nuisances, tangent], axis=1)
        known = _known(fit, model)
        covariances.append(spread @ known @ spread.T + np.eye(len(spread)))
    cosines = _cosines(named, fits, model, parts[-1], nuisances)
    return predictions_with_unlisted_hypothesis(question, Prediction(means, np.array(covariances), cosines), parts[-1])


def predicted_outcomes_of_two_likeliest_hypotheses(question: PlatformQuestion, plan: Plan) -> PerFrame:
    """Predicted outcomes by frame (PerFrame) of a question's two likeliest hypotheses.
    Raises what `_predict_outcomes` raises, and ValueError for a question of one name
    """
    seen = _seen(replace(question, hypotheses=question.likeliest), plan)
    model, F = seen.model, len(plan.t)
    P = np.linalg.pinv(model.nuisances.solve)
    values, vectors = np.linalg.eigh(_known(seen.fits[0], model))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    difference, own = seen.moved[1], seen.columns[0]
    of, onto, left = np.zeros(F), np.zeros((F, len(root))), np.zeros((F, len(root), len(root)))
    for n, block in enumerate(model.linear.blocks):
        d, basis, tangent = (c.parts[n] for c in (difference, model.linear.columns, own))
        if d is None or not len(d):
            continue
        table = (
            np.concatenate(
                [np.asarray(basis) @ P, np.zeros((len(d), own.count)) if tangent is None else tangent], axis=1
            )
            @ root
        )
        for f, (a, b) in enumerate(zip(block.edges[:-1], block.edges[1:])):
            of[f] += d[a:b, 0] @ d[a:b, 0]
            onto[f] += table[a:b].T @ d[a:b, 0]
            left[f] += table[a:b].T @ table[a:b]
    return PerFrame(of, onto, left, _by_camera(model, seen.other) if model.point.seen is not None else {})


def _by_camera(model: LinearisedModel, other: OperatingPoint) -> dict[str, Floats]:
    """{camera: (F,)} squares of what images show otherwise at another OperatingPoint, in units of noise."""
    o, order = model.point.observed.observations, model.corners.order
    d = (
        np.einsum("nij,nj->ni", model.corners.whiten, (other.pixels() - model.point.pixels())[order])
        / model.corners.sigma
    )
    squares, frame, camera = (d**2).sum(axis=1), o.frame[order], o.camera[order]
    return {
        model.point.design.cameras[i].name: cast(
            Floats, np.bincount(frame[camera == i], squares[camera == i], model.frames)
        )
        for i in np.unique(camera)
    }


def _seen(question: PlatformQuestion, plan: Plan, warmer: float = 0.0) -> _Seen:
    named = question.named
    fits = [h.fitted for h in named]
    point = operating_point_with_turned_cubes(operating_point_of_last_recording(fits[0].point), plan)
    sensors = predicted_sensor_log(point.sensors, plan, warmer)
    runs = [predicted_poses(fit, point.design, plan, sensors) for fit in fits]
    here = predicted_operating_point(point, fits[0], plan, sensors, runs[0])
    model = linearise(here)
    sensitivities = Sensitivities(here)
    columns: list[Column] = []
    moved: list[Column] = []
    shapes: list[Column] = []
    other = here
    for h, fit, T in zip(named, fits, runs):
        at = replace(model, point=here.with_effects(fit.point.effects))
        columns.append(effect_coordinates_and_directions(at, sensitivities)[1] or _none(model))
        other = replace(
            here,
            T=T,
            design=design_with_fitted_geometry_and_cameras(fit, here.design),
            seats=remounted_cube_seats(here.design, fit.point.seats),
        ).with_effects(fit.point.effects)
        moved.append(_between(model, here, other))
        shapes.append(residual_change_column_with_only_effects(at, _without(fit.point.effects, h.number)))
    return _Seen(fits, model, other, columns, moved, shapes)


def _between(model: LinearisedModel, here: OperatingPoint, other: OperatingPoint) -> Column:
    """Column (1) of what is seen otherwise where another fit holds."""
    if here.seen is not None:
        return Column(model.fold((other.pixels() - here.pixels())[..., None]).parts)
    return model.lengthened((_lengths(other, here) - _lengths(here, here))[..., None])


def _lengths(point: OperatingPoint, by: OperatingPoint) -> Floats:
    """(F, axes) m of a point's poses, by another's geometry."""
    return mechanisms.kinematics_of(by.design.mechanism).inverse(point.T, by.design.mechanism)


def _none(model: LinearisedModel) -> Column:
    return Column(tuple(np.zeros((len(b.residual), 0)) for b in model.linear.blocks))


def _without(effects: Sequence[Effect], number: int) -> list[Effect]:
    return [e for i, e in enumerate(effects) if i != number]


def _nuisances(model: LinearisedModel, new: LinearisedModel) -> tuple[list[tuple[str, str | int]], Floats]:
    """(names of the nuisances (p,) so far and of the new recording's own, (p, p) information on them that the
    recordings so far, and what remounting may do to a cube that is put back, give)."""
    before = list(model.nuisances.names)
    fresh = [name for name in new.nuisances.names if name not in before]
    P = np.linalg.pinv(model.nuisances.solve)
    own = remounted_cube_pose_nuisances(fresh)
    if sum(map(len, own.values())) != len(fresh):
        raise ValueError(f"the new recording has nuisances that no previous recording has: {fresh}")
    information = np.diag(np.r_[np.zeros(len(before)), np.tile(1 / np.repeat(SEAT, 3) ** 2, len(own))])
    information[: len(before), : len(before)] = P.T @ P
    return [*before, *fresh], information


def _known(fit: Refinement, new: LinearisedModel) -> Floats:
    """(p + c, p + c) covariance of the new recording's nuisances and of a fit's coordinates (c), as the recordings so
    far have them.
    """
    names, own = _nuisances(fit.model, new)
    n, count = len(names), len(fit.coordinates)
    information = np.zeros((n + count, n + count))
    information[:n, :n] = own
    if fit.column is not None and count:
        found, wide = (
            fit.model.linear.project(fit.column),
            _prior_standard_deviations(fit.coordinates, fit.point.effects),
        )
        cross = np.linalg.pinv(fit.model.nuisances.solve).T @ found.onto
        information[: len(cross), n:] = cross
        information[n:, : len(cross)] = cross.T
        information[n:, n:] = found.gram + found.onto.T @ found.onto + np.diag(1 / wide**2)
    covariance = _inverse(information)
    at = [names.index(name) for name in new.nuisances.names] + list(range(n, n + count))
    return covariance[np.ix_(at, at)]


def _cosines(
    named: Sequence[Hypothesis[Refinement]],
    fits: Sequence[Refinement],
    new: LinearisedModel,
    shapes: Floats,
    nuisances: Floats,
) -> Floats:
    """(h, h) cosines between what the hypotheses do in all recordings so far and the new one, cameras and geometry
    taken out of all together.
    """
    model = fits[0].model
    own = join_columns(
        [
            Column(
                residual_change_column_with_only_effects(
                    replace(model, point=model.point.with_effects(fit.point.effects)),
                    _without(fit.point.effects, h.number),
                ).parts
            )
            for h, fit in zip(named, fits)
        ]
    )
    found = model.linear.project(own)
    P, (names, N) = np.linalg.pinv(model.nuisances.solve), _nuisances(model, new)
    K, G = np.zeros((len(names), len(fits))), found.gram + found.onto.T @ found.onto
    K[: P.shape[1]] = P.T @ found.onto
    at = [names.index(name) for name in new.nuisances.names]
    N[np.ix_(at, at)] += nuisances.T @ nuisances
    K[at] += nuisances.T @ shapes
    left = G + shapes.T @ shapes - K.T @ _inverse(N) @ K
    size = np.sqrt(np.maximum(np.diag(left), 1e-300))
    return left / size[:, None] / size


def _inverse(information: Floats) -> Floats:
    """(p, p) pseudo-inverse of information (p, p) whose numbers are of different units: scaled to a diagonal of ones
    first.
    """
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    return np.linalg.pinv(information * scale[:, None] * scale, rcond=1e-13, hermitian=True) * scale[:, None] * scale


def _prior_standard_deviations(coordinates: list[Coordinate], effects: tuple[Effect, ...]) -> Floats:
    """(c,) standard deviations of coordinates by what rigs show, so that what no data hold stays within reason."""
    out = []
    for c in coordinates:
        parameter = next(p for p in effects[c.effect].parameters_at(effects[c.effect].place) if p.name == c.name)
        low, high = parameter.usual
        wide = {"log": np.log(high / low) if low > 0 else 1.0, "phase": np.pi, "inverse": 1 / low if low > 0 else 1.0}
        out.append(wide.get(c.role, 3 * max(abs(low), abs(high))))
    return np.array(out)


def open_questions_of_platform_diagnosis(diagnosis: Diagnosis) -> list[PlatformQuestion]:
    """Questions ([PlatformQuestion]) that a platform's diagnosis leaves open.

    None where it is clear.
    Raises RigError for a rig of which no plan can be foretold.
    """
    d, fit = diagnosis, diagnosis.selection.fit
    size = fit.refined.model.size
    open_ones = [
        f for f in d.selection.findings if any(not is_alternative_ruled_out(f, a, size) for a in f.alternatives)
    ]
    if not open_ones:
        return []
    point = d.selection.before.refined.point
    if not point.axes or point.moving:
        raise RigError("experiments are predicted for commanded platforms and fixed cameras only")
    problem = PlatformProblem(point, list(fit.terms), given=d.options.given)
    out = []
    for finding in open_ones:
        own = fit.terms[finding.number]
        found: list[Rival[Refinement]] = [Rival(own.name, own.place, 0.0, fit.refined, finding.number)]
        bare, unasked = problem.remove_term(fit, finding.number), []
        for a in (a for a in finding.alternatives if not is_alternative_ruled_out(finding, a, size)):
            candidate = a.score.candidate
            try:
                refined = problem.add_term(bare, a.score).refined
            except RigError as error:
                unasked.append(f"{candidate.name.replace('_', ' ')} at {candidate.place}: {error}")
                continue
            found.append(
                Rival(
                    candidate.name,
                    candidate.place,
                    a.behind,
                    refined,
                    len(bare.terms),
                    deviance_of_alternative(finding, a, size),
                )
            )
        out.append(PlatformQuestion(rival_hypotheses_with_odds(found), tuple(unasked)))
    return out
