"""Quiet innovations are called a change as seldom as stated, over all struts and onsets that are looked at."""

import numpy as np
import pytest
from scipy.special import ndtri

from calib.online import information_filter_kernels_and_change_detection
from calib.online.information_filter_kernels_and_change_detection import (
    WINDOW,
    Evidence,
    detect_changes,
    likelihood_ratio_thresholds,
    strut_jump_threshold,
)

ALARM, TRIALS = 0.02, 3000


def quiet(rng):
    """Evidence of the last 1 .. WINDOW poses of a machine that does not change."""
    S = rng.normal(size=(WINDOW, 6, 12))
    e = rng.normal(size=(WINDOW, 6))
    out = []
    for poses in range(1, WINDOW + 1):
        s, r = S[-poses:], e[-poses:]
        single = np.stack([np.einsum("fia,fi->fa", s[..., :6], r), (s[..., :6] ** 2).sum(axis=1)], axis=1)
        out.append(
            Evidence(0, float((r**2).sum()), np.einsum("fia,fi->a", s, r), np.einsum("fia,fib->ab", s, s), single)
        )
    return out


def jumps(evidence):
    """Standard errors of the greatest jump of one strut since any onset."""
    return max(np.abs(e.projected[:6] / np.sqrt(np.diag(e.gram)[:6])).max() for e in evidence)


def test_the_search_over_struts_and_onsets_is_paid_for():
    rng = np.random.default_rng(0)
    greatest = np.array([jumps(quiet(rng)) for _ in range(TRIALS)])
    rate = (greatest > strut_jump_threshold(ALARM)).mean()
    assert ALARM / 3 < rate < ALARM + 3 * np.sqrt(ALARM / TRIALS), "the bound is not far above what there is"
    assert (greatest > -ndtri(ALARM / 2)).mean() > 5 * ALARM, (
        "one look's threshold would be exceeded many times as often"
    )


def test_quiet_poses_are_no_change(monkeypatch):
    monkeypatch.setattr(information_filter_kernels_and_change_detection, "JUMP", strut_jump_threshold(ALARM / 2))
    monkeypatch.setattr(
        information_filter_kernels_and_change_detection, "MOVED", likelihood_ratio_thresholds(ALARM / 2)
    )
    rng = np.random.default_rng(1)
    assert np.mean([bool(detect_changes(quiet(rng))) for _ in range(TRIALS)]) < ALARM + 3 * np.sqrt(ALARM / TRIALS)


def test_thresholds_grow_with_what_is_looked_at():
    assert strut_jump_threshold(1e-6, 10) > strut_jump_threshold(1e-6, 3) > strut_jump_threshold(1e-5, 3)
    assert likelihood_ratio_thresholds(1e-6, 10)[3] > likelihood_ratio_thresholds(1e-6, 3)[3]
    assert pytest.approx((5.31, 48.36), abs=0.01) == (
        information_filter_kernels_and_change_detection.JUMP,
        information_filter_kernels_and_change_detection.MOVED[6],
    )
