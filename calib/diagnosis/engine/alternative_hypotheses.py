"""Alternative hypotheses of each finding that explain the data as well, listed and refitted."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic

from calib.diagnosis.engine.candidate_score import Alternative, Score, score_with_likelihood_ratio
from calib.diagnosis.engine.linear_model import column_cosine
from calib.diagnosis.engine.problem_interface import AliasedNodes, Fit, Model, Problem
from calib.diagnosis.engine.selection_inputs import C, SelectionPolicy


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


def find_alternatives(
    problem: Problem[Fit, Model, C], model: Model, own: Score[C], progress: Callable[[int, int], None] | None
) -> list[Alternative[C]]:
    """[Alternative] to a Score on a model without it, by weight, the best of each name and place."""
    policy, linear = problem.policy, problem.linear(model)
    size, here = linear.size, (own.candidate.name, own.candidate.place)
    reach = max(2 * policy.alike, policy.near * own.delta_chi2 * own.dispersion)
    scores = problem.search(model, problem.candidates, max(own.raw_delta_bic(size) - reach, 0.0), progress)
    column = problem.column(model, own)

    def alternative(score: Score[C]) -> Alternative[C]:
        return Alternative(
            score,
            own.evidence(size) - score.evidence(size),
            column_cosine(linear, column, problem.column(model, score)),
        )

    out: list[Alternative[C]] = []
    listed: set[tuple[str, str]] = set()
    for s in scores:
        place = s.candidate.name, s.candidate.place
        if place == here:
            others = problem.aliases(model, own, s) if isinstance(problem, AliasedNodes) else []
            found = [alternative(a) for a in others]
            out += [a for a in found if a.behind < 2 * policy.alike and abs(a.cosine) >= policy.akin]
            continue
        if place in listed or own.evidence(size) - s.evidence(size) > reach or s.p_value > policy.alternative_alpha:
            continue
        listed.add(place)
        out.append(alternative(s))
    return sorted(out, key=lambda a: a.behind)


def refit_alternatives(
    problem: Problem[Fit, Model, C],
    fit: Fit,
    number: int,
    own: Score[C],
    alternatives: list[Alternative[C]],
    hidden: bool = False,
) -> list[Refit[Fit, C]]:
    """[Refit] of the first few that a scan does not tell from a finding: a scan takes for scatter what is not admitted
    yet, and so tells of a strong term far less than it could. hidden : whether the finding convinces by its fit alone,
    as they then may"""
    close = [a for a in alternatives if is_indistinguishable(a, problem.policy)][: problem.policy.refitted]
    if not close:
        return []
    size, bare, out = problem.size(fit), problem.remove_term(fit, number), []
    for a in close:
        new = problem.add_term(bare, a.score)
        behind = problem.likelihood_ratio(new, fit) + a.score.complexity(size) - own.complexity(size)
        score = (
            score_with_likelihood_ratio(
                a.score, problem.likelihood_ratio(bare, new), problem.linear(problem.residual(bare)).frames
            )
            if hidden
            else a.score
        )
        out.append(Refit(a, replace(a, score=score, behind=behind), new))
    return out
