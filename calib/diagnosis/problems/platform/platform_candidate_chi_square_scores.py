"""Scores (delta chi-square) of all candidates on a platform's linearised model.

Each at the best node of its grid.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from calib.diagnosis.engine import least_squares_with_nuisances_eliminated_by_frame as inner
from calib.diagnosis.engine.candidate_scores_and_their_significance import (
    best_node_score,
    score_at_node,
    score_of_insignificant_candidate_without_dispersion,
)
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import Node
from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import FrameProducts, Solved
from calib.diagnosis.engine.linear_residual_model import Column
from calib.diagnosis.problems.platform import platform_vibration_frequency_search
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import (
    SIZED,
    PlatformCandidate,
    PlatformScore,
    Reach,
    Sensitivities,
)
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import CLOSURES, CORNERS, LinearisedModel
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.compute.numba_compilation_and_kernel_cache_folder import njit
from rig.compute.parallel_map_and_dask_cluster import parallel_map
from rig.compute.worker_processes import Progress
from rig.effects.framework.machine_motion_and_play import Motion
from rig.model.arm_hands_effect_places_and_tolerances import Place
from vision.bundle.corner_jacobians_normal_equations_and_schur_complement import (
    corner_jacobians_to_poses_and_lens_by_camera,
)

CHUNK = 64  # nodes at a time
COARSE = 0.8  # of what a finer grid of sizes explains, that a grid explains at least
FINER = 4  # steps from a size of a grid to the next
FEW = 8  # columns, above which rows are gathered for a product of matrices


@njit(cache=True, nogil=True, error_model="numpy")
def _row_projection(table: Floats, rows: Integers, V: Floats, out: Floats) -> None:
    """Into out (q, p) V^T times the rows (h,) of a table (n, p); V : (h, q)."""
    out[:] = 0.0
    for h in range(len(rows)):
        part = table[rows[h]]
        for i in range(V.shape[1]):
            v = V[h, i]
            for j in range(len(part)):
                out[i, j] += v * part[j]


@njit(cache=True, nogil=True, error_model="numpy")
def _row_projection_by_frame(local: Floats, rows: Integers, frame: Integers, V: Floats, out: Floats) -> None:
    """Into out (F, L, q), frame by frame, the rows (h,) of local (n, L) transposed times V (h, q); frame : (h,)"""
    out[:] = 0.0
    for h in range(len(rows)):
        for k in range(local.shape[1]):
            v = local[rows[h], k]
            for i in range(V.shape[1]):
                out[frame[h], k, i] += v * V[h, i]


def score_candidates(
    model: LinearisedModel,
    candidates: list[PlatformCandidate],
    sensitivities: Sensitivities,
    least_delta_chi2_for_p_value: float = -np.inf,
    progress: Progress | None = None,
) -> list[PlatformScore]:
    """Scores of all candidates.

    The greatest raw delta BIC is first.
    sensitivities : at the model's OperatingPoint; progress : called with (done, of), or None
    least_delta_chi2_for_p_value : what explains less is listed too, but is not asked how likely it is, see
        `best_node_score`
    """
    k = model.point
    motion = k.motion(k.effects) if k.axes else None
    axes = axis_elongation_inner_products(model) if k.axes else None
    mounts: dict[str, FrameProducts] = {}
    held = set(sensitivities.pixels)

    def ask(candidate: PlatformCandidate) -> tuple[PlatformScore, dict[tuple[object, ...], tuple[Integers, Floats]]]:
        if candidate.reach in (Reach.SPECTRUM, Reach.AXES):
            if axes is None or motion is None:
                raise ValueError(f"{candidate.name}: effects on strut motion require a recording with commands")
            score = (
                platform_vibration_frequency_search.best_vibration_frequency_score(
                    model, candidate, axes, least_delta_chi2_for_p_value
                )
                if candidate.reach is Reach.SPECTRUM
                else _along_axes(model, candidate, sensitivities, axes, motion, least_delta_chi2_for_p_value)
            )
        elif candidate.reach is Reach.MOUNT:
            if candidate.place not in mounts:
                mounts[candidate.place] = corner_displacement_normal_equations_by_frame(
                    model, camera_mount_pixel_derivatives(model, Place.parse(candidate.place))
                )
            score = _mounted(model, candidate, mounts[candidate.place], least_delta_chi2_for_p_value)
        else:
            score = _viewed(model, candidate, sensitivities, least_delta_chi2_for_p_value)
        new = {key: sensitivities.pixels[key] for key in sensitivities.pixels.keys() - held}
        held.update(new)
        unnamed: Any = None  # a candidate is known by its identity, which no copy has
        return replace(score, candidate=unnamed), new

    out = []
    for candidate, (score, new) in zip(candidates, parallel_map(ask, candidates, progress, on_cluster=True)):
        sensitivities.pixels.update(new)
        out.append(replace(score, candidate=candidate, values=candidate.numbers(score.node, score.coefficients)))
    return sorted(out, key=lambda s: -s.raw_delta_bic(model.size))


def candidate_column(
    model: LinearisedModel, candidate: PlatformCandidate, node: Node, sensitivities: Sensitivities
) -> Column:
    """Column of one node of a candidate.

    Its displacement of corners and closures per unit of its parameters.
    """
    k = model.point
    if candidate.reach is Reach.SPECTRUM:
        return model.lengthened(
            platform_vibration_frequency_search.axis_elongations_by_sinusoidal_platform_motion(
                model, np.array([node["frequency"]])
            )[0]
        )
    if candidate.reach is Reach.AXES:
        return model.lengthened(sensitivities.deviation(candidate, node, k.motion(k.effects)))
    if candidate.reach is Reach.MOUNT:
        pixels = (
            camera_mount_pixel_derivatives(model, Place.parse(candidate.place))
            * camera_mount_motion_share_by_frame(model, candidate, node)[k.observed.observations.frame][:, None, None]
        )
        return model.fold(pixels)
    return model.fold(sensitivities.corners(*sensitivities.seen(candidate, node)))


def axis_elongation_inner_products(model: LinearisedModel) -> FrameProducts:
    """Inner products (FrameProducts) of axis elongations.

    One axis at a time, frame by frame (per m).
    """
    F, axes = model.frames, model.point.axes
    W = model.closures.W  # (F, a, a): column i is axis i
    y = model.closure_residual[: F * axes].reshape(F, axes)
    Q = model.linear.columns.whole[CLOSURES][: F * axes].reshape(F, axes, -1)
    return FrameProducts(np.einsum("fij,fi->fj", W, y), np.swapaxes(W, 1, 2) @ W, np.einsum("fij,fip->fjp", W, Q))


def corner_displacement_normal_equations_by_frame(model: LinearisedModel, pixels: Floats) -> FrameProducts:
    """Normal equations (FrameProducts), frame by frame, of candidates that displace corners, (n, 2, a) px.

    The residual and the basis stand square to each frame's own poses, so the displacements need not be freed of them
    first.
    """
    k, axes, c = model.point, model.point.axes, model.corners
    basis, closures = model.linear.columns.whole, model.closure_residual
    table, turn = model.linear.factors(CORNERS)
    F, a, p = model.frames, pixels.shape[2], model.linear.columns.count
    beta, gamma, kappa = np.zeros((F, a)), np.zeros((F, a, a)), np.zeros((F, a, table.shape[1]))
    onto = np.zeros((F, a, p))  # of the closures
    rows = np.flatnonzero(np.any(pixels.reshape(len(pixels), -1), axis=1)[c.order])
    V = np.einsum("nij,njk->nik", c.whiten[rows], pixels[c.order[rows]]) / c.sigma
    y, Q, local = (part.reshape(len(c.order), 2, -1) for part in (model.corner_residual, table, c.local))
    frame = k.observed.observations.frame[c.order[rows]]
    edges = np.searchsorted(frame, np.arange(F + 1))
    for f in np.unique(frame):
        part = slice(edges[f], edges[f + 1])
        v, at = V[part].reshape(-1, a), rows[part]
        own = local[at].reshape(len(v), -1).T @ v
        beta[f] = v.T @ y[at].reshape(-1)
        gamma[f] = v.T @ v - own.T @ own
        kappa[f] = v.T @ Q[at].reshape(len(v), -1)
        if axes:
            moved, here = model.closures.to_rows[f] @ own, slice(f * axes, (f + 1) * axes)
            beta[f] += moved.T @ closures[here]
            gamma[f] += moved.T @ moved
            onto[f] = moved.T @ basis[CLOSURES][here]
    return FrameProducts(beta, gamma, (kappa if turn is None else kappa @ turn) + onto)


def constant_displacement_normal_equations(
    model: LinearisedModel, displaced_corners: Integers, pixels: Floats
) -> inner.Normal:
    """Normal equations of one constant displacement.

    The same in every frame, of observed corners (h,).
    """
    k, c = model.point, model.corners
    at = np.empty(len(c.order), int)
    at[c.order] = np.arange(len(c.order))
    both = (2 * at[displaced_corners][:, None] + np.arange(2)).ravel()
    V = (np.einsum("hij,hjq->hiq", c.whiten[at[displaced_corners]], pixels) / c.sigma).reshape(len(both), -1)
    q, basis, frame = (
        V.shape[1],
        model.linear.columns.whole,
        np.repeat(k.observed.observations.frame[displaced_corners], 2),
    )
    table, turn = model.linear.factors(CORNERS)
    b, raw, K = V.T @ model.corner_residual[both], V.T @ V, np.empty((q, table.shape[1]))
    if q > FEW:
        K[:] = (table[both].T @ V).T
    else:
        _row_projection(table, both, V, K)
    K = K if turn is None else K @ turn
    own = np.empty((model.frames, c.local.shape[1], q))
    _row_projection_by_frame(c.local, both, frame, V, own)
    G = raw - np.tensordot(own, own, ((0, 1), (0, 1)))
    if k.axes:
        moved = (model.closures.to_rows @ own).reshape(-1, q)
        b, G, K = (
            b + moved.T @ model.closure_residual[: len(moved)],
            G + moved.T @ moved,
            K + moved.T @ basis[CLOSURES][: len(moved)],
        )
    K = model.linear.onto(K).T
    return inner.Normal(b[None], (G - K.T @ K)[None], np.diag(G)[None].copy())


def camera_mount_pixel_derivatives(model: LinearisedModel, camera: Place) -> Floats:
    """Derivatives (n, 2, 6) of corner pixels by the tangent of a camera's mount."""
    k = model.point
    o = k.observed.observations
    out = np.zeros((len(o), 2, 6))
    for i, rows, _, J_camera, _ in corner_jacobians_to_poses_and_lens_by_camera(o, k.state):
        if k.design.cameras[i].name == camera.name:
            out[rows] = J_camera
    return out


def _along_axes(
    model: LinearisedModel,
    candidate: PlatformCandidate,
    sensitivities: Sensitivities,
    products: FrameProducts,
    motion: Motion,
    least: float,
) -> PlatformScore:
    solver, normal = solver_and_normal_equations_of_axis_candidate(candidate, sensitivities, products, motion)
    solved = solver(normal)
    best = int(np.argmax(solved.delta_chi2))
    if not candidate.spec.linear and solved.delta_chi2[best] >= COARSE * least:
        grid, finer = candidate.grid, replace(candidate, grid=_nodes_of_finer_sizes(candidate, best))
        of_finer = solver(solver_and_normal_equations_of_axis_candidate(finer, sensitivities, products, motion)[1])
        top = int(np.argmax(of_finer.delta_chi2))
        candidate = replace(candidate, grid=[*grid[:best], finer.grid[top], *grid[best + 1 :]])
        solved = Solved.of(
            [solved.part(slice(best)), of_finer.part(slice(top, top + 1)), solved.part(slice(best + 1, None))]
        )
    return best_node_score(
        model.linear,
        candidate,
        solved,
        products,
        lambda best: sensitivities.deviation(candidate, candidate.grid[best], motion),
        least,
    )


def _nodes_of_finer_sizes(candidate: PlatformCandidate, best: int) -> list[Node]:
    """Nodes of sizes between those next to the best node of a candidate without linear parameters, that of the best
    among them: the best of them takes its place, so that no hypothesis explains more by which sizes a grid happens to
    have, and the grid has as many nodes as before, by which a hypothesis pays. The best node alone where not one
    number, but none or several, are its size.
    """
    node = candidate.grid[best]
    names = [p.name for p in candidate.kind.parameters if p.role in SIZED and p.name in node]
    if len(names) != 1:
        return [node]
    name, size = names[0], node[names[0]]
    alike = [other[name] for other in candidate.grid if other | {name: size} == node]
    sizes = sorted(other for other in alike if np.sign(other) == np.sign(size))
    i, last = sizes.index(size), len(sizes) - 1
    steps = np.arange(max(FINER * (i - 1) + 1, 0), min(FINER * (i + 1), FINER * last + 1))
    return [node | {name: float(one)} for one in np.interp(steps / FINER, np.arange(len(sizes)), sizes)]


def solver_and_normal_equations_of_axis_candidate(
    candidate: PlatformCandidate, sensitivities: Sensitivities, products: FrameProducts, motion: Motion
) -> tuple[Callable[[inner.Normal], Solved], inner.Normal]:
    """Solver and normal equations of a candidate that acts on axes.

    They are of all nodes.
    products : of axis elongations; motion : Motion with the admitted effects
    """
    solver: Callable[[inner.Normal], Solved] = inner.solve_normal_equations
    if not candidate.spec.linear:
        solver = inner.chi2_reduction_at_unit_coefficient
    elif candidate.nonnegative:
        solver = inner.solve_nonnegative
    normals = []
    for start in range(0, len(candidate.grid), CHUNK):
        weights = sensitivities.deviations(candidate, candidate.grid[start : start + CHUNK], motion)
        k, F, axes, q = weights.shape
        sums: Floats = np.ones(k * F) @ np.abs(weights).reshape(k * F, -1)
        moved: Booleans = np.any(sums.reshape(axes, q) > 0, axis=1)
        moved |= not moved.any()
        normals.append(inner.normal_equations_by_direction_weights(products.confined(moved), weights[:, :, moved]))
    return solver, inner.Normal(*(np.concatenate(part) for part in zip(*normals)))


def _mounted(
    model: LinearisedModel, candidate: PlatformCandidate, products: FrameProducts, least: float
) -> PlatformScore:
    w = np.stack([camera_mount_motion_share_by_frame(model, candidate, node) for node in candidate.grid])
    solved = inner.solve_normal_equations(inner.normal_equations_by_common_weights(products, w))
    return best_node_score(
        model.linear, candidate, solved, products, lambda best: w[best][:, None, None] * np.eye(6), least
    )


def camera_mount_motion_share_by_frame(model: LinearisedModel, candidate: PlatformCandidate, node: Node) -> Floats:
    """Share (F,) of a camera mount's motion that it has made by each frame."""
    camera = model.point.stated.camera(Place.parse(candidate.place).name)
    return candidate.effect(node, np.r_[1.0, np.zeros(5)]).mount(camera, model.point.t, model.point.logged)[:, 0]


def _viewed(
    model: LinearisedModel, candidate: PlatformCandidate, sensitivities: Sensitivities, least: float
) -> PlatformScore:
    seen = [sensitivities.seen(candidate, node) for node in candidate.grid]
    solved = Solved.of(
        [
            inner.solve_normal_equations(
                constant_displacement_normal_equations(model, *sensitivities.touched(rows, quads))
            )
            for rows, quads in seen
        ]
    )
    best = int(np.argmax(solved.delta_chi2 - solved.rank * np.log(model.size)))
    if solved.delta_chi2[best] < least:
        return score_of_insignificant_candidate_without_dispersion(candidate, solved, best)
    products = corner_displacement_normal_equations_by_frame(model, sensitivities.corners(*seen[best]))
    weights = np.broadcast_to(np.eye(products.beta.shape[1]), products.gamma.shape)
    return score_at_node(model.linear, candidate, best, candidate.grid[best], solved, products, weights)
