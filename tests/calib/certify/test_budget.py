"""What cameras and lenses add to a pose makes up what all poses share, however much the two go together."""

from types import SimpleNamespace

import numpy as np
import pytest

from calib.certify.budget import by_part, rms


def test_cameras_and_lenses_make_up_what_is_shared():
    rng = np.random.default_rng(0)
    names = [("cam0", name) for name in ("x", "y", "z", "rx", "ry", "rz", "fx", "cx")]
    wide = np.linalg.cholesky(np.eye(8) + 0.9 * 50 * np.outer(*[np.r_[0, 0, 1, 0, 0, 0, 1, 0]] * 2))  # z and focal length go together
    factor = np.r_[np.full(3, 1e-6), np.full(3, 1e-6), 1e-3, 1e-3][:, None] * wide
    gain = rng.normal(size=(40, 6, 8))
    gain[:, :, 6] = -1e-3 * gain[:, :, 2]  # and poses feel their difference alone
    common = gain @ factor
    measurement = SimpleNamespace(adjustment=SimpleNamespace(shared_factor=factor, shared_names=names, of_prints=np.zeros(len(names), bool)))
    cameras, lenses = by_part([(SimpleNamespace(common=common), measurement)])
    whole = rms(common @ np.swapaxes(common, 1, 2))
    known = np.linalg.inv(np.linalg.inv(factor @ factor.T)[:6, :6])  # covariance of the places were the lens known
    assert cameras == pytest.approx(rms(gain[:, :, :6] @ known @ np.swapaxes(gain[:, :, :6], 1, 2)), rel=1e-6)
    assert np.hypot(cameras, lenses) == pytest.approx(whole) and lenses[0] < whole[0]
    assert by_part([(SimpleNamespace(common=common), None)]) == (None, None)
