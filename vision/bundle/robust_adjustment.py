"""Robust bundle adjustment.

Outlying corners and unsupported frames are excluded in rounds.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.errors import NotEnoughData
from vision.bundle.bundle_adjustment import Adjustment, adjust_bundle
from vision.corner_observations_and_merging import (
    Observations,
    group_sums,
    inverse_cholesky_factors,
    observations_of_frames,
    repeated_base_corner_rows_and_groups,
)
from vision.marker_corner_prediction import State, predict_corners
from vision.pose.frame_and_camera_poses import PLATFORM
from vision.pose.pose_refinement_and_choice_by_neighbour_frames import GATE, MEDIAN

ROUNDS = 8  # of adjusting and sorting out; a corner that still wavers then remains as adjusted
CLOSING = 0.3  # by which a wide first gate closes with every round
TIGHT = 0.5  # px; a gate narrower than this is no longer a first one
STANDING_GROUPS = 20  # repeated corners from which their standing error can be told
STANDING_PROOF = 4.0  # standard errors by which it must exceed chance
BLURRED = 5.0  # px; what a narrower gate lets through may be blur, what a wider one does is a mistake
ALIKE = (1, 2, 3, 4, 6, 8, 12, 20, 40, 100)  # degrees of freedom of the frames' scatter; the largest: they are alike
ENOUGH = 50  # degrees of freedom from which the residuals' own scale is trusted over the stated one


@dataclass(frozen=True, slots=True, eq=False)
class RobustAdjustment:
    """An Adjustment of what fits. solved : (f,) frame indices; inliers : (n,) bool; covariance : (n, 2, 2) px^2, as the
    scatter seen has it; scale : what the stated standard deviations were multiplied by."""

    adjustment: Adjustment
    solved: Integers
    inliers: Booleans
    covariance: Floats
    scale: float


def adjust_robustly(
    observations: Observations,
    state: State,
    free: Sequence[str],
    unsolved: dict[int, str],
    stated: State,
    single_sighting_bodies: Collection[tuple[int, int]] = frozenset(),
    initial_gate: float = 0.0,
    progress: Callable[[int, int], None] | None = None,
) -> RobustAdjustment:
    """Robust adjustment of all frames.

    Outlying corners and unsupported frames are excluded in rounds.
    state : over all frames; unsolved : {frame: reason}, added to; stated : State as its owner states it
    single_sighting_bodies : {(frame, body)} for which one sighting is enough; initial_gate : px within which no corner
        is rejected at first
    progress : called with (done, of) rounds, or None
    The inliers are those within GATE of where the optimum puts them, by the residuals' own scale; a frame whose inliers
    no longer hold it is given up; repeated until both stand. With a moving camera every frame and body has a scatter of
    its own.
    Raises NotEnoughData where no frame could be solved.
    """
    count = len(observations.frames)
    solved = np.array([f for f in range(count) if f not in unsolved], int)
    inliers, result, rounds, factor = None, None, 0, np.ones(len(observations))
    while True:
        if not len(solved):
            reasons = sorted(set(unsolved.values()))
            raise NotEnoughData(f"none of {count} frames could be solved: " + "; ".join(reasons[:5]))
        mine = np.isin(observations.frame, solved)
        plain = observations_of_frames(observations, solved)
        retained = replace(plain, covariance=factor[mine][:, None, None] * plain.covariance)
        gate = initial_gate * CLOSING**rounds
        good = are_corner_residuals_within_gate(retained, state.at(solved), gate)
        weak = _unsupported(
            retained,
            good,
            state,
            {(int(np.searchsorted(solved, f)), body) for f, body in single_sighting_bodies if f in solved},
        )
        if weak:
            unsolved.update({int(solved[f]): reason for f, reason in weak.items()})
            solved, inliers = np.delete(solved, list(weak)), None
            continue
        if (
            inliers is not None
            and result is not None
            and (rounds >= ROUNDS or ((good == inliers).all() and gate < TIGHT))
        ):
            break
        inliers, rounds = good, rounds + 1
        if progress:
            progress(rounds - 1, ROUNDS)
        result = adjust_bundle(retained.take(good), state.at(solved), free, stated=stated)
        state = _spread(result.state, state, solved)
        if state.moving and gate < BLURRED:
            factor[mine] = _scatter(plain, good, result.state)
    if progress:
        progress(ROUNDS, ROUNDS)
    everywhere = np.zeros(len(observations), bool)
    everywhere[mine] = inliers
    # of the corners alone: what is stated wrongly pulls, and is no scatter of theirs
    scale = np.sqrt((result.whitened**2).sum() / result.dof) if result.dof >= ENOUGH else 1.0
    return RobustAdjustment(
        result, solved, everywhere, (scale**2 * factor)[:, None, None] * observations.covariance, float(scale)
    )


def _scatter(observations: Observations, inliers: Booleans, state: State) -> Floats:
    """(n,) by how much the variance of each frame's corners of each body exceeds the typical: motion blurs some frames
    more.

    The frames' mean squares are taken as draws of an F distribution, whose second degrees of freedom say how alike
    frames are; each frame's variance is its own drawn towards the typical accordingly (a t distribution's weights).
    """
    square = _squares(observations, state)
    group = observations.frame * 2 + observations.on_platform
    size = 2 * np.bincount(group[inliers], minlength=group.max() + 1) - 6
    total = (
        2
        * np.bincount(group[inliers], minlength=group.max() + 1)
        * _medians(group[inliers], square[inliers], group.max() + 1)
        / MEDIAN
    )
    known = size > 0
    if not known.any():
        return np.ones(len(observations))
    mean = np.maximum(total[known] / size[known], 1e-12)

    def worse(log_typical: float, alike: int) -> float:
        return known.sum() * log_typical - scipy.stats.f.logpdf(mean / np.exp(log_typical), size[known], alike).sum()

    bounds = np.log(np.median(mean)) + np.array([-2.0, 2.0])
    fits = [
        (scipy.optimize.minimize_scalar(worse, bounds=bounds, args=(alike,), method="bounded"), alike)
        for alike in ALIKE
    ]
    fit, alike = min(fits, key=lambda one: one[0].fun)
    typical = np.exp(fit.x)
    if alike == max(ALIKE):
        return np.ones(len(observations))
    return ((alike + np.where(known, total, 0) / typical) / (alike + np.where(known, size, 0)))[group]


def repeated_corner_covariance_and_systematic_error(
    observations: Observations, inliers: Booleans, state: State
) -> tuple[Floats, float]:
    """Inflated covariances (n, 2, 2) of repeated base corners, and their systematic error in px.

    A base marker seen by a fixed camera stands on the same pixels in every frame, and what the pixel grid does to it
    comes back every time: n repeats are not n observations. Their scatter about their own mean is the noise; what their
    means miss beyond that is the standing error s, and weighing each repeat by C + n s^2 gives all n together the
    weight of one mean.
    """
    rows, index, _ = repeated_base_corner_rows_and_groups(observations, state.moving, inliers)
    count, covariance = np.bincount(index), observations.covariance.copy()
    if not len(count) or (count > 1).sum() < STANDING_GROUPS:
        return covariance, 0.0
    residual = observations.uv[rows] - predict_corners(observations.take(rows), state)[0]
    mean = group_sums(residual, index) / count[:, None]
    many = count > 1
    within = ((residual - mean[index])[many[index]] ** 2).sum() / (2 * (count[many] - 1).sum())
    unknowns = 12 * len(np.unique(observations.camera[rows]))  # what each camera bends to follow its standing errors
    between = (mean[many] ** 2).sum() / max(2 * many.sum() - unknowns, 1)
    chance = within * np.mean(1 / count[many])
    excess = between - chance
    if excess < STANDING_PROOF * chance / np.sqrt(many.sum()):
        return covariance, 0.0
    covariance[rows] += (count[index] * excess)[:, None, None] * np.eye(2)
    return covariance, float(np.sqrt(excess))


@dataclass(frozen=True, slots=True, eq=False)
class WeighedAdjustment:
    """Adjustment of n corners of the solved frames, m of them used.

    used : Observations (m,), as weighed; own : (m,) whether a corner's covariance is that of its own errors alone
    weights : (n, 2, 2) px^2; systematic_error : px, of repeated base corners; variance : by which the corners' own
    squares differ from those that all corners together left
    """

    adjustment: Adjustment
    used: Observations
    own: Booleans
    weights: Floats
    systematic_error: float
    variance: float


def adjust_with_systematic_errors_weighed(
    observations: Observations, fit: RobustAdjustment, free: Sequence[str], stated: State
) -> WeighedAdjustment:
    """WeighedAdjustment in which repeats of base corners count as what they are.

    observations : of all frames; fit : RobustAdjustment of them
    Where such corners err by more than chance, the others alone say how much corners scatter.
    """
    keep, result, variance = np.isin(observations.frame, fit.solved), fit.adjustment, 1.0
    good = fit.inliers[keep]
    while True:
        retained = observations_of_frames(replace(observations, covariance=variance * fit.covariance), fit.solved)
        weights, error = repeated_corner_covariance_and_systematic_error(retained, good, result.state)
        used = replace(retained, covariance=weights).take(good)
        result = adjust_bundle(used, result.state, free, stated=stated, printing=result.printing)
        own = (weights == retained.covariance).all(axis=(1, 2))[good]
        dof = 2 * np.count_nonzero(own) - int(result.unknowns.used.sum())
        if own.all() or variance != 1.0 or dof < ENOUGH:
            return WeighedAdjustment(result, used, own, weights, error, variance)
        variance = float((result.whitened[own] ** 2).sum() / dof)


def _spread(found: State, state: State, solved: Floats) -> State:
    """The state over all frames with the solved ones' poses put in."""

    def put(all_frames: RigidTransform, some: RigidTransform) -> RigidTransform:
        matrices = all_frames.as_matrix()
        matrices[solved] = some.as_matrix()
        return RigidTransform.from_matrix(matrices)

    return State(
        found.cameras,
        put(state.platform, found.platform),
        {i: put(state.moving[i], T) for i, T in found.moving.items()},
        found.markers,
    )


def _medians(group: Integers, values: Floats, count: int) -> Floats:
    """(count,) median of the values (n,) of each group (n,), 0 for an empty one: a few corners gone wrong do not move
    it.
    """
    order = np.lexsort((values, group))
    size = np.bincount(group, minlength=count)
    start = np.cumsum(size) - size
    out, full = np.zeros(count), size > 0
    low, high = (start + (size - 1) // 2)[full], (start + size // 2)[full]
    out[full] = (values[order][low] + values[order][high]) / 2
    return out


def _squares(observations: Observations, state: State) -> Floats:
    """(n,) whitened squares of how far the corners lie from where the state puts them; infinite behind a camera."""
    whitener = inverse_cholesky_factors(observations.covariance)
    uv, ahead = predict_corners(observations, state)
    square = ((whitener @ (observations.uv - uv)[..., None])[..., 0] ** 2).sum(axis=1)
    square[(ahead[:, 2] <= 0) | ~np.isfinite(square)] = np.inf
    return square


def are_corner_residuals_within_gate(observations: Observations, state: State, smallest_gate: float = 0.0) -> Booleans:
    """Whether each corner's residual (n,) is within the gate.

    The gate is GATE robust scales, or the smallest gate px.
    """
    square = _squares(observations, state)
    scale = np.sqrt(np.median(square) / MEDIAN)
    typical = np.median(np.einsum("nii->n", observations.covariance)) / 2
    return (square < (GATE * scale) ** 2) | (square * typical < smallest_gate**2)


def _unsupported(
    observations: Observations, inliers: Booleans, state: State, vouched: Collection[tuple[int, int]]
) -> dict[int, str]:
    """{frame: reason} of frames whose inliers are fewer than two sightings of the platform, or of the base by a moving
    camera.

    vouched : {(frame, body)} that do with one
    """
    markers = observations.marker.max() + 1
    bodies = [(observations.on_platform, "the platform", PLATFORM)]
    bodies += [
        (~observations.on_platform & (observations.camera == i), f"the base by camera {state.cameras[i].name!r}", i)
        for i in state.moving
    ]
    weak = {}
    for mask, what, body in bodies:
        rows = np.flatnonzero(inliers & mask)
        key = (
            observations.frame[rows] * len(state.cameras) + observations.camera[rows]
        ) * markers + observations.marker[rows]
        keys, count = np.unique(key, return_counts=True)
        sightings = np.bincount(keys[count >= 3] // markers // len(state.cameras), minlength=len(observations.frames))
        for f in np.flatnonzero(sightings < 2).tolist():
            if sightings[f] and (f, body) in vouched:
                continue
            weak[f] = f"only {sightings[f]} sightings of {what} agree with the other frames"
    return weak
