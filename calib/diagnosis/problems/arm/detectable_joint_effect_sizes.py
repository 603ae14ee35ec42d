"""Smallest sizes of effects that an arm's poses would show.

The geometry and the findings are nuisances.
"""

import numpy as np

from calib.diagnosis.engine.candidate_scores_and_their_significance import Threshold
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import Node
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import Dispersion, residual_dispersion
from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import (
    FrameProducts,
    normal_equations_by_direction_weights,
)
from calib.diagnosis.problems.arm.arm_candidate_chi_square_scores import joint_motion_normal_equations_by_frame
from calib.diagnosis.problems.arm.arm_problem import ArmProblem
from calib.diagnosis.problems.arm.finding_parameter_optimisation_and_intervals import axis_unit
from calib.diagnosis.problems.arm.joint_effect_candidates_and_effects_seen_by_instruments import (
    JointCandidate,
    effect_candidate_of_node,
)
from calib.diagnosis.problems.arm.robust_fit_of_effect_terms_to_arm_poses import Fit
from calib.diagnosis.problems.detectable_effect_sizes import (
    DetectableSize,
    NodeLook,
    detectable_size,
    evenly_spaced_grid_nodes,
    mean_square_displacement_matrix,
    smallest_detectable_size_by_place,
)


def detectable_joint_effect_sizes(problem: ArmProblem, fit: Fit) -> list[DetectableSize]:
    """Detectable sizes of joint effects (DetectableSize).

    They are of each candidate effect and joint that is not among a Fit's terms, beside these.
    """
    found = {(term.candidate.name, term.candidate.place) for term in fit.terms}
    threshold = Threshold(len(problem.candidates), fit.size, problem.policy, is_scatter_estimated=True)
    products: dict[int | None, FrameProducts] = {}
    out = []
    for candidate in problem.candidates:
        if (candidate.name, candidate.place) in found:
            continue
        if candidate.joint not in products:
            products[candidate.joint] = joint_motion_normal_equations_by_frame(fit, candidate.joint)
        out.append(_size(problem, fit, candidate, products[candidate.joint], threshold))
    return smallest_detectable_size_by_place(out)


def _size(
    problem: ArmProblem, fit: Fit, candidate: JointCandidate, products: FrameProducts, threshold: Threshold
) -> DetectableSize:
    def dispersion(node: Node) -> Dispersion:
        weights = candidate.weights(node)[fit.used]
        nothing = np.zeros(weights.shape[2])
        return residual_dispersion(fit.linear, products, weights, nothing, problem.policy.cluster)

    looks = [_look(fit, candidate, products, node) for node in evenly_spaced_grid_nodes(candidate.grid)]
    return detectable_size(
        candidate, lambda node: effect_candidate_of_node(candidate.specs, node), looks, dispersion, threshold
    )


def _look(fit: Fit, candidate: JointCandidate, products: FrameProducts, node: Node) -> NodeLook:
    """NodeLook with the prior on the sizes, as a candidate is scored: delta chi-square is G (G + prior)^-1 G."""
    weights = candidate.weights(node)[fit.used]
    G = normal_equations_by_direction_weights(products, weights[None]).G[0]
    share = np.linalg.solve(G + np.diag(1 / candidate.prior(node) ** 2), G)
    moved = weights[:, :3] - weights[:, :3].mean(axis=0)  # of the whole hand, its position
    unit = fit.arms.unit if candidate.joint is None else axis_unit(fit, candidate.joint)
    return NodeLook(node, G @ share, float(np.trace(share)), mean_square_displacement_matrix(moved), unit)
