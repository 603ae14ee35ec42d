"""A claim states the conditions that its recording leaves it: the side from which poses were approached, and where
poses were recorded.
"""

from dataclasses import replace

import numpy as np
import pytest

import calib
import rig
from calib.api.calibrate import CalibrateOptions
from rig.report.verdict_refutations_and_result_display import Verdict
from tests import truth
from tests.truth.journey import Journey, journey, middle, spread
from tests.truth.rigid import displaced, rows_of

POSES = 80


def recorded(folder, approach="both", first=(0.0, 1.0)):
    """Verdict on a calibration of a sound machine. approach : "both" or "below", the side from which each axis comes to
    each pose; first : (least, greatest) of the first strut's unit range
    """
    case = truth.draw(7, "none", "none", "shuffled", count=POSES)
    rng = np.random.default_rng(3)
    unit = rng.permutation(spread(6, POSES, rng))
    unit[:, 0] = first[0] + (first[1] - first[0]) * unit[:, 0]
    places = middle(case.owner.ranges, unit)
    side = -1.0 if approach == "below" else rng.choice([-1.0, 1.0], places.shape)
    before = places + side * 0.05 * np.ptp(case.owner.ranges, axis=1)
    stops = np.stack([before, places], axis=1).reshape(-1, 6)
    path = journey(stops, case.owner.ranges.mean(axis=1), case.speeds, case.dwell)
    path = Journey(path.t, path.values, path.looked[1::2])
    stood = truth.laws.stood(case.machine, path, case.day, ())
    seen = rows_of(displaced(stood, rng.normal(size=(POSES, 6)) * np.repeat(case.sigma, 3)))
    truth.record(replace(case, journey=path, seen=seen), folder)
    return calib.calibrate(rig.load(folder), CalibrateOptions(quick=True)).verdict


def doubts(verdict: Verdict, text: str) -> list[str]:
    return [line for line in verdict.rests_on if text in line]


def test_a_claim_from_one_side_holds_for_poses_approached_from_it(tmp_path):
    assert not doubts(recorded(tmp_path / "both"), "approached")
    assert doubts(recorded(tmp_path / "below", "below"), "approached as recorded, from one side on struts 1-6")


@pytest.mark.parametrize("first, missed", [((0.0, 1.0), ""), ((0.0, 0.5), "above the greatest of strut 1")])
def test_a_claim_names_where_the_workspace_has_no_poses(tmp_path, first, missed):
    found = doubts(recorded(tmp_path / "rec", first=first), "beyond the recorded poses")
    assert missed in found[0] if missed else not found, found
