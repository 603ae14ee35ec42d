"""Removal of findings that are no longer significant when fitted together with smooth functions of what is left."""

from dataclasses import replace

from calib.diagnosis.engine.candidate_scores_and_their_significance import is_significant
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import C
from calib.diagnosis.engine.forward_and_backward_term_selection import Selection
from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import LackOfFit
from calib.diagnosis.engine.problem_interface import Fit, Model, Problem, SmoothCover
from calib.diagnosis.engine.term_confirmation_against_alternative_candidates import (
    Finding,
    refit_with_other_member_of_law,
)


def remove_findings_insignificant_with_smooth_functions(
    problem: Problem[Fit, Model, C], selection: Selection[Fit, C], unexplained: list[LackOfFit]
) -> Selection[Fit, C]:
    """Remove findings that are insignificant once smooth functions of the unexplained are fitted with them.

    Where what is left at a name's own place would make no finding, and is as unlikely by chance as what is named, the
    same is asked; then the name goes only for what is reported in its stead. Nothing goes where smooth functions are no
    freedom of the problem.
    """
    if not isinstance(problem, SmoothCover):
        return selection
    fit, gone, after, findings = selection.fit, [], problem.residual(selection.fit), []
    for f in selection.findings:
        if not problem.given.holds(f.score.candidate) and _is_insignificant_with_smooth_functions(
            problem, f, fit, after, unexplained, selection.candidate_count
        ):
            without = problem.without_term(fit, f.number)
            member = refit_with_other_member_of_law(problem, without, fit, f.number)
            if member is None:
                gone.append(f.number)
                continue
            fit = problem.in_place(member, f.number)
            f = replace(f, score=problem.rescored(without, fit, f.number))
        findings.append(f)
    for number in sorted(gone, reverse=True):
        fit = problem.remove_term(fit, number)
    findings = [replace(f, number=f.number - sum(g < f.number for g in gone)) for f in findings]
    return replace(selection, fit=fit, findings=findings)


def _is_insignificant_with_smooth_functions(
    problem: Problem[Fit, Model, C],
    finding: Finding[C],
    fit: Fit,
    after: Model,
    unexplained: list[LackOfFit],
    candidate_count: int,
) -> bool:
    """Whether a Finding is insignificant beside smooth functions of what the unexplained residuals, or those left at
    its own place, depend on.

    after : the residuals with all findings. Axes may differ in what a law of the whole machine makes of them: what a
    single axis leaves says nothing against its form unless that would be a finding itself.
    """
    assert isinstance(problem, SmoothCover)
    place, known = finding.score.candidate.site, {(u.place, u.depends_on) for u in unexplained}
    if unexplained and not _stays(problem, finding, fit, unexplained, candidate_count):
        return True
    size = problem.size(fit)
    doubts = [
        u
        for u in problem.lack_of_fit(after, place)
        if (u.place, u.depends_on) not in known
        and u.evidence(size) > 0  # what pays for its own numbers
        and (place.is_axis or not u.place.is_axis)
    ]
    if not doubts or _stays(problem, finding, fit, unexplained + doubts, candidate_count):
        return False
    return any(problem.within(u, place) for u in problem.lack_of_fit(problem.without_term(fit, finding.number)))


def _stays(problem: Problem[Fit, Model, C], finding: Finding[C], fit: Fit, left: list[LackOfFit], count: int) -> bool:
    """Whether a Finding of a Fit explains more than what is left at its place, and stands beside smooth functions of
    what all that is left depends on, of so many candidates asked; one of free form stands where little is left, and
    one that its own scatter hides where those functions take little of it."""
    assert isinstance(problem, SmoothCover)
    score = finding.score
    here = [u.delta_chi2 for u in left if u.depends_on and problem.within(u, score.candidate.site)]
    most = max(here, default=0.0)
    if most > score.delta_chi2:
        return False
    if score.candidate.free_form and most < problem.policy.form_left * score.delta_chi2:
        return True
    model, policy = problem.covered(fit, finding.number, left), problem.policy
    covered = problem.rescored(model, fit, finding.number)
    if is_significant(covered, count, problem.linear(model).size, policy):
        return True
    bare = problem.without_term(fit, finding.number)
    alone = problem.rescored(bare, fit, finding.number)
    hidden = not is_significant(alone, count, problem.linear(bare).size, policy)  # by the scatter that it makes itself
    return hidden and covered.delta_chi2 > policy.cover_left * alone.delta_chi2
