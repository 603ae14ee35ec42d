"""Kernels of the on-line filter, and change detection.

Compiled, of the square-root information filter; changes are detected by likelihood ratio.

Every hypothesis is held to the same innovations of the last poses: it must explain what is there beyond chance, and
what it leaves must be no more than noise. The simplest that does wins; where two equally simple ones do, the next pose
decides. What changed, and since which pose, is searched for: a ratio counts by the chance that the greatest of all that
were looked at is as great (Bonferroni's bound).

The state is a triangle [R | z | signatures]: R dp = z about the present estimate, moved so that z is zero. A pose adds
six whitened rows; Householder reflections bring the triangle back, and what they leave in the rows is the whitened
innovation, docs/mathematics.md (22).
A column of signatures, carried along, leaves there what a change since a given pose would add to it, less what the
parameters would have made of it: their inner products are the likelihood ratio of the change, (23). Source: Bierman,
Factorization Methods for Discrete Sequential Estimation, 1977; Willsky and Jones, IEEE Trans. Automatic Control 21,
1976 (the ratio).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, ndtri

from calib.models.platform.strut_loop_closure_equations import (
    Measured,
    fill_whitened_pose_row,
    solve_pose_in_place_by_newton,
)
from rig.array_and_json_types import Floats
from rig.compute.numba_compilation_and_kernel_cache_folder import njit

STRUTS, WINDOW = 6, 3  # the poses within which a change must show, each a possible onset
FALSE_ALARM = 2e-6  # at most, of a strut's jump at a quiet pose, over struts and onsets
FALSE_OTHER = 1.6e-7  # of the same for what has more freedom
LEFT = 1e-4  # share of true jumps whose poses agree no better with it
APART = 15.0  # of misfit by which the measuring frame's motion and jumps of several struts must differ to be told apart
DECIDES = 3  # poses from which the better of the two is taken, however little it is
CLEARLY = 9.0  # likelihood ratio that every pose must give a knocked joint
COUNTS = 4.0  # standard errors from which one strut of several counts as having jumped


def strut_jump_threshold(false_alarm: float, onsets: int = WINDOW) -> float:
    """Threshold of a strut's jump, in standard errors.

    At one of `onsets` poses, for a `false_alarm` chance.
    """
    return float(-ndtri(false_alarm / (2 * STRUTS * onsets)))


def likelihood_ratio_thresholds(false_alarm: float, onsets: int = WINDOW) -> dict[int, float]:
    """Thresholds {k: threshold} of the likelihood ratio of hypotheses with k numbers, for a `false_alarm` chance."""
    looks = (STRUTS + 2) * (onsets - 1)
    return {k: float(chdtri(k, false_alarm / looks)) for k in range(1, STRUTS + 1)}


JUMP = strut_jump_threshold(FALSE_ALARM)
MOVED = likelihood_ratio_thresholds(FALSE_OTHER)
MISFIT = {k: float(chdtri(k, LEFT)) for k in range(1, 19)}
SUSPECT = MOVED[6]  # innovation squared beyond which a pose is held until the next one


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """Something jumped.

    kind : "strut" (it is longer by the same at every pose: missed steps), "joint" (by an amount that differs from pose
    to pose: a knocked joint) or "frame" (the measured poses moved against the base: a camera or the base knocked)
    strut : 1..6 or None; onset : number of the first pose after it, from 0
    size : m by which the strut is longer than its command says since (a joint: on average), or (6,) m, rad of the frame
        in the base
    sigma : its standard error, of the same shape
    """

    kind: str
    strut: int | None
    onset: int
    size: float | Floats
    sigma: float | Floats


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Innovations of the last poses and their products with what a jump since the first of them would have left there.

    onset : number of the first pose; total : innovations squared; projected : (12,) products; gram : (12, 12) of the
    signatures, six struts (1/m) and six motions of the frame (1/m, 1/rad); single : (poses, 2, 6) products and squares
    of the struts' signatures, pose by pose
    """

    onset: int
    total: float
    projected: Floats
    gram: Floats
    single: Floats


def detect_changes(evidence: list[Evidence]) -> tuple[Change, ...]:
    """Changes detected in the last poses.

    evidence : Evidence of the last 1, 2, .. poses
    """
    for hypothesis in (_strut, _joint, _several):
        found = hypothesis(evidence)
        if found is not None:
            return found
    return ()


def _strut(evidence: list[Evidence]) -> tuple[Change, ...] | None:
    """One strut by the same at every pose; () where the last pose alone tells it best, so that the next one decides."""
    best: float = 0.0
    found: tuple[Change, ...] | None = None
    for poses, e in enumerate(evidence, 1):
        z = e.projected[:6] / np.sqrt(np.maximum(np.diag(e.gram)[:6], 1e-300))
        i = int(np.argmax(np.abs(z)))
        if abs(z[i]) <= max(JUMP, best):
            continue
        best, found = abs(z[i]), None
        if poses == 1:
            found = ()
        elif e.total - z[i] ** 2 < MISFIT[6 * poses - 1]:
            found = (
                Change("strut", i + 1, e.onset, float(e.projected[i] / e.gram[i, i]), float(e.gram[i, i] ** -0.5)),
            )
    return found or None


def _joint(evidence: list[Evidence]) -> tuple[Change, ...] | None:
    """One strut by amounts that differ."""
    best: float = 0.0
    found: tuple[Change, ...] | None = None
    for poses, e in list(enumerate(evidence, 1))[1:]:
        squares = (e.single[:, 0] ** 2 / np.maximum(e.single[:, 1], 1e-300)).sum(axis=0)
        i = int(np.argmax(squares))
        each = e.single[:, 0, i] ** 2 / e.single[:, 1, i]
        if squares[i] > max(MOVED[poses], best) and each.min() > CLEARLY and e.total - squares[i] < MISFIT[5 * poses]:
            size = float(np.mean(e.single[:, 0, i] / e.single[:, 1, i]))
            best, found = squares[i], (Change("joint", i + 1, e.onset, size, float(e.single[:, 1, i].sum() ** -0.5)),)
    return found


def _several(evidence: list[Evidence]) -> tuple[Change, ...] | None:
    """Several struts at once, or the frame; None while either may be."""
    for poses, e in list(enumerate(evidence, 1))[1:]:
        if e.total < MOVED[6]:
            continue
        fits = []
        for part in (slice(0, 6), slice(6, 12)):
            spread = np.linalg.pinv(e.gram[part, part])
            size = spread @ e.projected[part]
            fits.append((float(size @ e.projected[part]), size, np.sqrt(np.diag(spread))))
        struts, frame = fits
        better, other = (struts, frame) if struts[0] > frame[0] else (frame, struts)
        apart = 0.0 if poses == len(evidence) and poses >= DECIDES else APART
        if better[0] < MOVED[6] or e.total - better[0] > MISFIT[6 * poses - 6] or better[0] - other[0] < apart:
            continue
        if better is frame:
            return (Change("frame", None, e.onset, frame[1], frame[2]),)
        return tuple(
            Change("strut", int(i) + 1, e.onset, float(struts[1][i]), float(struts[2][i]))
            for i in np.flatnonzero(np.abs(struts[1]) > COUNTS * struts[2])
        )
    return None


def change_sentence(change: Change, frame: int, is_undone_later: bool = False) -> str:
    """Sentence about a change.

    frame : number of the first frame after it; is_undone_later : whether later changes undo it
    """
    if not isinstance(change.size, float):
        position, rotation = (float((part**2).sum() ** 0.5) for part in (change.size[:3], change.size[3:]))
        return (
            f"from frame {frame} on the measured poses are moved against the base by {position * 1e3:.3f} mm "
            f"and {rotation * 1e3:.3f} mrad: "
            "a camera or the base was knocked"
        )
    if is_undone_later:
        return (
            f"from frame {frame} on strut {change.strut} is longer by {change.size * 1e3:+.4f} +- "
            f"{change.sigma * 1e3:.4f} mm, and returns: play"
        )
    cause = (
        "missed steps or a slipped joint"
        if change.kind == "strut"
        else "a knocked joint, the amount differs from pose to pose"
    )
    return (
        f"from frame {frame} on strut {change.strut} is longer by {change.size * 1e3:+.4f} +- "
        f"{change.sigma * 1e3:.4f} mm: {cause}"
    )


KINDS = 12  # signatures of an onset: six struts, six motions of the measuring frame against the base
REFUSED, QUIET, ALARM = 0, 1, 2  # what `learn` says
LEAST = MOVED[2]  # innovations squared below which no hypothesis of change_detection.py but a strut's can hold
SUMS = (
    1 + KINDS + KINDS * KINDS + 1
)  # per onset: innovation squared, its products with the signatures, the signatures' own, poses


class Pose(NamedTuple):
    """One pose to learn. number : from 0; command : (6,) m; R : (3, 3) and t : (3,) m, measured; covariance : (6, 6)
    tangent on the right;
    common : (6, c) factor of the errors that all poses share."""

    number: int
    command: Floats
    R: Floats
    t: Floats
    covariance: Floats
    common: Floats


class Machine(NamedTuple):
    """What does not change. home : (4, 4), where forward kinematics starts; variance : (6,) m^2 of each strut beyond
    the poses' covariance.
    """

    home: Floats
    variance: Floats


class Estimate(NamedTuple):
    """What the poses so far tell. p : (42,) m, parameters; s : (c,) shared draw; S : (c + 42, c + 43 + KINDS WINDOW)
    triangle, about p and s;
    sums : (WINDOW, SUMS), of the onset that began at each of the last poses."""

    p: Floats
    s: Floats
    S: Floats
    sums: Floats


@njit(cache=True)
def _absorb(S: Floats, rows: Floats) -> None:
    """Householder reflections: the upper triangle S (k, w) takes in rows (m, w), whose first k columns become zero."""
    k, width, m = S.shape[0], S.shape[1], rows.shape[0]
    dot = np.empty(width)
    for j in range(k):
        square = 0.0
        for i in range(m):
            square += rows[i, j] ** 2
        if square == 0.0:
            continue
        first = S[j, j]
        length = np.sqrt(first**2 + square)
        alpha = -length if first > 0 else length
        v = first - alpha
        beta = 2 / (v**2 + square)
        for c in range(j + 1, width):
            dot[c] = v * S[j, c]
        for i in range(m):
            f = rows[i, j]
            for c in range(j + 1, width):
                dot[c] += f * rows[i, c]
        for c in range(j + 1, width):
            dot[c] *= beta
            S[j, c] -= v * dot[c]
        for i in range(m):
            f = rows[i, j]
            for c in range(j + 1, width):
                rows[i, c] -= f * dot[c]
            rows[i, j] = 0.0
        S[j, j] = alpha


@njit(cache=True)
def _frame_motion(R: Floats, t: Floats, out: Floats) -> None:
    """Into out (6, 6): the pose's tangent on the right by the base's tangent on the left, at pose R (3, 3), t (3,)."""
    out[:] = 0.0
    for i in range(3):
        for k in range(3):
            out[i, k] = R[k, i]
            out[3 + i, 3 + k] = R[k, i]
        out[i, 3] = R[2, i] * t[1] - R[1, i] * t[2]
        out[i, 4] = R[0, i] * t[2] - R[2, i] * t[0]
        out[i, 5] = R[1, i] * t[0] - R[0, i] * t[1]


@njit(cache=True)
def add_triangular_solution_to_estimate(p: Floats, s: Floats, S: Floats) -> None:
    """Solve the triangle S for its step and add it to the estimate p (42,), s (c,), in place."""
    c = len(s)
    k = c + 42
    step = np.empty(k)
    for j in range(k - 1, -1, -1):
        total = S[j, k]
        for i in range(j + 1, k):
            total -= S[j, i] * step[i]
        step[j] = total / S[j, j]
        S[j, k] = 0.0
    for j in range(c):
        s[j] += step[j]
    for j in range(42):
        p[j] += step[c + j]


@njit(cache=True)
def add_pose_to_estimate_in_place(
    pose: Pose, machine: Machine, estimate: Estimate, onset_index: int, innovation: Floats, update_at_once: bool
) -> int:
    """Add one pose to the estimate in place.

    pose : Pose; machine : Machine; estimate : Estimate; onset_index : the onset that begins with this pose
    innovation : (6,) gets the whitened innovation; update_at_once : whether the estimate follows at once; otherwise z
        gathers, all poses about one p
    Returns a status: QUIET, ALARM, or REFUSED where it does not close
    """
    p, s, S, sums = estimate.p, estimate.s, estimate.S, estimate.sums
    c = len(s)
    k = c + 42
    R, t = machine.home[:3, :3].copy(), machine.home[:3, 3].copy()
    if not solve_pose_in_place_by_newton(pose.command, p, R, t):
        return REFUSED
    right, J, motion = np.empty((6, 7 + c)), np.zeros((6, 42)), np.empty((6, 6))
    _frame_motion(R, t, motion)
    for i in range(6):  # elements, not slices: numba would compile seconds of error messages
        for j in range(c):
            right[i, 1 + j] = pose.common[i, j]
        for j in range(6):
            right[i, 1 + c + j] = motion[i, j]
    well, struts = fill_whitened_pose_row(
        R, t, p, Measured(pose.R, pose.t, pose.covariance), machine.variance, right, J
    )
    if not well:
        return REFUSED
    _begin(S, sums, onset_index)
    rows = np.zeros((6, S.shape[1]))
    for i in range(6):
        rows[i, k] = right[i, 0]
        for j in range(c):
            rows[i, j] = right[i, 1 + j]
            rows[i, k] -= rows[i, j] * s[j]
        for j in range(42):
            rows[i, c + j] = J[i, j]
    for w in range(WINDOW):
        if sums[w, -1] > 0:
            at = k + 1 + KINDS * w
            for i in range(6):
                for j in range(6):
                    rows[i, at + j], rows[i, at + 6 + j] = struts[i, j], right[i, 1 + c + j]
    _absorb(S, rows)
    for i in range(6):
        innovation[i] = rows[i, k]
    _gather(rows, k, sums)
    if update_at_once:
        add_triangular_solution_to_estimate(p, s, S)
    return ALARM if _suspicious(sums) else QUIET


@njit(cache=True)
def _begin(S: Floats, sums: Floats, slot: int) -> None:
    """An onset begins in a slot: its KINDS columns of the triangle S (n, n) and its row of the sums (slots, ..) are
    nothing yet.
    """
    at = S.shape[0] + 1 + KINDS * slot
    S[:, at : at + KINDS] = 0.0
    sums[slot] = 0.0
    sums[slot, -1] = 1e-9  # begun


@njit(cache=True)
def _gather(rows: Floats, k: int, sums: Floats) -> None:
    """Add to every onset's sums (WINDOW, SUMS) what a pose's rows (6, w) tell of it: the innovation is their column
    k.
    """
    for w in range(WINDOW):
        if sums[w, -1] > 0:
            at = k + 1 + KINDS * w
            for i in range(6):
                nu = rows[i, k]
                sums[w, 0] += nu * nu
                for a in range(KINDS):
                    sums[w, 1 + a] += rows[i, at + a] * nu
                    for b in range(KINDS):
                        sums[w, 1 + KINDS + KINDS * a + b] += rows[i, at + a] * rows[i, at + b]
            sums[w, -1] += 1.0


@njit(cache=True)
def _suspicious(sums: Floats) -> bool:
    """Whether any onset's sums (WINDOW, SUMS) leave room for a change."""
    for w in range(WINDOW):
        if sums[w, -1] > 0:
            if sums[w, 0] > LEAST:
                return True
            for a in range(6):
                if sums[w, 1 + a] ** 2 > JUMP**2 * sums[w, 1 + KINDS + (KINDS + 1) * a]:
                    return True
    return False
