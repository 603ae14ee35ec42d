"""Wild rows: gross mistakes of measurement in a share of what was seen of a case, each by one of several laws."""

from dataclasses import replace

import numpy as np

from tests.truth.case import Case
from tests.truth.rigid import displaced, matrices, rows_of

SHARE = 0.05  # of the rows
JUMP = (5e-4, 5e-2)  # m, between which a jump is drawn; rad at a tenth of a metre
PIXELS = (3.0, 60.0)  # px, the same of the corners of one marker
LAWS = ("jump", "exchange", "flip", "stale", "unit")


def spoilt(case: Case, seed: int, share: float = SHARE) -> tuple[Case, np.ndarray, list[str]]:
    """(the case with wild rows, their frames (k,), the law of each) of a case without; share : of its frames, at least
    two

    An exchange spoils two frames. Where cameras look, a jump, a flip and a wrong unit are of one marker in one image,
    all else of whole frames.
    """
    rng = np.random.default_rng([case.seed, seed, 5])
    count = len(case.journey.looked)
    wanted, order = max(round(share * count), 2), rng.permutation(np.arange(1, count)).tolist()
    seen, done = case.seen.copy(), dict[int, str]()
    first = int(rng.integers(len(LAWS)))
    while len(done) < wanted:
        frame, law = order.pop(), LAWS[(first + len(done)) % len(LAWS)]
        law = "jump" if law == "exchange" and len(done) + 2 > wanted else law
        other = order.pop() if law == "exchange" else frame - 1
        seen = (_pose if case.camera_set is None else _corners)(seen, case, frame, other, law, rng)
        done |= {frame: law} | ({other: law} if law == "exchange" else {})
    frames = np.array(sorted(done))
    return replace(case, seen=seen), frames, [done[int(frame)] for frame in frames]


def _pose(seen: np.ndarray, case: Case, frame: int, other: int, law: str, rng: np.random.Generator) -> np.ndarray:
    """Poses (n, 6) with that of one frame spoilt, of two where it is an exchange. other : the frame it is exchanged
    with, or the one before it
    """
    seen = seen.copy()
    flat = case.kind == "planar2"  # whose rows tell where a point of the plane is
    if law == "exchange":
        seen[[frame, other]] = seen[[other, frame]]
    elif law == "stale":
        seen[frame] = seen[other]
    elif law == "jump" or flat and law == "flip":
        displacement = rng.normal(size=6) * ([1, 1, 0, 0, 0, 0] if flat else [1, 1, 1, 10, 10, 10])
        size = np.exp(rng.uniform(*np.log(JUMP))) / np.linalg.norm(displacement[:3])
        seen[frame] = rows_of(displaced(matrices(seen[frame]), size * displacement[None]))[0]
    elif law == "flip":
        turned = matrices(seen[frame])[0]
        axis = int(rng.integers(4))
        if axis == 3:
            turned[:3, :3] = turned[:3, :3].T
        else:
            turned[:3, :3] = turned[:3, :3] @ (2 * np.outer(np.eye(3)[axis], np.eye(3)[axis]) - np.eye(3))
        seen[frame] = rows_of(turned[None])[0]
    else:
        part, factor = [(slice(0, 3), 1e-3), (slice(0, 3), 0.0254), (slice(3, 6), float(np.radians(1)))][
            int(rng.integers(2 if flat else 3))
        ]
        seen[frame, part] *= factor
    return seen


def _corners(seen: np.ndarray, case: Case, frame: int, other: int, law: str, rng: np.random.Generator) -> np.ndarray:
    """Rows (k, 6) of corners with those of one frame spoilt, of two where it is an exchange."""
    here, other_rows = seen[:, 0] == frame, seen[:, 0] == other
    if law in ("exchange", "stale"):
        copied = np.where(np.arange(6) == 0, frame, seen[other_rows])
        left = np.where(np.arange(6) == 0, other, seen[here]) if law == "exchange" else seen[other_rows]
        return np.vstack([seen[~here & ~other_rows], copied, left])
    seen = seen.copy()
    one = rng.choice(np.flatnonzero(here))
    own = np.flatnonzero(here & (seen[:, 1:3] == seen[one, 1:3]).all(axis=1))
    if law == "jump":
        angle = rng.uniform(0, 2 * np.pi)
        seen[own, 4:] += np.exp(rng.uniform(*np.log(PIXELS))) * np.array([np.cos(angle), np.sin(angle)])
    elif law == "flip":
        seen[own, 4:] = np.roll(seen[own, 4:], int(rng.integers(1, 4)), axis=0)
    else:
        seen[own, 4:] *= 0.5  # read off an image of half the size
    return seen
