"""How struts go from place to place."""

import numpy as np
import pytest

from rig.driving.move_profiles_and_path_check import trapezoidal_profile


@pytest.mark.parametrize(
    ("cruise", "ramp", "whole"),
    [(1.0, 0.2, 1.2), (1.0, 0.2, 1.5), (0.01, 0.2, 0.3), (1.0, None, 1.3), (1.0, None, 1.0), (1.0, 0.0, 1.1)],
)
def test_a_trapezoid_moves_evenly_and_arrives(cruise, ramp, whole):
    profile = trapezoidal_profile(5.0, 5.0 + whole, cruise, ramp)
    t, share = np.array([(5.0, 0.0), *profile, (5.0 + whole, 1.0)]).T
    assert (np.diff(t) > 0).all() and (np.diff(share) >= 0).all()
    if ramp is None:
        ramp = whole - cruise
    moving = cruise + ramp if ramp < cruise else 2 * np.sqrt(ramp * cruise)
    fine = np.linspace(0, moving, 4001)
    peak = 1 / cruise if ramp < cruise else 2 / moving
    rise = ramp if ramp < cruise else moving / 2
    speed = peak * np.clip(np.minimum(fine, moving - fine) / max(rise, 1e-12), 0, 1)
    exact = np.r_[0, np.cumsum((speed[1:] + speed[:-1]) / 2) * fine[1]]
    assert np.abs(np.interp(5.0 + fine, t, share) - exact).max() < (rise / moving) / 400 + 1e-3
