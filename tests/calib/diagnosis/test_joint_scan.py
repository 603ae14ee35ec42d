"""The search at an arm's joints: its short cuts give what the long way gives, and what comes again is told from
noise.
"""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.engine.forward_and_backward_term_selection import select_terms
from calib.diagnosis.engine.linear_residual_model import Column, LinearModel
from calib.diagnosis.problems.arm import arm_lack_of_fit_covariates_and_joint_formulas as arm_excess_scatter
from calib.diagnosis.problems.arm.arm_candidate_chi_square_scores import (
    joint_motion_normal_equations_by_frame,
    score_candidates,
    solve_candidate_at_all_nodes,
    solve_candidate_at_nodes,
)
from calib.diagnosis.problems.arm.arm_lack_of_fit_covariates_and_joint_formulas import find_lack_of_fit_by_joint
from calib.diagnosis.problems.arm.arm_problem import ArmProblem
from calib.diagnosis.problems.arm.arm_recording_evidence import pose_repeatability
from calib.diagnosis.problems.arm.joint_effect_candidates_and_effects_seen_by_instruments import (
    joint_candidates_and_untested_effects,
)
from calib.diagnosis.problems.arm.linearised_poses_and_whitened_columns import (
    Columns,
    Part,
    linearised_arm_poses_and_geometry,
)
from calib.diagnosis.problems.arm.robust_fit_of_effect_terms_to_arm_poses import Term, fit_terms_to_poses
from calib.diagnosis.problems.evidence_interface_and_requested_effects import RequestedEffects
from calib.identify.bounded_and_robust_least_squares_fit import excess_scatter, robust_weights
from rig.model.arm_hands_effect_places_and_tolerances import Place
from tests.calib import secret_arms
from tests.rig.arms import UR10

SIGMA = 2e-5  # m, per axis


def seen(deviation, count=200, seed=3, repeats=0):
    rng = np.random.default_rng(seed)
    samples = secret_arms.tracked(secret_arms.secret(UR10, rng), UR10, count, rng, deviation=deviation, repeats=repeats)
    return linearised_arm_poses_and_geometry(samples, secret_arms.design(UR10))[0]


def only(joint, function):
    """What a joint (index) does beyond its command, function(q), the others being true."""
    return lambda q: function(q)[:, None] * (np.arange(6) == joint)


@pytest.fixture(scope="module")
def searched():
    arms = seen(only(2, lambda q: 3e-4 * np.sin(7 * q[:, 2])), 150)
    return fit_terms_to_poses(arms, (), np.arange(len(arms)) % 7 != 3), joint_candidates_and_untested_effects(
        arms, RequestedEffects()
    )[0]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cyclic_error", "missed_steps"])
def test_short_cuts_give_the_best_nodes_their_score_and_the_others_a_bound(searched, name):
    now, candidates = searched
    candidate = next(c for c in candidates if c.name == name and c.joint == 2)
    products = joint_motion_normal_equations_by_frame(now, 2)
    quick, long = (
        solve_candidate_at_all_nodes(now, candidate, products),
        solve_candidate_at_nodes(now, candidate, products, candidate.grid),
    )
    top = np.argsort(long.delta_chi2)[-20:]
    assert quick.delta_chi2[top] == pytest.approx(long.delta_chi2[top], rel=1e-6)
    assert np.array(quick.coefficients)[top] == pytest.approx(np.array(long.coefficients)[top], abs=1e-9)
    assert (
        quick.delta_chi2 <= long.delta_chi2 * (1 + 1e-6)
    ).all() and quick.delta_chi2.sum() > 0.8 * long.delta_chi2.sum()


def test_a_term_struck_out_or_set_beside_is_the_fit_without_or_with_it(searched):
    now, candidates = searched
    a, b = [Term.of(s) for s in score_candidates(now, candidates, -np.inf)[:2]]
    both = now.with_terms([a, b])
    assert both.without_terms([0, 1]).left == pytest.approx(now.left, abs=1e-12)
    assert both.without_terms([0]).left == pytest.approx(now.with_terms([b]).left, abs=1e-12)
    assert both.cost() < now.with_terms([b]).cost() < now.cost()
    score = score_candidates(now, [a.candidate], -np.inf)[0]
    assert score.delta_chi2 * score.dispersion == pytest.approx(now.cost() - now.with_terms([a]).cost(), rel=1e-6)


def test_a_model_by_its_columns_leaks_what_one_by_its_basis_does(searched):
    now, candidates = searched
    linear = now.with_terms([Term.of(score_candidates(now, candidates)[0])]).linear
    Q = linear.columns.parts[0] @ linear.half  # the columns are an operator; this is written out
    basis = LinearModel(linear.blocks, Column((Q,)), None, linear.size)
    rng = np.random.default_rng(0)
    reach, onto = rng.normal(size=Q.shape[1]), rng.normal(size=(3, Q.shape[1]))
    assert linear.leakage_and_carried(reach, onto)[0] == pytest.approx(
        basis.leakage_and_carried(reach, onto)[0], abs=1e-9
    )
    projections, grams = basis.frame_products(0)  # as a model of few nuisances is asked
    leakage, carried = linear.leakage_and_carried(reach, onto)
    assert leakage == pytest.approx((projections + grams @ reach) @ onto.T, abs=1e-9)
    assert carried == pytest.approx(onto @ grams @ onto.T, abs=1e-9)
    few = LinearModel(linear.blocks, Column((np.ascontiguousarray(Q[:, :2]),)), None, linear.size)
    assert few.leakage_and_carried(reach[:2], onto[:, :2])[0] == pytest.approx(
        (projections[:, :2] + grams[:, :2, :2] @ reach[:2]) @ onto[:, :2].T, abs=1e-9
    )
    column = Column((rng.normal(size=(len(Q), 2)),))
    assert linear.project(column).right == pytest.approx(basis.project(column).right, rel=1e-9)
    assert linear.project(column).gram == pytest.approx(basis.project(column).gram, rel=1e-9)


def test_columns_made_of_joints_and_weights_are_the_columns_written_out():
    rng = np.random.default_rng(1)
    n, k = 20, 6
    directions = rng.normal(size=(n, k, 3))
    shapes = {None: (n, k, 4)} | {joint: (n, joint) for joint in (2, 1)}
    parts = (
        *(Part(joint, rng.normal(size=shape)) for joint, shape in shapes.items()),
        Part(1, rng.normal(size=(n, 5))),
    )
    columns = Columns(directions, parts)
    plain = np.concatenate(
        [p.values if p.joint is None else directions[..., [p.joint]] * p.values[:, None, :] for p in parts], axis=2
    )
    flat, sizes, moved = plain.reshape(n * k, -1), rng.normal(size=(12, 3)), rng.normal(size=(n, k, 2))
    assert columns.gram() == pytest.approx(flat.T @ flat) and columns.at(sizes) == pytest.approx(plain @ sizes)
    assert columns.onto(moved) == pytest.approx(flat.T @ moved.reshape(n * k, 2))
    assert columns.along(moved) == pytest.approx(np.swapaxes(moved, 1, 2) @ plain)
    assert columns.cross(columns.without_parts([0, 2])) == pytest.approx(
        flat.T @ np.delete(flat, [0, 1, 2, 3, 6], axis=1)
    )
    assert columns.operator() @ sizes == pytest.approx(flat @ sizes) and columns.operator().T @ flat == pytest.approx(
        flat.T @ flat
    )


def test_wild_poses_neither_widen_the_scatter_nor_count():
    rng = np.random.default_rng(4)
    left, own = SIGMA * rng.normal(size=(400, 6)), np.tile(SIGMA**2 * np.eye(6), (400, 1, 1))
    assert excess_scatter(left, own) == pytest.approx(0, abs=0.3 * SIGMA)
    left[::33] += 10 * SIGMA
    assert excess_scatter(left, own) == pytest.approx(0, abs=0.6 * SIGMA)
    assert excess_scatter(10 * left, own) == pytest.approx(
        10 * SIGMA, rel=0.1
    )  # a sigma that is stated too small by ten
    weight = robust_weights((left**2).sum(axis=1) / SIGMA**2, 6)
    assert (weight[::33] < 0.1).all() and np.delete(weight, np.s_[::33]).mean() > 0.99


def test_an_effect_at_the_end_of_a_recording_is_not_taken_for_wild_poses():
    arms = seen(None, 150)
    late = np.arange(150) >= 140
    arms = replace(arms, left=arms.left + arms.joints[..., 2] * 2e-3 * late[:, None])
    chosen = select_terms(
        ArmProblem(arms, joint_candidates_and_untested_effects(arms, RequestedEffects(("missed_steps",)))[0])
    ).fit
    assert [(t.candidate.name, t.candidate.place) for t in chosen.terms] == [("missed_steps", "joint 3")]
    assert not chosen.aside.any() and chosen.theta[chosen.slices[0]] == pytest.approx(2e-3, rel=0.05)


def test_sinusoid_is_found_with_its_order(searched):
    now, candidates = searched
    problem = ArmProblem(now.arms, candidates)
    chosen = select_terms(problem)
    assert [(t.candidate.name, t.candidate.place) for t in chosen.fit.terms] == [("cyclic_error", "joint 3")]
    assert chosen.fit.terms[0].node["order"] == pytest.approx(7, abs=0.1)
    assert np.hypot(*chosen.fit.theta[chosen.fit.slices[0]]) == pytest.approx(3e-4, rel=0.1)
    proof = problem.cross_validations(chosen.fit, [0])[0]
    assert proof.after < 0.7 * proof.before and proof.gain > 2


@pytest.mark.slow
def test_repeats_tell_noise_from_what_comes_again():
    quiet = pose_repeatability(fit_terms_to_poses(seen(None, repeats=60)))
    assert quiet.pairs == 60 and quiet.rms == pytest.approx(SIGMA * np.sqrt(3), rel=0.15) and quiet.p_value > 1e-3
    wavy = pose_repeatability(
        fit_terms_to_poses(seen(only(1, lambda q: 2e-4 * np.sin(9 * q[:, 1] + 5 * q[:, 3])), repeats=60))
    )
    assert (
        wavy.rms == pytest.approx(SIGMA * np.sqrt(3), rel=0.15) and wavy.recurring_share > 0.8 and wavy.p_value < 1e-4
    )
    assert pose_repeatability(fit_terms_to_poses(seen(None))) is None


@pytest.mark.slow
def test_what_the_catalogue_lacks_is_unknown_at_its_joint():
    arms = seen(only(2, lambda q: 2e-4 * np.sin(q[:, 0])), repeats=60)
    chosen = select_terms(ArmProblem(arms, joint_candidates_and_untested_effects(arms, RequestedEffects())[0])).fit
    assert chosen.terms == ()
    left = [
        *find_lack_of_fit_by_joint(chosen, 5),
        *arm_excess_scatter.excess_scatter_over_stated_noise(chosen, pose_repeatability(chosen), []),
    ]
    assert left[0].place == Place("joint", "3") and left[0].depends_on == ("pose",)
    assert left[0].magnitude == pytest.approx(np.std(2e-4 * np.sin(arms.q[:, 0])), rel=0.3)
    assert left[-1].place == Place("rig") and left[-1].depends_on == ("configuration",)
