"""The profile of a move, by reports at uncertain moments, against the motion that made them."""

import numpy as np
import pytest

from rig.driving.controller_status_and_limits import PositionReport
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import MovingAxes
from rig.driving.move_profiles_and_path_check import move_profile_fitted_to_reports

SPEED = 0.02  # m/s
PROFILE = np.array([1, 0.5, -0.3, 0.2, 0.9, -1])


def reported(axes, until, lengths_at):
    """Reports every 12 ms or so, each read at some moment of the 1 to 3 ms that it takes."""
    rng, t, reports = np.random.default_rng(4), 9.9, []
    while t < until + 0.05:
        width = rng.uniform(0.001, 0.003)
        reports.append(PositionReport(t, t + width, lengths_at(t + width * rng.uniform())))
        t += width + 0.01
    return reports


@pytest.mark.parametrize(("far", "acceleration"), [(0.05, 0.5), (0.05, 0.1), (0.003, 0.1)])
def test_the_way_is_the_true_one_to_a_few_micrometres(far, acceleration):
    axes = MovingAxes(0.0, np.zeros(6), np.full(6, SPEED), np.full(6, acceleration))
    end = axes.go(10.0, far * PROFILE)
    found = move_profile_fitted_to_reports(np.zeros(6), far * PROFILE, reported(axes, end, axes.lengths_at), SPEED)
    t, share = np.array(found.travel).T
    times = np.linspace(10.0, end, 300)
    off = np.interp(times, t, share) * far - axes.lengths_at(times)[:, 0]
    assert np.sqrt((off**2).mean()) < 6e-6 and share[0] == 0 and share[-1] == 1
    assert np.abs(off).max() < SPEED * 0.003, "less than a report by itself may be off"


def test_what_follows_no_trapezoid_has_no_profile():
    axes = MovingAxes(0.0, np.zeros(6), np.full(6, SPEED), np.full(6, 0.1))
    end = axes.go(10.0, 0.05 * PROFILE)

    def held(t):  # a hold of half a second on the way
        return axes.lengths_at(min(t, 11.2) if t < 11.7 else t - 0.5)

    found = move_profile_fitted_to_reports(np.zeros(6), 0.05 * PROFILE, reported(axes, end + 0.5, held), SPEED)
    assert found.travel == () and found.rms > 1e-4
    assert move_profile_fitted_to_reports(np.zeros(6), 0.05 * PROFILE, [], SPEED).rms is None
    assert move_profile_fitted_to_reports(np.zeros(6), np.zeros(6), [], SPEED).travel == ()
