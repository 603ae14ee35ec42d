"""Data types of candidates, of the selection policy (thresholds) and of outliers.

Thresholds with their reasons, excluded outliers, and stated terms.
"""

from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, TypeVar

import numpy as np

from calib.identify.bounded_and_robust_least_squares_fit import MOST
from rig.array_and_json_types import Floats
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.report.verdict_refutations_and_result_display import FieldSummaryRepr

Node = dict[str, Any]  # {parameter: value} of the nonlinear parameters, one node of a candidate's grid


class Role(Enum):
    """How a number that rigs show over some range enters: in proportion, by its reciprocal, or as the size that a grid
    goes through.
    """

    LINEAR = "linear"
    INVERSE = "inverse"
    SIZE = "size"


@dataclass(frozen=True, slots=True)
class UsualRange:
    """What rigs show of one number: low, high in its own unit; signed : whether minus that is as usual; role."""

    name: str
    low: float
    high: float
    signed: bool
    role: Role


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Candidate(FieldSummaryRepr):
    """Something that may be at a place. Candidates are distinguished by identity.

    name; place; grid : [Node] in the order of the search; label : which variant
    extra : nonlinear parameters that the search chooses; tied : coefficients that the others determine
    usual : what rigs show of its numbers, None where nobody says
    bounds : (low (q,), high (q,)) of its coefficients, None for none
    vector : whether its size is many numbers, of which nobody says what is usual
    free_form : whether it is any function of what it depends on, by so many numbers: what such functions still leave
        refutes the numbers, not the name
    searched : whether a parameter that means nothing without the effect is sought over the grid, so that the search
        over it tells its cost
    """

    name: str
    place: str
    grid: list[Node]
    label: str = ""
    extra: int = 0
    tied: int = 0
    usual: tuple[UsualRange, ...] | None = None
    bounds: tuple[Floats, Floats] | None = None
    searched: bool = False
    vector: bool = False
    free_form: bool = False

    @property
    def site(self) -> Place:
        """Its place as a Place."""
        return Place.parse(self.place)

    @property
    def nonnegative(self) -> bool:
        """Whether it has several coefficients, none of them below zero."""
        return self.bounds is not None and len(self.bounds[0]) > 1 and bool((self.bounds[0] == 0).all())

    def allowed(self, coefficients: Floats) -> Floats:
        """Coefficients (q,) within the bounds, those beyond at them."""
        return coefficients if self.bounds is None or not len(coefficients) else np.clip(coefficients, *self.bounds)


C = TypeVar("C", bound=Candidate)  # a problem's own kind of candidate


@dataclass(frozen=True, slots=True)
class NotTested:
    """An effect that a recording cannot show, and why."""

    effect: str
    reason: str


Site = tuple[str, str]  # an effect's name and a place


@dataclass(frozen=True, slots=True)
class StatedTerms:
    """assumed : terms that are there, whatever the data say of them; before : terms seen before, that have to stand
    like any other.
    """

    assumed: tuple[Site, ...] = ()
    before: tuple[Site, ...] = ()

    @property
    def first(self) -> tuple[Site, ...]:
        """All that is in from the start, what is assumed first."""
        return tuple(dict.fromkeys((*self.assumed, *self.before)))

    def holds(self, candidate: Candidate) -> bool:
        """Whether a term stays whatever the data say."""
        return (candidate.name, candidate.place) in self.assumed


NO_STATED_TERMS = StatedTerms()


@dataclass(frozen=True, slots=True)
class SelectionPolicy:
    """The thresholds by which terms are admitted, kept, named and told apart.

    alpha : chance of a finding where there is nothing, over all effects, places and searches (Bonferroni)
    delta_bic : of the Bayesian information criterion that a term must bring; 10 is "very strong" (Kass and Raftery
        1995)
    hidden : chance, over all candidates, above which a candidate is not fitted to see whether its own scatter hides it,
    unless it explains by delta_bic more than it costs; 0 for never
    most : terms at once
    tried : candidates that may fail on held-out stretches before the search ends
    companions : of the greatest delta BIC; another axis' candidate with so much is admitted in the same step, inf for
        none
    forward_gain : standard errors by which held-out stretches must gain for a term to be admitted, None where it is
        asked at the end alone
    final_gain : standard errors by which they must gain for a term to stay at the end, None where it was asked when it
        was admitted
    alike : minus twice the logarithm of odds, from which hypotheses are told apart (odds of 20 to 1)
    cosine : between sensitivities, nuisances taken out, from which two hypotheses are the same
    akin : between sensitivities, below which two hypotheses are different effects and no alternatives, whatever each
        explains
    near : of a finding's delta chi-square; an alternative whose sensitivities are nearly the same lies no farther
        behind
    form_left : of what a name of free form explains; so much may be left at its place by smooth functions for the name
        to stand
    cover_left : of what a name explains by itself, from which it stands beside smooth functions although the scatter
        that it makes hides it from a scan
    alternative_alpha : chance above which an alternative explains nothing by itself; what searching for it costs is in
        its odds already
    refitted : alternatives that are fitted with all that is free in a finding's place; 0 where the score is exact
    members : of an alternative's law that are fitted so, where the likeliest does worse than its score said
    takes_over : minus twice the logarithm of odds by which an alternative must lead to take a finding's place, inf for
        never
    smooth_beyond : times a name's delta BIC, from which a smooth function without one explains so much more that no
        further name is given
    smooth_anywhere : whether a smooth function at another place, likelier by `alike` than a name, takes that name away;
        one at its own always does
    cluster : frames in a row whose errors may be alike, taken together where dispersion is judged
    """

    alpha: float = 1e-3
    delta_bic: float = 10.0
    hidden: float = 1.0
    most: int = 24
    tried: int = 3
    companions: float = float("inf")
    forward_gain: float | None = 0.5
    final_gain: float | None = None
    alike: float = 6.0
    cosine: float = 0.99
    akin: float = 0.0
    near: float = 0.03
    form_left: float = 0.25
    cover_left: float = 0.5
    alternative_alpha: float = 1e-2
    refitted: int = 4
    members: int = 2
    takes_over: float = 1.0
    smooth_beyond: float = 2.0
    smooth_anywhere: bool = True
    cluster: int = 1


PLATFORM = SelectionPolicy()

ARM = replace(
    PLATFORM,
    hidden=0.0,  # an arm's scatter is one for all joints, and no joint's own
    # an arm has six gears, six bearings and six loads of its own, where a platform's struts are alike and stiff
    most=24,
    # each joint's turn is measured nearly apart from the others', so that several can be admitted on one look
    companions=0.4,
    forward_gain=None,  # a step admits several at once, each too small to tell by stretches until the others are in
    # no alternative takes a term's place and nothing is refitted nonlinearly, so stretches are the last judge of it
    final_gain=2.0,
    # a sinusoid may stand for any smooth function of one joint: as good a score does not make another effect of it
    akin=0.5,
    # many sinusoids stand for any smooth function of a joint, each explaining a little of every other
    alternative_alpha=1e-4,
    refitted=0,  # terms are linear at their grid's node: the score is the refit
    takes_over=float(
        "inf"
    ),  # a general profile beats its special case by chance; `simplified` decides between them instead
    smooth_beyond=float(
        "inf"
    ),  # something unnamed always remains of a real arm, and is most often several gears not admitted yet
    smooth_anywhere=False,  # for the same reason: what remains at one joint says little of a name at another
    cluster=5,  # poses of a trajectory are neighbours: what a geometry leaves is alike in a row
)


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A row that was left out of all that was asked. frame : its number; place : where it shows most; off : in unit
    times : the scatter of the others; what : "pose" where the whole frame was left out, "corners" where those of one
        marker in one image were
    reason : in words"""

    frame: int
    what: str
    place: str
    off: float
    unit: str
    times: float
    reason: str


@dataclass(frozen=True, slots=True)
class Crowd:
    """So many of a kind are far off that they are not wild: the model is incomplete. what : in the plural;
    count, of : how many.
    """

    what: str
    count: int
    of: int


@dataclass(frozen=True, slots=True, eq=False)
class Outliers:
    """frames : numbers of those left out whole; sightings : {(frame's number, camera's index, marker's row)} of those
    whose corners are
    left_out : (LeftOut, ..) of both; crowd : Crowd of what is far off in too many, or None"""

    frames: frozenset[int] = frozenset()
    sightings: frozenset[tuple[int, int, int]] = frozenset()
    left_out: tuple[LeftOut, ...] = ()
    crowd: Crowd | None = None

    def with_more(self, more: "Outliers", count: int, what: str) -> "Outliers":
        """Both together, of so many rows, called `what`; where these are too many, the first alone and the crowd that
        they are.
        """
        both = len(self.frames) + len(more.frames - self.frames)
        if both > MOST * count:
            return replace(self, crowd=Crowd(what, both, count))
        left_out = sorted(self.left_out + more.left_out, key=lambda one: one.frame)
        return Outliers(
            self.frames | more.frames, self.sightings | more.sightings, tuple(left_out), more.crowd or self.crowd
        )
