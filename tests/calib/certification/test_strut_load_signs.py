"""Signs of struts' loads, against static balance written out, and claims where joints have a clearance."""

from dataclasses import replace

import numpy as np
import pytest

from calib.certification.strut_deviation_covariance_functions_by_cause import (
    PLACES,
    strut_load_signs_with_sign_mean_and_variance,
)
from calib.samples.exposure_conditions import Conditions, Weight
from rig.errors import NotConverged
from rig.model.mechanisms import hexapod
from rig.planning.configuration_generators import evenly_spread_configurations
from tests.calib.certification.test_left_out import calibrated, driven
from tests.calib.noisy_samples import rms, sampled


def test_signs_are_those_of_struts_in_balance(design):
    samples, _ = sampled(design, 3, 60)
    n, m, centre = len(samples), design.mechanism, np.array([0.0, 0.4, 0.3])  # so far out that some struts pull
    known = Conditions(np.zeros((n, 6)), samples.t, {}, Weight(np.array([0, 0, -9.81]), 5.0, centre, None))
    found = strut_load_signs_with_sign_mean_and_variance(replace(samples, conditions=known), m)
    assert sum(one is not None for one in found) > 0
    T = samples.T_base_platform.as_matrix()
    arms = m.platform_joints @ np.swapaxes(T[:, :3, :3], 1, 2)
    along = arms + T[:, None, :3, 3] - m.base_joints
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    balance = np.swapaxes(np.concatenate([along, np.cross(arms, along)], axis=2), 1, 2)
    weight = np.array([0, 0, -9.81 * 5.0])
    moment = np.cross(T[:, :3, :3] @ centre, weight)
    loads = np.linalg.solve(
        balance, -np.concatenate([np.broadcast_to(weight, moment.shape), moment], axis=1)[..., None]
    )[..., 0]
    for i, one in enumerate(found):
        if one is not None:
            np.testing.assert_array_equal(one[0], np.sign(loads[:, i]))
    middle, half = m.strut_range.mean(axis=1), np.ptp(m.strut_range, axis=1) / 2
    at = next(one for one in found if one is not None)[1]((hexapod.inverse(samples.T_base_platform, m) - middle) / half)
    np.testing.assert_array_equal(np.abs(at[0]), 1)
    np.testing.assert_array_equal(at[1], 0)


def test_without_gravity_or_where_every_strut_pushes_there_is_no_sign(design):
    samples, _ = sampled(design, 3, 30)
    n = len(samples)
    assert strut_load_signs_with_sign_mean_and_variance(samples, design.mechanism) == [None] * 6
    known = Conditions(np.zeros((n, 6)), samples.t, {}, Weight(np.array([0, 0, -9.81]), None, None, None))
    T = samples.T_base_platform
    pushing = hexapod.axis_forces_and_torques(
        T, samples.effective, design.mechanism, known.weight.wrench(T, np.zeros(n))
    )
    for i, one in enumerate(
        strut_load_signs_with_sign_mean_and_variance(replace(samples, conditions=known), design.mechanism)
    ):
        assert one is not None or (pushing[:, i] > 0).all() or (pushing[:, i] < 0).all()


@pytest.mark.slow
def test_a_claim_holds_where_joints_have_a_clearance_and_names_the_load(tmp_path):
    """Ladders show each strut's change of sides in few poses."""
    of, calibration, claim, _ = calibrated(tmp_path / "rec", 0, "joint_clearance", "strong", "ladders")
    assert "the sign of its load" in claim.unexplained[0]
    assert 0.97 * claim.after[0][1] <= rms(driven(of, calibration)[0])[0] <= 1.03 * claim.after[0][2]


def test_travels_whose_corners_close_on_no_pose(design):
    """An owner's strut_range may reach where no platform holds the struts: those places have no sign, and no error."""
    samples, _ = sampled(design, 3, 60)
    n, m = len(samples), design.mechanism
    middle, half = m.strut_range.mean(axis=1), np.ptp(m.strut_range, axis=1) / 2
    wide = replace(m, strut_range=np.stack([middle - 2.4 * half, middle + 2.4 * half], axis=1))
    assert 0 < len(refused(wide)) < len(evenly_spread_configurations(wide, PLACES))
    known = Conditions(
        np.zeros((n, 6)), samples.t, {}, Weight(np.array([0, 0, -9.81]), 5.0, np.array([0, 0.4, 0.3]), None)
    )
    for one in strut_load_signs_with_sign_mean_and_variance(replace(samples, conditions=known), wide):
        if one is not None:
            mean, variance = one[1]((evenly_spread_configurations(wide, PLACES) - middle) / (2.4 * half))
            assert set(mean[refused(wide)]) <= {0.0} and set(variance[refused(wide)]) <= {1.0}


def refused(m):
    """Indices of the places looked at that close on no pose."""
    try:
        hexapod.forward(evenly_spread_configurations(m, PLACES), m)
    except NotConverged as error:
        return error.index
    return []
