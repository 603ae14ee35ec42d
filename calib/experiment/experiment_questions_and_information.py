"""Questions for an experiment, and information expected of it.

A question has rival hypotheses, their odds and predicted outcomes.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from scipy.linalg import solve_triangular

from calib.diagnosis.engine.candidate_scores_and_their_significance import Alternative
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import PLATFORM, C
from calib.diagnosis.engine.term_confirmation_against_alternative_candidates import Finding
from calib.diagnosis.report.diagnosis_json_entries import UNKNOWN
from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.model.design import Design
from rig.planning.configuration_generators import grid_configurations, sobol_configurations
from rig.planning.recording_plan import axis_strokes, build_plan
from rig.planning.timed_plan_and_visiting_order import Plan

FOREIGN = 0.05  # of all odds, for what is in no catalogue
F = TypeVar("F")
F_co = TypeVar("F_co", covariant=True)


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis(Generic[F_co]):
    """One explanation of a finding. name, place; odds : share of all, 0..1; refined : all that is free fitted with it
    in the finding's place, or None where it cannot be fitted (a temperature that nobody logs); number : of it among the
    effects of `refined`
    deviance : how much less likely than the finding the data so far make it, as minus twice a logarithm, whatever
        either costs in simplicity"""

    name: str
    place: str
    odds: float
    refined: F_co | None
    number: int
    deviance: float = 0.0

    @property
    def title(self) -> str:
        """As "creep at strut 3"."""
        return f"{self.name.replace('_', ' ')} at {self.place}" if self.name != UNKNOWN else "something in no catalogue"

    @property
    def fitted(self) -> F_co:
        """The fit with it. Raises ValueError where there is none."""
        if self.refined is None:
            raise ValueError(f"{self.title} cannot be fitted")
        return self.refined


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Of h hypotheses on r directions. means : (h, r); covariances : (h, r, r), the noise's own 1 included
    cosines : (h, h) between what they do, over all recordings with this one, nuisances taken out"""

    means: Floats
    covariances: Floats
    cosines: Floats


@dataclass(frozen=True, slots=True, eq=False)
class PerFrame:
    """What each of a plan's F exposures tells between two hypotheses, in units of noise. of (F,) : squares of what they
    do otherwise
    onto (F, p) : that on what both leave open; open (F, p, p) : squares of what is left open, which is p numbers of
    variance 1 beforehand
    by_camera : {name: (F,) squares of how otherwise its image looks, its corners' noise 1}; none where an instrument
        measures"""

    of: Floats
    onto: Floats
    open: Floats
    by_camera: dict[str, Floats]


@dataclass(frozen=True, slots=True, eq=False)
class Question(ABC, Generic[F_co]):
    """Hypotheses of one finding, its own first, something in no catalogue last; what cannot be fitted is left out and
    named in `unasked`.
    """

    hypotheses: tuple[Hypothesis[F_co], ...]
    not_tested: tuple[str, ...] = ()

    @property
    def named(self) -> tuple[Hypothesis[F_co], ...]:
        """Those with a name."""
        return tuple(h for h in self.hypotheses if h.name != UNKNOWN)

    @property
    def likeliest(self) -> tuple[Hypothesis[F_co], ...]:
        """The two likeliest names. Raises ValueError for a question of one name"""
        found = tuple(sorted(self.named, key=lambda h: -h.odds)[:2])
        if len(found) < 2:
            raise ValueError("a question with one hypothesis has nothing to distinguish")
        return found

    @property
    @abstractmethod
    def follows_temperature(self) -> bool:
        """Whether one of the names follows a temperature."""

    @abstractmethod
    def predict_outcomes(self, plan: Plan, warmer: float = 0.0) -> Prediction:
        """Prediction of the hypotheses under a plan. warmer : K, than it was in the first recording
        Raises RigError where the machine as found cannot follow it, or nothing would be seen of some of it"""

    @abstractmethod
    def predicted_outcomes_of_two_likeliest_hypotheses(self, plan: Plan) -> PerFrame:
        """PerFrame of the two likeliest names. Raises what `foretold` raises, and ValueError for a question of one
        name
        """


def predictions_with_unlisted_hypothesis(question: Question[F], predictions: Prediction, shapes: Floats) -> Prediction:
    """Predictions with an unlisted hypothesis added last, for an effect in no catalogue.

    shapes : (r, h) what each name does
    """
    if question.hypotheses[-1].name != UNKNOWN:
        return predictions
    means, covariances = predictions.means, predictions.covariances
    size = float(np.linalg.norm(shapes[:, 0]))
    axes = np.linalg.svd(np.concatenate([shapes, means.T], axis=1), full_matrices=False)[0]
    foreign = covariances[0] + size**2 / axes.shape[1] * axes @ axes.T
    h = len(means)
    wide = np.zeros((h + 1, h + 1))
    wide[:h, :h] = predictions.cosines
    return Prediction(np.concatenate([means, means[:1]]), np.concatenate([covariances, foreign[None]]), wide)


@dataclass(frozen=True, slots=True, eq=False)
class Rival(Generic[F]):
    """A name in the running. behind : how much less likely it is, as minus twice a logarithm; fit : with it; number,
    deviance : as of Hypothesis"""

    name: str
    place: str
    behind: float
    fit: F
    number: int
    deviance: float = 0.0


def rival_hypotheses_with_odds(rivals: list[Rival[F]]) -> tuple[Hypothesis[F], ...]:
    """Hypotheses of rivals with their odds.

    The finding's first, an unlisted effect last.
    """
    weights = np.exp(-np.array([rival.behind for rival in rivals]) / 2)
    shares = (1 - FOREIGN) * weights / weights.sum()
    named = [Hypothesis(r.name, r.place, float(share), r.fit, r.number, r.deviance) for r, share in zip(rivals, shares)]
    return (*named, Hypothesis(UNKNOWN, rivals[0].place, FOREIGN, rivals[0].fit, rivals[0].number))


def is_alternative_ruled_out(finding: Finding[C], alternative: Alternative[C], independent_residual_count: int) -> bool:
    """Whether an alternative to a finding is ruled out.

    It is by its odds or by the data alone.
    """
    same = abs(alternative.cosine) > PLATFORM.cosine
    return alternative.behind >= PLATFORM.alike and (
        not same or deviance_of_alternative(finding, alternative, independent_residual_count) >= PLATFORM.alike
    )


def deviance_of_alternative(finding: Finding[C], alternative: Alternative[C], independent_residual_count: int) -> float:
    """Deviance (-2 log likelihood ratio) of an alternative from its finding.

    It has no cost of complexity.
    """
    return float(
        alternative.behind
        - alternative.score.complexity(independent_residual_count)
        + finding.score.complexity(independent_residual_count)
    )


POOL = 96  # configurations to choose from, beside the corners of what the axes reach
NAME = "apart"  # of the part of a plan that they become


def discriminating_configurations(
    open_questions: Sequence[Question[object]], design: Design, count: int, seed: int
) -> Floats:
    """Configurations (count, axes) that discriminate best between hypotheses.

    Between each question's two likeliest.

    A camera counts by what its image shows: configurations that bring markers where the two differ are chosen for it.
    seed : of the pool
    Raises RigError where the rig cannot follow the pool, no camera sees some of it, or no question has two names
    """
    open_ones = [q for q in open_questions if len(q.named) > 1]
    if not open_ones:
        raise RigError("only one hypothesis is considered, so there are no two to distinguish")
    strokes = axis_strokes(design)
    pool = np.concatenate([sobol_configurations(strokes, POOL, seed=seed), grid_configurations(strokes, 2)])
    plan = build_plan(design, "pool", additional_parts={"pool": pool})
    return pool[
        most_informative_exposures([q.predicted_outcomes_of_two_likeliest_hypotheses(plan) for q in open_ones], count)
    ]


def most_informative_exposures(questions: Sequence[PerFrame], count: int) -> Floats:
    """Indices (count,) of the exposures that together give most information on questions.

    They are chosen greedily.
    Raises ValueError for more than there are, or no question
    """
    if not questions or count > len(questions[0].of):
        raise ValueError(f"{count} exposures are to be chosen from {len(questions[0].of) if questions else 0}")
    sums = [(0.0, np.zeros(q.onto.shape[1]), np.eye(q.onto.shape[1])) for q in questions]
    free, out = np.ones(len(questions[0].of), bool), []
    for _ in range(count):
        information = np.zeros(len(free))
        for q, (of, onto, left) in zip(questions, sums):
            b = onto + q.onto[free]
            information[free] += (
                of + q.of[free] - np.einsum("fp,fp->f", b, np.linalg.solve(left + q.open[free], b[..., None])[..., 0])
            )
        best = int(np.argmax(np.where(free, information, -np.inf)))
        sums = [
            (of + q.of[best], onto + q.onto[best], left + q.open[best]) for q, (of, onto, left) in zip(questions, sums)
        ]
        free[best] = False
        out.append(best)
    return np.array(out)


def camera_information_shares(open_questions: Sequence[Question[object]], plan: Plan) -> dict[str, float]:
    """Share {camera: share} of the information on the questions that each camera's images give.

    The greatest first.
    """
    parts: dict[str, float] = {}
    for question in open_questions:
        for name, squares in (
            question.predicted_outcomes_of_two_likeliest_hypotheses(plan).by_camera if len(question.named) > 1 else {}
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


def experiment_information(odds: Floats, predictions: Prediction, deviance: Floats) -> Information:
    """Expected information of an experiment, averaged over drawn outcomes.

    odds : (h,) of the hypotheses
    deviance : (h,) how much less likely the data so far make each, as minus twice a logarithm
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
    of_all = likelihood - deviance / 2
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
