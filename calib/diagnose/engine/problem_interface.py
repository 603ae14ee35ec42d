"""The interface (protocol) of a problem that the engine searches: platforms, bodies and arms.

A Fit is all that is admitted at its best; a Model is what it leaves, linear, with nuisances and the admitted terms'
parameters taken out.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeVar

from calib.diagnose.engine.candidate_score import Score
from calib.diagnose.engine.cross_validation import CrossValidation
from calib.diagnose.engine.lack_of_fit import LackOfFit
from calib.diagnose.engine.linear_model import Column, LinearModel
from calib.diagnose.engine.selection_inputs import C, SelectionPolicy, StatedTerms

Fit = TypeVar("Fit")
Model = TypeVar("Model")
Progress = Callable[[str, int, int], None]  # called with (label, done, of)


class Wald(NamedTuple):
    """How far a term stands from nothing, in squared standard deviations, by how many numbers that the data
    determine.
    """

    statistic: float
    freedom: float


class Problem(Protocol[Fit, Model, C]):
    """A recording to be explained."""

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

    def is_explained_by_tolerances(self, fit: Fit, best: Score[C] | None) -> bool:
        """Whether from here on something that is nobody's fault stands among the nuisances, since it explains more than
        the best there is: a change for all Fits, made once."""

    def without_term(self, fit: Fit, number: int) -> Model:
        """What it leaves with one term taken away, the others' parameters among the nuisances."""

    def covered(self, fit: Fit, number: int, left: list[LackOfFit]) -> Model | None:
        """The same with the smooth functions of what is left among the nuisances; None where there are none for such a
        problem.
        """

    def linear(self, model: Model) -> LinearModel:
        """The LinearModel that a Model stands for."""

    def open(self, fit: Fit) -> list[C]:
        """The candidates that may still be admitted."""

    def search(
        self, model: Model, candidates: list[C], least: float, progress: Callable[[int, int], None] | None
    ) -> list[Score[C]]:
        """Scores by raw delta BIC, the greatest first; those below `least` may be missing."""

    def rescored(self, model: Model, fit: Fit, number: int) -> Score[C]:
        """The Score of an admitted term on a model without it."""

    def aliases(self, model: Model, own: Score[C], score: Score[C]) -> list[Score[C]]:
        """Other nodes of the candidate of `own` (scored as `score`) that are another hypothesis than its best one."""

    def column(self, model: Model, score: Score[C]) -> Column:
        """Column (1) of what a Score's candidate does as scanned."""

    def add_term(self, fit: Fit, score: Score[C]) -> Fit:
        """The Fit with one term more, the last."""

    def companion(self, fit: Fit, score: Score[C]) -> Score[C] | None:
        """A Score of another place anew, now that others are admitted; None where it has gone."""

    def remove_term(self, fit: Fit, number: int) -> Fit:
        """The Fit with one term less."""

    def in_place(self, fit: Fit, number: int) -> Fit:
        """The Fit with its last term moved to a number."""

    def refined(self, fit: Fit) -> Fit:
        """The Fit with terms' nonlinear parameters at their best now that others are admitted."""

    def simplified(self, fit: Fit, /) -> Fit:
        """The Fit with special cases in place of general ones that do no better, and one general one in place of many
        special.
        """

    def wald(self, fit: Fit, number: int) -> Wald:
        """Of one term."""

    def likelihood_ratio(self, fit: Fit, other: Fit) -> float:
        """By how much minus twice the log likelihood of `fit` is above that of `other`."""

    def heldout_gains(self, fit: Fit, numbers: list[int]) -> list[float]:
        """Standard errors by which stretches held out gain by each of some terms."""

    def cross_validation(self, fit: Fit, number: int) -> CrossValidation:
        """Of one term."""

    def lack_of_fit(self, model: Model, place: str | None = None) -> list[LackOfFit]:
        """What nobody named, the most convincing first; at a place of a name alone, by the chance that names are found
        by, where one is given.
        """

    def within(self, left: LackOfFit, place: str) -> bool:
        """Whether what is left sits where something at a place does, or at a part of it."""
