"""What held-out poses promise of all poses in their volume: "with 95 % confidence, 95 % of poses lie within ..", as a whole and cell by cell.

Each configuration counts once. The limit is that of the poses' own errors (calib.certify.true_errors), to whose margin is added, in
squares, what one draw of the errors that all poses of a recording share could hide, and what the scale of the targets is uncertain by.
docs/mathematics.md (26)
"""

from dataclasses import dataclass

import numpy as np

from calib.certify import tolerance_limits, true_errors
from calib.certify.held_poses import HeldPoses

DRAWS = 400  # of the shared errors
PARTS = (slice(0, 3), slice(3, 6))  # position, rotation


@dataclass(frozen=True, slots=True)
class Bound:
    """Of one length (position m, or rotation rad): estimate of the `coverage` quantile of true errors, one-sided limits (lower, upper), the upper
    one being the promise; measured : the upper limit of the errors as measured, noise and all; shared, scale : margins of what poses share."""

    estimate: float
    lower: float
    upper: float
    measured: float
    shared: float
    scale: float


@dataclass(frozen=True, slots=True)
class Promise:
    """position, rotation : Bound, rotation None where none was measured; n : configurations that it rests on"""

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


def promised(poses: HeldPoses, coverage: float, confidence: float, scale: float, rng: np.random.Generator,
             chosen: np.ndarray | None = None) -> Promise:
    """Promise of poses. scale : relative standard uncertainty of the targets' scale; chosen : (c,) indices, every configuration's first by default

    rng : numpy Generator, for the draws of shared errors. Raises NotEnoughData for fewer configurations than it takes
    """
    at = poses.first if chosen is None else chosen
    tolerance_limits.enough(len(at), coverage, confidence)
    bounds = [_bound(poses, at, part, (coverage, confidence), scale, rng) for part in PARTS[: 2 if poses.rotations else 1]]
    return Promise(bounds[0], bounds[1] if len(bounds) > 1 else None, coverage, confidence, len(at))


def _bound(poses: HeldPoses, at: np.ndarray, part: slice, level: tuple[float, float], scale: float, rng: np.random.Generator) -> Bound:
    coverage, confidence = level
    errors = poses.errors[at][:, part]
    lengths = np.linalg.norm(errors, axis=1)
    own = true_errors.limits(lengths, poses.sigma(part)[at], coverage, confidence)
    drawn = [np.einsum("nik,dk->dni", factor[at][:, part], rng.normal(size=(DRAWS, factor.shape[2]))) for factor in poses.common]
    shared = _margins(errors, sum(drawn, np.zeros((DRAWS, 1, 3))), coverage, confidence)
    stretched = np.zeros(2)
    if scale and part.start == 0:
        T = poses.T_base_platform[at]
        stretched = _margins(errors, scale * rng.normal(size=(DRAWS, 1, 1)) * T.rotation.inv().apply(T.translation), coverage, confidence)
    down, up = np.sqrt(np.array([own.estimate - own.lower, own.upper - own.estimate]) ** 2 + shared**2 + stretched**2)
    return Bound(own.estimate, max(0.0, own.estimate - float(down)), own.estimate + float(up),
                 tolerance_limits.upper(lengths, coverage, confidence), float(shared[1]), float(stretched[1]))


def _margins(errors: np.ndarray, drawn: np.ndarray, coverage: float, confidence: float) -> np.ndarray:
    """(2,) by how much the errors' (n, 3) quantile may lie lower and higher for what is drawn (d, n, 3) with one draw for all.

    Higher: the quantile with it taken off. Lower: its own length, as it may be all that is seen, which draws apart from the errors do not show
    """
    quantiles = np.quantile(np.linalg.norm(errors - drawn, axis=2), coverage, axis=1)
    at = np.quantile(np.linalg.norm(errors, axis=1), coverage)
    own = np.sqrt((drawn**2).sum(axis=2).mean(axis=1))
    return np.array([np.quantile(own, confidence), max(float(np.quantile(quantiles, confidence) - at), 0.0)])


def cells(poses: HeldPoses, coverage: float, confidence: float, scale: float, rng: np.random.Generator) -> tuple[Cell, ...]:
    """Cells of the volume, halved along its longest side at the middle pose for as long as both halves have poses enough; none of one alone."""
    least = tolerance_limits.smallest(coverage, confidence)
    places = poses.T_base_platform.translation
    boxes = _halved(places, poses.first, places[poses.first].min(axis=0), places[poses.first].max(axis=0), least)
    return tuple(Cell(tuple(low.tolist()), tuple(high.tolist()), promised(poses, coverage, confidence, scale, rng, at))
                 for at, low, high in boxes) if len(boxes) > 1 else ()


def _halved(places: np.ndarray, at: np.ndarray, low: np.ndarray, high: np.ndarray, least: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """[(indices, low, high)] of boxes."""
    if len(at) < 2 * least:
        return [(at, low, high)]
    axis = int(np.argmax(high - low))
    order = at[np.argsort(places[at, axis], kind="stable")]
    half = len(order) // 2
    cut = (places[order[half - 1], axis] + places[order[half], axis]) / 2
    middle_high, middle_low = high.copy(), low.copy()
    middle_high[axis] = middle_low[axis] = cut
    return _halved(places, order[:half], low, middle_high, least) + _halved(places, order[half:], middle_low, high, least)
