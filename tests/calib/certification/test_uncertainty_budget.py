"""What cameras and lenses add to a pose makes up what all poses share, however much the two go together."""

from types import SimpleNamespace

import numpy as np
import pytest

from calib.certification.uncertainty_budget import (
    expanded_uncertainty_over_poses,
    pose_covariances_by_cameras_and_by_lenses,
    rms_position_and_rotation_uncertainty,
)


def test_cameras_and_lenses_make_up_what_is_shared():
    rng = np.random.default_rng(0)
    names = [("cam0", name) for name in ("x", "y", "z", "rx", "ry", "rz", "fx", "cx")]
    wide = np.linalg.cholesky(
        np.eye(8) + 0.9 * 50 * np.outer(*[np.r_[0, 0, 1, 0, 0, 0, 1, 0]] * 2)
    )  # z and focal length go together
    factor = np.r_[np.full(3, 1e-6), np.full(3, 1e-6), 1e-3, 1e-3][:, None] * wide
    gain = rng.normal(size=(40, 6, 8))
    gain[:, :, 6] = -1e-3 * gain[:, :, 2]  # and poses feel their difference alone
    common = gain @ factor
    measurement = SimpleNamespace(
        adjustment=SimpleNamespace(shared_factor=factor, shared_names=names, of_prints=np.zeros(len(names), bool))
    )
    cameras, lenses = pose_covariances_by_cameras_and_by_lenses([(SimpleNamespace(common=common), measurement)])
    whole = rms_position_and_rotation_uncertainty(common @ np.swapaxes(common, 1, 2))
    known = np.linalg.inv(np.linalg.inv(factor @ factor.T)[:6, :6])  # covariance of the places were the lens known
    assert rms_position_and_rotation_uncertainty(cameras) == pytest.approx(
        rms_position_and_rotation_uncertainty(gain[:, :, :6] @ known @ np.swapaxes(gain[:, :, :6], 1, 2)), rel=1e-6
    )
    assert (
        np.hypot(rms_position_and_rotation_uncertainty(cameras), rms_position_and_rotation_uncertainty(lenses))
        == pytest.approx(whole)
        and rms_position_and_rotation_uncertainty(lenses)[0] < whole[0]
    )
    assert pose_covariances_by_cameras_and_by_lenses([(SimpleNamespace(common=common), None)]) is None


@pytest.mark.parametrize("widths, k", [((1, 1, 1), 1.614), ((1, 0, 0), 1.960), ((1, 1, 0), 1.731), ((3, 1, 0.2), None)])
def test_an_expanded_uncertainty_covers_95_of_100_lengths(widths, k):
    covariance = np.zeros((40, 6, 6))
    covariance[:, :3, :3] = np.diag(np.square(widths, dtype=float))
    U = expanded_uncertainty_over_poses(covariance)
    assert k is None or U.k[0] == pytest.approx(k, abs=0.01)
    lengths = np.linalg.norm(np.random.default_rng(1).normal(size=(200_000, 3)) * widths, axis=1)
    assert np.mean(lengths <= U.position) == pytest.approx(0.95, abs=0.003), (
        "twice the RMS length would be 99.3 % of three directions"
    )


def test_poses_of_different_uncertainty_are_covered_at_large():
    covariance = np.tile(np.eye(6), (50, 1, 1)) * np.linspace(0.1, 9, 50)[:, None, None]
    lengths = np.linalg.norm(
        np.sqrt(np.repeat(np.linspace(0.1, 9, 50), 4000))[:, None] * np.random.default_rng(2).normal(size=(200_000, 3)),
        axis=1,
    )
    assert np.mean(lengths <= expanded_uncertainty_over_poses(covariance).position) == pytest.approx(0.95, abs=0.003)
