"""Interface of the evidence that a diagnosis takes, and the effects requested of it.

Evidence is what a machine's recording offers a diagnosis.

A common core and parts of some machines; effects of the catalogue, at which places, are included or omitted.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Protocol, Self, TypeVar, runtime_checkable

import numpy as np

from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import (
    C,
    Candidate,
    NotTested,
    Outliers,
    StatedTerms,
)
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import CrossValidation
from calib.diagnosis.engine.forward_and_backward_term_selection import Selection
from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import Covariate, LackOfFit
from calib.diagnosis.engine.problem_interface import Fit, Problem, Progress
from calib.diagnosis.engine.term_confirmation_against_alternative_candidates import Finding
from calib.diagnosis.problems.covariate_functions_smoothed_temperatures_and_repeats import Repeats, Suggestion
from rig.array_and_json_types import Floats, Integers
from rig.effects.catalogue.effect_list import ALL
from rig.effects.framework.effect_base_class import Effect
from rig.errors import FileError, RigError
from rig.formats.csv_and_parquet_tables_and_time_origin import TimeOrigin
from rig.model.design import Design

Made = TypeVar("Made", bound=Candidate)


class EffectSites(NamedTuple):
    """places : at which an effect may be requested, None for any; searched : those at which candidates are made;
    not_tested : what it cannot be asked for"""

    places: tuple[str, ...] | None
    searched: tuple[str, ...]
    not_tested: Sequence[NotTested] = ()


@dataclass(frozen=True, slots=True)
class RequestedEffects:
    """only : "effect" or "effect place" to which the catalogue is confined, empty for all of it; without : what is left
    out
    kinds : the catalogue, with what a user adds to it."""

    only: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    kinds: tuple[type[Effect], ...] = ALL

    @staticmethod
    def of(
        only: Iterable[str] | None, without: Iterable[str], given: StatedTerms, kinds: tuple[type[Effect], ...] = ALL
    ) -> "RequestedEffects":
        """Asked with what is assumed besides. Raises RigError where that is left out at the same time."""
        requested = RequestedEffects(tuple(only or ()), tuple(without), kinds)
        assumed = tuple(f"{name} {place}" for name, place in given.assumed)
        out = [text for text, (name, _) in zip(assumed, given.assumed) if {name, text} & set(requested.without)]
        if out:
            raise RigError(f"{' and '.join(out)} cannot be both assumed and excluded")
        return RequestedEffects((*requested.only, *assumed) if requested.only else (), requested.without, kinds)

    def name(self, name: str) -> bool:
        """Whether an effect is asked for at any place."""
        return (not self.only or any(text.split(" ")[0] == name for text in self.only)) and name not in self.without

    def touches(self, name: str) -> bool:
        """Whether anything is said of an effect, or everything is asked for."""
        return not self.only or any(text.split(" ")[0] == name for text in (*self.only, *self.without))

    def place(self, name: str, place: str) -> bool:
        """Whether an effect is asked for at a place."""
        names = {name, f"{name} {place}"}
        return (not self.only or bool(names & set(self.only))) and not names & set(self.without)

    def candidates(
        self, sites_of: Callable[[type[Effect]], EffectSites], candidates_at: Callable[[type[Effect], str], list[Made]]
    ) -> tuple[list[Made], list[NotTested]]:
        """(candidates, what cannot be tested) of the requested catalogue.

        sites_of : EffectSites of an effect, RigError where it cannot be tested at all; candidates_at : of an effect at
            a place. Raises RigError for a requested place at which an effect cannot sit
        """
        out: list[Made] = []
        skipped: list[NotTested] = []
        sites: dict[str, tuple[str, ...]] = {}
        for kind in filter(lambda kind: self.touches(kind.name), self.kinds):
            try:
                found = sites_of(kind)
                skipped += found.not_tested
                if found.places is not None:
                    sites[kind.name] = found.places
                for place in found.searched:
                    if self.place(kind.name, place):
                        out += candidates_at(kind, place)
            except FileError:
                raise  # of a file that a user wrote
            except RigError as error:
                skipped.append(NotTested(kind.name, str(error)))
        self.check(sites)
        return out, [s for s in skipped if self.name(s.effect)]

    def check(self, sites: dict[str, tuple[str, ...]]) -> None:
        """Raise RigError where a place is asked for, or left out, that none of the places (of each effect that can be
        asked for) is.
        """
        for text in (*self.only, *self.without):
            name, _, place = text.partition(" ")
            if place and name in sites and place not in sites[name]:
                raise RigError(
                    f"{text!r}: {name} cannot sit at {place!r} in this recording; it can at {', '.join(sites[name])}"
                )


def require_assumed_effects_testable(
    stated_terms: StatedTerms, candidates: Sequence[Candidate], untestable_effects: Sequence[NotTested]
) -> StatedTerms:
    """Require that the recording can test assumed effects.

    Returns the stated terms. Raises RigError otherwise.
    """
    testable = {(c.name, c.place) for c in candidates}
    for name, place in stated_terms.assumed:
        if (name, place) not in testable:
            reasons = [s.reason for s in untestable_effects if s.effect == name]
            raise RigError(
                f"{name} at {place} is assumed, but this recording cannot be tested for it"
                + (f": {reasons[0]}" if reasons else "")
            )
    return stated_terms


LEFT = "what remains"  # of a pose, beside what each finding does to it
STATED, RESIDUALS, ASSUMED_NOISE = (
    "stated",
    "residuals",
    "assumed",
)  # whence the noise comes: a statement, the residuals themselves, a usual figure
Family = Literal["struts", "joints"]


@dataclass(frozen=True, slots=True)
class Value:
    """value : number, list of numbers or names; unit; ci95 : (low, high) of a number, (lows, highs) of a list;
    at_bound : the bound of what makes sense that the value stands at, the data asking for more; open : "below", "above"
        or
    "both" where the data leave it open up to a bound of what makes sense, at which ci95 ends"""

    value: Any
    unit: str
    ci95: list[Any] | None = None
    at_bound: float | None = None
    open: str | None = None


def value_with_interval_cut_at_bounds(
    value: float, unit: str, ends: tuple[float, float], bounds: tuple[float, float], at_bound: float | None = None
) -> Value:
    """Value with its 95 % interval, cut off at the bounds that make sense."""
    low, high = max(ends[0], bounds[0]), min(ends[1], bounds[1])
    below, above = low == bounds[0], high == bounds[1]
    return Value(
        value,
        unit,
        [low, high],
        at_bound,
        "both" if below and above else "below" if below else "above" if above else None,
    )


def onset_time_with_interval(
    t: Floats, onset_time: float, origin: TimeOrigin, onset_interval: tuple[float, float] | None = None
) -> Value:
    """Onset time with its interval.

    It is by the owner's clock; the interval is the times of the frames between which it lies.
    t : (n,) s of the frames; onset_time : s from the recording's start
    onset_interval : (earliest, latest) s, where it may lie between other frames as well
    """
    low, high = (np.clip(np.searchsorted(t, v), 1, len(t) - 1) for v in onset_interval or (onset_time, onset_time))
    return Value(origin.shown(onset_time), "s", [origin.shown(t[low - 1]), origin.shown(t[high])])


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations of what was measured, cameras known: px of a corner, m and rad of a pose, m of a strut; None
    where there is none. source : whence it comes; times : {position or rotation: Value} by which poses scatter more
    than is stated, where that was estimated
    """

    corner_px: float | None
    pose_m: float | None
    pose_rad: float | None
    strut_m: float | None
    source: str
    times: dict[str, Value] = field(default_factory=dict)


class Misfit(NamedTuple):
    """Misfit of stretches held out in one unit, with nothing admitted and with all; floor : what noise alone leaves."""

    before: float
    after: float
    floor: float
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutPoses:
    """Residuals (n, k), m and rad, of poses by structures chosen and fitted on other stretches: geometry alone, and
    with effects.

    stretches : how many there were; names : per part, what was chosen on the others
    far : (n,) rad, how far the joint that is farthest stood from any angle that it was fitted at"""

    before: Floats
    after: Floats
    stretches: int
    names: tuple[tuple[str, ...], ...]
    far: Floats


class Remark(NamedTuple):
    """Something beyond chance that is nobody's fault. effect, place; parameters : {name: Value}; reason : in words that
    follow "no more than"; p_value : of chance.
    """

    effect: str
    place: str
    parameters: dict[str, Value]
    reason: str
    p_value: float


class MeasuredFinding(NamedTuple):
    """A finding that was measured before anything was searched: faces exchanged, or not where they are stated."""

    kind: type[Effect]
    place: str
    parameters: dict[str, Value]


@dataclass(frozen=True, slots=True, eq=False)
class Tolerable:
    """What is there beyond chance and no finding, set apart. findings : [(Finding, reason)]; left : [(LackOfFit,
    reason)]; remarks : [Remark] of tolerances themselves; reason : in words that follow "no more than".
    """

    findings: list[tuple[Finding[Any], str]] = field(default_factory=list)
    left: list[tuple[LackOfFit, str]] = field(default_factory=list)
    remarks: list[Remark] = field(default_factory=list)


class Evidence(Protocol[Fit, C]):
    """What was measured of a machine, from which its problem is made, and what only its machine can say of a Selection
    of that problem.
    """

    @property
    def source(self) -> str:
        """Where the poses come from, in words."""

    @property
    def family(self) -> Family:
        """What was measured of the machine: corners and closures of struts, or poses at joints."""

    def gross_outliers(self) -> Outliers:
        """Outliers that show before anything is admitted."""

    # Any: fits, models and candidates, of each kind of machine their own
    def problem(self, outliers: Outliers) -> tuple[Problem[Any, Any, Any], list[NotTested]]:
        """(Problem without outliers, what its recording cannot be asked for, and why). Raises RigError where what is
        assumed cannot be.
        """

    def outliers(self, fit: Fit, known: Outliers) -> Outliers:
        """Outliers with those that show beside a Fit, which a large effect hid."""

    def effects(self, selection: Selection[Fit, C]) -> tuple[Effect, ...]:
        """The effects found, with their values."""

    def design(self, selection: Selection[Fit, C]) -> Design | None:
        """Design as fitted with the findings; None where nothing was commanded."""

    def parameters(self, selection: Selection[Fit, C], finding: Finding[C], origin: TimeOrigin) -> dict[str, Value]:
        """{name: Value} of a Finding, moments by the owner's clock."""

    def noise(self, selection: Selection[Fit, C]) -> Noise:
        """Noise that all is judged by."""

    def misfits(
        self, selection: Selection[Fit, C], held: list[HeldOutPoses], repeats: Repeats | None
    ) -> tuple[dict[str, Misfit], str]:
        """({what is looked at: Misfit of all findings together}, what the first finding shows in)."""

    def covariates(self, selection: Selection[Fit, C]) -> list[Covariate]:
        """[Covariate] that what is left goes with, the one that explained most before first."""

    def suggestions(
        self, selection: Selection[Fit, C], left: list[LackOfFit], progress: Progress | None
    ) -> list[Suggestion]:
        """Formulas for what is left."""

    def scatter_beyond_noise(
        self, selection: Selection[Fit, C], left: list[LackOfFit], repeats: Repeats | None, covariates: list[Covariate]
    ) -> list[LackOfFit]:
        """[LackOfFit] of what scatters beyond the noise."""


@runtime_checkable
class TemperatureAlternatives(Protocol[Fit, C]):
    """Capability: a finding may as well be an effect that follows a temperature."""

    def with_temperature_alternatives(self, selection: Selection[Fit, C]) -> Selection[Fit, C]:
        """Selection in which every finding has those among its alternatives."""


@runtime_checkable
class IntervalWidening(Protocol[Fit, C]):
    """Capability: thermometers' own errors and tolerances leave parameters open."""

    def with_widened_intervals(self, selection: Selection[Fit, C]) -> Selection[Fit, C]:
        """Selection whose Fit's covariances hold what those add."""


@runtime_checkable
class ToleratedFindings(Protocol[Fit, C]):
    """Capability: tolerances may do on their own what was found."""

    def set_apart_tolerable(
        self, selection: Selection[Fit, C], left: list[LackOfFit]
    ) -> tuple[Selection[Fit, C], list[LackOfFit], Tolerable]:
        """(Selection of what matters, what is left and matters, Tolerable)."""


@runtime_checkable
class MeasuredFindings(Protocol):
    """Capability: some findings are measured before the search."""

    def measured_findings(self, found: tuple[Effect, ...]) -> tuple[MeasuredFinding, ...]:
        """Those findings, beside the effects that the search found."""

    @property
    def effects_shown_by_instruments(self) -> tuple[Effect, ...]:
        """Their effects, as far as these make another machine."""


@runtime_checkable
class NestedSelection(Protocol[Fit, C]):
    """Capability: the search can be made on parts of the recording, to predict the others."""

    def held_out_poses(self, selection: Selection[Fit, C], progress: Progress | None) -> list[HeldOutPoses]:
        """[HeldOutPoses], fine stretches first."""


@runtime_checkable
class RegionValidation(Protocol[Fit, C]):
    """Capability: whole regions of an axis' travel can be held out."""

    def validations_by_region(self, selection: Selection[Fit, C]) -> list[list[CrossValidation]]:
        """For each axis, [CrossValidation] of the findings with whole regions of its travel held out in turn."""


@runtime_checkable
class RepeatedCommands(Protocol[Fit, C]):
    """Capability: commands given twice say how well poses repeat."""

    def repeats(self, selection: Selection[Fit, C]) -> Repeats | None:
        """Repeats, or None where too few commands were given twice."""


@runtime_checkable
class ScatterSize(Protocol[Fit, C]):
    """Capability: the fit determines what poses scatter beyond what is stated of them."""

    def scatter_beyond_stated(self, selection: Selection[Fit, C]) -> tuple[float, bool]:
        """(m by length, whether that is more than a statement of noise may be wrong by)."""


@runtime_checkable
class NoiseEstimation(Protocol[Fit, C]):
    """Capability: the residuals show that the noise of all poses is a multiple of what is stated."""

    def with_estimated_noise(self, selection: Selection[Fit, C]) -> Self | None:
        """The same Evidence with that noise, to be explained anew; None where the stated noise stands."""


@runtime_checkable
class WeighedPoses(Protocol[Fit, C]):
    """Capability: single poses count for less where they agree with no model."""

    def frames_set_aside(self, selection: Selection[Fit, C]) -> list[int]:
        """Numbers of frames that count for next to nothing."""


@runtime_checkable
class PoseContributions(Protocol[Fit, C]):
    """Capability: what each finding does to each pose is known."""

    def contributions(self, selection: Selection[Fit, C]) -> tuple[Integers, list[str], Floats]:
        """(frames (n,), ("effect place" .., "what remains"), (n, findings + 1) m) by how much each finding displaces
        the target in each pose, alone, and what they leave; in the order of the diagnosis.
        """
