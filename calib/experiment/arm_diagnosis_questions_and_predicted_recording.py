"""Questions that an arm's diagnosis left open, and the predicted recording of a plan.

A recording is predicted with poses, corners with noise and a sensor log. Outcomes of a plan are predicted under each
hypothesis, with poses linear about the fitted geometry.

Poses of an instrument are as sure as its others; of cameras, as their images will tell, with what cameras and lenses
add to all alike.

Geometry and the sizes of all that is admitted are as sure as the recordings so far leave them; a lag's or a friction's
own shape is taken as found.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.diagnosis.problems.arm.arm_problem import ArmProblem
from calib.diagnosis.problems.arm.finding_parameter_optimisation_and_intervals import (
    has_continuous_parameters,
    optimise_nonlinear_parameters,
)
from calib.diagnosis.problems.arm.joint_effect_candidates_and_effects_seen_by_instruments import joint_candidate
from calib.diagnosis.problems.arm.linearised_poses_and_whitened_columns import (
    Arms,
    Columns,
    Geometry,
    Part,
    linearise_planned_poses,
)
from calib.diagnosis.problems.arm.robust_fit_of_effect_terms_to_arm_poses import Fit, Term
from calib.diagnosis.problems.platform.joint_refinement_of_cameras_geometry_poses_and_effects import Refinement
from calib.diagnosis.problems.platform.linearisation_operating_point import (
    OperatingPoint,
    observations_grouped_into_sightings,
    remounted_cube_seats,
)
from calib.diagnosis.problems.platform.tolerance_and_temperature_alternatives import WARM
from calib.diagnosis.recording_diagnosis import Diagnosis
from calib.experiment.experiment_questions_and_information import (
    PerFrame,
    Prediction,
    Question,
    Rival,
    deviance_of_alternative,
    is_alternative_ruled_out,
    predictions_with_unlisted_hypothesis,
    rival_hypotheses_with_odds,
)
from rig.array_and_json_types import Floats, Integers
from rig.errors import RigError
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.design import Design
from rig.model.mechanism_geometry_classes import Arm
from rig.model.pose import exp
from rig.planning.recording_plan import sensors_with_payload
from rig.planning.timed_plan_and_visiting_order import Plan
from rig.recording.corner_and_pose_csv_tables import Corners
from rig.recording.recording_folder import PAYLOAD, Sensors
from vision.corner_observations_and_merging import observations_from_corners
from vision.marker_corner_prediction import (
    State,
    is_inside_image,
    marker_map,
    predict_sightings,
    sightings_facing_cameras_anywhere,
)

SEED = 0  # of the noise by which a recording that is not there yet is weighed
TEMPERATURE = "_temperature_C"  # how channels of temperatures end
PUT_BACK = "@next"  # after the name of a cube as a plan puts it back


def operating_point_of_last_recording(point: OperatingPoint) -> OperatingPoint:
    """OperatingPoint of the last recording.

    Each camera and cube is where it stood then.
    """
    last = {c.name.partition("@")[0]: c for c in point.design.cameras}
    cubes = {t.name.partition("@")[0]: t for t in point.design.targets}
    return replace(point, design=replace(point.design, cameras=tuple(last.values()), targets=tuple(cubes.values())))


def operating_point_with_turned_cubes(point: OperatingPoint, plan: Plan) -> OperatingPoint:
    """OperatingPoint with cubes turned.

    A plan has turned them, and they then stand at unknown poses.
    """
    quarters, targets = dict(plan.turned), []
    for target in point.design.targets:
        name = target.name.partition("@")[0]
        fresh = quarters.get(name, target.turned) != target.turned
        targets.append(replace(target, name=f"{name}{PUT_BACK}", turned=quarters[name]) if fresh else target)
    return replace(point, design=replace(point.design, targets=tuple(targets)))


def predicted_sensor_log(log: Sensors | None, plan: Plan, temperature_rise: float) -> Sensors | None:
    """Predicted sensor log of a plan's recording.

    Temperatures of the first log raised, payload as planned.
    """
    if log is None:
        return (
            sensors_with_payload(plan, Sensors(np.array([0.0, plan.commands.t[-1]]), {}))
            if (plan.payload[:, 1] > 0).any()
            else None
        )
    end = np.searchsorted(log.t, log.starts[0]) if len(log.starts) else len(log.t)
    first = {
        name: values[:end] + temperature_rise * name.endswith(TEMPERATURE)
        for name, values in log.channels.items()
        if name != PAYLOAD
    }
    return sensors_with_payload(plan, Sensors(log.t[:end], first))


def design_with_fitted_geometry_and_cameras(fit: Refinement, design: Design) -> Design:
    """Design with the geometry and the cameras as fitted."""
    cameras = {c.name: c for c in fit.point.design.cameras}
    return replace(design, mechanism=fit.point.design.mechanism, cameras=tuple(cameras[c.name] for c in design.cameras))


def predicted_poses(fit: Refinement, design: Design, plan: Plan, sensors: Sensors | None) -> RigidTransform:
    """Predicted poses T_base_platform (F,) at a plan's exposures, by a fit."""
    moving = [e for e in fit.point.effects if e.stage != "view"]
    return motion_simulation.simulate_machine_run(
        design_with_fitted_geometry_and_cameras(fit, design), plan.commands, plan.t, moving, sensors
    ).T_base_platform


def predicted_operating_point(
    point: OperatingPoint, fit: Refinement, plan: Plan, sensors: Sensors | None, T: RigidTransform
) -> OperatingPoint:
    """OperatingPoint predicted for a plan's recording.

    It is by one fit, with noise as large as before.
    Raises RigError where no camera sees a marker in some of its exposures
    """
    rng, design, F = (
        np.random.default_rng(SEED),
        design_with_fitted_geometry_and_cameras(fit, point.design),
        len(plan.t),
    )
    stated = replace(point.stated, cameras=design.cameras, targets=design.targets)
    here = OperatingPoint(
        design,
        stated,
        np.arange(F),
        plan.t,
        T,
        {},
        None,
        plan.commands,
        sensors,
        None,
        fit.point.effects,
        standing=point.standing,
        seats=remounted_cube_seats(design, fit.point.seats),
    )
    if point.seen is None:
        own = point.own if point.own is not None else np.zeros((1, 6, 6))
        typical = np.median(own, axis=0)
        noise = rng.multivariate_normal(np.zeros(6), typical, F)
        return replace(here, T=T * exp(noise), own=np.broadcast_to(typical, (F, 6, 6)).copy())
    markers, state = marker_map(here.stated), State(design.cameras, T, {})
    sightings = sightings_facing_cameras_anywhere(state, markers)
    uv = predict_sightings(
        sightings, state, markers, plan.t, [*fit.point.effects, *here.seats], sensors, here.run(fit.point.effects)
    )
    whole = is_inside_image(sightings, uv, design.cameras)
    sightings, uv = sightings.take(whole), uv[whole].reshape(-1, 2)
    if len(np.unique(sightings.frame)) < F:
        raise RigError(
            f"in {F - len(np.unique(sightings.frame))} of the plan's {F} exposures no camera would see a marker"
        )
    sigma = fit.model.corner_noise()
    corners = Corners(
        np.repeat(sightings.frame, 4),
        [design.cameras[i].name for i in np.repeat(sightings.camera, 4)],
        np.repeat(markers.key[sightings.marker], 4),
        np.tile(np.arange(4), len(sightings.frame)),
        uv + sigma * rng.normal(size=uv.shape),
        np.broadcast_to(sigma**2 * np.eye(2), (len(uv), 2, 2)).copy(),
    )
    return replace(
        here,
        seen=observations_grouped_into_sightings(
            observations_from_corners(corners, here.frames, here.stated, markers), markers
        ),
    )


WEAK = 1e-10  # of the greatest singular value; directions below are none


@dataclass(frozen=True, slots=True, eq=False)
class ArmFit:
    """fit : Fit with a hypothesis in the finding's place; geometry : that it is linear about"""

    fit: Fit
    geometry: Geometry


@dataclass(frozen=True, slots=True, eq=False)
class ArmQuestion(Question[ArmFit]):
    """Of an arm whose poses an instrument measures, or cameras."""

    @property
    def follows_temperature(self) -> bool:
        return any(h.fitted.fit.terms[h.number].candidate.kind in WARM for h in self.named)

    def predict_outcomes(self, plan: Plan, warmer: float = 0.0) -> Prediction:
        named = self.named
        tables, shapes, _ = _seen([h.fitted for h in named], [h.number for h in named], plan, warmer)
        basis, values, _ = np.linalg.svd(np.concatenate([*tables, shapes], axis=1), full_matrices=False)
        basis = basis[:, values > WEAK * values[0]]
        spread = [basis.T @ table for table in tables]
        means = np.array([part @ h.fitted.fit.theta for part, h in zip(spread, named)])
        covariances = np.array(
            [_square(part @ h.fitted.fit.inverse) + np.eye(len(part)) for part, h in zip(spread, named)]
        )
        return predictions_with_unlisted_hypothesis(
            self, Prediction(means, covariances, _cosines(self, tables[0], shapes)), basis.T @ shapes
        )

    def predicted_outcomes_of_two_likeliest_hypotheses(self, plan: Plan) -> PerFrame:
        first, other = self.likeliest
        (one, two), _, seen = _seen([first.fitted, other.fitted], [first.number, other.number], plan, 0.0)
        F, k = len(plan.t), len(one) // len(seen)
        d, table = np.zeros((F, k)), np.zeros((F, k, one.shape[1]))
        d[seen] = (two @ other.fitted.fit.theta - one @ first.fitted.fit.theta).reshape(-1, k)
        table[seen] = (one @ first.fitted.fit.inverse).reshape(len(seen), k, -1)
        return PerFrame(
            (d**2).sum(axis=1), np.einsum("fkp,fk->fp", table, d), np.einsum("fkp,fkq->fpq", table, table), {}
        )


def open_questions_of_arm_diagnosis(diagnosis: Diagnosis) -> list[ArmQuestion]:
    """Questions that an arm's diagnosis leaves open.

    None where it is clear.
    Raises RigError for a machine of which no plan can be foretold.
    """
    problem, whole = diagnosis.selection.problem, diagnosis.selection.fit
    assert isinstance(problem, ArmProblem) and isinstance(whole, Fit) and problem.geometry is not None
    geometry, size = problem.geometry, whole.size
    open_ones = [f for f in diagnosis.findings if any(not is_alternative_ruled_out(f, a, size) for a in f.alternatives)]
    if not open_ones:
        return []
    if not isinstance(geometry.mechanism, Arm):
        raise RigError(
            "experiments are predicted for platforms on struts and for arms; what is ambiguous in a chain is "
            "distinguished by its stages alone"
        )
    out = []
    for finding in open_ones:
        own = whole.terms[finding.number].candidate
        found: list[Rival[ArmFit]] = [Rival(own.name, own.place, 0.0, ArmFit(whole, geometry), finding.number)]
        bare = problem.remove_term(whole, finding.number)
        for a in (a for a in finding.alternatives if not is_alternative_ruled_out(finding, a, size)):
            term = Term.of(a.score)
            fit = bare.with_terms(
                [optimise_nonlinear_parameters(bare, term) if has_continuous_parameters(term) else term]
            )
            found.append(
                Rival(
                    a.score.candidate.name,
                    a.score.candidate.place,
                    a.behind,
                    ArmFit(fit, geometry),
                    len(bare.terms),
                    deviance_of_alternative(finding, a, size),
                )
            )
        out.append(ArmQuestion(rival_hypotheses_with_odds(found)))
    return out


def _seen(
    fits: Sequence[ArmFit], numbers: Sequence[int], plan: Plan, warmer: float
) -> tuple[list[Floats], Floats, Integers]:
    """([(n k, p + c) whitened change of a plan's poses with each fit's freedoms and sizes], (n k, h) what each fit's
    term of a number does, (n,) which of its exposures are measured). Raises RigError as `linearise_planned_poses`, and
    for a cube that is to be turned"""
    if plan.turned:
        raise RigError("the effect of a remounted, turned cube is predicted for platforms only")
    first, geometry = fits[0].fit, fits[0].geometry
    linearised = linearise_planned_poses(
        first.arms, geometry, plan.commands, plan.t, predicted_sensor_log(first.arms.context.sensors, plan, warmer)
    )
    W = np.linalg.inv(np.linalg.cholesky(linearised.own + np.diag(first.scatter**2)))
    tables, shapes = [], []
    for one, number in zip(fits, numbers):
        terms = [_on(term, linearised) for term in one.fit.terms]
        X = Columns(linearised.joints, (Part(None, linearised.freedoms), *(term.part for term in terms))).whitened(W)
        tables.append(X.at(np.eye(X.count)).reshape(-1, X.count))
        shapes.append(tables[-1][:, one.fit.slices[number]] @ one.fit.theta[one.fit.slices[number]])
    return tables, np.stack(shapes, axis=1), linearised.frame


def _on(term: Term, arms: Arms) -> Term:
    """The Term at the poses of other Arms."""
    return Term.at(joint_candidate(term.candidate.specs, arms), term.node)


def _cosines(question: ArmQuestion, table: Floats, shapes: Floats) -> Floats:
    """(h, h) between what hypotheses do in all recordings so far and the new one, geometry and the other terms taken
    out of all together.

    table : (n k, p + c) of the first in the new recording; shapes : (n k, h)
    """
    named = question.named
    first, own = named[0].fitted.fit, named[0].number
    retained = np.ones(first.X.count, bool)
    retained[first.slices[own]] = False
    old = first.X.at(np.eye(first.X.count)[:, retained])
    done = [
        Columns(first.arms.joints, (h.fitted.fit.terms[h.number].part,))
        .take(first.used)
        .whitened(first.W[first.used])
        .at(h.fitted.fit.theta[h.fitted.fit.slices[h.number], None])
        for h in named
    ]
    N = np.concatenate(
        [old.reshape(-1, retained.sum()), table[:, retained], np.diag(np.sqrt(first.prior()))[:, retained]]
    )
    S = np.concatenate(
        [np.concatenate(done, axis=2).reshape(-1, len(named)), shapes, np.zeros((first.X.count, len(named)))]
    )
    Q, R = np.linalg.qr(N)
    Q = Q[:, np.abs(np.diag(R)) > WEAK * np.abs(np.diag(R)).max()]
    left = S - Q @ (Q.T @ S)
    size = np.maximum(np.linalg.norm(left, axis=0), 1e-300)
    return left.T @ left / size[:, None] / size


def _square(root: Floats) -> Floats:
    """(r, r) root root.T."""
    return root @ root.T
