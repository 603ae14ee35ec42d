"""Load terms of an arm chosen anew, from all of them together.

What a load does at one link is nearly the sum of what it does at its neighbours. Terms that are admitted one by one may
end in a set that others, admitted together, beat.
"""

import numpy as np

from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import StatedTerms
from calib.diagnosis.engine.forward_and_backward_term_selection import remove_redundant_terms
from calib.diagnosis.engine.problem_interface import Problem
from calib.diagnosis.problems.arm.joint_effect_candidates_and_effects_seen_by_instruments import JointCandidate
from calib.diagnosis.problems.arm.robust_fit_of_effect_terms_to_arm_poses import Fit, Term, fit_terms_to_poses
from rig.array_and_json_types import Booleans

FEWEST = 2  # load terms, from which they are chosen anew
QUICK = 2  # times of weighing anew


def fit_with_load_terms_chosen_anew(
    problem: Problem[Fit, Fit, JointCandidate],
    fit: Fit,
    candidates: list[JointCandidate],
    train: Booleans | None,
    stated_terms: StatedTerms,
) -> Fit:
    """The Fit with its load terms chosen anew.

    They are chosen by elimination, from those at all joints and links, where that clearly explains more.
    Only where loads are stated, so that links may bend. train : (n,) bool, or None for all
    """
    retained = [t for t in fit.terms if not _is_load(t.candidate) or stated_terms.holds(t.candidate)]
    has = {(t.candidate.name, t.candidate.place) for t in retained}
    plain = [c for c in candidates if _is_plain_load(c) and (c.name, c.place) not in has]
    if len(fit.terms) - len(retained) < FEWEST or not any(c.kind.of_links for c in plain):
        return fit
    terms = [*retained, *(Term.at(c, c.grid[0]) for c in plain)]
    trial = fit_terms_to_poses(fit.arms, terms, train, fit.weighing, rounds=QUICK)
    trial = remove_redundant_terms(problem, _without_springs_that_push(problem, trial))
    trial = fit_terms_to_poses(fit.arms, trial.terms, train, fit.weighing, rounds=1)
    return trial if trial.criterion() < fit.criterion() - problem.policy.delta_bic else fit


def _is_load(candidate: JointCandidate) -> bool:
    return candidate.kind.of_links or candidate.kind.form == "load"


def _is_plain_load(candidate: JointCandidate) -> bool:
    """Whether a candidate is a load's of one number, with nothing else to choose."""
    return _is_load(candidate) and candidate.bounds is not None and not any(candidate.grid) and not candidate.extra


def _without_springs_that_push(problem: Problem[Fit, Fit, JointCandidate], fit: Fit) -> Fit:
    """The Fit without load terms that yield against their load, the one that does so most surely first."""
    while True:
        sure = [
            float(fit.theta[here][0] / np.sqrt(fit.covariance(number)[0, 0])) if _is_plain_load(t.candidate) else 0.0
            for number, (t, here) in enumerate(zip(fit.terms, fit.slices))
        ]
        worst = int(np.argmin(sure)) if sure else 0
        if not sure or sure[worst] >= 0:
            return fit
        fit = problem.remove_term(fit, worst)
