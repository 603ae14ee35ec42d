"""Confirmation of findings against alternatives."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Generic

import numpy as np

from calib.diagnosis.engine.candidate_scores_and_their_significance import (
    SEVERAL,
    Alternative,
    Scans,
    Score,
    is_significant,
    may_become_significant_when_fitted,
    score_raised_to_likelihood_ratio,
)
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import C, SelectionPolicy
from calib.diagnosis.engine.choice_between_whole_machine_and_axis_terms import is_significant_alone_or_with_other_axes
from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import LackOfFit
from calib.diagnosis.engine.linear_residual_model import column_cosine
from calib.diagnosis.engine.problem_interface import (
    AliasedNodes,
    AlternativeScreening,
    Fit,
    Model,
    Problem,
    Progress,
    UnfittedNodes,
)
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.report.verdict_refutations_and_result_display import FieldSummaryRepr

TAKEN = 0.5  # of a smooth function's mean square, which it keeps at most beside a name that stands for the same
LISTED = 3  # terms that the label of a search names
RESTARTS = 2  # times the most terms that there may be, replacements after which terms are confirmed as they stand


@dataclass(frozen=True, slots=True, eq=False)
class Refit(Generic[Fit, C]):
    """scanned : as a scan tells it; alternative : with what it is behind by a fit of all that is free
    fit : with it in the finding's place, the last of the terms"""

    scanned: Alternative[C]
    alternative: Alternative[C]
    fit: Fit


def is_indistinguishable(alternative: Alternative[C], policy: SelectionPolicy) -> bool:
    """Whether the data leave an Alternative indistinguishable from its finding."""
    close = abs(alternative.cosine)
    return close > policy.cosine or (alternative.behind < policy.alike and close >= policy.akin)


def _reach(policy: SelectionPolicy, score: Score[C]) -> float:
    """How far, in delta BIC, an alternative may lie behind a finding with a Score."""
    return max(2 * policy.alike, policy.near * score.delta_chi2 * score.dispersion)


def find_alternatives(
    problem: Problem[Fit, Model, C],
    model: Model,
    finding_score: Score[C],
    progress: Callable[[int, int], None] | None,
    known: tuple[list[Score[C]], Score[C]] | None = None,
    candidates: Callable[[], list[C]] | None = None,
) -> list[Alternative[C]]:
    """Find the alternatives to a finding ([Alternative]).

    They are on a model without it, by weight, the best of each place.
    known : as `Scans.of_same_terms` has it, taken in place of a new scan where that listed all that is asked here
    candidates : a function of those that are scanned, None for all
    """
    policy, linear = problem.policy, problem.linear(model)
    size, here = linear.size, (finding_score.candidate.name, finding_score.candidate.place)
    reach, scores = _reach(policy, finding_score), None
    if known is not None and known[1].raw_delta_bic(size) - _reach(policy, known[1]) >= policy.delta_bic:
        scores, finding_score = known  # it leaves out what is below delta_bic, where a weak finding has alternatives
        reach = _reach(policy, finding_score)
    if scores is None:
        least = max(finding_score.raw_delta_bic(size) - reach, 0.0)
        scores = problem.search(model, problem.candidates if candidates is None else candidates(), least, progress)
    column = problem.column(model, finding_score)

    def alternative(score: Score[C]) -> Alternative[C]:
        return Alternative(
            score,
            finding_score.evidence(size) - score.evidence(size),
            column_cosine(linear, column, problem.column(model, score)),
        )

    out: list[Alternative[C]] = []
    listed: set[tuple[str, str]] = set()
    for s in scores:
        place = s.candidate.name, s.candidate.place
        if place == here:
            others = problem.aliases(model, finding_score, s) if isinstance(problem, AliasedNodes) else []
            found = [alternative(a) for a in others]
            out += [a for a in found if a.behind < 2 * policy.alike and abs(a.cosine) >= policy.akin]
            continue
        if (
            place in listed
            or finding_score.evidence(size) - s.evidence(size) > reach
            or s.p_value > policy.alternative_alpha
        ):
            continue
        listed.add(place)
        out.append(alternative(s))
    return sorted(out, key=lambda a: a.behind)


def refit_alternatives(
    problem: Problem[Fit, Model, C],
    fit: Fit,
    number: int,
    finding_score: Score[C],
    alternatives: list[Alternative[C]],
    hidden: bool = False,
) -> list[Refit[Fit, C]]:
    """Refit alternatives to a finding.

    They are the first that a scan cannot separate from it.
    A scan takes for scatter what is not admitted yet, and so tells of a strong term far less than it could. Where an
    alternative does worse than the scan said, the other members of its law are refitted too.
    hidden : whether the finding convinces by its fit alone, as they then may
    """
    close = [a for a in alternatives if is_indistinguishable(a, problem.policy)][: problem.policy.refitted]
    size, out = problem.size(fit), []

    @cache
    def bare() -> Fit:
        return problem.remove_term(fit, number)

    def behind(score: Score[C], new: Fit) -> float:
        return problem.likelihood_ratio(new, fit) + score.complexity(size) - finding_score.complexity(size)

    for a in close:
        chosen, new = a.score, problem.exchange_term(fit, number, a.score)
        if behind(chosen, new) > a.behind + problem.policy.alike:
            new = min(new, problem.add_term(bare(), a.score), key=lambda one: behind(a.score, one))
        if behind(chosen, new) > a.behind + problem.policy.alike:
            others = _scores_of_other_members(problem, problem.residual(bare()), a.score.candidate)
            members = [(s, problem.exchange_term(fit, number, s)) for s in others[: problem.policy.members]]
            chosen, new = min([(chosen, new), *members], key=lambda one: behind(*one))
        score = (
            score_raised_to_likelihood_ratio(
                chosen, problem.likelihood_ratio(bare(), new), problem.linear(problem.residual(fit)).frames
            )
            if hidden
            else chosen
        )
        out.append(Refit(a, replace(a, score=score, behind=behind(chosen, new)), new))
    return out


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Finding(FieldSummaryRepr, Generic[C]):
    """number : of the term among the admitted; score : with all others admitted; alternatives : that the recording
    cannot tell from it
    """

    number: int
    score: Score[C]
    alternatives: list[Alternative[C]]


def search_label_of_unconfirmed_terms(terms: Sequence[C]) -> str:
    """Label of a search beside terms found so far, which names them as not yet confirmed."""
    places = [f"{term.name} at {term.place}" for term in terms]
    more = f" and {len(places) - LISTED} more" if len(places) > LISTED else ""
    return f"so far {', '.join(places[:LISTED])}{more}, not yet confirmed; searching on" if places else "searching"


def labelled_progress(progress: Progress | None, label: str) -> Callable[[int, int], None] | None:
    """A progress (done, of) under a label, or None."""
    return None if progress is None else lambda done, of: progress(label, done, of)


def confirmed_fit_and_findings(
    problem: Problem[Fit, Model, C], fit: Fit, scans: Scans[C], progress: Progress | None
) -> tuple[Fit, list[Finding[C]]]:
    """Fit whose terms are confirmed one by one, and these as findings.

    All candidates are tried against it: it is removed, replaced, or retained with its alternatives.
    The others stay admitted meanwhile, and a term's moment or choice is searched for again beside them; after a change
    all are gone through anew, and what still explains as much keeps its alternatives. What was replaced does not come
    back, and after a number of replacements nothing is replaced any more: every term of the Fit is a finding in the
    end. scans : those made so far
    """
    changes, findings = _Changes[C](), list[Finding[C]]()
    while len(findings) < len(problem.terms(fit)):
        fit, finding = _confirm_term(problem, fit, len(findings), scans, changes, progress)
        findings = [] if finding is None else [*findings, finding]
    return fit, sorted(findings, key=lambda f: -f.score.delta_chi2)


class _Changes(Generic[C]):
    """What confirmation has changed. replaced : candidates that do not come back; moved : times that a
    term went to another node"""

    def __init__(self) -> None:
        self.replaced, self.moved = list[C](), 0
        self._screened: tuple[object, list[list[C]] | None] = None, None

    def candidates(
        self, problem: Problem[Fit, Model, C], fit: Fit, number: int, progress: Callable[[int, int], None] | None
    ) -> list[C]:
        """Those that may explain as much as a term of a Fit, screened once for all where terms are several; or all."""
        if not isinstance(problem, AlternativeScreening) or len(problem.terms(fit)) < SEVERAL:
            return problem.candidates
        if self._screened[0] is not fit:
            self._screened = fit, problem.screen_alternatives(fit, progress)
        return problem.candidates if self._screened[1] is None else self._screened[1][number]


def _confirm_term(
    problem: Problem[Fit, Model, C],
    fit: Fit,
    number: int,
    scans: Scans[C],
    changes: _Changes[C],
    progress: Progress | None,
) -> tuple[Fit, Finding[C] | None]:
    """(Fit, Finding of a term); (Fit without the term or with another in its place, None) where it is not confirmed."""
    policy, count = problem.policy, len(problem.candidates)
    replaces = len(changes.replaced) < RESTARTS * policy.most
    model, size, term = problem.without_term(fit, number), problem.size(fit), problem.terms(fit)[number]
    scanned, held = problem.rescored(model, fit, number), problem.given.holds(term)
    bare = cache(lambda: problem.remove_term(fit, number))
    own = _score_as_fitted(problem, model, fit, term, scanned, bare)
    if not held and not is_significant_alone_or_with_other_axes(problem, fit, number, own):  # beside all others
        return bare(), None
    member = None if held or not replaces else _likelier_member(problem, model, fit, number, scanned, changes.replaced)
    if member is not None:
        changes.replaced.append(term)
        return problem.in_place(member, number), None
    may_move = not held and changes.moved < RESTARTS * policy.most
    moved = _at_likelier_node(problem, fit, number, scanned) if may_move else None
    if moved is not None:
        changes.moved += 1
        return problem.in_place(moved, number), None
    others = [c for i, c in enumerate(problem.terms(fit)) if i != number]
    if (confirmed := scans.alternatives(others, own, size)) is not None:
        return fit, Finding(number, own, confirmed)
    label = labelled_progress(progress, f"alternatives of {own.candidate.name}")
    known = scans.of_same_terms(others, scanned, problem.linear(model).size)  # like against like
    screened = partial(changes.candidates, problem, fit, number, label)
    found = find_alternatives(problem, model, scanned, label, known, screened)
    tries = refit_alternatives(problem, fit, number, scanned, found, own is not scanned)
    rest = [a for a in found if not any(a is t.scanned for t in tries)]
    ranked = sorted([*(t.alternative for t in tries), *rest], key=lambda a: a.behind)
    better = next((t for t in tries if t.alternative is ranked[0] and _takes_over(problem, fit, number, t)), None)
    if (
        better is not None
        and replaces
        and not held
        and not any(better.alternative.score.candidate is c for c in changes.replaced)
        and is_significant(better.alternative.score, count, size, policy)
    ):
        changes.replaced.append(term)
        return problem.in_place(better.fit, number), None
    if not held and _outdone(problem, model, fit, own):
        # only now: what has no name may be likelier than one name, and not than the next
        member = refit_with_other_member_of_law(problem, model, fit, number, changes.replaced) if replaces else None
        if member is None:
            return bare(), None
        changes.replaced.append(term)
        return problem.in_place(member, number), None
    finding = Finding(number, own, [a for a in ranked if is_indistinguishable(a, policy)])
    scans.keep_alternatives(others, own, finding.alternatives)
    return fit, finding


def _score_as_fitted(
    problem: Problem[Fit, Model, C], model: Model, fit: Fit, term: C, scanned: Score[C], bare: Callable[[], Fit]
) -> Score[C]:
    """The Score of a term that a scan of a model without it gave, raised to what the Fit shows where the scan may have
    taken what the term explains for scatter of its axis. bare : makes the Fit without the term"""
    policy, count, size = problem.policy, len(problem.candidates), problem.size(fit)
    if is_significant(scanned, count, size, policy):
        return scanned
    hides_itself = term.site.is_axis and policy.hidden > 0
    if not hides_itself and not may_become_significant_when_fitted(scanned, count, size, policy):
        return scanned
    ratio = problem.likelihood_ratio(bare(), fit)
    return score_raised_to_likelihood_ratio(scanned, ratio, problem.linear(model).frames)


def _takes_over(problem: Problem[Fit, Model, C], fit: Fit, number: int, tried: Refit[Fit, C]) -> bool:
    """Whether an alternative takes the place of a term of a Fit: it leads by what the policy asks; where the term's
    name stands at several axes and the alternative is one of the whole machine, by the data alone, since together with
    the name at the other axes it does the same."""
    least, term, other = problem.policy.takes_over, problem.terms(fit)[number], tried.alternative.score.candidate
    if tried.alternative.behind >= -least:
        return False
    alike = sum(c.name == term.name and c.site.is_axis for c in problem.terms(fit))
    if alike < SEVERAL or not term.site.is_axis or other.site.is_axis:
        return True
    return problem.likelihood_ratio(tried.fit, fit) < -least


def _outdone(problem: Problem[Fit, Model, C], model: Model, fit: Fit, score: Score[C]) -> bool:
    """Whether a smooth function without a name is likelier than a hypothesis that consists of a few numbers: these lie
    far from what rigs show,
    or the place is another. model : without it; fit : with it; a name that leaves nothing there explains, once fitted,
        as much as the function."""
    if score.candidate.vector:
        return False
    size, place, alike = problem.linear(model).size, score.candidate.site, problem.policy.alike
    before = _smooth_functions(problem, model, place)
    likelier = [u for u in before if u.evidence(size) > score.evidence(size) + alike]
    if not likelier:
        return False
    after = _smooth_functions(problem, problem.residual(fit), place)
    # in metres or pixels: how unlikely it is, is judged by what scatters then
    left = {(u.place, u.depends_on, u.freedom): u.magnitude for u in after}
    likelier = [u for u in likelier if left.get((u.place, u.depends_on, u.freedom), 0.0) ** 2 < TAKEN * u.magnitude**2]
    far_from_usual = any(score.complexity(size) > u.shortest(size)[1] + alike for u in likelier)
    return far_from_usual or bool(likelier and after)


def _smooth_functions(problem: Problem[Fit, Model, C], model: Model, place: Place) -> list[LackOfFit]:
    """Smooth functions without a name that a model shows at a place, or anywhere where the policy asks that."""
    anywhere = problem.policy.smooth_anywhere
    return [u for u in problem.lack_of_fit(model) if u.dispersion and (anywhere or problem.within(u, place))]


def _scores_of_other_members(problem: Problem[Fit, Model, C], model: Model, term: C) -> list[Score[C]]:
    """Scores of the other members of a term's law at its place, on a model without it, the likeliest first."""
    size = problem.linear(model).size
    others = [c for c in problem.candidates if (c.name, c.place) == (term.name, term.place) and c is not term]
    return sorted(problem.search(model, others, -np.inf, None), key=lambda s: -s.evidence(size)) if others else []


def _likelier_member(
    problem: Problem[Fit, Model, C], model: Model, fit: Fit, number: int, scanned: Score[C], excluded: Sequence[C]
) -> Fit | None:
    """The Fit with another member of a term's law in its place, the last of the terms, where that is likelier once all
    is fitted by what an alternative must lead by; None where none is.

    model : without the term, scanned as this Score; excluded : members that are not tried
    """
    policy, size = problem.policy, problem.linear(model).size
    if not np.isfinite(policy.takes_over):
        return None
    term = problem.terms(fit)[number]
    others = [s for s in _scores_of_other_members(problem, model, term) if not any(s.candidate is c for c in excluded)]
    if not others:
        return None
    frames = problem.linear(model).frames if policy.hidden > 0 and term.site.is_axis else None
    reach = 1.0
    if not term.extra:  # linear, so that a scan errs only in that it takes for scatter what is not admitted
        fitted = problem.likelihood_ratio(problem.remove_term(fit, number), fit)
        reach = max(fitted / scanned.likelihood_ratio(frames), 1.0)

    def evidence(score: Score[C]) -> float:
        return reach * score.likelihood_ratio(frames) - score.complexity(size)

    for score in sorted(others, key=evidence, reverse=True)[: policy.refitted]:
        if evidence(score) < evidence(scanned) - policy.alike:
            break
        new = problem.exchange_term(fit, number, score)
        cost = score.complexity(size) - scanned.complexity(size)
        if problem.likelihood_ratio(fit, new) > cost + policy.takes_over:
            return new
    return None


def _at_likelier_node(problem: Problem[Fit, Model, C], fit: Fit, number: int, scanned: Score[C]) -> Fit | None:
    """The Fit with a term at the node of its candidate that is best beside all others, the last of the terms, where
    that is another one and likelier by what an alternative must lead by; None where it is not.
    """
    if not isinstance(problem, UnfittedNodes) or not problem.is_at_other_node(fit, number, scanned):
        return None
    new = problem.exchange_term(fit, number, scanned)
    return new if problem.likelihood_ratio(fit, new) > problem.policy.takes_over else None


def refit_with_other_member_of_law(
    problem: Problem[Fit, Model, C], model: Model, fit: Fit, number: int, excluded: Sequence[C] = ()
) -> Fit | None:
    """Fit with another member of a term's law in its place, that explains its residuals; None where none does.

    It is the last of the terms. A law is a family, and a machine need not follow its first
    formula.
    model : without it; excluded : members that are not tried
    """
    site, size = problem.terms(fit)[number].site, problem.linear(model).size
    for score in _scores_of_other_members(problem, model, problem.terms(fit)[number]):
        if any(score.candidate is c for c in excluded):
            continue
        if is_significant(score, len(problem.candidates), size, problem.policy):
            new = problem.exchange_term(fit, number, score)
            left = problem.lack_of_fit(problem.residual(new))
            if not any(u.dispersion and problem.within(u, site) for u in left):
                return new
    return None


def is_finding_significant(
    problem: Problem[Fit, Model, C], finding: Finding[C], model: Model, fit: Fit, candidate_count: int
) -> bool:
    """Whether a Finding is significant on a model without it, among `candidate_count` candidates."""
    return is_significant(
        problem.rescored(model, fit, finding.number), candidate_count, problem.linear(model).size, problem.policy
    )
