"""Bundle adjustment of cameras, markers and poses.

With lenses and marker places: Gauss-Newton with Schur complement.

Unknowns are shared (each fixed camera's pose, each lens, each marker's and target's place) or belong to one frame (the
platform's pose, each moving camera's pose). The stated places of the base's markers, all together, hold the base frame,
those of the platform's markers the platform frame.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from rig.array_and_json_types import Booleans, Floats
from rig.errors import NotEnoughData, RigError
from rig.model.design import Camera
from vision.bundle.adjustment_unknowns_estimate_and_marker_printing_errors import (
    POSE_SCALE,
    Estimate,
    Printing,
    UnknownName,
    Unknowns,
    align_with_datums,
    estimate_after_step,
    estimate_offset_from_stated,
)
from vision.bundle.adjustment_unknowns_with_priors_and_start_estimate import (
    adjustment_unknowns_and_start_estimate,
    stated_lens_prior_sigmas,
)
from vision.bundle.corner_jacobians_normal_equations_and_schur_complement import (
    normal_equations,
    predicted_cost_decrease,
    schur_complement,
    solve_shared_and_frame_steps,
    whitened_residuals_and_derivatives,
)
from vision.corner_observations_and_merging import (
    Observations,
    Whitener,
    merged_corners_and_lost_squares,
    whitener_of_observations,
)
from vision.marker_corner_prediction import State, predict_corners

MAX_ITERATIONS = 120
CONVERGED = 1e-9  # relative decrease of the cost
OPEN = 1e-14  # of the best determined direction's information; what has less is not determined
MORE, LEAST = 3.0, 1e-8  # damping after a step that does not pay, over the one before; the first


class NoOptimum(RigError):
    """An adjustment that finds no optimum, or not within MAX_ITERATIONS: what is stated is far from what is seen."""


@dataclass(frozen=True, slots=True, eq=False)
class Adjustment:
    """The optimum and what is known of it, for corners' covariance as given (scale it by what the residuals say).

    state : State; residuals : (n, 2) px, seen less predicted; whitened : (n, 2)
    platform_given_cameras : (F, 6, 6) covariance of each platform pose were all shared unknowns known, tangent on the
        right
    platform_common : (F, 6, k) factor of what the shared unknowns' uncertainty adds, the same k draws for every frame
    shared_factor : (s, k) of the shared unknowns in their own units, named by shared_names: with the same draws they
        are off by this times z
    prior : (s,) standard deviation that each was given before the images, infinite for none
    dof : observations less the unknowns that they determine; cost : sum of whitened squares, priors' included
    unknowns : Unknowns, what was adjusted, being of the groups `free`; stated : State that the priors pull to
    printing : how far printed markers were taken to be off, or None
    common_image_errors : px RMS, of each camera, by which corners err alike at the same place of its image in every
    frame, () where they show no such errors
    """

    state: State
    residuals: Floats
    whitened: Floats
    platform_given_cameras: Floats
    platform_common: Floats
    shared_factor: Floats
    shared_names: list[UnknownName]
    prior: Floats
    dof: float
    cost: float
    unknowns: Unknowns
    stated: State
    free: tuple[str, ...]
    printing: Printing | None = None
    common_image_errors: tuple[float, ...] = ()

    @property
    def of_prints(self) -> Booleans:
        """(s,) bool, which of the shared unknowns are how markers are printed."""
        out, prints = np.zeros(len(self.shared_names), bool), self.unknowns.prints
        for columns in (*prints.rows.values(), prints.together):
            out[columns] = True
        return out

    @property
    def platform_covariance(self) -> Floats:
        """(F, 6, 6) covariance of each platform pose, cameras' uncertainty included, tangent on the right."""
        return self.platform_given_cameras + self.platform_common @ np.swapaxes(self.platform_common, 1, 2)

    @property
    def shared_covariance(self) -> Floats:
        """(s, s) covariance of the shared unknowns, in their own units."""
        return self.shared_factor @ self.shared_factor.T


def adjust_bundle(
    observations: Observations,
    state: State,
    free: Sequence[str] = ("poses", "lenses"),
    stated: State | None = None,
    lens_prior_sigmas: Callable[[Camera], Floats] = stated_lens_prior_sigmas,
    printing: Printing | None = None,
) -> Adjustment:
    """Adjust a bundle of cameras, marker places and poses.

    The cameras, places and poses that fit all corners best, weighted by covariance.
    observations : Observations, outliers taken out; state : State to start from, with its markers where these are free
    free : which of "poses" (of fixed cameras), "lenses", "markers" (each on its target: face misplacement) and
    "targets" (each in its body: cube misplacement) are adjusted; the rest is held and taken as known
    stated : State whose lenses and places are what the owner stated, `state` by default
    lens_prior_sigmas : function of a Camera, the standard deviations (4 + terms,) that its stated lens is given
    printing : how far printed markers are taken to be off where they are not free, or None
    The mean motion of all corners of a body's markers from where they are stated is held at zero, and so is the mean
    motion of a target's markers on it where both are free. Without targets on the base the stated camera poses hold the
    base frame: their mean motion is held at zero.
    Returns Adjustment. Raises NotEnoughData where unknowns outnumber observations, NoOptimum where there is none to be
        found.
    Source: Triggs et al., Bundle adjustment - a modern synthesis, 2000
    """
    stated = state if stated is None else stated
    u, estimate = adjustment_unknowns_and_start_estimate(observations, state, stated, free, lens_prior_sigmas, printing)
    if 2 * len(observations) < int(u.used.sum()) + int((u.prior == 0).sum()):
        raise NotEnoughData(
            f"{len(observations)} corners cannot determine {int(u.used.sum()) + u.basis.shape[1]} unknowns"
        )
    few, spare = merged_corners_and_lost_squares(observations, state)
    W = whitener_of_observations(few)
    damping, cost, blocks = 0.0, np.inf, None
    for _ in range(MAX_ITERATIONS):
        if blocks is None:
            residual, derivatives = whitened_residuals_and_derivatives(few, estimate, u, W)
            away = estimate_offset_from_stated(estimate, stated, u)
            cost = float((residual**2).sum() + (u.prior * away**2).sum()) + spare
            blocks = normal_equations(few, derivatives, u, away)
        steps = solve_shared_and_frame_steps(blocks, u, damping)
        moved = estimate_after_step(estimate, u, *steps)
        new = adjustment_cost(few, moved, stated, u, W) + spare
        if not new <= cost:
            if predicted_cost_decrease(
                blocks, *(solve_shared_and_frame_steps(blocks, u) if damping else steps)
            ) <= CONVERGED * max(cost, 1.0):
                if new - cost <= CONVERGED * max(cost, 1.0):
                    estimate = moved
                # at the bottom: what a step still promises drowns in the rounding of the cost; taken, it is as good to
                # the last digits
                break
            damping = max(MORE * damping, LEAST)
            if damping > 1e8:
                raise NoOptimum(
                    f"the adjustment of {len(observations)} corners finds no descent from a cost of {cost:.6g}"
                )
            continue
        done = cost - new <= CONVERGED * max(cost, 1.0)
        estimate, damping, blocks = moved, damping / MORE if damping > LEAST else 0.0, None
        if done:
            break
    else:
        raise NoOptimum(
            f"the adjustment of {len(observations)} corners did not converge in {MAX_ITERATIONS} iterations"
        )
    return replace(
        _finish(observations, few, W, align_with_datums(estimate, stated, u), stated, u, tuple(free)), printing=printing
    )


def adjustment_cost(
    observations: Observations, estimate: Estimate, stated: State, unknowns: Unknowns, whitening: Whitener
) -> float:
    """Cost of an adjustment.

    Sum of whitened squares with the priors'; infinite with a corner behind a camera.
    """
    uv, ahead = predict_corners(observations, estimate.state)
    if (ahead[:, 2] <= 0).any():
        return np.inf
    return float(
        (whitening(observations.uv - uv) ** 2).sum()
        + (unknowns.prior * estimate_offset_from_stated(estimate, stated, unknowns) ** 2).sum()
    )


def _finish(
    observations: Observations,
    few: Observations,
    W: Whitener,
    estimate: Estimate,
    stated: State,
    u: Unknowns,
    free: tuple[str, ...],
) -> Adjustment:
    """The Adjustment of Observations that were adjusted as few, with their Whitener."""
    residual, derivatives = whitened_residuals_and_derivatives(few, estimate, u, W)
    away = estimate_offset_from_stated(estimate, stated, u)
    blocks = normal_equations(few, derivatives, u, away)
    uv, _ = predict_corners(observations, estimate.state)
    residual = whitener_of_observations(observations)(observations.uv - uv)
    gain, reduced, _ = schur_complement(blocks)
    factor = u.basis @ _inverse_root(u.basis.T @ reduced @ u.basis, u)
    given = np.linalg.inv(blocks.local)[:, :6, :6] * POSE_SCALE**2
    cost = float((residual**2).sum() + (u.prior * away**2).sum())
    own = factor * u.scale[:, None]
    fitted_count = (
        u.basis.shape[1] - (u.prior[:, None] * factor**2).sum()
    )  # a term held by what was stated takes no observation
    dof = float(2 * len(observations) - u.used.sum() - fitted_count)
    return Adjustment(
        estimate.state,
        observations.uv - uv,
        residual,
        cast(Floats, given),
        (gain @ factor)[:, :6] * POSE_SCALE,
        own,
        u.names,
        np.where(u.prior > 0, u.scale, np.inf),
        dof,
        cost,
        u,
        stated,
        free,
    )


def _inverse_root(information: Floats, u: Unknowns) -> Floats:
    """Square root of the inverse of what the images say (k, k) of the basis' directions. Raises NotEnoughData naming
    what they leave open.
    """
    if not len(information):
        return np.zeros((0, 0))
    values, vectors = np.linalg.eigh((information + information.T) / 2)
    if not values[0] > OPEN * values[-1]:
        worst = np.argsort(-np.abs(u.basis @ vectors[:, 0]))[:3]
        raise NotEnoughData("the images do not determine: " + ", ".join(str(u.names[i]) for i in worst))
    return vectors / np.sqrt(values)
