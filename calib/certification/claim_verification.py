"""Verification of a calibration's claim.

Whether the pose errors of a recording lie within the claim.

Of n poses the machine's error may be as large as the claim's upper end, the instrument's own errors are drawn anew in
every pose and so average out, its shared errors are drawn once. The squares are whitened by all three together, so that
a shared error costs its own few degrees of freedom and widens nothing else. Their distribution, the machine's error
being the same in each visit of one configuration, is drawn.
A base (or an instrument) that stands elsewhere moves all poses by one rigid motion: it is estimated, and the claim
tested without it. Zeros of struts that have changed move all poses nearly alike. They are estimated too: where the
claim is kept with them and not with a rigid motion, the machine itself is wrong; where it is kept with either, poses do
not separate the two.
Source: docs/mathematics.md (21); Rao, Linear Statistical Inference, 2nd ed., 3b (quadratic forms); 4a (generalised
    least squares)
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certification.claimed_error_reduction_over_workspace import Claim
from calib.certification.held_out_pose_error_statistics import pose_errors
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.model.pose import adjoint, exp
from rig.report.verdict_refutations_and_result_display import REFUTES

LEVEL = 0.995  # of each part's quantile: one claim in a hundred that is kept is taken for one that is not
DRAWS, FEWEST_DRAWS, MOST = 2000, 400, 200_000  # of squares: as many as times the poses make MOST
NOTICED = 0.975  # chance with which an error of the size that is stated would have been noticed
FEWEST = 8  # poses from which a rigid motion is estimated
FAR, BEYOND, MOST_FAR = 10.0, 4.0, 0.1  # times half of all, and times what is allowed; share of the poses at most
# of whitened squares, between two explanations with as many unknowns. It decides of words alone: the machine's errors
# are smooth, so that the difference grows with the poses, and of 100 bases moved before 200 poses several exceed it
CLEARLY = 50.0
STEPS = 6  # of Gauss and Newton: motions of a metre and a radian converge in five
TINY = 1e-9  # m or rad, claims below which weigh as this


@dataclass(frozen=True, slots=True)
class Part:
    """Position or rotation. rms : m or rad as measured; claimed : upper end of the claim; of_allowed : RMS of the
    whitened squares, 1 where the error is what claim and noise allow; limit : up to which chance goes; noticed : m or
    rad, an error of the machine that would have passed it"""

    rms: float
    claimed: float
    of_allowed: float
    limit: float
    noticed: float

    @property
    def kept(self) -> bool:
        """Whether the claim is kept."""
        return self.of_allowed <= self.limit


@dataclass(frozen=True, slots=True)
class Offset:
    """A rigid motion common to all poses. of : "base" or "platform", which of the two stands elsewhere; position : m;
    rotation : rad, its lengths
    kept : whether the claim is kept without it, so that the machine may be as claimed, with changed zeros or without
    zeros : m, greatest change of a strut's zero with which it is kept, None where no changes do that
    machine : whether these explain the poses clearly better than the motion, without which the claim is not kept"""

    of: str
    position: float
    rotation: float
    kept: bool
    zeros: float | None = None
    machine: bool = False


@dataclass(frozen=True, slots=True)
class FarPoses:
    """Few poses far off all others. frames : their numbers; kept : whether the claim is kept without them."""

    frames: tuple[int, ...]
    kept: bool

    def __str__(self) -> str:
        several = len(self.frames) > 1
        named = ", ".join(map(str, self.frames))
        return (
            f"{len(self.frames)} pose{'s lie' if several else ' lies'} more than {FAR:g} times farther off than half "
            f"of all (frame{'s' if several else ''} {named}); without {'them' if several else 'it'} the claim is "
            f"{'kept' if self.kept else 'NOT kept either'}"
        )


@dataclass(frozen=True, slots=True)
class Verification:
    """A claim held against n poses. position, rotation : Part, None where it was not measured or nothing is claimed of
    it
    far : FarPoses, None where the claim is kept or no few poses stand out
    offset : Offset that explains why the claim is not kept, None where it is kept or no such motion explains it
    unexplained : whether the claim names something that it leaves so"""

    n: int
    position: Part | None
    rotation: Part | None
    offset: Offset | None = None
    unexplained: bool = False
    far: FarPoses | None = None

    @property
    def parts(self) -> dict[str, Part]:
        """{"position" | "rotation": Part} of what was judged."""
        return {
            name: part for name, part in (("position", self.position), ("rotation", self.rotation)) if part is not None
        }

    @property
    def kept(self) -> bool:
        """Whether all that was judged is kept. Of nothing judged nothing is."""
        return bool(self.parts) and all(part.kept for part in self.parts.values())

    @property
    def refutes(self) -> bool:
        """Whether the claim is not kept, and neither a rigid motion of all poses nor few that lie far off explain it.

        What a claim names as unexplained differs with the day and the plan: it is refuted by more than REFUTES times
        what it and noise allow.
        """
        explained = (self.offset is not None and self.offset.kept) or (self.far is not None and self.far.kept)
        if self.kept or not self.parts or explained:
            return False
        return not self.unexplained or max(part.of_allowed for part in self.parts.values()) > REFUTES

    @property
    def of_limit(self) -> float:
        """Greatest of the whitened RMS errors over its limit, 1 where the claim is just kept."""
        return max((part.of_allowed / part.limit for part in self.parts.values()), default=math.nan)


def verify_claim(
    predicted: RigidTransform,
    samples: Samples,
    label: Integers,
    claim: Claim,
    rng: np.random.Generator,
    by_lengths: Floats | None = None,
) -> Verification:
    """Verification of a Claim by predicted poses (n,) and measured samples.

    samples : Samples, the poses as measured; label : (n,) configuration of each pose; rng : numpy Generator
    by_lengths : (n, 6, axes) change of the poses with the struts' lengths, None for a machine without struts
    Raises ValueError for a Claim without a factor
    """
    if claim.after is None:
        raise ValueError("no factor is claimed, so nothing can be verified")
    errors = pose_errors(predicted, samples)
    found = replace(_verified(errors, samples, label, claim, rng), unexplained=bool(claim.unexplained))
    if found.kept or not found.parts:
        return found
    far = _far(errors, samples, claim)
    if far.any():
        holds_without = _verified(errors[~far], samples.take(~far), label[~far], claim, rng).kept
        found = replace(found, far=FarPoses(tuple(samples.frame[far].tolist()), holds_without))
        if holds_without:
            return found
    offset = _offset(predicted, samples, label, claim, found.of_limit, rng)
    if offset is not None and by_lengths is not None:
        offset = _with_zeros(offset, predicted, samples, label, claim, by_lengths, rng)
    return replace(found, offset=offset)


def _far(errors: Floats, samples: Samples, claim: Claim) -> Booleans:
    """(n,) whether a pose lies FAR times farther off than half of all, and as far beyond what claim and noise allow;
    none where these are more than a share MOST_FAR of the poses.
    """
    assert claim.after is not None
    far = np.zeros(len(errors), bool)
    for rows, three in zip(_parts(errors, claim), claim.after):
        if rows:
            C = samples.total_covariance()[:, rows][:, :, rows] + three[2] ** 2 / len(rows) * np.eye(len(rows))
            size = np.sqrt(np.einsum("ni,nij,nj->n", errors[:, rows], np.linalg.inv(C), errors[:, rows]) / len(rows))
            far |= size > FAR * max(float(np.median(size)), BEYOND / FAR)
    return far & (far.mean() <= MOST_FAR)


def _verified(
    errors: Floats, samples: Samples, label: Integers, claim: Claim, rng: np.random.Generator
) -> Verification:
    """Verification by errors (n, 6), without a rigid motion."""
    assert claim.after is not None
    parts = [
        _part(errors, samples.covariance, samples.common, label, rows, three[2], rng)
        for rows, three in zip(_parts(errors, claim), claim.after)
    ]
    return Verification(len(errors), parts[0], parts[1])


def _parts(errors: Floats, claim: Claim) -> list[list[int]]:
    """Rows of the tangent that are judged, of position and of rotation."""
    assert claim.after is not None
    return [
        [i for i in part if np.isfinite(errors[:, i]).all() and np.abs(errors[:, i]).any()] if three[2] > 0 else []
        for part, three in zip((range(3), range(3, 6)), claim.after)
    ]


def _part(
    errors: Floats,
    own: Floats,
    common: Floats,
    label: Integers,
    rows: list[int],
    claimed: float,
    rng: np.random.Generator,
) -> Part | None:
    """Part of rows of the tangent; None of no rows."""
    if not rows:
        return None
    e, C, B = errors[:, rows], own[:, rows][:, :, rows], common[:, rows]
    whiten = _Whitener(C + claimed**2 / len(rows) * np.eye(len(rows)), B)
    n, d = e.shape
    draws = int(np.clip(MOST // n, FEWEST_DRAWS, DRAWS))
    root = np.linalg.cholesky(C + TINY**2 * np.eye(d))
    machine = rng.normal(size=(draws, int(label.max()) + 1, d))[:, label] * (claimed / math.sqrt(d))
    noise = np.einsum("nij,qnj->qni", root, rng.normal(size=(draws, n, d)))
    noise = noise + np.einsum("nik,qk->qni", B, rng.normal(size=(draws, B.shape[2])))
    alone, crossed, own_squares = (
        whiten.squares(machine, machine),
        whiten.squares(machine, noise),
        whiten.squares(noise, noise),
    )

    def squares(times: float) -> Floats:
        return times**2 * alone + 2 * times * crossed + own_squares

    limit = float(np.quantile(squares(1.0), LEVEL))
    found = math.sqrt(float(whiten.squares(e[None], e[None])[0]) / (n * d))
    times = _root(lambda size: float(np.quantile(squares(size), 1 - NOTICED)) - limit)
    return Part(float(np.sqrt((e**2).sum(axis=1).mean())), claimed, found, math.sqrt(limit / (n * d)), claimed * times)


def _root(rising: Callable[[float], float], most: float = 1e3) -> float:
    """Where a rising function passes 0, to a part in a hundred; infinite beyond the most."""
    low, high = 0.0, most
    if rising(high) < 0:
        return math.inf
    while high - low > 0.01 * high:
        middle = (low + high) / 2
        low, high = (low, middle) if rising(middle) > 0 else (middle, high)
    return high


class _Whitener:
    """Products a' (diag(C) + B B')^-1 b of errors. C : (n, d, d); B : (n, d, k), by Woodbury's identity."""

    def __init__(self, C: Floats, B: Floats) -> None:
        self.inverse = np.linalg.inv(C)
        self.B = B
        self.weighted = self.inverse @ B
        self.core = np.linalg.inv(np.eye(B.shape[2]) + np.einsum("nik,nil->kl", B, self.weighted))

    def squares(self, a: Floats, b: Floats) -> Floats:
        """(q,) of a and b (q, n, d)."""
        alone = ((a[:, :, None] @ self.inverse)[:, :, 0] * b).sum(axis=(1, 2))
        z, w = (np.tensordot(one, self.weighted, axes=((1, 2), (0, 1))) for one in (a, b))
        return np.asarray(alone - ((z @ self.core) * w).sum(axis=1))


def _offset(
    predicted: RigidTransform, samples: Samples, label: Integers, claim: Claim, whole: float, rng: np.random.Generator
) -> Offset | None:
    """The rigid motion, of the base or of what is measured on the platform, that explains why a claim is not kept:
    without it the claim is kept, or less than half of what was beyond it is left. None where neither does.
    whole : `Verification.of_limit` with it"""
    if samples.measured not in ("pose", "position") or len(samples) < FEWEST:
        return None
    found: list[tuple[float, Offset]] = []
    for of in ("base", "platform"):
        motion, without = _without(of, predicted, samples, claim)
        left = _verified(pose_errors(predicted, without), samples, label, claim, rng)
        sizes = float(np.linalg.norm(motion.translation)), float(motion.rotation.magnitude())
        found.append((left.of_limit, Offset(of, *sizes, left.kept)))
    least, best = min(found, key=lambda one: one[0])
    return best if best.kept or least < whole / 2 else None


def _with_zeros(
    offset: Offset,
    predicted: RigidTransform,
    samples: Samples,
    label: Integers,
    claim: Claim,
    by_lengths: Floats,
    rng: np.random.Generator,
) -> Offset:
    """The Offset with the change of the struts' zeros with which the claim is kept, where one does that."""
    errors = pose_errors(predicted, samples)
    rows, weight = _weighed(errors, samples, claim)
    A = by_lengths[:, rows]
    zeros = _least_squares(A, weight, errors[:, rows])
    left = errors - by_lengths @ zeros
    if not _verified(left, samples, label, claim, rng).kept:
        return offset
    changed = float(np.abs(zeros).max())
    if offset.kept:
        return replace(offset, zeros=changed)
    moved = pose_errors(predicted, _without(offset.of, predicted, samples, claim)[1])
    squares = [np.einsum("ni,nij,nj->", e[:, rows], weight, e[:, rows]) for e in (left, moved)]
    return replace(offset, zeros=changed, machine=bool(squares[0] < squares[1] - CLEARLY))


def _weighed(errors: Floats, samples: Samples, claim: Claim) -> tuple[Integers, Floats]:
    """(rows of the tangent that are measured, (n, rows, rows) inverse covariance of noise and claim)."""
    assert claim.after is not None
    sizes = np.repeat([three[2] / math.sqrt(3) for three in claim.after], 3)
    rows: Integers = np.asarray(np.flatnonzero(np.isfinite(errors).all(axis=0)))
    added = np.diag(np.maximum(sizes[rows], TINY) ** 2)
    return rows, np.asarray(np.linalg.inv(samples.total_covariance()[:, rows][:, :, rows] + added), dtype=np.float64)


def _least_squares(A: Floats, weight: Floats, e: Floats) -> Floats:
    """(k,) by generalised least squares. A : (n, rows, k); weight : (n, rows, rows); e : (n, rows)"""
    information, right = np.einsum("nia,nij,njb->ab", A, weight, A), np.einsum("nia,nij,nj->a", A, weight, e)
    return np.asarray(np.linalg.lstsq(information, right, rcond=1e-10)[0])


def _without(of: str, predicted: RigidTransform, samples: Samples, claim: Claim) -> tuple[RigidTransform, Samples]:
    """(rigid motion that fits best, Samples without it), by generalised least squares on SE(3)."""
    motion, moved = RigidTransform.identity(), samples
    for _ in range(STEPS):
        e = pose_errors(predicted, moved)
        rows, weight = _weighed(e, samples, claim)
        A = (adjoint(predicted.inv()) if of == "base" else np.broadcast_to(np.eye(6), (len(e), 6, 6)))[:, rows]
        step = exp(_least_squares(A, weight, e[:, rows]))
        T = samples.T_base_platform
        motion = step * motion if of == "base" else motion * step
        moved = replace(samples, T_base_platform=motion.inv() * T if of == "base" else T * motion.inv())
    return motion, moved
