"""Smallest sizes of effects that a platform's recording would show.

Poses, cameras and findings are nuisances.
"""

from dataclasses import replace
from functools import cache

import numpy as np

from calib.diagnosis.engine.candidate_scores_and_their_significance import Threshold
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import Node
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import Dispersion, residual_dispersion
from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import (
    FrameProducts,
    Normal,
    normal_equations_by_common_weights,
    solve_normal_equations,
)
from calib.diagnosis.problems.detectable_effect_sizes import (
    DetectableSize,
    NodeLook,
    detectable_size,
    evenly_spaced_grid_nodes,
    mean_square_displacement_matrix,
    smallest_detectable_size_by_place,
)
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import PlatformCandidate, Reach
from calib.diagnosis.problems.platform.platform_candidate_chi_square_scores import (
    axis_elongation_inner_products,
    camera_mount_motion_share_by_frame,
    camera_mount_pixel_derivatives,
    constant_displacement_normal_equations,
    corner_displacement_normal_equations_by_frame,
    solver_and_normal_equations_of_axis_candidate,
)
from calib.diagnosis.problems.platform.platform_problem import PlatformFit, PlatformProblem
from rig.array_and_json_types import Floats
from rig.effects.framework.machine_motion_and_play import Motion
from rig.model.arm_hands_effect_places_and_tolerances import Place


def detectable_platform_effect_sizes(problem: PlatformProblem, fit: PlatformFit) -> list[DetectableSize]:
    """Detectable sizes of platform effects (DetectableSize).

    They are of each candidate effect and place that is not among a fit's terms, beside these.
    Of a vibration none: it takes a frequency and a direction.
    """
    found = {(term.name, term.place) for term in fit.terms}
    looked = [c for c in problem.candidates if (c.name, c.place) not in found and c.reach is not Reach.SPECTRUM]
    looks = _Looks(problem, fit)
    return smallest_detectable_size_by_place(looks.size(candidate) for candidate in looked)


class _Looks:
    """Of one fit: what its model tells of each candidate."""

    def __init__(self, problem: PlatformProblem, fit: PlatformFit) -> None:
        self.model = problem.residual(fit)
        self.sensitivities = problem.sensitivities.at(self.model.point)
        self.threshold = Threshold(len(problem.candidates), self.model.size, problem.policy)
        point = self.model.point
        self.motion = point.motion(point.effects) if point.axes else None
        self.axes = axis_elongation_inner_products(self.model) if point.axes else None
        self.mount_pixels = cache(lambda place: camera_mount_pixel_derivatives(self.model, Place.parse(place)))
        self.mount = cache(
            lambda place: corner_displacement_normal_equations_by_frame(self.model, self.mount_pixels(place))
        )

    def size(self, candidate: PlatformCandidate) -> DetectableSize:
        """DetectableSize of a candidate."""
        nodes = evenly_spaced_grid_nodes(candidate.grid)
        normal = self._normal(candidate, nodes)
        looks = [
            NodeLook(node, gram, float(rank), *self._moved(candidate, node), not candidate.spec.linear)
            for node, gram, rank in zip(nodes, normal.G, solve_normal_equations(normal).rank)
        ]
        return detectable_size(
            candidate, lambda _: candidate.spec, looks, lambda node: self._dispersion(candidate, node), self.threshold
        )

    def _normal(self, candidate: PlatformCandidate, nodes: list[Node]) -> Normal:
        """Normal equations of a candidate at nodes, as it is scored."""
        if candidate.reach is Reach.MOUNT:
            share = np.stack([camera_mount_motion_share_by_frame(self.model, candidate, node) for node in nodes])
            return normal_equations_by_common_weights(self.mount(candidate.place), share)
        if candidate.reach is Reach.VIEW:
            seen = [self.sensitivities.touched(*self.sensitivities.seen(candidate, node)) for node in nodes]
            each = [constant_displacement_normal_equations(self.model, *one)[:3] for one in seen]
            return Normal(*(np.concatenate(part) for part in zip(*each)))
        products, motion = self._along_axes()
        return solver_and_normal_equations_of_axis_candidate(
            replace(candidate, grid=nodes), self.sensitivities, products, motion
        )[1]

    def _moved(self, candidate: PlatformCandidate, node: Node) -> tuple[Floats, str]:
        """((q, q) mean square of what a candidate moves, by its coefficients, its unit): m of axes, px of corners."""
        if not candidate.vector:
            return np.eye(max(len(candidate.spec.linear), 1)), ""
        if candidate.reach is Reach.AXES:
            moved, unit = self.sensitivities.deviation(candidate, node, self._along_axes()[1]), "m"
            moved = moved - moved.mean(axis=0)
        elif candidate.reach is Reach.MOUNT:
            looks = self.mount_pixels(candidate.place)
            share = camera_mount_motion_share_by_frame(self.model, candidate, node)[
                self.model.point.observed.observations.frame
            ]
            moved = (looks * share[:, None, None])[looks.any(axis=(1, 2))]
            unit = "px"
        else:
            moved, unit = self.sensitivities.touched(*self.sensitivities.seen(candidate, node))[1], "px"
        return mean_square_displacement_matrix(moved), unit

    def _dispersion(self, candidate: PlatformCandidate, node: Node) -> Dispersion:
        """Dispersion of what the fit leaves about a candidate at a node; of what is seen alone, as stated by as many
        frames as see it.
        """
        if candidate.reach is Reach.MOUNT:
            products = self.mount(candidate.place)
            weights = camera_mount_motion_share_by_frame(self.model, candidate, node)[:, None, None] * np.eye(6)
        elif candidate.reach is Reach.VIEW:  # its products by frame would cost as much as all else
            hit = self.sensitivities.touched(*self.sensitivities.seen(candidate, node))[0]
            return Dispersion(1.0, len(np.unique(self.model.point.observed.observations.frame[hit])) - 1.0)
        else:
            products, motion = self._along_axes()
            weights = self.sensitivities.deviation(candidate, node, motion)
        return residual_dispersion(self.model.linear, products, weights, np.zeros(weights.shape[2]))

    def _along_axes(self) -> tuple[FrameProducts, Motion]:
        """(inner products of axes' elongations, Motion) with the findings. Raises ValueError where nothing was
        commanded.
        """
        if self.axes is None or self.motion is None:
            raise ValueError("effects on strut motion require a recording with commands")
        return self.axes, self.motion
