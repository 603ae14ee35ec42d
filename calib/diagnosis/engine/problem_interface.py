"""Interface (protocol) of a problem that the engine searches.

Platforms, bodies and arms are such problems.

No member that asks changes anything.

A Fit is all that is admitted at its best; a Model is what it leaves, linear, with nuisances and the admitted terms'
parameters taken out.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol, Self, TypeVar, runtime_checkable

from calib.diagnosis.engine.candidate_scores_and_their_significance import Score
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import C, SelectionPolicy, StatedTerms
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import CrossValidation
from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import LackOfFit
from calib.diagnosis.engine.linear_residual_model import Column, LinearModel
from rig.model.arm_hands_effect_places_and_tolerances import Place

Fit = TypeVar("Fit")
Fit_contra = TypeVar("Fit_contra", contravariant=True)
Model = TypeVar("Model")
Model_co = TypeVar("Model_co", covariant=True)
Model_contra = TypeVar("Model_contra", contravariant=True)
Progress = Callable[[str, int, int], None]  # called with (label, done, of)


class Wald(NamedTuple):
    """How far a term stands from nothing, in squared standard deviations, by how many numbers that the data
    determine.
    """

    statistic: float
    freedom: float


class Problem(Protocol[Fit, Model, C]):
    """A recording to be explained: what every problem answers."""

    @property
    def policy(self) -> SelectionPolicy:
        """Its thresholds."""

    @property
    def candidates(self) -> list[C]:
        """All that it is asked for."""

    @property
    def given(self) -> StatedTerms:
        """What is said beforehand."""

    def start(self) -> Fit:
        """The Fit with nothing admitted."""

    def terms(self, fit: Fit) -> list[C]:
        """The admitted candidates, in order."""

    def size(self, fit: Fit) -> int:
        """How many independent numbers its residuals hold."""

    def residual(self, fit: Fit) -> Model:
        """What it leaves."""

    def without_term(self, fit: Fit, number: int) -> Model:
        """What it leaves with one term taken away, the others' parameters among the nuisances."""

    def linear(self, model: Model) -> LinearModel:
        """The LinearModel that a Model stands for."""

    def search(
        self, model: Model, candidates: list[C], least: float, progress: Callable[[int, int], None] | None
    ) -> list[Score[C]]:
        """Scores by raw delta BIC, the greatest first; those below `least` may be missing."""

    def rescored(self, model: Model, fit: Fit, number: int) -> Score[C]:
        """The Score of an admitted term on a model without it."""

    def column(self, model: Model, score: Score[C]) -> Column:
        """Column (1) of what a Score's candidate does as scanned."""

    def add_term(self, fit: Fit, score: Score[C]) -> Fit:
        """The Fit with one term more, the last."""

    def remove_term(self, fit: Fit, number: int) -> Fit:
        """The Fit with one term less."""

    def exchange_term(self, fit: Fit, number: int, score: Score[C]) -> Fit:
        """The Fit with a Score's term, the last, in place of an admitted one; the others start from where they are."""

    def in_place(self, fit: Fit, number: int) -> Fit:
        """The Fit with its last term moved to a number."""

    def wald(self, fit: Fit, number: int) -> Wald:
        """Of one term."""

    def likelihood_ratio(self, fit: Fit, other: Fit) -> float:
        """By how much minus twice the log likelihood of `fit` is above that of `other`."""

    def cross_validations(self, fit: Fit, numbers: list[int]) -> list[CrossValidation]:
        """Of each of some terms alone."""

    def lack_of_fit(self, model: Model, place: Place | None = None) -> list[LackOfFit]:
        """What nobody named, the most convincing first; at a place of a name alone, by the chance that names are found
        by, where one is given.
        """

    def within(self, left: LackOfFit, place: Place) -> bool:
        """Whether what is left sits where something at a place does, or at a part of it."""


@runtime_checkable
class AdmissionRules(Protocol[Fit_contra, C]):
    """Capability: some candidates exclude others."""

    def admissible(self, fit: Fit_contra) -> list[C]:
        """The candidates that may still be admitted."""


@runtime_checkable
class Tolerances(Protocol[Fit_contra, C]):
    """Capability: something that is nobody's fault may explain what is measured."""

    def tolerances_explain(self, fit: Fit_contra, best: Score[C] | None) -> bool:
        """Whether tolerances explain more than the best candidate, and are not among the nuisances yet."""

    def with_tolerances(self) -> Self:
        """The problem with tolerances among its nuisances, for all Fits."""


@runtime_checkable
class SmoothCover(Protocol[Fit_contra, Model_co]):
    """Capability: a name has to stand beside smooth functions of what is left."""

    def covered(self, fit: Fit_contra, number: int, left: list[LackOfFit]) -> Model_co:
        """What a Fit leaves with one term taken away, the smooth functions of what is left among the nuisances."""


@runtime_checkable
class AlternativeScreening(Protocol[Fit_contra, C]):
    """Capability: what all candidates about explain in place of each term of a Fit is found at once."""

    def screen_alternatives(
        self, fit: Fit_contra, progress: Callable[[int, int], None] | None = None
    ) -> list[list[C]] | None:
        """For each term, the candidates that may explain as much in its place; None where that cannot be said."""


@runtime_checkable
class AliasedNodes(Protocol[Model_contra, C]):
    """Capability: nodes of one candidate may be hypotheses of their own."""

    def aliases(self, model: Model_contra, own: Score[C], score: Score[C]) -> list[Score[C]]:
        """Other nodes of the candidate of `own` (scored as `score`) that are another hypothesis than its best one."""


@runtime_checkable
class UnfittedNodes(Protocol[Fit_contra, C]):
    """Capability: a fit leaves what was found on a grid as it is: moments, and which of several things it is."""

    def is_at_other_node(self, fit: Fit_contra, number: int, score: Score[C]) -> bool:
        """Whether a Score of an admitted term's candidate is at another moment or choice than the term."""


@runtime_checkable
class Companions(Protocol[Fit_contra, C]):
    """Capability: other places may show a term of the same step."""

    def companion(self, fit: Fit_contra, score: Score[C]) -> Score[C] | None:
        """A Score of another place anew, now that others are admitted; None where it has gone."""


@runtime_checkable
class TermRefinement(Protocol[Fit]):
    """Capability: nonlinear parameters of admitted terms are fitted apart from their admission."""

    def refine_terms(self, fit: Fit) -> Fit:
        """The Fit with terms' nonlinear parameters at their best now that others are admitted."""


@runtime_checkable
class TermSimplification(Protocol[Fit]):
    """Capability: one term may be a special case of another."""

    def simplify_terms(self, fit: Fit, /) -> Fit:
        """The Fit with special cases in place of general ones that do no better, and one general one in place of many
        special.
        """
