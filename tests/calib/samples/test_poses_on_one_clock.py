"""Samples whose exposures are brought onto the commands' clock stand where their commands are at that moment."""

import numpy as np

from calib.samples.commanded_and_measured_pose_samples import sample_recording
from calib.samples.position_confounds_and_poses_on_one_clock import (
    estimate_clocks_from_samples,
    recording_and_poses_on_commands_clock,
)
from rig.recording.recording_folder import load_recording
from tests.moving_run import write_moving_recording

OFFSET, SPEED = 0.0073, 0.02  # s, m/s


def test_commands_are_taken_when_the_exposures_truly_were(tmp_path):
    _, lengths = write_moving_recording(tmp_path, OFFSET, np.array([0.0, 0.021, 0.013]), SPEED)
    recording = load_recording(tmp_path)
    sampled = sample_recording(recording)
    moved, message = recording_and_poses_on_commands_clock(
        recording, sampled, estimate_clocks_from_samples(recording, sampled.samples)
    )
    wanted = lengths[sampled.samples.frame]
    before, after = (np.abs(one.samples.commanded - wanted).max(axis=1) for one in (sampled, message))
    assert np.median(before) > 0.9 * OFFSET * SPEED and after.max() < 2e-4 * SPEED
    np.testing.assert_allclose(message.samples.t - sampled.samples.t, OFFSET, atol=2e-4)
    np.testing.assert_allclose(moved.exposures.t - recording.exposures.t, OFFSET, atol=2e-4)
    assert (message.samples.conditions.t == message.samples.t).all()
    assert recording_and_poses_on_commands_clock(recording, sampled, ()) == (recording, sampled)
