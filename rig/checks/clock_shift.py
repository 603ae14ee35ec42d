"""Two clocks held against each other: by how much frames are to be moved so that they were taken while the commands
stood still.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rig.checks.user_mistake import Mistake

FEWEST = 5  # frames and dwells by which two clocks are told
SHARE = 0.95  # of the frames, that must come to lie in dwells
APART = 0.9  # share of the best count, above which another place would be as good
NOW = 0.9  # of the frames, that stand as they are timed: then nothing is asked of clocks
LAG = 0.5  # s; clocks that differ by less are an effect, not a mistake
STILL = 1e-3  # of the fastest move: slower is standing, as what logs read back never stands to the last digit
MOST_PAIRS = 4_000_000


@dataclass(frozen=True, slots=True)
class Standing:
    """shift : s to add to frames; room : s, half the width of the shifts that serve as well; frames : how many then lie
    in a dwell.
    """

    shift: float
    room: float
    frames: int


def standing_shift(frames: np.ndarray, t: np.ndarray, values: np.ndarray) -> Standing | None:
    """Standing that puts the most frames into dwells of the commands, or None where no shift stands out.

    frames : (m,) s; t : (n,) s of the commands, increasing; values : (n, axes) m or rad
    """
    dwells = _dwells(t, values)
    if min(len(frames), len(dwells)) < FEWEST or len(frames) * len(dwells) > MOST_PAIRS:
        return None
    at = np.concatenate(
        [np.subtract.outer(dwells[:, 0], frames).ravel(), np.subtract.outer(dwells[:, 1], frames).ravel()]
    )
    step = np.repeat([1, -1], len(at) // 2)
    order = np.lexsort((-step, at))  # a dwell begins before another ends at the same shift
    at, count = at[order], np.cumsum(step[order])
    best = int(count.argmax())
    low, high = at[best], at[best + 1]
    far = (at < low - (dwells[:, 1] - dwells[:, 0]).max()) | (at > high + (dwells[:, 1] - dwells[:, 0]).max())
    if count[best] < SHARE * len(frames) or count[far].max(initial=0) > APART * count[best]:
        return None
    return Standing(float(low + high) / 2, float(high - low) / 2, int(count[best]))


def clock_offset_mistake(frames: np.ndarray, t: np.ndarray, values: np.ndarray) -> Iterator[Mistake]:
    """The Mistake of clocks that differ though they overlap: frames taken while axes moved, which another offset puts
    where they stand.

    frames : (m,) s; t : (n,) s of the commands; values : (n, axes) m or rad
    """
    dwells = _dwells(t, values)
    if not len(dwells):
        return
    row = np.searchsorted(dwells[:, 0], frames, side="right") - 1
    now = int(((row >= 0) & ((frames <= dwells[row, 1]) | (frames >= t[-1]))).sum())
    if now >= NOW * len(frames):
        return
    found = standing_shift(frames, t, values)
    if found is None or abs(found.shift) <= LAG:
        return
    way = "behind" if found.shift > 0 else "ahead of"
    yield Mistake(
        f"frames.csv: the frames' clock is {abs(found.shift):.4g} s {way} the commands' (+-{found.room:.2g} "
        f"s): {found.frames} of "
        f"{len(frames)} frames were then taken while the commands stand still, as it stands {now}",
        f"{'Add' if found.shift > 0 else 'Subtract'} {abs(found.shift):.4g} s to t of frames.csv (rig import --set "
        f"images.shift={found.shift:.3f}, or poses.shift), or log both by one clock",
        proof=0.9,
    )


def _dwells(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(k, 2) s: from when to when the commands stand."""
    apart = np.diff(t)
    speed = np.abs(np.diff(values, axis=0)).max(axis=1) / np.where(apart > 0, apart, np.inf)
    still = np.concatenate([[False], speed <= STILL * speed.max(initial=0.0), [False]])
    edges = np.flatnonzero(still[1:] != still[:-1])
    return t[edges].reshape(-1, 2)
