"""Information expected of an experiment, and configurations that best discriminate two hypotheses."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from calib.diagnosis.engine.selection_inputs import PLATFORM
from calib.experiment.experiment_question import PerFrame, Prediction, Question
from rig.arrays import Floats
from rig.errors import RigError
from rig.model.design import Design
from rig.planning.configuration_sets import grid_configurations, sobol_configurations
from rig.planning.plan import axis_strokes, build_plan
from rig.planning.plan_construction_and_table import Plan

POOL = 96  # configurations to choose from, beside the corners of what the axes reach
NAME = "apart"  # of the part of a plan that they become


def discriminating_configurations(
    open_questions: Sequence[Question[object]], design: Design, count: int, seed: int
) -> Floats:
    """Configurations (count, axes) that discriminate best between each question's two likeliest hypotheses.

    A camera counts by what its image shows: configurations that bring markers where the two differ are chosen for it.
    seed : of the pool
    Raises RigError where the rig cannot follow the pool, no camera sees some of it, or no question has two names
    """
    open_ones = [q for q in open_questions if len(q.named) > 1]
    if not open_ones:
        raise RigError("one name alone is thought of, so there are no two that come apart anywhere")
    strokes = axis_strokes(design)
    pool = np.concatenate([sobol_configurations(strokes, POOL, seed=seed), grid_configurations(strokes, 2)])
    plan = build_plan(design, "pool", own_parts={"pool": pool})
    return pool[choose_exposures([q.predict_outcomes_by_frame(plan) for q in open_ones], count)]


def choose_exposures(questions: Sequence[PerFrame], count: int) -> Floats:
    """Numbers (count,) of the exposures chosen greedily to give most information on the questions.

    Raises ValueError for more than there are, or no question
    """
    if not questions or count > len(questions[0].of):
        raise ValueError(f"{count} exposures are to be chosen of {len(questions[0].of) if questions else 0}")
    sums = [(0.0, np.zeros(q.onto.shape[1]), np.eye(q.onto.shape[1])) for q in questions]
    free, out = np.ones(len(questions[0].of), bool), []
    for _ in range(count):
        told = np.zeros(len(free))
        for q, (of, onto, left) in zip(questions, sums):
            b = onto + q.onto[free]
            told[free] += (
                of + q.of[free] - np.einsum("fp,fp->f", b, np.linalg.solve(left + q.open[free], b[..., None])[..., 0])
            )
        best = int(np.argmax(np.where(free, told, -np.inf)))
        sums = [
            (of + q.of[best], onto + q.onto[best], left + q.open[best]) for q, (of, onto, left) in zip(questions, sums)
        ]
        free[best] = False
        out.append(best)
    return np.array(out)


def camera_information_shares(open_questions: Sequence[Question[object]], plan: Plan) -> dict[str, float]:
    """{camera: share of the information that its images give on the questions}, the greatest first."""
    parts: dict[str, float] = {}
    for question in open_questions:
        for name, squares in (
            question.predict_outcomes_by_frame(plan).by_camera if len(question.named) > 1 else {}
        ).items():
            parts[name] = parts.get(name, 0.0) + float(squares.sum())
    whole = max(sum(parts.values()), 1e-300)
    return dict(sorted(((name, part / whole) for name, part in parts.items()), key=lambda item: -item[1]))


DRAWS = 400  # outcomes that are looked at
SEED = 0


@dataclass(frozen=True, slots=True)
class Information:
    """bits : expected on which hypothesis holds; settles : chance that one is left alone; right : that it is the one
    that holds.
    """

    bits: float
    settles: float
    right: float


def experiment_information(odds: Floats, predictions: Prediction, data_log_odds: Floats) -> Information:
    """Information expected of an experiment, from drawn outcomes. odds : (h,) of the hypotheses

    data_log_odds : (h,) how much less likely the data so far make each, as minus twice a logarithm
    One is left alone where all others are less likely by the odds from which a diagnosis tells apart; those that do
    nearly the same, by what the data so far and the experiment say
    """
    rng, h = np.random.default_rng(SEED), len(odds)
    roots = [np.linalg.cholesky(C) for C in predictions.covariances]
    numbers = np.maximum(np.round(DRAWS * odds).astype(int), 4)
    logs, truth, weight = [], [], []
    for k in range(h):
        z = predictions.means[k] + rng.normal(size=(numbers[k], predictions.means.shape[1])) @ roots[k].T
        logs.append(np.stack([_log_likelihood(z, predictions.means[g], roots[g]) for g in range(h)], axis=1))
        truth += [k] * numbers[k]
        weight += [odds[k] / numbers[k]] * numbers[k]
    likelihood = np.concatenate(logs)
    posterior = likelihood + np.log(odds)
    posterior -= posterior.max(axis=1, keepdims=True)
    best, w, rows = posterior.argmax(axis=1), np.array(weight), np.arange(len(truth))
    of_all = likelihood - data_log_odds / 2
    by_data = of_all - of_all[rows, best][:, None] < -PLATFORM.alike / 2
    apart = (posterior < -PLATFORM.alike / 2) & ((np.abs(predictions.cosines[best]) <= PLATFORM.cosine) | by_data)
    apart[rows, best] = True
    alone = apart.all(axis=1)
    share = np.exp(posterior)
    share /= share.sum(axis=1, keepdims=True)
    left = -(share * np.log2(np.maximum(share, 1e-300))).sum(axis=1)
    bits = float(-(odds * np.log2(odds)).sum() - w @ left)
    return Information(max(bits, 0.0), float(w @ alone), float(w @ (alone & (best == np.array(truth)))))


def _log_likelihood(z: Floats, mean: Floats, root: Floats) -> Floats:
    """(n,) of outcomes (n, r) under a Gaussian of a mean (r,) and a covariance's root (r, r), but for a constant."""
    u = solve_triangular(root, (z - mean).T, lower=True)
    return -(u**2).sum(axis=0) / 2 - np.log(np.diag(root)).sum()
