"""The promise is kept on fresh rigs, and guarded decisions are right."""

import numpy as np
import pytest

from calib.certify.conformity import CONFORMS, FAILS, OPEN, judged
from calib.certify.promise import Bound
from tests.calib.statement.trials import share_kept, trial, wrong_decisions


def test_a_few_rigs_keep_what_is_promised(design):
    trials = [trial(design, seed) for seed in (2, 11)]
    assert share_kept(trials) == 1 and wrong_decisions(trials) == 0
    assert {len(t.effects) for t in trials} >= {0, 1}
    for t in trials:
        assert all(0.9 * p <= m for p, m in zip(t.promise, t.measured)) or not t.effects
        if t.effects:
            assert t.promise[0] < 2 * t.true[0]


def test_decisions_keep_a_guard_band():
    bound = Bound(10.0, 8.0, 13.0, 14.0, 0.0, 0.0)
    assert [judged("position", value, bound).verdict for value in (13.1, 12.9, 10.0, 8.1, 7.9)] == [CONFORMS, OPEN, OPEN, OPEN, FAILS]
    assert judged("position", 1.0, bound).guard == pytest.approx(3.0)


@pytest.mark.slow
def test_three_hundred_rigs(design):
    trials = [trial(design, seed) for seed in range(300)]
    assert 0.93 <= share_kept(trials) <= 0.99
    for k in range(2):
        assert np.mean([t.kept[k] for t in trials]) >= 0.93
    decided = [t for t in trials if t.verdict[0]]
    assert wrong_decisions(trials) <= 0.025 * 2 * len(decided)
