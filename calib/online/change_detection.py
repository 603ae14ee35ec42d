"""Detection of changes by likelihood ratio: of a strut's length, a joint, several struts or the frame.

Every hypothesis is held to the same innovations of the last poses: it must explain what is there beyond chance, and
what it leaves must be no more than noise. The simplest that does wins; where two equally simple ones do, the next pose
decides. What changed, and since which pose, is searched for: a ratio counts by the chance that the greatest of all that
were looked at is as great (Bonferroni's bound).
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri, ndtri

from rig.arrays import Floats

STRUTS, WINDOW = 6, 3  # the poses within which a change must show, each a possible onset
FALSE_ALARM = 2e-6  # at most, of a strut's jump at a quiet pose, over struts and onsets
FALSE_OTHER = 1.6e-7  # of the same for what has more freedom
LEFT = 1e-4  # share of true jumps whose poses agree no better with it
APART = 15.0  # of misfit by which the measuring frame's motion and jumps of several struts must differ to be told apart
DECIDES = 3  # poses from which the better of the two is taken, however little it is
CLEARLY = 9.0  # likelihood ratio that every pose must give a knocked joint
COUNTS = 4.0  # standard errors from which one strut of several counts as having jumped


def jump_threshold(false_alarm: float, onsets: int = WINDOW) -> float:
    """Threshold, in standard errors, of a strut's jump at one of `onsets` poses, for a `false_alarm` chance."""
    return float(-ndtri(false_alarm / (2 * STRUTS * onsets)))


def likelihood_ratio_thresholds(false_alarm: float, onsets: int = WINDOW) -> dict[int, float]:
    """{k: threshold of the likelihood ratio} of hypotheses with k numbers, for a `false_alarm` chance."""
    looks = (STRUTS + 2) * (onsets - 1)
    return {k: float(chdtri(k, false_alarm / looks)) for k in range(1, STRUTS + 1)}


JUMP = jump_threshold(FALSE_ALARM)
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
    """Changes detected in the last poses. evidence : Evidence of the last 1, 2, .. poses"""
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


def change_sentence(change: Change, frame: int, returns: bool = False) -> str:
    """Sentence about a change. frame : number of the first frame after it; returns : whether later changes undo it"""
    if not isinstance(change.size, float):
        position, rotation = (float((part**2).sum() ** 0.5) for part in (change.size[:3], change.size[3:]))
        return (
            f"from frame {frame} on the measured poses are moved against the base by {position * 1e3:.3f} mm "
            f"and {rotation * 1e3:.3f} mrad: "
            "a camera or the base was knocked"
        )
    if returns:
        return (
            f"from frame {frame} on strut {change.strut} is longer by {change.size * 1e3:+.4f} +- "
            f"{change.sigma * 1e3:.4f} mm, and goes back: play"
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
