"""Lack of fit of an arm, ranking of covariates, and formulas suggested for joints.

Effects at its joints that the catalogue does not list.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import ARM
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import (
    FOLDS,
    STRETCHES,
    Z95,
    signed_rank_gain_in_standard_errors,
    time_stretch_folds,
)
from calib.diagnosis.engine.formula_search_for_unexplained_residuals import Formula, Library, Search
from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import (
    ALPHA,
    Covariate,
    LackOfFit,
    Share,
    Test,
    detect_excess_scatter,
    rank_covariates,
    share_explained_by_functions,
    significant_lack_of_fit,
    test_lack_of_fit,
)
from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import Reduced
from calib.diagnosis.problems.arm.arm_candidate_chi_square_scores import joint_motion_normal_equations_by_frame
from calib.diagnosis.problems.arm.finding_parameter_optimisation_and_intervals import (
    has_continuous_parameters,
    term_parameter_covariance,
)
from calib.diagnosis.problems.arm.joint_effect_candidates_and_effects_seen_by_instruments import joint_candidate
from calib.diagnosis.problems.arm.linearised_poses_and_whitened_columns import Arms
from calib.diagnosis.problems.arm.profile_and_sinusoid_simplification import optimise_terms
from calib.diagnosis.problems.arm.robust_fit_of_effect_terms_to_arm_poses import Fit, Term, fit_terms_to_poses
from calib.diagnosis.problems.covariate_functions_smoothed_temperatures_and_repeats import (
    AGREE,
    NAME,
    Repeats,
    Suggestion,
    formula_quantity_names,
    formula_text,
    library_of_quantities,
    smooth_functions_of_axis_motion,
    smooth_functions_of_time_and_sensors,
)
from rig.array_and_json_types import Floats
from rig.effects.framework.first_order_lag_weighted_sum_and_curved_scale_laws import independent_load_column_indices
from rig.effects.texts.effect_file_from_formula import Written
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.mechanisms import axis_places

# joints of which a formula is held out: something unnamed remains of every real arm, and the largest are worth a look
SHOWN = 2


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """joint : index; library : Library of what a formula may look at there; formula : of all poses."""

    joint: int
    library: Library
    formula: Formula


def suggest_joint_formulas(fit: Fit, unexplained: list[LackOfFit]) -> list[Suggestion]:
    """Suggested formulas ([Suggestion]) for the unexplained part of single joints.

    The largest first.

    At most SHOWN.
    """
    motion, places = fit.arms.context.moved(), {u.place for u in unexplained if u.depends_on}
    open_, out = [j for j, place in enumerate(axis_places(motion.mechanism)) if place in places], []
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
    return Search(
        library, Reduced.of(joint_motion_normal_equations_by_frame(now, joint), np.flatnonzero(now.used)), floor
    ).best()


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
    without = [
        fit_terms_to_poses(arms, now.terms, now.used & (fold != h), now.weighing, rounds=1) for h in range(FOLDS)
    ]
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
    last = fit_terms_to_poses(arms, [*now.terms, _term(now, found, found.formula)], now.used)
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
    parts = tuple(formula_quantity_names(one, found.library) for one in chosen)
    form, effect = _written(now, found, found.formula), term.candidate.effect(term.node, theta)
    return Suggestion(
        place, form, effect, intervals, lengths[0], lengths[1], noise, arms.unit, gain, parts, found.formula.length
    ), last


KNOTS = 8  # of a smooth function of time
PRIOR = 1e-3  # rad; size of a coefficient
SHARE = 0.05  # of the squares left, from which a covariate is named beside the scatter
JOINTS = "joints"


def find_lack_of_fit_by_joint(
    fit: Fit, correlated_frames: int = 1, place: Place | None = None, alpha: float = ALPHA
) -> list[LackOfFit]:
    """Find lack of fit ([LackOfFit]) of a Fit's residuals to smooth functions at each joint.

    Largest first.
    place : where alone they are asked, None for everywhere; alpha : chance of any where there is nothing
    """
    arms, found = fit.arms, []
    moved = arms.context.moved()
    axes = axis_places(moved.mechanism)
    for j in range(arms.q.shape[1]):
        products = joint_motion_normal_equations_by_frame(fit, j)
        information = float(products.gamma.sum())
        for depends, basis in _bases(arms, j):
            weights = basis[fit.used][:, None, :]
            test = Test(axes[j], moved.units[j], (depends,), weights, information, PRIOR)
            found.append(test_lack_of_fit(fit.linear, products, test, correlated_frames))
    return sorted(
        significant_lack_of_fit([u for u in found if u is not None and place in (None, u.place)], alpha),
        key=lambda u: -u.delta_chi2,
    )


def _bases(arms: Arms, j: int) -> list[tuple[str, Floats]]:
    """[(depends on, (n, q) smooth functions of it)] for a joint."""
    others = np.delete(arms.q, j, axis=1)
    moves = np.sign(np.diff(arms.q[:, j], prepend=arms.q[0, j]))
    out = [
        ("pose", np.concatenate([np.sin(others), np.cos(others)], axis=1)),
        ("time", _hats(arms.t)),
        ("history", moves[:, None]),
    ]
    links = arms.context.moved().links()[:, j]
    turning = links[:, independent_load_column_indices(links)]
    if turning.shape[1]:
        out.append(("torque", np.sign(turning)))
    return out + [(name, ((v - v.mean()) / v.std())[:, None]) for name, v in arms.channels.items() if np.ptp(v) > 0]


def _hats(t: Floats) -> Floats:
    x = np.linspace(t[0], t[-1], KNOTS)
    return np.stack([np.interp(t, x, row) for row in np.eye(KNOTS)[1:]], axis=1)


def excess_scatter_over_stated_noise(
    fit: Fit, repeats: Repeats | None, covariates: Sequence[Covariate]
) -> list[LackOfFit]:
    """Excess scatter of positions and of rotations beyond their stated noise ([LackOfFit]).

    repeats : Repeats, which show whether the scatter recurs with the same joint angles ("configuration"); where it does
    not, it depends on the covariates that explain some of it, or on nothing known. Where the noise is not stated, only
    what recurs under one command is beyond it. Poses that agree with no model are no scatter of the others
    """
    recurs = repeats is not None and repeats.p_value < ALPHA
    if fit.arms.assumed and not recurs:
        return []
    depends = ("configuration",) if recurs else tuple(c.name for c in covariates if _explains(c, len(covariates)))
    used, k = fit.used & ~fit.aside, fit.left.shape[1]
    fitted = (fit.arms.freedoms.shape[2] + fit.known()) / k  # of each number measured
    found = []
    for part, unit in ((slice(0, 3), fit.arms.unit), (slice(3, 6), "rad")):
        left, own = fit.left[used, part], fit.arms.own[used, part, part]
        if left.size:
            square = float(np.einsum("ni,nij,nj->", left, np.linalg.inv(own), left))
            noise = float(np.sqrt(np.einsum("nii->n", own).mean()))
            found.append(
                detect_excess_scatter(
                    Place("rig"), unit, noise, square, left.size - left.shape[1] * fitted, max(k // 3, 1), depends
                )
            )
    return [u for u in found if u is not None]


def _explains(covariate: Covariate, count: int) -> bool:
    """Whether a covariate, one of so many, explains some of what is left with all admitted."""
    return any(s.p_value * count < ALPHA and s.share > SHARE for s in covariate.after.values())


def ranked_covariates(before: Fit, after: Fit, correlated_poses: int) -> list[Covariate]:
    """Covariates ranked by the share of residuals that they explain, without effects and with them.

    correlated_poses : poses in a row whose errors may be alike
    """
    return rank_covariates(_shares(before, correlated_poses), _shares(after, correlated_poses))


def _shares(fit: Fit, cluster: int) -> dict[str, dict[str, Share]]:
    arms, used = fit.arms, fit.used
    count = arms.q.shape[1]
    products = [joint_motion_normal_equations_by_frame(fit, j) for j in range(count)]
    requested = {
        **smooth_functions_of_time_and_sensors(arms.t, arms.context.sensors),
        **smooth_functions_of_axis_motion(arms.context.moved().path, arms.commands, arms.t),
    }
    out = {}
    for name, functions in requested.items():
        wide = np.broadcast_to(functions, (len(arms), count, functions.shape[2]))[used]
        out[name] = {
            JOINTS: share_explained_by_functions(
                fit.linear, 0, [(products[j], wide[:, [j]]) for j in range(count)], cluster
            )
        }
    return out
