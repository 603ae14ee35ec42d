"""Simplification of a joint's profiles and sinusoids.

Of profiles, sinusoids and scales of one joint, the simplest that explains as much is retained.
"""

from dataclasses import replace

from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import (
    NO_STATED_TERMS,
    SelectionPolicy,
    StatedTerms,
)
from calib.diagnosis.problems.arm.arm_candidate_chi_square_scores import score_candidates
from calib.diagnosis.problems.arm.finding_parameter_optimisation_and_intervals import (
    has_continuous_parameters,
    optimise_nonlinear_parameters,
)
from calib.diagnosis.problems.arm.joint_effect_candidates_and_effects_seen_by_instruments import (
    OWN_ANGLE,
    SPAN,
    Form,
    JointCandidate,
)
from calib.diagnosis.problems.arm.robust_fit_of_effect_terms_to_arm_poses import Fit, Term, fit_terms_to_poses
from rig.array_and_json_types import Booleans
from rig.effects.framework.parameters_covariates_and_marker_table import COUNT

FINE = 0.3  # step between orders, of what a joint's travel resolves
CYCLES = 2  # sinusoids that a profile is tried to be made of
QUICK = 2  # times of weighing anew while the search goes on
NEIGHBOURS = 2  # steps to either side of a sinusoid's order at which it is looked for anew


def candidates_compatible_with_terms(fit: Fit, candidates: list[JointCandidate]) -> list[JointCandidate]:
    """Candidates compatible with the terms already in a Fit.

    Neither repeated nor contained in a profile.
    """
    has = {(t.candidate.name, t.candidate.place) for t in fit.terms if t.candidate.kind.once}
    profiles = {c.joint: c for c in candidates if c.form is Form.PROFILE}
    profiled = {t.candidate.joint for t in fit.terms if t.candidate.form is Form.PROFILE}
    cycles = [t for t in fit.terms if t.candidate.form is Form.SINUSOID]
    out = []
    for candidate in candidates:
        if (candidate.name, candidate.place) in has or (candidate.form is Form.SLOPE and candidate.joint in profiled):
            continue
        if candidate.form is Form.SINUSOID and candidate.joint in profiled:
            finest = _resolved_order(profiles[candidate.joint], fit) if candidate.joint in profiles else 0.0
            candidate = replace(candidate, grid=[node for node in candidate.grid if node[candidate.sought] > finest])
        for one in cycles:
            if candidate.step and one.candidate.joint == candidate.joint:
                name, order = candidate.sought, one.node[one.candidate.sought]
                candidate = replace(
                    candidate, grid=[node for node in candidate.grid if abs(node[name] - order) > candidate.step / FINE]
                )
        if candidate.grid:
            out.append(candidate)
    return out


def _resolved_order(profile: JointCandidate, now: Fit) -> float:
    """The order, per turn of what drives the axis, of the fastest sinusoid that a profile's finest knots can follow."""
    finest = max(profile.grid, key=lambda node: node[COUNT])
    low, high = finest[SPAN]
    turn = now.arms.context.moved().turn()[profile.joint]
    return float((finest[COUNT] - 1) / max(high - low, 1e-9) * turn / 2)


def merge_sinusoids_into_profiles(
    fit: Fit,
    candidates: list[JointCandidate],
    train: Booleans | None,
    policy: SelectionPolicy,
    stated_terms: StatedTerms = NO_STATED_TERMS,
) -> Fit:
    """The Fit with sinusoids merged into profiles.

    Many at a joint become one profile.
    Where that fits about as well.
    train : (n,) bool, or None for all
    """
    for candidate in [c for c in candidates if c.form is Form.PROFILE]:
        reach = _resolved_order(candidate, fit)
        cycles = [
            i
            for i, t in enumerate(fit.terms)
            if not stated_terms.holds(t.candidate)
            and t.candidate.joint == candidate.joint
            and t.candidate.form in OWN_ANGLE
            and (t.candidate.form is not Form.SINUSOID or t.node[t.candidate.sought] < reach)
        ]
        if len(cycles) <= CYCLES:
            continue
        rest = fit.without_terms(cycles)
        best = score_candidates(rest, [candidate], correlated_frames=policy.cluster)
        trial = rest.with_terms([Term.of(best[0])]) if best else rest
        if trial.criterion() < fit.criterion() + policy.delta_bic * len(cycles):
            fit = fit_terms_to_poses(fit.arms, trial.terms, train, fit.weighing, rounds=QUICK)
    return fit


def refine_knots_and_parameters(fit: Fit, train: Booleans | None, policy: SelectionPolicy) -> Fit:
    """Refine a Fit's profile knots and term parameters.

    As many profile knots, and as exact term parameters, as the data support.

    A term is looked at again once the scatter has changed to speak of. train : (n,) bool, or None for all poses
    """
    fit = optimise_terms(fit, [t for t in fit.terms if has_continuous_parameters(t) and t.stale(fit.scatter[0])])
    for one in [t for t in fit.terms if t.candidate.form in (Form.PROFILE, Form.SINUSOID) and t.stale(fit.scatter[0])]:
        rest = fit.without_terms(_numbers(fit, one))
        best = score_candidates(rest, [_about(one)], correlated_frames=policy.cluster)
        better = best and best[0].node != one.node
        trial = rest.with_terms(
            [replace(Term.at(one.candidate, best[0].node) if better else one, level=float(fit.scatter[0]))]
        )
        fit = trial if not better or one.candidate.form is Form.PROFILE or trial.criterion() < fit.criterion() else fit
    return fit_terms_to_poses(fit.arms, fit.terms, train, fit.weighing, rounds=QUICK)


def optimise_terms(fit: Fit, terms: list[Term]) -> Fit:
    """The Fit with the nonlinear parameters of some terms optimised.

    Weights of the poses as they are.
    """
    for one in terms:
        rest, level = fit.without_terms(_numbers(fit, one)), float(fit.scatter[0])
        trial = rest.with_terms([replace(optimise_nonlinear_parameters(rest, one), level=level)])
        fit = trial if trial.criterion() < fit.criterion() else rest.with_terms([replace(one, level=level)])
    return fit


def _about(one: Term) -> JointCandidate:
    """The candidate of a term, confined to nodes near the term's."""
    candidate, near = one.candidate, [one.node]
    if candidate.form is Form.PROFILE:
        here = candidate.grid.index(one.node)
        near = candidate.grid[max(here - 1, 0) : here + 2]
    elif candidate.step:
        whole = round(one.node[candidate.sought] / candidate.step)
        near = [
            {candidate.sought: k * candidate.step} for k in range(max(whole - NEIGHBOURS, 1), whole + NEIGHBOURS + 1)
        ]
    return replace(candidate, grid=near)


def simplify_profiles(
    fit: Fit,
    candidates: list[JointCandidate],
    train: Booleans | None,
    policy: SelectionPolicy,
    stated_terms: StatedTerms = NO_STATED_TERMS,
) -> Fit:
    """The Fit with profiles simplified.

    They become a scale or a few sinusoids where these do as well.
    train : (n,) bool, or None for all poses
    """
    for one in [t for t in fit.terms if t.candidate.form is Form.PROFILE and not stated_terms.holds(t.candidate)]:
        here, worth = fit.without_terms(_numbers(fit, one)), fit.criterion()
        own = [c for c in candidates if c.joint == one.candidate.joint and c.form in (Form.SLOPE, Form.SINUSOID)]
        for left in range(CYCLES, 0, -1):
            scores = score_candidates(here, own, correlated_frames=policy.cluster)
            if not scores or here.criterion() - left * max(s.delta_chi2 * s.dispersion for s in scores) > worth:
                break  # later ones seldom bring more than the first
            here = here.with_terms([Term.of(scores[0])])
            if here.criterion() < worth:
                fit = fit_terms_to_poses(fit.arms, here.terms, train, fit.weighing, rounds=QUICK)
                break
    return fit


def choose_forms_of_laws(
    fit: Fit,
    candidates: list[JointCandidate],
    train: Booleans | None,
    policy: SelectionPolicy,
    stated_terms: StatedTerms = NO_STATED_TERMS,
) -> Fit:
    """The Fit with each law in its best form.

    It has the more or fewer numbers that explain best, in place of another term or beside all others.
    A search admits a form before the other terms are there, and more numbers stand for some of these; or it admits
    another term for what a form of few numbers leaves. train : (n,) bool, or None for all poses
    """
    for one in [t for t in fit.terms if t.candidate.form not in (Form.PROFILE, Form.SINUSOID)]:
        forms = [c for c in candidates if (c.name, c.place) == (one.candidate.name, one.candidate.place)]
        if stated_terms.holds(one.candidate) or len({len(c.prior(node)) for c in forms for node in c.grid}) < 2:
            continue
        if not _numbers(fit, one):  # another law has taken its place
            continue
        # of what scattered before the term was there, no number more would be worth itself
        fit = fit_terms_to_poses(fit.arms, fit.terms, train, fit.weighing, rounds=QUICK)
        own = _numbers(fit, one)
        others = [[i] for i, t in enumerate(fit.terms) if [i] != own and not stated_terms.holds(t.candidate)]
        rests = [fit.without_terms(own + gone) for gone in ([], *others)]
        trials = [
            rest.with_terms([Term.of(s)])
            for rest in rests
            for s in score_candidates(rest, forms, correlated_frames=policy.cluster)
        ]
        best = min(trials, key=Fit.criterion, default=fit)
        if best.criterion() < fit.criterion():
            fit = fit_terms_to_poses(fit.arms, best.terms, train, fit.weighing, rounds=QUICK)
    return fit


def _numbers(now: Fit, one: Term) -> list[int]:
    return [i for i, t in enumerate(now.terms) if t is one]
