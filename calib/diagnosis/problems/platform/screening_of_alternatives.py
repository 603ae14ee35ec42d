"""Screening of the alternatives of all terms of a fit at once.

A term that is left out gives back directions of the residuals that it had among the nuisances, and what it explained
there. Both change the normal equations of a candidate by products with those directions, which its products with the
nuisances' basis hold already: so one pass over the grids says, for every term, about how much each candidate would
explain in its place.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.engine import reduced_least_squares as inner
from calib.diagnosis.engine.linear_model import Column
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import (
    PlatformCandidate,
    Reach,
    Sensitivities,
)
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import LinearisedModel
from calib.diagnosis.problems.platform.scores_of_all_candidates import (
    axis_elongation_inner_products,
    axis_normal_equations,
)
from calib.diagnosis.problems.platform.simultaneous_refinement import Refinement
from rig.array_and_json_types import Floats
from rig.compute.parallel_map_and_dask_cluster import parallel_map

SEEN = 1e-3  # of a direction's length, beside all other terms, from which a term's absence gives it back


@dataclass(frozen=True, slots=True, eq=False)
class ReleasedDirections:
    """What a term gives back that is left out. directions : (h, q), orthonormal, on the last h vectors of the basis of
    a model that has all terms among the nuisances; residual : (q,) what the term explained along them"""

    directions: Floats
    residual: Floats

    @staticmethod
    def of(
        refinement: Refinement, full: LinearisedModel, without: LinearisedModel, number: int
    ) -> "ReleasedDirections":
        """Of one effect of a Refinement. full : its model, all effects among the nuisances; without : without this

        Raises ValueError for a Refinement that has no effects
        """
        column, before = refinement.column, refinement.model.linear.columns.count
        if column is None:
            raise ValueError("a refinement without effects has none to leave out")
        added = Column(tuple(np.asarray(part)[:, before:] for part in full.linear.columns.whole))
        onto, seen = np.zeros((added.count, column.count)), np.zeros(added.count)
        for basis, part, block in zip(added.whole, column.parts, without.linear.blocks, strict=True):
            seen += basis.T @ block.residual
            if part is not None:
                onto += basis.T @ part
        own = np.array([c.effect == number for c in refinement.coordinates])
        found = refinement.model.linear.project(column)
        size = np.sqrt(np.maximum(np.diag(found.gram) + (found.onto**2).sum(axis=0), 1e-300))
        others = _orthonormal(onto[:, ~own] / size[~own])
        left = onto[:, own] / size[own]
        directions = _orthonormal(left - others @ (others.T @ left))
        return ReleasedDirections(directions, directions.T @ seen)

    def normal_equations(self, normal: inner.Normal, onto: Floats) -> inner.Normal:
        """Normal equations without the term. normal : with all terms; onto : (k, q, h) products of the candidates'
        columns with the last h vectors of the basis"""
        along = onto @ self.directions
        return inner.Normal(normal.b + along @ self.residual, normal.G + along @ np.swapaxes(along, 1, 2), normal.raw)


def screen_axis_candidates(
    model: LinearisedModel,
    candidates: list[PlatformCandidate],
    sensitivities: Sensitivities,
    released: list[ReleasedDirections],
    progress: Callable[[int, int], None] | None = None,
) -> Floats:
    """(candidates, terms) of about what each candidate's best node explains in the place of each term; inf for
    candidates that do not act on axes.

    model : with all terms among the nuisances; sensitivities : at its OperatingPoint; released : of each term
    """
    motion, products = model.point.motion(model.point.effects), axis_elongation_inner_products(model)

    def ask(candidate: PlatformCandidate) -> Floats:
        if candidate.reach is not Reach.AXES:
            return np.full(len(released), np.inf)
        solver, normal = axis_normal_equations(candidate, sensitivities, products, motion)
        assert normal.onto is not None
        explained = []
        for term in released:
            onto = normal.onto[:, :, normal.onto.shape[2] - len(term.directions) :]
            solved = solver(term.normal_equations(normal, onto))
            explained.append(solved.delta_chi2[np.argmax(solved.delta_chi2 - solved.rank * np.log(model.size))])
        return np.array(explained)

    return np.array(list(parallel_map(ask, candidates, progress, on_cluster=True)))


def _orthonormal(columns: Floats) -> Floats:
    """(h, r) orthonormal vectors that span columns (h, k), each of a length of one at most before nuisances."""
    vectors, values, _ = np.linalg.svd(columns, full_matrices=False)
    return vectors[:, values > SEEN]
