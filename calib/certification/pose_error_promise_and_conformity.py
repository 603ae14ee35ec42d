"""Pose error promise, and conformity with tolerances.

A bound from held-out poses, whole and by cell.

The promise is one statement of position and rotation. Each pose has a depth, the greater of its position error and
its rotation error, each in a unit that was fixed before the held-out poses were measured; the limit of depth, times
the units, bounds both. So the 59 configurations of one limit suffice, and nothing is divided between two. Each
configuration counts once. The limit is that of the poses' own errors
(calib.certification.noise_free_errors_and_tolerance_limits), to whose
margin is added, in squares, what one draw of the errors that all poses of a recording share could hide, and what the
scale of the targets is uncertain by. docs/mathematics.md (24) and (26)

One decision is made of all tolerances. Judged is the depth below which the `coverage` of all poses lies, each pose's
depth the greater of its position and rotation errors over their tolerances: 1 is as good as required. It is accepted
only where even the upper limit is within 1, refused only where even the lower is beyond it, both one-sided with
GUARD: the guard band between is as wide as the limits are apart, and a decision, of one tolerance or of two, is wrong
in 2.5 % of cases at the most. Errors of the targets' scale are in no held-out pose, so that a position is accepted
only where the scale was certified. docs/mathematics.md (28); JCGM 106:2012, 8.3 (guarded acceptance).
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np

from calib.certification import noise_free_errors_and_tolerance_limits
from calib.certification.held_out_pose_errors_and_distinct_configurations import HeldPoses
from rig.array_and_json_types import Floats, Integers

DRAWS = 400  # of the shared errors
POSITION, ROTATION = slice(0, 3), slice(3, 6)


@dataclass(frozen=True, slots=True)
class Bound:
    """Of one length (position m, or rotation rad) or of depth: estimate of the `coverage` quantile of true errors,
    one-sided limits (lower, upper), the upper one being the promise; measured : the upper limit of the errors as
    measured, noise and all; shared, scale : margins of what poses share. Where a Promise has two, these are of position
    and rotation at once."""

    estimate: float
    lower: float
    upper: float
    measured: float
    shared: float
    scale: float

    def times(self, unit: float) -> "Bound":
        """The Bound of depth as one of a length, in m or rad."""
        return Bound(*(unit * value for value in astuple(self)))


@dataclass(frozen=True, slots=True)
class Promise:
    """position, rotation : Bound, rotation None where none was measured; n : configurations that it rests on
    The share `coverage` of poses lies within position.upper and rotation.upper both."""

    position: Bound
    rotation: Bound | None
    coverage: float
    confidence: float
    n: int

    @property
    def turned(self) -> float | None:
        """rad, the promise of rotations, None where none was measured."""
        return None if self.rotation is None else self.rotation.upper


@dataclass(frozen=True, slots=True)
class Cell:
    """A box of the volume: low, high (3,) m of the platform's position, and the Promise of it."""

    low: tuple[float, ...]
    high: tuple[float, ...]
    promise: Promise


@dataclass(frozen=True, slots=True)
class Unit:
    """of : POSITION or ROTATION; size : m or rad, in which a pose's length counts for its depth, fixed before the poses
    were measured.
    """

    of: slice
    size: float


def pose_error_promise(
    poses: HeldPoses,
    coverage: float,
    confidence: float,
    scale: float,
    units: tuple[float, float],
    rng: np.random.Generator,
    pose_indices: Integers | None = None,
) -> Promise:
    """Promise of pose errors from held-out poses.

    scale : relative standard uncertainty of the length scale
    units : (m, rad) whose ratio is that of the promised position to the promised rotation; whatever they are, the
    promise is valid as long as the poses had no part in their choice
    rng : numpy Generator, for the draws of shared errors. Raises NotEnoughData for fewer configurations than it takes
    """
    at = poses.first if pose_indices is None else pose_indices
    parts = (Unit(POSITION, units[0]), Unit(ROTATION, units[1]))[: 2 if poses.rotations else 1]
    depth = greatest_scaled_error_bound(poses, at, parts, (coverage, confidence), scale, rng)
    return Promise(
        depth.times(units[0]), depth.times(units[1]) if poses.rotations else None, coverage, confidence, len(at)
    )


def greatest_scaled_error_bound(
    poses: HeldPoses,
    pose_indices: Floats | Integers,
    units: tuple[Unit, ...],
    level: tuple[float, float],
    scale: float,
    rng: np.random.Generator,
) -> Bound:
    """Bound of the greatest scaled pose error.

    The greater of position and rotation, each in its unit.
    pose_indices : (c,) indices of poses; level : (coverage, confidence); scale, rng : as `pose_error_promise`
    Raises NotEnoughData for fewer poses than it takes
    """
    coverage, confidence = level
    noise_free_errors_and_tolerance_limits.require_sample_size(len(pose_indices), coverage, confidence)
    errors = _in_units(poses.errors[pose_indices], units)
    lengths = np.linalg.norm(errors, axis=2)
    own = noise_free_errors_and_tolerance_limits.tolerance_limits_of_true_errors(
        lengths,
        np.stack([poses.sigma(unit.of)[pose_indices] / unit.size for unit in units], axis=1),
        coverage,
        confidence,
    )
    drawn = [
        _in_units(np.einsum("nik,dk->dni", factor[pose_indices], rng.normal(size=(DRAWS, factor.shape[2]))), units)
        for factor in poses.common
    ]
    shared = _margins(errors, np.sum(drawn, axis=0), coverage, confidence) if any(map(np.any, drawn)) else np.zeros(2)
    stretched = np.zeros(2)
    if scale:
        T = poses.T_base_platform[pose_indices]
        moved = np.concatenate([T.rotation.inv().apply(T.translation), np.zeros((len(pose_indices), 3))], axis=1)
        stretched = _margins(
            errors, _in_units(scale * rng.normal(size=(DRAWS, 1, 1)) * moved, units), coverage, confidence
        )
    down, up = np.sqrt(np.array([own.estimate - own.lower, own.upper - own.estimate]) ** 2 + shared**2 + stretched**2)
    return Bound(
        own.estimate,
        max(0.0, own.estimate - float(down)),
        own.estimate + float(up),
        noise_free_errors_and_tolerance_limits.upper_tolerance_limit(lengths.max(axis=1), coverage, confidence),
        float(shared[1]),
        float(stretched[1]),
    )


def _in_units(errors: Floats, units: tuple[Unit, ...]) -> Floats:
    """(.., d, 3) of errors (.., 6), each of d parts in its unit."""
    return np.stack([errors[..., unit.of] / unit.size for unit in units], axis=-2)


def _greatest_error_lengths(errors: Floats) -> Floats:
    """(..,) greatest length of the parts of errors (.., d, 3)."""
    found: Floats = np.linalg.norm(errors, axis=-1).max(axis=-1)
    return found


def _margins(errors: Floats, drawn: Floats, coverage: float, confidence: float) -> Floats:
    """(2,) by how much the quantile of the depth of errors (n, d, 3) may lie lower and higher for what is drawn (k, n,
    d, 3), one draw for all.

    Higher: the quantile with it taken off. Lower: its own size, as it may be all that is seen, which draws apart from
    the errors do not show
    """
    quantiles = np.quantile(_greatest_error_lengths(errors - drawn), coverage, axis=1)
    at = np.quantile(_greatest_error_lengths(errors), coverage)
    own = np.sqrt((drawn**2).sum(axis=3).mean(axis=1)).max(axis=1)
    return np.array([np.quantile(own, confidence), max(float(np.quantile(quantiles, confidence) - at), 0.0)])


def promise_by_cell(
    poses: HeldPoses,
    coverage: float,
    confidence: float,
    scale: float,
    units: tuple[float, float],
    rng: np.random.Generator,
) -> tuple[Cell, ...]:
    """Pose error promise of each cell.

    The volume is cut along its longest side while both halves have poses enough.
    Each cell's promise has the confidence by itself. The arguments are those of `pose_error_promise`
    """
    least = noise_free_errors_and_tolerance_limits.least_sample_size(coverage, confidence)
    places = poses.T_base_platform.translation
    boxes = _halved(places, poses.first, places[poses.first].min(axis=0), places[poses.first].max(axis=0), least)
    return (
        tuple(
            Cell(
                tuple(low.tolist()),
                tuple(high.tolist()),
                pose_error_promise(poses, coverage, confidence, scale, units, rng, at),
            )
            for at, low, high in boxes
        )
        if len(boxes) > 1
        else ()
    )


def _halved(
    places: Floats, at: Integers, low: Floats, high: Floats, least: int
) -> list[tuple[Integers, Floats, Floats]]:
    """[(indices, low, high)] of boxes."""
    if len(at) < 2 * least:
        return [(at, low, high)]
    axis = int(np.argmax(high - low))
    order = at[np.argsort(places[at, axis], kind="stable")]
    half = len(order) // 2
    cut = (places[order[half - 1], axis] + places[order[half], axis]) / 2
    middle_high, middle_low = high.copy(), low.copy()
    middle_high[axis] = middle_low[axis] = cut
    return _halved(places, order[:half], low, middle_high, least) + _halved(
        places, order[half:], middle_low, high, least
    )


GUARD = 0.975
CONFORMS, FAILS, OPEN = "conforms", "does not conform", "cannot be said"


@dataclass(frozen=True, slots=True)
class Conformity:
    """Of one tolerance. quantity : "position" or "rotation"; tolerance, lower, upper, estimate : m or rad, of all
    quantities at once
    verdict : one of the three, the same for all tolerances; guard : between the tolerance and what may be accepted, m
        or rad
    given_scale : the verdict if the targets' scale is exact, which differs from `verdict` where a position would
        conform and nobody certified it
    beyond : how many of the held-out poses lie beyond this tolerance, as measured."""

    quantity: str
    tolerance: float
    estimate: float
    lower: float
    upper: float
    guard: float
    verdict: str
    given_scale: str
    beyond: int


def tolerance_conformity(
    tolerances: Sequence[tuple[str, float]],
    scaled_error_bound: Bound | None,
    scale_certified: bool,
    counts_beyond: Sequence[int],
) -> tuple[Conformity, ...]:
    """Conformity with each tolerance, of position (m) or rotation (rad), by the bound of the scaled error.

    scaled_error_bound : Bound of the depth in units of the tolerances, its limits of the confidence GUARD; None where
        there are too few poses for one
    counts_beyond : of each tolerance
    """
    if scaled_error_bound is None:
        scaled_error_bound = Bound(float("nan"), 0.0, float("inf"), float("nan"), 0.0, 0.0)
    given = CONFORMS if scaled_error_bound.upper <= 1 else FAILS if scaled_error_bound.lower > 1 else OPEN
    resting = not scale_certified and any(quantity == "position" for quantity, _ in tolerances)
    verdict = OPEN if given == CONFORMS and resting else given
    guard = (
        scaled_error_bound.upper
        if scaled_error_bound.estimate != scaled_error_bound.estimate
        else scaled_error_bound.upper - scaled_error_bound.estimate
    )
    return tuple(
        Conformity(
            quantity,
            size,
            size * scaled_error_bound.estimate,
            size * scaled_error_bound.lower,
            size * scaled_error_bound.upper,
            size * guard,
            verdict,
            given,
            count,
        )
        for (quantity, size), count in zip(tolerances, counts_beyond)
    )
