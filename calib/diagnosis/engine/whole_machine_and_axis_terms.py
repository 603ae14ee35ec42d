"""Terms of one name about the whole machine, or at its axes apart: which of the two a Fit has."""

import numpy as np

from calib.diagnosis.engine.candidate_score import SEVERAL, Score
from calib.diagnosis.engine.candidate_threshold_and_outlier_types import C, Site
from calib.diagnosis.engine.confirmation_against_alternatives import is_significant
from calib.diagnosis.engine.problem_interface import AdmissionRules, Fit, Model, Problem

HypothesisKeys = set[tuple[object, ...]]  # of those admitted once
Merges = set[tuple[str, frozenset[Site]]]  # (name at several axes, (name, place) of all other terms), tried as one


def admissible_candidates(problem: Problem[Fit, Model, C], fit: Fit) -> list[C]:
    """Candidates of a problem that may still be admitted to a Fit."""
    return problem.admissible(fit) if isinstance(problem, AdmissionRules) else problem.candidates


def best_score(problem: Problem[Fit, Model, C], fit: Fit, candidates: list[C], size: int) -> Score[C] | None:
    """Score with the most evidence, by residuals of a size, of candidates beside a Fit; None where none is seen."""
    scores = problem.search(problem.residual(fit), candidates, -np.inf, None)
    return max(scores, key=lambda s: s.evidence(size), default=None)


def one_hypothesis_of_alike_axes(
    problem: Problem[Fit, Model, C], fit: Fit, keys: HypothesisKeys, merged: Merges
) -> Fit:
    """The Fit with one hypothesis about the whole machine in place of a name's terms at several axes, where that is
    likelier once fitted, by what residuals scatter, and no axis then shows what no name explains; axes may then differ
    from it anew. merged : those tried, each once"""
    terms, size = problem.terms(fit), problem.size(fit)
    for name in dict.fromkeys(c.name for c in terms if c.site.is_axis):
        tried = name, frozenset((c.name, c.place) for c in terms if c.name != name)
        numbers = [i for i, c in enumerate(terms) if c.name == name and c.site.is_axis]
        whole = [c for c in problem.candidates if c.name == name and not c.site.is_axis]
        places = {terms[i].place for i in numbers}
        if len(places) < SEVERAL or not whole or any(problem.given.holds(terms[i]) for i in numbers) or tried in merged:
            continue
        bare = _without_terms(problem, fit, numbers)
        best = best_score(problem, bare, whole, size)
        if best is None:
            continue
        new = problem.add_term(bare, best)
        fewer = _parameters(problem, fit, numbers) - _parameters(problem, new, [len(problem.terms(new)) - 1])
        merged.add(tried)
        if _gain(problem, fit, new) + fewer * np.log(size) > 0 and not _leaves_axes_unexplained(
            problem, fit, new, name, places
        ):
            keys -= {known for known in keys if known[0] == name and known[1] in places}
            return new
    return fit


def terms_at_axes_apart(problem: Problem[Fit, Model, C], fit: Fit) -> Fit | None:
    """The Fit with a name's terms at each axis in place of one about the whole machine, None where that serves none.

    It serves where an axis shows what no name explains, as one does that has less of it than the whole machine where it
    has no negative size; and where the terms apart are likelier, by what residuals scatter.
    """
    terms, size, count = problem.terms(fit), problem.size(fit), len(problem.candidates)
    of_axes = {c.name: [s for s in problem.candidates if s.name == c.name and s.site.is_axis] for c in terms}
    whole = [c for c in terms if not c.site.is_axis and of_axes[c.name] and not problem.given.holds(c)]
    if not whole:
        return None
    shown = {str(u.place) for u in problem.lack_of_fit(problem.residual(fit))}
    for name in dict.fromkeys(c.name for c in whole):
        places = list(dict.fromkeys(c.place for c in of_axes[name]))
        numbers = [i for i, c in enumerate(terms) if c.name == name]
        if not shown & set(places) or any(problem.given.holds(terms[i]) for i in numbers):
            continue
        new = _without_terms(problem, fit, numbers)
        before = len(problem.terms(new))
        for place in places:
            best = best_score(problem, new, [c for c in of_axes[name] if c.place == place], size)
            if best is not None and best.evidence(size) > 0:
                new = problem.add_term(new, best)
        more = _parameters(problem, new, list(range(before, len(problem.terms(new)))))
        more -= _parameters(problem, fit, numbers)
        if _gain(problem, fit, new) > more * np.log(size) + 2 * np.log(count):
            return new
    return None


def _leaves_axes_unexplained(problem: Problem[Fit, Model, C], fit: Fit, new: Fit, name: str, places: set[str]) -> bool:
    """Whether with one hypothesis of a name in place of those at several axes, an axis shows a misfit that it did not
    show before and that the name, differing there, would not explain."""
    model = problem.residual(new)
    explained = {u.place for u in problem.lack_of_fit(problem.residual(fit))}
    left = [u for u in problem.lack_of_fit(model) if u.place not in explained and str(u.place) in places]
    if not left:
        return False
    own = [c for c in admissible_candidates(problem, new) if c.name == name and c.place in places]
    count, size = len(problem.candidates), problem.linear(model).size
    return not any(is_significant(s, count, size, problem.policy) for s in problem.search(model, own, -np.inf, None))


def _without_terms(problem: Problem[Fit, Model, C], fit: Fit, numbers: list[int]) -> Fit:
    """The Fit without the terms of these numbers, in ascending order."""
    for number in reversed(numbers):
        fit = problem.remove_term(fit, number)
    return fit


def _gain(problem: Problem[Fit, Model, C], fit: Fit, new: Fit) -> float:
    """Likelihood ratio of a new Fit against a Fit, by what the latter's residuals scatter where that is more than
    stated.
    """
    left = problem.linear(problem.residual(fit))
    return problem.likelihood_ratio(fit, new) / max(left.cost() / left.size, 1.0)


def _parameters(problem: Problem[Fit, Model, C], fit: Fit, numbers: list[int]) -> float:
    """How many numbers some terms of a Fit have, those found on a grid included."""
    return sum(problem.wald(fit, n).freedom + problem.terms(fit)[n].extra for n in numbers)
