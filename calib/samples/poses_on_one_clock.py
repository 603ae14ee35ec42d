"""Samples of poses whose exposures are brought onto the commands' clock."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.samples.exposure_conditions import conditions_of_exposures
from calib.samples.pose_samples import Sampled, Samples, tilt_readings
from rig.recording.recording_folder import Recording
from vision.camera_and_command_clocks import Clocks, clocks_of_recording, recording_with_clocks


def clocks_of_samples(recording: Recording, samples: Samples) -> tuple[Clocks, ...]:
    """Clocks of a recording by Samples of its poses; () where these are not whole poses."""
    if samples.measured != "pose":
        return ()
    return clocks_of_recording(recording, samples.frame, samples.T_base_platform, samples.covariance, samples.common)


def recording_and_poses_on_one_clock(
    recording: Recording, sampled: Sampled, clocks: Sequence[Clocks]
) -> tuple[Recording, Sampled]:
    """The Recording and its Sampled with exposures on the commands' clock, and commands as the axes follow them."""
    if not clocks:
        return recording, sampled
    recording, s = recording_with_clocks(recording, clocks), sampled.samples
    frames, t, commanded = recording.commanded()
    at = np.searchsorted(frames, s.frame)
    samples = replace(
        s,
        t=t[at],
        commanded=commanded[at],
        conditions=None if s.conditions is None else conditions_of_exposures(recording, t[at]),
        tilts=None if s.tilts is None else tilt_readings(recording, t[at]),
    )
    return recording, replace(sampled, samples=samples)
