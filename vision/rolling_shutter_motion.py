"""Rolling shutter motion, taken out of poses.

Motion of the platform while a rolling shutter reads an image row by row.

A corner in row v is exposed (v - height / 2) * row_time after its frame's time, and the platform has moved on by then,
at the rate that commands state. Where it speeds up, this rate depends on the clocks of cameras and commands and on the
lag of the drives, which nobody knows yet: what they may make of it is in the covariance of the pose.
"""

from dataclasses import dataclass, replace

import numpy as np

from rig.array_and_json_types import Floats
from rig.model.design import Design
from rig.model.motion_simulation import simulate_machine_run
from rig.model.pose import exp
from rig.recording.recording_folder import Recording
from vision.corner_observations import Observations
from vision.recording_adjustment import Measurement

ABOUT = 0.02  # s; a platform whose commands stay the same for so long before and after an exposure stands
APART = 0.02  # s by which clocks may be apart and drives behind, standard deviation


@dataclass(frozen=True, slots=True, eq=False)
class Rates:
    """rate, curvature : (F, 6) tangents on the right, per s and per s^2, of the platform at exposures."""

    rate: Floats
    curvature: Floats


def commanded_rates(recording: Recording) -> Rates | None:
    """Rates of the platform by a recording's commands.

    None where no camera is stated to expose row by row, nothing is commanded, or nothing moves.
    Raises what `simulate_machine_run` does
    """
    design, commands, (_, t) = recording.design, recording.commands, recording.exposures.times()
    if commands is None or not any(camera.shutter == "rolling" for camera in design.cameras):
        return None
    around = [commands.at(np.maximum(t + shift, commands.t[0])) for shift in (-ABOUT, 0.0, ABOUT)]
    moving = (np.ptp(around, axis=0) > 0).any(axis=1)
    if not moving.any():
        return None
    rates = Rates(np.zeros((len(t), 6)), np.zeros((len(t), 6)))
    run = simulate_machine_run(design, commands, t[moving], (), recording.sensors, rates=True)
    rates.rate[moving], rates.curvature[moving] = run.rate, run.curvature
    return rates


def _late(observed: Observations, design: Design) -> Floats:
    """(n,) s by which corners are exposed after their frame's time; 0 on the base."""
    row_time = np.array([c.row_time if c.shutter == "rolling" else 0.0 for c in design.cameras])[observed.camera]
    middle = np.array([c.height / 2 for c in design.cameras])[observed.camera]
    return np.where(observed.on_platform, (observed.uv[:, 1] - middle) * row_time, 0.0)


def observations_with_readout_motion(observed: Observations, design: Design, rates: Rates) -> Observations:
    """The observations with the motion of the platform until their rows are exposed."""
    late = _late(observed, design)[:, None]
    step = late * rates.rate[observed.frame] + late**2 / 2 * rates.curvature[observed.frame]
    return replace(observed, motion=exp(step).as_matrix()[:, :3])


def with_uncertainty_of_rates(measured: Measurement, rates: Rates) -> Measurement:
    """The Measurement with the uncertainty of rates.

    With what rates that are taken at another moment would make of its poses.
    """
    o = measured.observations
    count = np.bincount(o.frame, o.on_platform, len(o.frames))
    late = np.bincount(o.frame, _late(o, measured.design), len(o.frames)) / np.maximum(count, 1)
    at = np.searchsorted(o.frames, measured.frames)
    off = (late[:, None] * APART * rates.curvature)[at]
    return replace(measured, covariance=measured.covariance + off[:, :, None] * off[:, None, :])
