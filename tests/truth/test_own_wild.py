"""Wild rows of the instrument of truth: as many as wanted, each off by more than any noise, all else as it was."""

import numpy as np
import pytest

from tests.truth import draw, errors, matrices
from tests.truth.wild import LAWS, SHARE, spoilt


@pytest.mark.parametrize("kind", ["hexapod", "arm", "planar2"])
def test_all_but_a_share_of_poses_stay(kind):
    names = set()
    for seed in range(8):
        case = draw(seed, "none", "none", "shuffled", kind, 80)
        bad, frames, laws = spoilt(case, seed)
        changed = np.flatnonzero((bad.seen != case.seen).any(axis=1))
        assert changed.tolist() == frames.tolist() and len(frames) == round(SHARE * 80) == len(laws)
        off = np.abs(errors(matrices(bad.seen[changed]), matrices(case.seen[changed])))
        assert (off > 20 * np.repeat(case.sigma, 3)).any(axis=1).all()
        redrawn, _, _ = spoilt(case, seed)
        assert np.array_equal(redrawn.seen, bad.seen)
        names |= set(laws)
    assert names == set(LAWS)


def test_corners_of_all_other_frames_stay():
    for seed in range(3):
        case = draw(seed, "none", "none", "shuffled", count=20, seen=True)
        bad, frames, _ = spoilt(case, seed)
        rows = [{tuple(row) for row in seen[~np.isin(seen[:, 0], frames)]} for seen in (case.seen, bad.seen)]
        assert rows[0] == rows[1]
        for frame in frames:
            assert {tuple(row) for row in case.seen[case.seen[:, 0] == frame]} != {
                tuple(row) for row in bad.seen[bad.seen[:, 0] == frame]
            }
