"""Open questions of an arm's diagnosis.

With predicted outcomes of a plan under each hypothesis.

Poses, linear about the fitted geometry.
Poses of an instrument are as sure as its others; of cameras, as their images will tell, with what cameras and lenses
add to all alike.

Geometry and the sizes of all that is admitted are as sure as the recordings so far leave them; a lag's or a friction's
own shape is taken as found.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.problems.arm.arm_problem import ArmProblem
from calib.diagnosis.problems.arm.finding_parameters_with_intervals_and_nonlinear_optimisation import (
    has_continuous_parameters,
    optimise_nonlinear_parameters,
)
from calib.diagnosis.problems.arm.joint_candidates import joint_candidate
from calib.diagnosis.problems.arm.linearised_poses_and_whitened_columns import (
    Arms,
    Columns,
    Geometry,
    Part,
    linearise_planned_poses,
)
from calib.diagnosis.problems.arm.projected_pose_residuals import Fit, Term
from calib.diagnosis.problems.platform.tolerance_and_temperature_alternatives_of_findings import WARM
from calib.diagnosis.recording_diagnosis import Diagnosis
from calib.experiment.experiment_questions_and_information import (
    PerFrame,
    Prediction,
    Question,
    Rival,
    data_log_odds,
    is_ruled_out,
    predictions_with_unlisted_hypothesis,
    rival_hypotheses,
)
from calib.experiment.predicted_recording_of_plan import predicted_sensor_log
from rig.array_and_json_types import Floats, Integers
from rig.errors import RigError
from rig.model.mechanism_geometry_classes import Arm
from rig.planning.timed_plan_and_visiting_order import Plan

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


def arm_questions(diagnosis: Diagnosis) -> list[ArmQuestion]:
    """Questions that an arm's diagnosis leaves open, none where it is clear.
    Raises RigError for a machine of which no plan can be foretold.
    """
    problem, whole = diagnosis.selection.problem, diagnosis.selection.fit
    assert isinstance(problem, ArmProblem) and isinstance(whole, Fit) and problem.geometry is not None
    geometry, size = problem.geometry, whole.size
    open_ones = [f for f in diagnosis.findings if any(not is_ruled_out(f, a, size) for a in f.alternatives)]
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
        for a in (a for a in finding.alternatives if not is_ruled_out(finding, a, size)):
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
                    data_log_odds(finding, a, size),
                )
            )
        out.append(ArmQuestion(rival_hypotheses(found)))
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
    there = linearise_planned_poses(
        first.arms, geometry, plan.commands, plan.t, predicted_sensor_log(first.arms.context.sensors, plan, warmer)
    )
    W = np.linalg.inv(np.linalg.cholesky(there.own + np.diag(first.scatter**2)))
    tables, shapes = [], []
    for one, number in zip(fits, numbers):
        terms = [_on(term, there) for term in one.fit.terms]
        X = Columns(there.joints, (Part(None, there.freedoms), *(term.part for term in terms))).whitened(W)
        tables.append(X.at(np.eye(X.count)).reshape(-1, X.count))
        shapes.append(tables[-1][:, one.fit.slices[number]] @ one.fit.theta[one.fit.slices[number]])
    return tables, np.stack(shapes, axis=1), there.frame


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
    kept = np.ones(first.X.count, bool)
    kept[first.slices[own]] = False
    old = first.X.at(np.eye(first.X.count)[:, kept])
    done = [
        Columns(first.arms.joints, (h.fitted.fit.terms[h.number].part,))
        .take(first.used)
        .whitened(first.W[first.used])
        .at(h.fitted.fit.theta[h.fitted.fit.slices[h.number], None])
        for h in named
    ]
    N = np.concatenate([old.reshape(-1, kept.sum()), table[:, kept], np.diag(np.sqrt(first.prior()))[:, kept]])
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
