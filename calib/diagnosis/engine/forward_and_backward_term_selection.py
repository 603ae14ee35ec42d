"""Forward and backward selection of the terms of a model.

Forward steps, backward removal, held-out tests, confirmation against alternatives.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic

import numpy as np

from calib.diagnosis.engine.candidate_scores_and_their_significance import (
    Scans,
    Score,
    is_significant,
    may_become_significant_when_fitted,
    score_raised_to_likelihood_ratio,
    scores_of_best_effect_at_several_axes,
)
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import C, Site
from calib.diagnosis.engine.choice_between_whole_machine_and_axis_terms import (
    HypothesisKeys,
    Merges,
    admissible_candidates,
    best_score,
    fit_with_axis_terms_in_place_of_whole_machine_term,
    fit_with_effect_weak_at_each_axis,
    fit_with_whole_machine_term_in_place_of_axis_terms,
    fit_with_whole_machine_term_split_by_axis,
)
from calib.diagnosis.engine.linear_residual_model import Projection, join_columns
from calib.diagnosis.engine.problem_interface import (
    Companions,
    Fit,
    Model,
    Problem,
    Progress,
    TermRefinement,
    TermSimplification,
    Tolerances,
)
from calib.diagnosis.engine.term_confirmation_against_alternative_candidates import (
    Finding,
    confirmed_fit_and_findings,
    labelled_progress,
    search_label_of_unconfirmed_terms,
)
from rig.report.verdict_refutations_and_result_display import FieldSummaryRepr

SEARCHED_AGAIN = 2  # times that terms are searched for beside those confirmed, where confirmation changed them
DIGITS = 3  # of a node's values, by which hypotheses are told apart


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Selection(FieldSummaryRepr, Generic[Fit, C]):
    """problem : Problem that all was judged by, with tolerances among its nuisances where they are seen to be at work
    before : Fit with nothing admitted; fit : with all; findings : in the order of their weight; candidate_count : of
    those tested
    """

    problem: Problem[Fit, Any, C]
    before: Fit
    fit: Fit
    findings: list[Finding[C]]
    candidate_count: int


def select_terms(
    problem: Problem[Fit, Model, C], progress: Progress | None = None, first: Sequence[Site] = ()
) -> Selection[Fit, C]:
    """Selection of the terms that a problem needs.

    progress : called with (label, done, of), or None; first : (name, place) of terms to begin with, which are confirmed
    as all others are
    """
    before = problem.start()
    problem, fit, scans = _chosen(problem, before, progress, first)
    searched = problem.terms(fit)
    fit, findings = confirmed_fit_and_findings(problem, fit, scans, progress)
    for _ in range(SEARCHED_AGAIN):
        if _counts(problem.terms(fit)) == _counts(searched):
            break
        more = _steps(problem, fit, scans, progress)
        if more is None:
            break
        searched = problem.terms(more)
        fit, findings = confirmed_fit_and_findings(problem, more, scans, progress)
    apart = fit_with_axis_terms_in_place_of_whole_machine_term(problem, fit)
    if apart is not None:
        fit, findings = confirmed_fit_and_findings(problem, remove_redundant_terms(problem, apart), scans, progress)
    return Selection(problem, before, fit, findings, len(problem.candidates))


def search_further_terms(
    problem: Problem[Fit, Model, C], selection: Selection[Fit, C], removed: set[Site], progress: Progress | None
) -> Selection[Fit, C]:
    """Selection with further terms found.

    They are in addition to its findings, but for those that were removed: (name, place).
    """
    scans, refused = Scans[C](), [c for c in problem.candidates if (c.name, c.place) in removed]
    more = _steps(problem, selection.fit, scans, progress, refused)
    if more is None or len(problem.terms(more)) == len(problem.terms(selection.fit)):
        return selection
    fit, findings = confirmed_fit_and_findings(problem, more, scans, progress)
    return replace(selection, fit=fit, findings=findings)


def select_and_fit_terms_without_alternatives(problem: Problem[Fit, Model, C], progress: Progress | None = None) -> Fit:
    """Fit of the terms that `select_terms` keeps, before alternatives are tried."""
    return _chosen(problem, problem.start(), progress, ())[1]


def _chosen(
    problem: Problem[Fit, Model, C], before: Fit, progress: Progress | None, first: Sequence[Site]
) -> tuple[Problem[Fit, Model, C], Fit, Scans[C]]:
    """(Problem, Fit, Scans made) with terms admitted, and those that pay on stretches held out retained. Raises
    ValueError for a policy that admits companions of a problem that has none.
    """
    if np.isfinite(problem.policy.companions) and not isinstance(problem, Companions):
        raise ValueError("the policy admits companions, and the problem does not search for any")
    sites = list(dict.fromkeys([*problem.given.first, *first]))
    problem, fit, scans = _forward(problem, _fit_with_terms_at(problem, before, sites), progress)
    if isinstance(problem, TermSimplification):
        fit = problem.simplify_terms(fit)
    return problem, _remove_terms_without_held_out_gain(problem, fit), scans


def _fit_with_terms_at(problem: Problem[Fit, Model, C], fit: Fit, sites: list[Site]) -> Fit:
    """The Fit with terms of these names and places admitted, each at its best beside those before it."""
    for site in sites:
        own = [c for c in admissible_candidates(problem, fit) if (c.name, c.place) == site]
        best = best_score(problem, fit, own, problem.linear(problem.residual(fit)).size)
        if best is not None:
            fit = problem.add_term(fit, best)
    return _refined(problem, fit) if sites else fit


def _refined(problem: Problem[Fit, Model, C], fit: Fit) -> Fit:
    """The Fit, refined where a problem refines its terms apart."""
    return problem.refine_terms(fit) if isinstance(problem, TermRefinement) else fit


def _tolerances_explain(problem: Problem[Fit, Model, C], fit: Fit, best: Score[C] | None) -> bool:
    """Whether something that is nobody's fault explains more than the best there is."""
    return isinstance(problem, Tolerances) and problem.tolerances_explain(fit, best)


def _forward(
    problem: Problem[Fit, Model, C], fit: Fit, progress: Progress | None
) -> tuple[Problem[Fit, Model, C], Fit, Scans[C]]:
    """(Problem, Fit, Scans) with terms admitted step by step; from the beginning again, tolerances among the nuisances,
    where these turn out to explain more.
    """
    scans: Scans[C] = Scans()
    found = _steps(problem, fit, scans, progress)
    while found is None and isinstance(problem, Tolerances):
        problem, scans = problem.with_tolerances(), Scans()
        found = _steps(problem, fit, scans, progress)
    return problem, fit if found is None else found, scans


def _steps(
    problem: Problem[Fit, Model, C], fit: Fit, scans: Scans[C], progress: Progress | None, excluded: Sequence[C] = ()
) -> Fit | None:
    """The Fit with terms admitted step by step; after each step, those that others have made needless go again. None
    where tolerances explain more than any name. scans : of each step; excluded : candidates that are not admitted"""
    policy, count = problem.policy, len(problem.candidates)
    keys: HypothesisKeys = set()
    merged: Merges = set()
    weak: set[str] = set()
    split: Merges = set()
    visited = {_counts(problem.terms(fit))}
    refused: list[C] = list(excluded)
    while len(problem.terms(fit)) < policy.most:
        model, size, admitted = problem.residual(fit), problem.size(fit), len(problem.terms(fit))
        model_size = problem.linear(model).size
        candidates, label = admissible_candidates(problem, fit), search_label_of_unconfirmed_terms(problem.terms(fit))
        scores = problem.search(model, candidates, policy.delta_bic, labelled_progress(progress, label))
        scans.keep(problem.terms(fit), scores)
        fresh = [s for s in scores if _hypothesis_key(s) not in keys and not any(s.candidate is c for c in refused)]
        promising = [s for s in fresh if is_significant(s, count, model_size, policy)] or _hidden(
            problem, fit, model, fresh
        )
        if _tolerances_explain(problem, fit, promising[0] if promising else None):
            return None
        alike: list[Score[C]] = []
        step = None
        apart = fit_with_whole_machine_term_split_by_axis(problem, fit, promising, split) if promising else None
        if apart is not None:
            fit = remove_redundant_terms(problem, _refined(problem, apart))
            continue
        if promising:
            alike = scores_of_best_effect_at_several_axes(
                promising, scores, model_size, _projection_of_scores(problem, model)
            )
            if admitted and _smooth_beyond(problem, model, [promising[0]], alike):
                break
            promising = sorted(promising, key=lambda s: not any(s is one for one in alike))
            step = _step(problem, fit, promising, scores, refused)
        if step is None:
            together = fit_with_effect_weak_at_each_axis(problem, fit, scores, weak)
            if together is None and not promising:
                return fit  # of which it was asked above whether tolerances explain more
            if together is None:
                break
            fit = remove_redundant_terms(problem, _refined(problem, together))
            continue
        fit, score = step
        keys.add(_hypothesis_key(score))
        fit = _same_name_elsewhere(problem, fit, score, alike, keys)
        fit = _companions(problem, fit, score, promising, keys, size)
        fit = remove_redundant_terms(problem, _refined(problem, fit))
        site = score.candidate.name, score.candidate.place
        if all((c.name, c.place) != site for c in problem.terms(fit)):  # it would be admitted and removed for ever
            refused += [c for c in problem.candidates if (c.name, c.place) == site]
        fit = fit_with_whole_machine_term_in_place_of_axis_terms(problem, fit, keys, merged)
        reached = _counts(problem.terms(fit))
        if reached in visited:  # as it would be where other terms at its place stay
            refused += [promising[0].candidate, score.candidate]
        visited.add(reached)
    return None if _tolerances_explain(problem, fit, None) else fit


def _counts(terms: Sequence[C]) -> frozenset[tuple[int, int]]:
    """How often each candidate is among terms, whatever their order."""
    return frozenset(Counter(map(id, terms)).items())


def _hidden(problem: Problem[Fit, Model, C], fit: Fit, model: Model, scores: list[Score[C]]) -> list[Score[C]]:
    """Of the strongest that a scan sees and the few that it finds least likely by chance, none convincing, those that
    convince once fitted, the most convincing first: what is not admitted yet counts as its own axis' scatter, the
    strongest hides itself most, and what a scan sees of it is worth no more than its frames, however many numbers that
    has to pay for."""
    policy, linear = problem.policy, problem.linear(model)
    scanned = [s for s in scores if may_become_significant_when_fitted(s, len(problem.candidates), linear.size, policy)]
    surest = sorted(scanned, key=lambda s: s.p_value)[: policy.tried]
    strongest = [
        s
        for s in sorted(scanned, key=lambda s: -s.raw_delta_bic(linear.size))[:1]
        if not any(s is other for other in surest)
    ]
    fitted = [
        score_raised_to_likelihood_ratio(s, problem.likelihood_ratio(fit, problem.add_term(fit, s)), linear.frames)
        for s in strongest + surest
    ]
    found = [s for s in fitted if is_significant(s, len(problem.candidates), linear.size, policy)]
    return sorted(found, key=lambda s: -s.delta_bic(linear.size))


def _projection_of_scores(problem: Problem[Fit, Model, C], model: Model) -> Callable[[list[Score[C]]], Projection]:
    """A function of Scores, the Projection on a model of a column for each."""
    linear = problem.linear(model)
    return lambda scores: linear.project(join_columns([problem.column(model, s) for s in scores]))


def _hypothesis_key(score: Score[C]) -> tuple[object, ...]:
    """What a hypothesis is known by: its name, place and node."""
    node = ((name, round(value, DIGITS) if isinstance(value, float) else value) for name, value in score.node.items())
    return score.candidate.name, score.candidate.place, tuple(sorted(node))


def _step(
    problem: Problem[Fit, Model, C], fit: Fit, promising: list[Score[C]], scores: list[Score[C]], refused: list[C]
) -> tuple[Fit, Score[C]] | None:
    """(Fit, Score) with the first of the promising that predicts stretches held out; None where none of the first few
    does.
    """
    least = problem.policy.forward_gain
    for best in promising[: problem.policy.tried]:
        trial = problem.add_term(fit, best)
        if least is None or problem.cross_validations(trial, [len(problem.terms(fit))])[0].gain > least:
            return _exchanged(
                problem, fit, trial, best, [s for s in scores if not any(s.candidate is c for c in refused)]
            )
        refused.append(best.candidate)
    return None


def _exchanged(
    problem: Problem[Fit, Model, C], fit: Fit, trial: Fit, best: Score[C], scores: list[Score[C]]
) -> tuple[Fit, Score[C]]:
    """(Fit, Score) with the hypothesis at a place that is best once fitted, of the variants of the name that a scan
    finds best and of others whose numbers a scan tries on a coarse grid only, so far as they may do better: by what
    factor `best` explains more once fitted than the scan said, they may do so twice over, since a large effect is not
    linear in its numbers, and what a coarse variant leaves counted as scatter. trial : `fit` with `best`"""
    size, fitted = problem.size(fit), problem.likelihood_ratio(fit, trial)
    scanned = next(s.delta_chi2 * s.dispersion for s in scores if s.candidate is best.candidate)
    reach, least = max(fitted / scanned, 1.0) ** 2, fitted - best.complexity(size)
    others = [
        s
        for s in scores
        if s.candidate.place == best.candidate.place
        and (s.candidate.name == best.candidate.name or s.candidate.extra)
        and s.candidate is not best.candidate
        and s.freedom > 0  # of those without, the scan says nothing
        and reach * s.delta_chi2 * s.dispersion - s.complexity(size) >= least
    ]
    found, chosen = trial, best
    for s in sorted(others, key=lambda s: -s.evidence(size))[: problem.policy.refitted]:
        if reach * s.delta_chi2 * s.dispersion - s.complexity(size) < least:
            continue
        new = problem.add_term(fit, s)
        gain = problem.likelihood_ratio(found, new) - (s.complexity(size) - chosen.complexity(size))
        if gain > 0:
            found, chosen, least = new, s, least + gain
    return found, chosen


def _same_name_elsewhere(
    problem: Problem[Fit, Model, C], fit: Fit, admitted: Score[C], alike: list[Score[C]], keys: HypothesisKeys
) -> Fit:
    """The Fit with a name that was admitted at one of several axes admitted at the others too, each where it convinces
    beside those before it. alike : the Scores that explain most together"""
    policy, size = problem.policy, problem.size(fit)
    if isinstance(problem, Companions) or all(s.candidate.name != admitted.candidate.name for s in alike):
        return fit
    for score in alike:
        place = score.candidate.place
        if place == admitted.candidate.place or len(problem.terms(fit)) >= policy.most:
            continue
        site = score.candidate.name, place
        variants = [c for c in admissible_candidates(problem, fit) if (c.name, c.place) == site]
        best, model_size = best_score(problem, fit, variants, size), problem.linear(problem.residual(fit)).size
        if best is not None and is_significant(best, len(problem.candidates), model_size, policy):
            keys.add(_hypothesis_key(best))
            fit = problem.add_term(fit, best)
    return fit


def _companions(
    problem: Problem[Fit, Model, C],
    fit: Fit,
    best: Score[C],
    promising: list[Score[C]],
    keys: HypothesisKeys,
    size: int,
) -> Fit:
    """The Fit with what other places show nearly as strongly, each asked again with the ones before it admitted."""
    policy, places = problem.policy, {best.candidate.place}
    if not isinstance(problem, Companions):
        return fit
    for score in promising:
        close = score.raw_delta_bic(size) >= policy.companions * best.raw_delta_bic(size)
        if score.candidate.place in places or not close or len(problem.terms(fit)) >= policy.most:
            continue
        places.add(score.candidate.place)
        companion = problem.companion(fit, score)
        if companion is not None and is_significant(companion, len(problem.candidates), size, policy):
            keys.add(_hypothesis_key(score))
            fit = problem.add_term(fit, companion)
    return fit


def _smooth_beyond(problem: Problem[Fit, Model, C], model: Model, *names: list[Score[C]]) -> bool:
    """Whether something that no name explains is larger than what the best name would, at one place or at several."""
    if not np.isfinite(problem.policy.smooth_beyond):
        return False
    size = problem.linear(model).size
    explained = max(sum(s.delta_bic(size) for s in scores) for scores in names)
    return any(
        u.delta_bic(size) > problem.policy.smooth_beyond * explained for u in problem.lack_of_fit(model) if u.dispersion
    )


def remove_redundant_terms(problem: Problem[Fit, Model, C], fit: Fit) -> Fit:
    """The Fit without terms that the others make redundant."""
    while not all(map(problem.given.holds, problem.terms(fit))):
        gains = []
        for number, candidate in enumerate(problem.terms(fit)):
            wald = problem.wald(fit, number)
            gain = wald.statistic - (wald.freedom + candidate.extra) * np.log(problem.size(fit))
            gains.append(np.inf if problem.given.holds(candidate) else gain)
        worst = int(np.argmin(gains))
        if gains[worst] >= problem.policy.delta_bic:
            break
        fit = problem.remove_term(fit, worst)
    return fit


def _remove_terms_without_held_out_gain(problem: Problem[Fit, Model, C], fit: Fit) -> Fit:
    """The Fit without terms that do not pay on stretches held out, where the policy asks that at the end."""
    least = problem.policy.final_gain
    while least is not None and not all(map(problem.given.holds, problem.terms(fit))):
        loose = [number for number, candidate in enumerate(problem.terms(fit)) if not problem.given.holds(candidate)]
        gains = [validation.gain for validation in problem.cross_validations(fit, loose)]
        worst = int(np.argmin(gains))
        if gains[worst] >= least:
            break
        fit = problem.remove_term(fit, loose[worst])
    return fit
