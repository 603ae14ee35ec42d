"""Steps of an operating point along its linearised model, and what they cost.

The cost is minus twice the log likelihood: before a step as the model has it, after it without linearising anew.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.diagnosis.engine.linear_residual_model import Column
from calib.diagnosis.problems.platform.linearisation_operating_point import OperatingPoint, move_operating_point
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import CLOSURES, CORNERS, LinearisedModel
from calib.diagnosis.problems.platform.linearised_corners import (
    camera_edge_bias_nuisances,
    coordinates_and_rest_in_frame_bases,
    remounted_cube_pose_nuisances,
)
from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.effect_checks_and_fit_coordinates import cost_of_priors
from rig.model.mechanisms.mechanism_kinds_and_kinematics import geometric_parameters, mechanism_with_parameters
from rig.model.pose import exp


def operating_point_and_nuisance_moves_after_step(
    model: LinearisedModel, step: Floats, column: Column | None, effects: Sequence[Effect], share: float = 1.0
) -> tuple[OperatingPoint, Floats]:
    """(OperatingPoint with effects, nuisances and each frame's own poses moved by a share of the way to where the fit
    puts them, (r,) nuisances' moves on the model's basis), where effects take a step along a Column."""
    k, whole = model.point, model.corners.inner
    z = share * (model.nuisances.at_rest - (0 if column is None else model.linear.project(column).onto @ step))
    freedoms = model.nuisances.solve @ z
    inner = share * whole[..., 0] - whole[..., 1:] @ freedoms[: whole.shape[2] - 1]
    if column is not None and column.inner is not None:
        inner = inner - share * (column.inner @ step)
    local = np.einsum("fij,fj->fi", model.corners.to_local, inner)
    cameras = list(k.design.cameras)
    for i, at in model.nuisances.camera_columns.items():
        value = freedoms[at]
        if i not in k.moving:
            cameras[i] = replace(cameras[i], pose=cameras[i].pose * exp(value[:6]))
            value = value[6:]
        matrix = cameras[i].matrix.copy()
        matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += value[:4]
        cameras[i] = replace(cameras[i], matrix=matrix, distortion=cameras[i].distortion + value[4:])
    finder = list(k.finder or [0.0] * len(cameras))
    for i, j in camera_edge_bias_nuisances(model.nuisances.names, k.design):
        finder[i] += float(freedoms[j])
    own = remounted_cube_pose_nuisances(model.nuisances.names)
    seats = tuple(
        type(s).of_numbers(s.place, s.numbers() + freedoms[own[s.place]]) if s.place in own else s for s in k.seats
    )
    if k.axes:
        m, p = k.platform, geometric_parameters(k.platform)
        k = replace(
            k,
            design=replace(
                k.design, mechanism=mechanism_with_parameters(m, p + freedoms[len(model.nuisances.names) - len(p) :])
            ),
        )
    if k.seen is None:
        local = np.zeros((model.frames, 6))
    moved = move_operating_point(k, cameras, local)
    return replace(moved, effects=tuple(effects), finder=tuple(finder), seats=seats), z


def cost_without_relinearisation(model: LinearisedModel, point: OperatingPoint, nuisances: Floats) -> float:
    """Minus twice the log likelihood as `likelihood_cost` has it, of an OperatingPoint near a LinearisedModel's whose
    nuisances are moved by (r,) on the model's basis: cameras, geometry and poses are at their best by the model's
    derivatives, noise and scatter as in the model.
    """
    c, basis = model.corners, model.linear.columns.whole
    corners, inner, excess = np.zeros(0), np.zeros((model.frames, c.local.shape[1], 1)), 0.0
    if point.seen is not None:
        off = (point.seen.observations.uv - point.pixels())[c.order]
        rho = np.einsum("nij,nj->ni", c.whiten, off).reshape(-1, 1) / c.sigma
        excess = float((2 * c.clip * np.maximum(np.abs(rho) - c.clip, 0)).sum())
        inner, out = coordinates_and_rest_in_frame_bases(np.clip(rho, -c.clip, c.clip), c.local, c.edges)
        corners = out[:, 0]
    closures = np.zeros(0)
    if point.axes:
        closures = (model.closures.W @ point.closures()[..., None] + model.closures.to_rows @ inner).ravel()
    known = model.linear.blocks[CLOSURES].known_rows
    beforehand = model.closure_residual[known] + basis[CLOSURES][known] @ (model.nuisances.at_rest - nuisances)
    rows = np.concatenate([closures, beforehand])
    z = basis[CORNERS].T @ corners + basis[CLOSURES].T @ rows
    cost = float(corners @ corners + rows @ rows - z @ z) + excess
    return cost + _constant(model) + cost_of_priors(point.effects)


def _constant(model: LinearisedModel) -> float:
    """What noise and scatter make of minus twice the log likelihood."""
    noise = 2 * len(model.corner_residual) * np.log(model.corners.sigma)
    return noise - 2 * np.linalg.slogdet(model.closures.W)[1].sum() if model.point.axes else noise


def likelihood_cost(model: LinearisedModel) -> float:
    """Minus twice the log likelihood, Huber's for corners, but for a constant; noise's and scatter's share included."""
    return model.linear.cost() + model.corners.excess + _constant(model) + cost_of_priors(model.point.effects)
