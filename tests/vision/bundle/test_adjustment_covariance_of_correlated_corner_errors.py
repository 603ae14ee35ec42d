"""Measured poses and cameras scatter as their covariance says under corner errors that no effect explains; sound
recordings are measured to the last bit as by equal and independent errors.
"""

from dataclasses import replace

import numpy as np
import pytest

from rig.model.pose import pose_difference
from synthetic.unlisted_effects_and_corner_noise import DISTURBANCES, _add_air_shimmer, _add_shaken_frames
from tests.vision.drawn_observations import scene, standing
from tests.vision.test_recording_adjustment_with_hand_and_stages import joint_chi2
from vision import recording_adjustment_with_hand_and_stages as recording_adjustment
from vision.bundle.adjustment_cross_validation_and_determined_unknowns import crossvalidate_adjustment
from vision.marker_corner_prediction import marker_map
from vision.recording_adjustment_with_hand_and_stages import measure_observations

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
    monkeypatch.setattr(
        recording_adjustment, "adjustment_with_correlated_error_covariance", lambda _, adjustment, own: adjustment
    )
    plain, _ = measured(design, None, 12)
    assert (found.covariance == plain.covariance).all() and (found.common == plain.common).all()
    assert (found.adjustment.shared_factor == plain.adjustment.shared_factor).all()


def test_air_counts_in_poses_and_in_what_frames_share(design, monkeypatch):
    found, _ = measured(design, _add_air_shimmer, 13)
    monkeypatch.setattr(
        recording_adjustment, "adjustment_with_correlated_error_covariance", lambda _, adjustment, own: adjustment
    )
    plain, errors = measured(design, _add_air_shimmer, 13)
    assert joint_chi2(plain, errors) / errors.size > 2
    assert (found.T_base_platform.as_matrix() == plain.T_base_platform.as_matrix()).all()
    shared, before = (np.diag(m.adjustment.shared_covariance) for m in (found, plain))
    assert np.median(shared / before) > 1.5


def wavy_lens(corners, design, noise, rng):
    """Corners seen by one camera through a pane whose surface is wavy: no polynomial, and the same in every frame."""
    own = np.array(corners.camera) == design.cameras[1].name
    phase, wave = rng.uniform(0, 2 * np.pi, (2, 2)), 2 * np.pi / (1.5 * design.cameras[1].width)
    u, v = corners.uv.T
    shift = np.stack([np.sin(wave * u + phase[0, k]) * np.cos(wave * v + phase[1, k]) for k in range(2)], axis=1)
    return replace(corners, uv=corners.uv + 5 * noise * own[:, None] * shift)


def test_a_lens_that_is_not_as_adjusted_counts_in_poses(design):
    """Poses scatter by what is stated, as they would not without it, and the camera is named."""
    ratios = []
    for seed in range(4):
        found, errors = measured(design, wavy_lens, 20 + seed)
        ratios.append(joint_chi2(found, errors) / errors.size)
        sizes = found.adjustment.common_image_errors
        assert len(sizes) == len(design.cameras) and np.argmax(sizes) == 1 and sizes[1] > NOISE / 2, seed
    assert max(ratios) < 2 and np.median(ratios) < 1.4


def test_held_out_frames_are_asked_of_corners_with_errors_of_their_own(design):
    """Corners of the base that err alike in every frame are weighed for that, and leave next to nothing."""
    rng = np.random.default_rng(31)
    observations, stated, _, _ = scene(design, 31, frames=FRAMES, noise=NOISE)
    found = measure_observations(standing(observations, rng, 2 * NOISE), stated, marker_map(stated))
    own = found.own_errors()
    assert not own.all() and found.standing > NOISE
    held = crossvalidate_adjustment(found.used(), found.adjustment, own)
    assert abs(held.ratio - 1) < max(3 * held.scatter, 0.05) and held.corners == own.sum()
    assert crossvalidate_adjustment(found.used(), found.adjustment).ratio < 0.9
