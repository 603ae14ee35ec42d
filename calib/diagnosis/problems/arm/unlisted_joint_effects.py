"""Unlisted effects of joints: formula suggestions for what the catalogue does not explain."""

from dataclasses import dataclass

import numpy as np

from calib.diagnosis.engine.chance_probability import Z95
from calib.diagnosis.engine.cross_validation import (
    FOLDS,
    STRETCHES,
    signed_rank_gain_in_standard_errors,
    time_stretch_folds,
)
from calib.diagnosis.engine.formula_library import Library
from calib.diagnosis.engine.formula_search import Formula, Search
from calib.diagnosis.engine.lack_of_fit import LackOfFit
from calib.diagnosis.engine.reduced_least_squares import Reduced
from calib.diagnosis.engine.selection_inputs import ARM
from calib.diagnosis.problems.arm.candidate_search import joint_products
from calib.diagnosis.problems.arm.joint_candidates import joint_candidate
from calib.diagnosis.problems.arm.nonlinear_parameters import has_continuous_parameters, term_parameter_covariance
from calib.diagnosis.problems.arm.profile_and_sinusoid_simplification import optimise_terms
from calib.diagnosis.problems.arm.projected_pose_residuals import Fit, Term, fit_poses
from calib.diagnosis.problems.formula_suggestion import (
    AGREE,
    NAME,
    Suggestion,
    formula_quantities,
    formula_text,
    library_of_quantities,
)
from rig.effects.texts.effect_file_from_formula import Written

# joints of which a formula is held out: something unnamed remains of every real arm, and the largest are worth a look
SHOWN = 2


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """joint : index; library : Library of what a formula may look at there; formula : of all poses."""

    joint: int
    library: Library
    formula: Formula


def suggest_joint_formulas(fit: Fit, unexplained: list[LackOfFit]) -> list[Suggestion]:
    """[Suggestion] of formulas for the unexplained part of single joints, the largest first.
    At most SHOWN.
    """
    motion, places = fit.arms.context.moved(), {u.place for u in unexplained if u.depends_on}
    open_, out = [j for j, place in enumerate(motion.places) if place in places], []
    for _ in range(SHOWN):
        tried = [found for j in open_ if (found := _found(fit, j)) is not None]
        if not tried:
            break
        largest = max(tried, key=lambda found: found.formula.length)
        suggested = _suggested(fit, largest)
        open_ = [found.joint for found in tried if found is not largest]
        if suggested is not None:
            out.append(suggested[0])
            fit = suggested[1]
    return out


def _found(now: Fit, joint: int) -> Found | None:
    library = library_of_quantities(now.arms.context.moved(), joint)
    formula = _best(now, joint, library)
    return None if formula is None else Found(joint, library, formula)


def _best(now: Fit, joint: int, library: Library) -> Formula | None:
    """The Formula of what a Fit leaves of a joint on the poses that it used."""
    own = float(np.einsum("nkk->nk", now.arms.own)[now.used, :3].mean())
    floor = own / (own + float(np.mean(now.scatter[:3] ** 2)))
    return Search(library, Reduced.of(joint_products(now, joint), np.flatnonzero(now.used)), floor).best()


def _written(now: Fit, found: Found, formula: Formula) -> Written:
    """Written of a Formula at a joint."""
    return formula_text(formula, found.library, now.arms.context.moved().kind.AXIS, False)


def _term(now: Fit, found: Found, formula: Formula) -> Term:
    """The Term of a Formula at a joint, as its own file makes it."""
    form = _written(now, found, formula)
    (spec,) = form.kind(NAME).candidates(now.arms.context.moved().places[found.joint], now.arms.context)
    return Term.at(joint_candidate((spec,), now.arms), {name: form.values[name] for name in form.waves.values()})


def _suggested(now: Fit, found: Found) -> tuple[Suggestion, Fit] | None:
    """(Suggestion of what was found, the Fit with it); None where poses held out do not gain by such."""
    arms, fold = now.arms, time_stretch_folds(len(now.arms), STRETCHES) % FOLDS
    without = [fit_poses(arms, now.terms, now.used & (fold != h), now.weighing, rounds=1) for h in range(FOLDS)]
    chosen = [_best(part, found.joint, found.library) for part in without]
    before, after = np.empty(arms.left.shape), np.empty(arms.left.shape)
    fall = np.zeros(len(arms))
    for h, (part, one) in enumerate(zip(without, chosen)):
        rows, more = fold == h, part if one is None else part.with_terms([_term(part, found, one)])
        before[rows], after[rows] = part.left[rows], more.left[rows]
        fall[rows] = ((part.y**2).sum(axis=1) - (more.y**2).sum(axis=1))[rows]
    gain = signed_rank_gain_in_standard_errors(fall[now.used])
    if gain < (ARM.final_gain or 0.0) or sum(one is not None for one in chosen) < AGREE * len(chosen):
        return None
    last = fit_poses(arms, [*now.terms, _term(now, found, found.formula)], now.used)
    last = optimise_terms(last, [last.terms[-1]]) if has_continuous_parameters(last.terms[-1]) else last
    number = len(last.terms) - 1
    term, theta, joint = last.terms[-1], last.theta[last.slices[-1]], term_parameter_covariance(last, number)
    spec, sigma = term.candidate.specs[0], Z95 * np.sqrt(np.diag(joint.covariance))
    values = [*theta.tolist(), *(float(term.node[name]) for name in joint.names)]
    names = [*(column.name for column in spec.linear), *joint.names]
    lengths = [float(np.sqrt(np.mean(np.sum(part[now.used, :3] ** 2, axis=1)))) for part in (before, after)]
    noise = float(np.sqrt(np.einsum("nkk->nk", arms.own)[now.used, :3].sum(axis=1).mean()))
    place = arms.context.moved().places[found.joint]
    intervals = {name: (v, v - s, v + s) for name, v, s in zip(names, values, sigma.tolist())}
    parts = tuple(formula_quantities(one, found.library) for one in chosen)
    form, effect = _written(now, found, found.formula), term.candidate.effect(term.node, theta)
    return Suggestion(
        place, form, effect, intervals, lengths[0], lengths[1], noise, "m", gain, parts, found.formula.length
    ), last
