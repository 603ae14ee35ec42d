"""Estimation of the variance of printing errors.

From the recording itself: variance components by restricted likelihood.

Source: Harville, Maximum likelihood approaches to variance component estimation, JASA 72, 1977; fixed point: MacKay,
    Neural Computation 4, 1992; extrapolated as by Varadhan and Roland, Scandinavian Journal of Statistics 35, 2008
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri

from rig.array_and_json_types import Floats
from rig.compute.parallel_map_and_dask_cluster import thread_map
from vision.bundle.adjustment_unknowns_estimate_and_marker_printing_errors import (
    KINDS,
    NAMES,
    Printing,
    estimate_offset_from_stated,
)
from vision.bundle.adjustment_unknowns_with_priors_and_start_estimate import adjustment_unknowns_and_start_estimate
from vision.bundle.bundle_adjustment import Adjustment, adjust_bundle
from vision.bundle.corner_jacobians_normal_equations_and_schur_complement import (
    normal_equations,
    predicted_cost_decrease,
    schur_complement,
    solve_shared_and_frame_steps,
    whitened_residuals_and_derivatives,
)
from vision.bundle.robust_adjustment import (
    RobustAdjustment,
    are_corner_residuals_within_gate,
    repeated_corner_covariance_and_systematic_error,
)
from vision.corner_observations_and_merging import (
    Observations,
    group_sums,
    merge_observation_groups,
    observations_of_frames,
    repeated_base_corner_rows_and_groups,
    whitener_of_observations,
)
from vision.marker_corner_prediction import State

MOST = 2.0  # of what is tolerated; markers farther off than that were not printed so, they were put elsewhere
TRIAL = Printing(1.0, 1.0, 1.0, 1.0)
# by which twice the log likelihood has to rise: one degree of freedom, a chance of 1 in 2000, and half the time nothing
# rises at all
PROOF = 12.1
FEWEST = 16  # markers, from which a variance is told to a third of itself
ROUNDS, SETTLED = 200, 1e-3  # of the fixed point; relative change of a standard deviation at which it ends
LONGEST = 16.0  # times two rounds of the fixed point, a step that is extrapolated from them
LEAST = 1e-3  # of what is tolerated, below which there is nothing
SORTED, REPEATS, FALLS = (
    2,
    4,
    0.95,
)  # times that prints are told: for the corners sorted anew, and where each takes that share off the standing error


@dataclass(frozen=True, slots=True, eq=False)
class _PrintInformation:
    """What images say of prints, all else free. information : (q, q), right : (q,) in units of what is tolerated;
    kind : (q,) which variance each has; cost, dof : of the adjustment without them."""

    information: Floats
    right: Floats
    kind: Floats
    cost: float
    dof: float


def adjust_with_estimated_printing_errors(
    observations: Observations, fit: RobustAdjustment, free: tuple[str, ...]
) -> RobustAdjustment:
    """The adjustment (Sorted) with estimated printing errors.

    It is repeated with their estimated size; it is as it was if none show.
    observations : Observations of all frames; fit : Sorted of them, places of markers as stated
    What stands still in the images may be a print or the pixel grid (see standing_error). At first all of it counts as
    the grid's, which errs corner by corner and camera by camera: prints must show beyond that. What they then explain
    is taken off it, and they are told again.
    """
    a = fit.adjustment
    retained = replace(
        observations_of_frames(observations, fit.solved),
        covariance=fit.covariance[np.isin(observations.frame, fit.solved)],
    )
    good = fit.inliers[np.isin(observations.frame, fit.solved)]
    if len(np.unique(retained.marker[good])) < FEWEST:
        return fit
    used, standing = np.zeros(len(good), bool), np.inf
    for turn in range(REPEATS):
        weights, now = repeated_corner_covariance_and_systematic_error(retained, good, a.state)
        if now >= FALLS * standing and (turn >= SORTED or (good == used).all()):
            break
        used, standing = good, now
        weighed = replace(retained, covariance=weights).take(used)
        printing = _printing(_print_information(weighed, fit.adjustment, free))
        if printing is None:
            return fit
        a = adjust_bundle(weighed, replace(a.state, markers=a.stated.markers), free, stated=a.stated, printing=printing)
        good = are_corner_residuals_within_gate(retained, a.state)
    cost = (
        a.cost - (a.whitened**2).sum() + (whitener_of_observations(retained.take(used))(a.residuals) ** 2).sum()
    )  # standing errors in it, as in fit.scale
    scale = float(np.sqrt(cost / a.dof))
    inliers = fit.inliers.copy()
    inliers[np.isin(observations.frame, fit.solved)] = used
    return RobustAdjustment(a, fit.solved, inliers, scale**2 * fit.covariance, scale * fit.scale)


def _merged(observations: Observations, state: State) -> Observations:
    """Observations in which repeats of a corner are one, their mean, weighed as all of them: they count as one degree
    of freedom.
    """
    rows, group, first = repeated_base_corner_rows_and_groups(observations, state.moving)
    count = np.bincount(group)
    return merge_observation_groups(
        observations,
        rows,
        first,
        group_sums(observations.uv[rows], group) / count[:, None],
        observations.covariance[first] / count[:, None, None],
    )


def _print_information(observations: Observations, a: Adjustment, free: tuple[str, ...]) -> _PrintInformation:
    """_Told of observations weighed as standing_error has it, linearised at an Adjustment."""
    one = _merged(observations, a.state)
    u, estimate = adjustment_unknowns_and_start_estimate(one, a.state, a.stated, free, printing=TRIAL)
    residual, derivatives = whitened_residuals_and_derivatives(one, estimate, u, whitener_of_observations(one))
    away = estimate_offset_from_stated(estimate, a.stated, u)
    blocks = normal_equations(one, derivatives, u, away)
    _, reduced, _ = schur_complement(blocks)
    covariance = u.basis @ np.linalg.inv(u.basis.T @ reduced @ u.basis) @ u.basis.T
    columns = np.concatenate([np.arange(c.start, c.stop) for c in (*u.prints.rows.values(), u.prints.together)])
    inverse = np.linalg.inv(covariance[np.ix_(columns, columns)])
    kind = [k for k, part in enumerate(KINDS) for _ in range(len(NAMES))[part]]
    shared, local = solve_shared_and_frame_steps(blocks, u)
    right = inverse @ shared[columns]
    cost = (
        float((residual**2).sum() + (u.prior * away**2).sum())
        - predicted_cost_decrease(blocks, shared, local)
        + float(right @ shared[columns])
    )
    return _PrintInformation(
        inverse - np.eye(len(columns)),
        right,
        np.array(kind * len(u.prints.rows) + [len(KINDS) - 1]),
        cost,
        a.dof - 2 * (len(observations) - len(one)),
    )


def _printing(information: _PrintInformation) -> Printing | None:
    """Printing with the variances that are there beyond chance, or None where none is."""
    present = np.ones(len(KINDS), bool)
    sigma, best = _likeliest(information, present)
    while present.any():
        kinds = np.flatnonzero(present).tolist()
        fewer = [present & (np.arange(len(KINDS)) != k) for k in kinds]
        without = dict(zip(kinds, thread_map(partial(_likeliest, information, start=sigma), fewer)))
        least = min(without, key=lambda k: without[k][1])
        if without[least][1] - best > PROOF:
            return Printing(*sigma.tolist())
        present[least] = False
        sigma, best = without[least]
    return None


def _likeliest(information: _PrintInformation, present: Floats, start: Floats | None = None) -> tuple[Floats, float]:
    """(standard deviations (kinds,) of those that are `present`, minus twice their restricted log likelihood but for a
    constant).
    """
    sigma = np.where(present, 1.0 if start is None else start, 0.0)
    walked = [np.append(sigma, information.cost / information.dof)]
    for _ in range(ROUNDS):
        part = _of(information, walked[-1][:-1])
        new, old = _round(part, walked[-1]), walked[-1]
        done = (np.abs(new - old)[:-1] <= SETTLED * old[:-1]).all()
        new[:-1][new[:-1] < LEAST] = 0.0
        walked = [*walked, new] if ((new > 0) == (old > 0)).all() else [new]
        if done:
            break
        if len(walked) == 3:
            walked = [_extrapolated(*walked)]
    sigma, noise = walked[-1][:-1], float(walked[-1][-1])
    part = _of(information, sigma)
    width = sigma[part.kind]
    M = noise * np.eye(len(width)) + width[:, None] * part.information * width
    z = width * part.right
    likelihood = (
        np.linalg.slogdet(M / noise)[1]
        + information.dof * np.log(noise)
        + (information.cost - z @ np.linalg.solve(M, z)) / noise
    )
    return sigma, float(likelihood)


def _round(part: _PrintInformation, now: Floats) -> Floats:
    """(kinds + 1,) standard deviations and the noise's variance after one round of the fixed point from others `now`.

    part : of the numbers on prints whose standard deviation is not zero
    """
    sigma, noise = now[:-1], now[-1]
    width = sigma[part.kind]
    inverse = _inverse(noise * np.eye(len(width)) + width[:, None] * part.information * width)
    x = width * (inverse @ (width * part.right))
    known = 1 - noise * np.diag(inverse)
    left = part.cost - 2 * part.right @ x + x @ part.information @ x
    new = np.append(sigma, left / (part.dof - known.sum()))
    for k in np.flatnonzero(sigma > 0):
        own = part.kind == k
        new[k] = min(np.sqrt((x[own] ** 2).sum() / max(known[own].sum(), 1e-9)), MOST)
    return new


def _extrapolated(first: Floats, second: Floats, third: Floats) -> Floats:
    """(kinds + 1,) where three rounds of the fixed point lead to, in logarithms; what is zero stays so."""
    out, on = third.copy(), third > 0
    one, two, three = (np.log(x[on]) for x in (first, second, third))
    step, bend = two - one, three - 2 * two + one
    length = np.clip(np.linalg.norm(step) / max(float(np.linalg.norm(bend)), 1e-300), 1.0, LONGEST)
    out[on] = np.exp(one + 2 * length * step + length**2 * bend)
    out[:-1][on[:-1]] = np.clip(out[:-1][on[:-1]], LEAST, MOST)  # what vanishes does so by a round of its own
    return out


def _of(information: _PrintInformation, sigma: Floats) -> _PrintInformation:
    """_Told of the numbers on prints that are not held at nothing. sigma : (kinds,)"""
    on = np.flatnonzero(sigma[information.kind] > 0)
    return replace(
        information,
        information=information.information[np.ix_(on, on)],
        right=information.right[on],
        kind=information.kind[on],
    )


def _inverse(M: Floats) -> Floats:
    """(q, q) inverse of a symmetric positive definite M (q, q). Raises LinAlgError where it is not."""
    if not len(M):
        return M
    factor, bad = dpotrf(M, lower=1, clean=1)
    if bad:
        raise np.linalg.LinAlgError(
            f"the information of {len(M)} numbers on prints, noise added, is not positive definite"
        )
    below, _ = dpotri(factor, lower=1)  # what is above the diagonal is nought, as `clean` has left it
    whole = below + below.T
    whole[np.diag_indices_from(whole)] = below.diagonal()
    return np.asarray(whole)
