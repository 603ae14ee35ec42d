"""Tilt sensors on a platform: its poses improve by what they tell, and are as uncertain as is then stated."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calib.samples.freely_placed_instrument_poses_combined_with_tilts import poses_with_platform_tilts
from rig.errors import RigError
from rig.model.base_and_link_tilt_sensors import TiltReadings, TiltSensor
from rig.model.pose import exp, pose_difference

ROTATION, POSITION, TILT, SHARED = 3e-4, 5e-5, 3e-5, 2e-4
COUNT = 40


def measured(seed, wild=()):
    """(true poses, measured ones, own covariance, common factor, readings) of a platform that tilts to and fro."""
    rng = np.random.default_rng(seed)
    true = RigidTransform.from_components(
        rng.uniform(-0.1, 0.1, (COUNT, 3)), Rotation.from_rotvec(rng.normal(0, 0.15, (COUNT, 3)))
    )
    own = np.tile(np.diag(np.repeat([POSITION**2, ROTATION**2], 3)), (COUNT, 1, 1))
    own[:, 0, 4] = own[:, 4, 0] = 0.6 * POSITION * ROTATION  # a platform that seems turned seems displaced
    common = np.tile(np.r_[np.zeros(3), SHARED, 0.0, 0.0][:, None], (COUNT, 1, 1))
    error = np.einsum("nij,nj->ni", np.linalg.cholesky(own), rng.normal(size=(COUNT, 6))) + common @ rng.normal(size=1)
    sensor = TiltSensor("level", 1, TILT, np.array([0.0, 0.0, 0.3]), 0.01)
    mount = Rotation.from_rotvec(sensor.mount) * Rotation.from_rotvec(rng.normal(0, 0.01, 3))
    axes = (true.rotation * mount).as_matrix()  # by a pendulum: the sine of an angle is what the axis has of up
    angles = np.arcsin(axes[:, 2, :2]) + TILT * rng.normal(size=(COUNT, 2))
    angles[list(wild)] += 0.02
    down = np.tile([0.0, 0.0, -1.0], (COUNT, 1))
    return true, true * exp(-error), own, common, TiltReadings((sensor,), angles[:, None], down)


def test_the_error_of_poses_shrinks_to_what_is_stated():
    scores, gains = [], []
    for seed in range(40):
        true, T, own, common, readings = measured(seed)
        found, left, shared = poses_with_platform_tilts(readings, T, own, common)
        total = left + shared @ np.swapaxes(shared, 1, 2)
        error = pose_difference(found, true)
        scores.append((error**2).mean(axis=0) / np.einsum("nii->ni", total).mean(axis=0))
        before = pose_difference(T, true)
        gains.append(np.sqrt((before[:, 3:5] ** 2).mean() / (error[:, 3:5] ** 2).mean()))
    print(np.mean(scores, axis=0).round(2), np.median(gains).round(2))
    assert np.abs(np.mean(scores, axis=0) - 1).max() < 0.35 and np.median(gains) > 2


def test_a_wild_reading_does_not_count():
    true, T, own, common, readings = measured(50, wild=(3, 17))
    found, left, _ = poses_with_platform_tilts(readings, T, own, common)
    np.testing.assert_allclose(left[3], own[3], rtol=1e-3, atol=1e-15)
    error = pose_difference(found, true)
    assert np.abs(error[[3, 17], 3:5]).max() < 5 * ROTATION


def test_a_sensor_that_scatters_counts_for_less():
    _, T, own, common, readings = measured(51)
    rough = readings.angles + np.random.default_rng(1).normal(0, 3e-3, readings.angles.shape)
    left = poses_with_platform_tilts(TiltReadings(readings.sensors, rough, readings.down), T, own, common)[1]
    assert left[:, 3, 3].mean() > 0.8 * ROTATION**2


def test_where_positions_alone_were_measured_they_are_refused():
    _, T, own, common, readings = measured(52)
    with pytest.raises(RigError, match="measures a position alone"):
        poses_with_platform_tilts(readings, T, own, common, "position")
