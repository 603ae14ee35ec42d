"""The benchmark of exposures in motion, on a shorter run."""

import pytest

from tests.bench.exposures_in_motion import outcome


@pytest.mark.slow
def test_in_motion_poses_and_calibration_are_as_good_as_at_rest(tmp_path):
    found = outcome(tmp_path, "sobol:20")
    assert found.poses > 200
    for (moving, turned), (standing, turning) in (found.measured, found.reached):
        assert moving <= 1.5 * standing and turned <= 1.5 * turning
    assert abs(found.offset - found.wanted) <= 2e-4
