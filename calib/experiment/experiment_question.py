"""Question for an experiment: rival hypotheses, their odds, and predicted outcomes of a plan."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from calib.diagnosis.engine.candidate_score import Alternative
from calib.diagnosis.engine.finding_confirmation import Finding
from calib.diagnosis.engine.selection_inputs import PLATFORM, C
from calib.diagnosis.report.diagnosis_json import UNKNOWN
from rig.arrays import Floats
from rig.planning.plan_construction_and_table import Plan

FOREIGN = 0.05  # of all odds, for what is in no catalogue
F = TypeVar("F")
F_co = TypeVar("F_co", covariant=True)


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis(Generic[F_co]):
    """One explanation of a finding. name, place; odds : share of all, 0..1; refined : all that is free fitted with it
    in the finding's place, or None where it cannot be fitted (a temperature that nobody logs); number : of it among the
    effects of `refined`
    data_log_odds : how much less likely than the finding the data so far make it, as minus twice a logarithm, whatever
        either costs in simplicity"""

    name: str
    place: str
    odds: float
    refined: F_co | None
    number: int
    data_log_odds: float = 0.0

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
    not_asked: tuple[str, ...] = ()

    @property
    def named(self) -> tuple[Hypothesis[F_co], ...]:
        """Those with a name."""
        return tuple(h for h in self.hypotheses if h.name != UNKNOWN)

    @property
    def likeliest(self) -> tuple[Hypothesis[F_co], ...]:
        """The two likeliest names. Raises ValueError for a question of one name"""
        found = tuple(sorted(self.named, key=lambda h: -h.odds)[:2])
        if len(found) < 2:
            raise ValueError("a question of one name has nothing to tell apart")
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
    def predict_outcomes_by_frame(self, plan: Plan) -> PerFrame:
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
    data_log_odds : as of Hypothesis"""

    name: str
    place: str
    behind: float
    fit: F
    number: int
    data_log_odds: float = 0.0


def rival_hypotheses(rivals: list[Rival[F]]) -> tuple[Hypothesis[F], ...]:
    """Hypotheses of rivals by their odds, the finding's first, an unlisted effect last."""
    weights = np.exp(-np.array([rival.behind for rival in rivals]) / 2)
    shares = (1 - FOREIGN) * weights / weights.sum()
    named = [
        Hypothesis(r.name, r.place, float(share), r.fit, r.number, r.data_log_odds) for r, share in zip(rivals, shares)
    ]
    return (*named, Hypothesis(UNKNOWN, rivals[0].place, FOREIGN, rivals[0].fit, rivals[0].number))


def is_ruled_out(finding: Finding[C], alternative: Alternative[C], size: int) -> bool:
    """Whether an alternative is ruled out by its odds, or by the data alone where its effect is nearly the same."""
    same = abs(alternative.cosine) > PLATFORM.cosine
    return alternative.behind >= PLATFORM.alike and (
        not same or data_log_odds(finding, alternative, size) >= PLATFORM.alike
    )


def data_log_odds(finding: Finding[C], alternative: Alternative[C], size: int) -> float:
    """Log odds (minus twice a logarithm) of an alternative against its finding by the data, without complexity cost."""
    return float(alternative.behind - alternative.score.complexity(size) + finding.score.complexity(size))
