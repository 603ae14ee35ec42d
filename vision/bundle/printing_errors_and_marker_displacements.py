"""Variance of printing errors, and displacements of markers and targets from their stated places.

The variance is estimated from the recording itself: variance components by restricted likelihood. The effect of
displacements on the residuals is stated too.

Source: Harville, Maximum likelihood approaches to variance component estimation, JASA 72, 1977; fixed point: MacKay,
    Neural Computation 4, 1992
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np
from scipy import special
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, Integers
from rig.compute.parallel_map_and_dask_cluster import thread_map
from rig.model.design import Marker
from rig.model.effect_places_and_part_tolerances import Place
from rig.model.pose import log
from vision.bundle.bundle_adjustment import Adjustment, adjust_bundle
from vision.bundle.normal_equations_and_corner_jacobians import (
    normal_equations,
    predicted_decrease,
    schur_complement,
    solve_step,
    whitened_residuals_and_derivatives,
)
from vision.bundle.priors_of_unknowns import adjustment_unknowns
from vision.bundle.robust_adjustment import RobustAdjustment, inflate_repeated_corner_covariance, is_within_gate
from vision.bundle.unknowns_estimate_and_printing_errors import KINDS, NAMES, Printing, offset_from_stated
from vision.corner_observations import (
    Observations,
    find_repeated_base_corners,
    group_sums,
    merge_observation_groups,
    observations_of_frames,
    whitener_of_observations,
)
from vision.pose.pose_refinement_and_ambiguity_resolution import (
    MOST,
    neighbour_rotation_scatter,
    pose_from_neighbours,
    rotation_angle,
)
from vision.predict import MarkerMap, State, predict_corners

MOST_OF_TOLERANCE = (
    2.0  # of what is tolerated; markers farther off than that were not printed so, they were put elsewhere
)
TRIAL = Printing(1.0, 1.0, 1.0, 1.0)
# by which twice the log likelihood has to rise: one degree of freedom, a chance of 1 in 2000, and half the time nothing
# rises at all
PROOF_OF_VARIANCE = 12.1
FEWEST = 16  # markers, from which a variance is told to a third of itself
ROUNDS, SETTLED = 200, 1e-3  # of the fixed point; relative change of a standard deviation at which it ends
LEAST = 1e-3  # of what is tolerated, below which there is nothing
SORTED, AGAIN, FALLS = (
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
    """The adjustment (Sorted) repeated with printing errors of estimated size; as it was if none show.

    observations : Observations of all frames; fit : Sorted of them, places of markers as stated
    What stands still in the images may be a print or the pixel grid (see standing_error). At first all of it counts as
    the grid's, which errs corner by corner and camera by camera: prints must show beyond that. What they then explain
    is taken off it, and they are told again.
    """
    a = fit.adjustment
    kept = replace(
        observations_of_frames(observations, fit.solved),
        covariance=fit.covariance[np.isin(observations.frame, fit.solved)],
    )
    good = fit.inliers[np.isin(observations.frame, fit.solved)]
    if len(np.unique(kept.marker[good])) < FEWEST:
        return fit
    used, standing = np.zeros(len(good), bool), np.inf
    for turn in range(AGAIN):
        weights, now = inflate_repeated_corner_covariance(kept, good, a.state)
        if now >= FALLS * standing and (turn >= SORTED or (good == used).all()):
            break
        used, standing = good, now
        weighed = replace(kept, covariance=weights).take(used)
        printing = _printing(_print_information(weighed, fit.adjustment, free))
        if printing is None:
            return fit
        a = adjust_bundle(weighed, replace(a.state, markers=a.stated.markers), free, stated=a.stated, printing=printing)
        good = is_within_gate(kept, a.state)
    cost = (
        a.cost - (a.whitened**2).sum() + (whitener_of_observations(kept.take(used))(a.residuals) ** 2).sum()
    )  # standing errors in it, as in fit.scale
    scale = float(np.sqrt(cost / a.dof))
    inliers = fit.inliers.copy()
    inliers[np.isin(observations.frame, fit.solved)] = used
    return RobustAdjustment(a, fit.solved, inliers, scale**2 * fit.covariance, scale * fit.scale)


def _merged(observations: Observations, state: State) -> Observations:
    """Observations in which repeats of a corner are one, their mean, weighed as all of them: they count as one degree
    of freedom.
    """
    rows, group, first = find_repeated_base_corners(observations, state.moving)
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
    u, estimate = adjustment_unknowns(one, a.state, a.stated, free, printing=TRIAL)
    residual, derivatives = whitened_residuals_and_derivatives(one, estimate, u, whitener_of_observations(one))
    away = offset_from_stated(estimate, a.stated, u)
    blocks = normal_equations(one, derivatives, u, away)
    _, reduced, _ = schur_complement(blocks)
    covariance = u.basis @ np.linalg.inv(u.basis.T @ reduced @ u.basis) @ u.basis.T
    columns = np.concatenate([np.arange(c.start, c.stop) for c in (*u.prints.rows.values(), u.prints.together)])
    inverse = np.linalg.inv(covariance[np.ix_(columns, columns)])
    kind = [k for k, part in enumerate(KINDS) for _ in range(len(NAMES))[part]]
    shared, local = solve_step(blocks, u)
    right = inverse @ shared[columns]
    cost = (
        float((residual**2).sum() + (u.prior * away**2).sum())
        - predicted_decrease(blocks, shared, local)
        + float(right @ shared[columns])
    )
    return _PrintInformation(
        inverse - np.eye(len(columns)),
        right,
        np.array(kind * len(u.prints.rows) + [len(KINDS) - 1]),
        cost,
        a.dof - 2 * (len(observations) - len(one)),
    )


def _printing(told: _PrintInformation) -> Printing | None:
    """Printing with the variances that are there beyond chance, or None where none is."""
    there = np.ones(len(KINDS), bool)
    sigma, best = _likeliest(told, there)
    while there.any():
        kinds = np.flatnonzero(there).tolist()
        fewer = [there & (np.arange(len(KINDS)) != k) for k in kinds]
        without = dict(zip(kinds, thread_map(partial(_likeliest, told, start=sigma), fewer)))
        least = min(without, key=lambda k: without[k][1])
        if without[least][1] - best > PROOF_OF_VARIANCE:
            return Printing(*sigma.tolist())
        there[least] = False
        sigma, best = without[least]
    return None


def _likeliest(told: _PrintInformation, there: Floats, start: Floats | None = None) -> tuple[Floats, float]:
    """(standard deviations (kinds,) of those that are `there`, minus twice their restricted log likelihood but for a
    constant).
    """
    sigma = np.where(there, 1.0 if start is None else start, 0.0)
    noise, part = told.cost / told.dof, _of(told, sigma)
    for _ in range(ROUNDS):
        width = sigma[part.kind]
        inverse = _inverse(noise * np.eye(len(width)) + width[:, None] * part.information * width)
        x = width * (inverse @ (width * part.right))
        known = 1 - noise * np.diag(inverse)
        left = told.cost - 2 * part.right @ x + x @ part.information @ x
        new = sigma.copy()
        for k in np.flatnonzero(sigma > 0):
            own = part.kind == k
            new[k] = min(np.sqrt((x[own] ** 2).sum() / max(known[own].sum(), 1e-9)), MOST_OF_TOLERANCE)
        new[new < LEAST] = 0.0
        noise, done = float(left / (told.dof - known.sum())), (np.abs(new - sigma) <= SETTLED * sigma).all()
        part = part if ((new > 0) == (sigma > 0)).all() else _of(told, new)
        sigma = new
        if done:
            break
    width = sigma[part.kind]
    M = noise * np.eye(len(width)) + width[:, None] * part.information * width
    z = width * part.right
    likelihood = (
        np.linalg.slogdet(M / noise)[1] + told.dof * np.log(noise) + (told.cost - z @ np.linalg.solve(M, z)) / noise
    )
    return sigma, float(likelihood)


def _of(told: _PrintInformation, sigma: Floats) -> _PrintInformation:
    """_Told of the numbers on prints that are not held at nothing. sigma : (kinds,)"""
    on = np.flatnonzero(sigma[told.kind] > 0)
    return replace(told, information=told.information[np.ix_(on, on)], right=told.right[on], kind=told.kind[on])


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


HALVED = 0.5  # of the corners' scatter; stated places are doubted where markers that may move leave less than this
PROOF = 0.999  # probability with which an unmoved marker stays unmentioned
WIDE = 1.96  # standard deviations on either side of a 95 % interval


class Measured(Protocol):
    """What is asked here of a vision.recording_adjustment.Measurement, which stands above."""

    @property
    def frames(self) -> Integers:
        """(f,) numbers of the solved frames."""

    @property
    def T_base_platform(self) -> RigidTransform:
        """(f,) poses of the solved frames."""

    @property
    def observations(self) -> Observations:
        """Of all frames."""

    @property
    def adjustment(self) -> Adjustment:
        """Of the solved frames together."""

    def used(self) -> Observations:
        """Observations that were adjusted."""


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """How far one marker or target sits from its stated place, along its own axes: by : (6,) m, rad; ci95 : (6,) half
    widths;
    moved : whether chance is ruled out."""

    place: Place
    by: Floats
    ci95: Floats
    moved: bool


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """What adjusting places did. moves : one per marker or target; frames : (f,) numbers
    before, after : (f,) px, RMS per axis over the platform's corners of each frame, places as stated and as adjusted,
    all else adjusted both times, the same corners; weighted : (before, after) whitened squares over degrees of freedom,
    of all corners; odd : {frame number: degrees} that turn against the frames around them
    """

    moves: tuple[Move, ...]
    frames: Integers
    before: Floats
    after: Floats
    weighted: tuple[float, float]
    odd: dict[int, float]


def compare_stated_and_adjusted_places(measurement: Measured, t: Floats) -> Places:
    """Comparison (Places) of stated and adjusted marker places, and of the residuals with each.
    measurement : Measurement whose markers were free; t : (F,) s of all frames of the recording
    """
    m, a = measurement, measurement.adjustment
    solved = np.searchsorted(m.observations.frames, m.frames)
    kept = m.used()
    rest = tuple(group for group in a.free if group not in ("markers", "targets"))
    stated = replace(
        a.stated,
        platform=a.state.platform,
        moving=a.state.moving,
        markers=a.stated.markers,
        cameras=tuple(replace(s, pose=c.pose) for s, c in zip(a.stated.cameras, a.state.cameras)),
    )
    before = adjust_bundle(kept, stated, rest, stated=a.stated)
    weighted = before.cost / before.dof, a.cost / a.dof
    return Places(
        marker_displacements(a),
        m.frames,
        _by_frame(kept, before.state, len(m.frames)),
        _by_frame(kept, a.state, len(m.frames)),
        weighted,
        _odd(m, t[solved]),
    )


def are_stated_places_doubtful(measurement: Measured, markers: MarkerMap) -> bool:
    """Whether the stated marker places are doubtful.

    Whether most of the corners' scatter comes from them.
    markers : MarkerMap as stated
    """
    a, kept = measurement.adjustment, measurement.used()
    state = replace(a.state, markers=markers)
    u, estimate = adjustment_unknowns(kept, state, replace(a.stated, markers=markers), (*a.free, "markers"))
    W = whitener_of_observations(kept)
    residual, derivatives = whitened_residuals_and_derivatives(kept, estimate, u, W)
    away = offset_from_stated(estimate, replace(a.stated, markers=markers), u)
    blocks = normal_equations(kept, derivatives, u, away)
    left = (residual**2).sum() - predicted_decrease(blocks, *solve_step(blocks, u))
    dof = 2 * len(kept) - u.used.sum() - u.basis.shape[1]
    return bool(dof > 0 and left / dof < HALVED**2 * a.cost / a.dof)


def adjusted_markers(measurement: Measured) -> dict[str, tuple[Marker, ...]]:
    """Adjusted markers by target.

    Returns {target name: (Marker, ...)}
    """
    m = measurement.adjustment.state.placed
    out: dict[str, list[Marker]] = {}
    for row, name in enumerate(m.target):
        out.setdefault(name, []).append(
            Marker(int(m.id[row]), float(m.side[row]), m.T_body_marker[row], float(m.margin[row]))
        )
    return {name: tuple(rows) for name, rows in out.items()}


def marker_displacements(adjustment: Adjustment) -> tuple[Move, ...]:
    """Displacements (Move, ...) of the markers that an Adjustment left free from where they are stated."""
    u, out = adjustment.unknowns, []
    moved = log(adjustment.stated.placed.T_body_marker.inv() * adjustment.state.placed.T_body_marker)
    ids = adjustment.state.placed.id
    for row, columns in u.markers.items():
        if not adjustment.stated.placed.stated[row]:
            continue
        by = moved[row]
        C = adjustment.shared_covariance[columns, columns]
        scale = adjustment.prior[columns]
        values, vectors = np.linalg.eigh(C / np.outer(scale, scale))
        free = values > 1e-12
        square = ((vectors.T @ (by / scale))[free] ** 2 / values[free]).sum()
        out.append(
            Move(
                Place("marker", str(ids[row])),
                by,
                WIDE * np.sqrt(np.diag(C)),
                bool(free.any() and special.chdtrc(free.sum(), square) < 1 - PROOF),
            )
        )
    return tuple(out)


def _by_frame(observations: Observations, state: State, count: int) -> Floats:
    """(count,) px, RMS per axis of the platform's corners in each frame."""
    on = observations.on_platform
    square = ((observations.uv - predict_corners(observations, state)[0]) ** 2).sum(axis=1)
    frame = observations.frame[on]
    return np.sqrt(np.bincount(frame, weights=square[on], minlength=count) / (2 * np.bincount(frame, minlength=count)))


def _odd(m: Measured, t: Floats) -> dict[int, float]:
    """{frame number: degrees} of solved frames whose platform turns against those around it by more than these
    predict.
    """
    found = dict(enumerate(m.T_base_platform.as_matrix()))
    reach = neighbour_rotation_scatter(found, t)
    out: dict[int, float] = {}
    if reach is None:
        return out
    for f, T in found.items():
        expected, limit = pose_from_neighbours(found, f, t, reach)
        if expected is not None and limit < MOST and rotation_angle(expected, T) > max(2 * limit, MOST):
            out[int(m.frames[f])] = float(np.degrees(rotation_angle(expected, T)))
    return out
