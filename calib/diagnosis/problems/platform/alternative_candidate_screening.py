"""Screening of the alternatives of all terms of a fit at once.

A term that is left out gives back directions of the residuals that it had among the nuisances, and what it explained
there. Both change the normal equations of a candidate by products with those directions, which its products with the
nuisances' basis hold already: so one pass over the grids says, for every term, about how much each candidate would
explain in its place.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.engine import least_squares_with_nuisances_eliminated_by_frame as inner
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import (
    PlatformCandidate,
    Reach,
    Sensitivities,
)
from calib.diagnosis.problems.platform.joint_refinement_of_cameras_geometry_poses_and_effects import Refinement
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import LinearisedModel
from calib.diagnosis.problems.platform.platform_candidate_chi_square_scores import (
    axis_elongation_inner_products,
    solver_and_normal_equations_of_axis_candidate,
)
from rig.array_and_json_types import Floats
from rig.compute.parallel_map_and_dask_cluster import parallel_map

SEEN = 1e-3  # of a direction's length, beside all other terms, from which a term's absence gives it back
SCREENED = 0.3  # of what a term explains, from which a candidate is searched exactly for in its place


@dataclass(frozen=True, slots=True, eq=False)
class _Released:
    """What a term gives back that is left out. directions : (h, q), orthonormal, on the last h vectors of the basis of
    a model that has all terms among the nuisances; residual : (q,) what the term explained along them"""

    directions: Floats
    residual: Floats

    def normal_equations(self, normal: inner.Normal) -> inner.Normal:
        """Normal equations of candidates without the term. normal : with all terms"""
        assert normal.onto is not None  # as those of candidates on axes have it
        along = normal.onto[:, :, normal.onto.shape[2] - len(self.directions) :] @ self.directions
        return inner.Normal(normal.b + along @ self.residual, normal.G + along @ np.swapaxes(along, 1, 2), normal.raw)


def screened_alternatives(
    refinement: Refinement,
    terms: Sequence[PlatformCandidate],
    models_without_term: list[LinearisedModel],
    candidates: list[PlatformCandidate],
    sensitivities: Sensitivities,
    progress: Callable[[int, int], None] | None = None,
) -> list[list[PlatformCandidate]]:
    """For each term of a Refinement, the candidates that may explain as much in its place.

    Only what acts on axes is screened out. terms : of its effects, in order; models_without_term : models without each;
    candidates : the terms among them; sensitivities : at its OperatingPoint
    """
    full = refinement.marginalised
    explained = _explained_in_place(
        full, candidates, sensitivities, _released(refinement, full, models_without_term), progress
    )
    numbers = {id(candidate): number for number, candidate in enumerate(candidates)}
    own = explained[[numbers[id(term)] for term in terms], range(len(terms))]
    least = np.where(np.isfinite(own), SCREENED * own, -np.inf)
    # what shifts the times of the whole machine does something else beside other terms
    follows_terms = np.array([c.kind.retimes() and not c.site.is_axis for c in candidates])
    passed = (explained >= least) | follows_terms[:, None]
    return [[candidates[i] for i in np.flatnonzero(row)] for row in passed.T]


def _released(refinement: Refinement, full: LinearisedModel, without: list[LinearisedModel]) -> list[_Released]:
    """Of each effect of a Refinement. full : its model, all effects among the nuisances; without : without each"""
    column, before = refinement.column, refinement.model.linear.columns.count
    if column is None:
        raise ValueError("a refinement without effects has none to leave out")
    added = [np.asarray(part)[:, before:] for part in full.linear.columns.whole]
    onto: Floats = sum(
        (basis.T @ part for basis, part in zip(added, column.parts, strict=True) if part is not None),
        np.zeros((added[0].shape[1], column.count)),
    )
    found = refinement.model.linear.project(column)
    onto = onto / np.sqrt(np.maximum(np.diag(found.gram) + (found.onto**2).sum(axis=0), 1e-300))
    out = []
    for number, model in enumerate(without):
        own = np.array([c.effect == number for c in refinement.coordinates])
        others = _orthonormal(onto[:, ~own])
        directions = _orthonormal(onto[:, own] - others @ (others.T @ onto[:, own]))
        along = (directions.T @ (basis.T @ block.residual) for basis, block in zip(added, model.linear.blocks))
        out.append(_Released(directions, sum(along, np.zeros(directions.shape[1]))))
    return out


def _explained_in_place(
    model: LinearisedModel,
    candidates: list[PlatformCandidate],
    sensitivities: Sensitivities,
    released: list[_Released],
    progress: Callable[[int, int], None] | None,
) -> Floats:
    """(candidates, terms) of about what each candidate's best node explains in the place of each term; inf for
    candidates that do not act on axes. model : with all terms among the nuisances"""
    motion, products = model.point.motion(model.point.effects), axis_elongation_inner_products(model)

    def explained(candidate: PlatformCandidate) -> Floats:
        if candidate.reach is not Reach.AXES:
            return np.full(len(released), np.inf)
        solver, normal = solver_and_normal_equations_of_axis_candidate(candidate, sensitivities, products, motion)
        each = [solver(term.normal_equations(normal)) for term in released]
        return np.array([one.delta_chi2[np.argmax(one.delta_chi2 - one.rank * np.log(model.size))] for one in each])

    return np.array(list(parallel_map(explained, candidates, progress, on_cluster=True)))


def _orthonormal(columns: Floats) -> Floats:
    """(h, r) orthonormal vectors that span columns (h, k), each of a length of one at most before nuisances."""
    vectors, values, _ = np.linalg.svd(columns, full_matrices=False)
    return vectors[:, values > SEEN]
