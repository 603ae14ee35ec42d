"""Choice between terms of the whole machine and terms of its axes.

Terms of one name about the whole machine, or at its axes apart: which of the two a Fit has, and whether axes show a
name together that none shows alone.
"""

import numpy as np
import scipy.special

from calib.diagnosis.engine.candidate_scores_and_their_significance import SEVERAL, Score, is_significant
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import C, Site
from calib.diagnosis.engine.problem_interface import AdmissionRules, Fit, Model, Problem

ALIKE = 0.5  # of the evidence for the most promising hypothesis
UNLIKELY = 0.05  # by chance: a term at one of several axes, among these
HypothesisKeys = set[tuple[object, ...]]  # of those admitted once
Merges = set[tuple[str, frozenset[Site]]]  # (name at several axes, (name, place) of all other terms), tried as one


def admissible_candidates(problem: Problem[Fit, Model, C], fit: Fit) -> list[C]:
    """Candidates of a problem that may still be admitted to a Fit."""
    return problem.admissible(fit) if isinstance(problem, AdmissionRules) else problem.candidates


def best_score(problem: Problem[Fit, Model, C], fit: Fit, candidates: list[C], size: int) -> Score[C] | None:
    """Best Score of candidates beside a Fit.

    It has the most evidence, by residuals of a size; None where none is seen.
    """
    scores = problem.search(problem.residual(fit), candidates, -np.inf, None)
    return max(scores, key=lambda s: s.evidence(size), default=None)


def fit_with_whole_machine_term_in_place_of_axis_terms(
    problem: Problem[Fit, Model, C], fit: Fit, keys: HypothesisKeys, merged: Merges
) -> Fit:
    """The Fit with one whole-machine term in place of a name's terms at several axes.

    It is taken where it is likelier once fitted, by what residuals scatter, and no axis then shows what no name
    explains; axes may then differ from it anew. merged : those tried, each once
    """
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


def fit_with_axis_terms_in_place_of_whole_machine_term(problem: Problem[Fit, Model, C], fit: Fit) -> Fit | None:
    """The Fit with terms at each axis in place of one of the whole machine.

    They are of one name; None where that serves none.
    It serves where an axis shows what no name explains, as one does that has less of it than the whole machine where it
    has no negative size; and where the terms apart are likelier, by what residuals scatter.
    """
    of_axes = _axis_candidates_of_whole_machine_terms(problem, fit)
    if not of_axes:
        return None
    shown = {str(u.place) for u in problem.lack_of_fit(problem.residual(fit))}
    least = 2 * np.log(len(problem.candidates))
    for own in of_axes.values():
        if shown & {c.place for c in own}:
            new, gain = _with_axis_terms(problem, fit, own)
            if gain > least:
                return new
    return None


def fit_with_whole_machine_term_split_by_axis(
    problem: Problem[Fit, Model, C], fit: Fit, promising: list[Score[C]], split: Merges
) -> Fit | None:
    """The Fit with a whole-machine term split by axis.

    It then has a name's terms at each axis; None where none is so split.
    It is where an axis shows the name beside it about as strongly as anything else, and all the axes apart gain more
    than the most promising hypothesis does: what axes have of one law in unequal shares is no other law at some of
    them. Laws with a number to be searched for in every variant are not split.
    promising : significant Scores; split : those tried, each once
    """
    terms, size = problem.terms(fit), problem.size(fit)
    most = max(0.0, *(s.evidence(size) for s in promising))
    at_axes = {s.candidate.name for s in promising if s.candidate.site.is_axis and s.evidence(size) >= ALIKE * most}
    for name, own in _axis_candidates_of_whole_machine_terms(problem, fit).items():
        tried = name, frozenset((c.name, c.place) for c in terms if c.name != name)
        # where every variant has a number to be searched for, as a time, an axis' term takes in what else it does
        flexible = min(c.extra for c in own) > 0
        if name not in at_axes or flexible or tried in split:
            continue
        split.add(tried)
        new, gain = _with_axis_terms(problem, fit, own)
        if gain > most + 2 * np.log(len(problem.candidates)):
            return new
    return None


def _axis_candidates_of_whole_machine_terms(problem: Problem[Fit, Model, C], fit: Fit) -> dict[str, list[C]]:
    """{name: its candidates at axes} of a Fit's terms about the whole machine that are not given."""
    terms = problem.terms(fit)
    names = dict.fromkeys(c.name for c in terms if not c.site.is_axis)
    given = {c.name for c in terms if problem.given.holds(c)}
    found = {n: [c for c in problem.candidates if c.name == n and c.site.is_axis] for n in names if n not in given}
    return {name: own for name, own in found.items() if own}


def _with_axis_terms(problem: Problem[Fit, Model, C], fit: Fit, own: list[C]) -> tuple[Fit, float]:
    """(The Fit with the best of a name's candidates at each axis in place of all its terms, how much likelier it is for
    its parameters).
    """
    terms, size = problem.terms(fit), problem.size(fit)
    numbers = [i for i, c in enumerate(terms) if c.name == own[0].name]
    whole = next(terms[i] for i in numbers if not terms[i].site.is_axis)
    member = [c for c in own if c.extra == whole.extra] or own  # of the law, as it is true of all
    new = _without_terms(problem, fit, numbers)
    before = len(problem.terms(new))
    for _ in range(2):  # what the others do is scatter at the first of them, until they are in
        for place in dict.fromkeys(c.place for c in member):
            here = [c for c in member if c.place == place]
            if any(c is one for c in here for one in problem.terms(new)):
                continue
            best = best_score(problem, new, here, size)
            if best is not None and best.evidence(size) > 0 and len(problem.terms(new)) < problem.policy.most:
                new = problem.add_term(new, best)
    more = _parameters(problem, new, list(range(before, len(problem.terms(new)))))
    more -= _parameters(problem, fit, numbers)
    return new, float(_gain(problem, fit, new) - more * np.log(size))


def fit_with_effect_weak_at_each_axis(
    problem: Problem[Fit, Model, C], fit: Fit, scores: list[Score[C]], tried: set[str]
) -> Fit | None:
    """The Fit with an effect at several axes that is weak at each.

    It is too good for chance at all of them together, though at none alone.
    What the other axes do counts as scatter at each, so that few frames of a small effect convince nobody. The axes'
    chances are combined by Fisher (Statistical methods for research workers, 1932). None where no name is so. scores :
    of candidates that may be admitted to the Fit; tried : names, each once
    """
    axes = {name: _surest_at_axes(scores, name) for name in dict.fromkeys(s.candidate.name for s in scores)}
    chances = {name: _combined_chance(of_axes) for name, of_axes in axes.items() if name not in tried}
    name = min(chances, key=lambda name: chances[name], default="")
    if not chances or chances[name] * len(axes) > problem.policy.alpha:
        return None
    tried.add(name)
    size, terms = problem.size(fit), len(problem.terms(fit))
    new = fit
    for place in axes[name]:
        own = [s.candidate for s in scores if (s.candidate.name, s.candidate.place) == (name, place)]
        best = best_score(problem, new, own, size)
        if best is not None and best.delta_bic(size) > 0 and len(problem.terms(new)) < problem.policy.most:
            new = problem.add_term(new, best)
    numbers = list(range(terms, len(problem.terms(new))))
    return new if len(numbers) >= SEVERAL and _predict_held_out(problem, new, numbers) else None


def _predict_held_out(problem: Problem[Fit, Model, C], fit: Fit, numbers: list[int]) -> bool:
    """Whether terms together predict stretches held out, by what the policy asks of one (Stouffer's sum of gains)."""
    least = problem.policy.forward_gain
    if least is None:
        return True
    return sum(v.gain for v in problem.cross_validations(fit, numbers)) > least * np.sqrt(len(numbers))


def _surest_at_axes(scores: list[Score[C]], name: str) -> dict[str, float]:
    """{axis: chance that noise alone shows there the best of a name's variants}, the least likely first."""
    chances: dict[str, list[float]] = {}
    for s in scores:
        if s.candidate.name == name and s.candidate.site.is_axis:
            chances.setdefault(s.candidate.place, []).append(s.p_value)
    found = {place: min(min(each) * len(each), 1.0) for place, each in chances.items()}
    return dict(sorted(found.items(), key=lambda item: item[1]))


def _combined_chance(of_axes: dict[str, float]) -> float:
    """The chance of chances {axis: p} all together; 1 where the axes are few."""
    if len(of_axes) < SEVERAL:
        return 1.0
    each = np.maximum(list(of_axes.values()), 1e-300)
    return float(scipy.special.chdtrc(2 * len(each), -2 * np.log(each).sum()))


def is_significant_alone_or_with_other_axes(
    problem: Problem[Fit, Model, C], fit: Fit, number: int, own: Score[C]
) -> bool:
    """Whether the term of a number is significant alone, or together with those of its name at the other axes.

    With others it must still pay for its parameters, and be unlikely by chance among these axes. own : its Score beside
    all others
    """
    policy, terms, size = problem.policy, problem.terms(fit), problem.size(fit)
    if is_significant(own, len(problem.candidates), size, policy):
        return True
    alike = [n for n, c in enumerate(terms) if c.name == own.candidate.name and c.site.is_axis]
    unlikely = own.p_value * len(alike) <= UNLIKELY and own.delta_bic(size) >= policy.delta_bic
    if number not in alike or len(alike) < SEVERAL or not unlikely:
        return False
    others = [problem.rescored(problem.without_term(fit, n), fit, n) for n in alike if n != number]
    names = {c.name for c in problem.candidates}
    return _combined_chance(_surest_at_axes([own, *others], own.candidate.name)) * len(names) <= policy.alpha


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
