"""Measured poses and cameras scatter as their covariance says under corner errors that no effect explains; sound
recordings are measured to the last bit as by equal and independent errors.
"""

import numpy as np
import pytest

from rig.model.pose import pose_difference
from synthetic.unlisted_effects_and_corner_noise import DISTURBANCES, _add_air_shimmer, _add_shaken_frames
from tests.vision.drawn_observations import scene
from tests.vision.test_recording_adjustment import joint_chi2
from vision import recording_adjustment
from vision.predict import marker_map
from vision.recording_adjustment import measure_observations

NOISE = 0.04  # px
FRAMES = 60


def measured(design, disturb, seed):
    """(Measurement, errors (f, 6) of its poses) of a recording whose corners something disturbs, None for nothing."""
    rng = np.random.default_rng(seed)
    spoil = None if disturb is None else lambda corners: disturb(corners, design, NOISE, rng)
    observations, stated, _, T = scene(design, seed, frames=FRAMES, noise=NOISE, spoil=spoil)
    found = measure_observations(observations, stated, marker_map(stated))
    return found, pose_difference(T[found.frames], found.T_base_platform)


@pytest.mark.parametrize("disturb", DISTURBANCES, ids=lambda disturb: disturb.__name__.removeprefix("_add_"))
def test_poses_scatter_as_their_covariance_says(design, disturb):
    found, errors = measured(design, disturb, 11)
    # of a shaken frame only the corners within the gate are left to tell of its errors
    assert 0.75 < joint_chi2(found, errors) / errors.size < (2.0 if disturb is _add_shaken_frames else 1.4)


def test_sound_recordings_are_measured_as_by_equal_and_independent_errors(design, monkeypatch):
    found, _ = measured(design, None, 12)
    monkeypatch.setattr(recording_adjustment, "with_covariance_of_unlike_errors", lambda _, adjustment, own: adjustment)
    plain, _ = measured(design, None, 12)
    assert (found.covariance == plain.covariance).all() and (found.common == plain.common).all()
    assert (found.adjustment.shared_factor == plain.adjustment.shared_factor).all()


def test_air_counts_in_poses_and_in_what_frames_share(design, monkeypatch):
    found, _ = measured(design, _add_air_shimmer, 13)
    monkeypatch.setattr(recording_adjustment, "with_covariance_of_unlike_errors", lambda _, adjustment, own: adjustment)
    plain, errors = measured(design, _add_air_shimmer, 13)
    assert joint_chi2(plain, errors) / errors.size > 2
    assert (found.T_base_platform.as_matrix() == plain.T_base_platform.as_matrix()).all()
    shared, before = (np.diag(m.adjustment.shared_covariance) for m in (found, plain))
    assert np.median(shared / before) > 1.5
