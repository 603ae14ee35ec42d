"""Motion of the platform between a frame's time and the exposure of each corner.

It is removed from poses, as a rolling shutter needs.

A corner in row v of a rolling shutter is exposed (v - height / 2) * row_time after its camera's time, which may itself
be later than the frame's. The platform has moved on by then, at the rate that commands state. Where it speeds up, this
rate depends on the clocks of cameras and commands and on the lag of the drives. They are solved for by the poses
themselves (vision.clock_offset_drive_lag_and_camera_time_offset_estimation) where these move enough; how well they
are known is in the covariance of the pose.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rig.array_and_json_types import Floats, Integers
from rig.model.design import Design
from rig.model.motion_simulation import simulate_machine_run
from rig.model.pose import exp
from rig.recording.exposures_and_image_files import SIMULTANEOUS
from rig.recording.recording_folder import Recording
from vision.clock_offset_drive_lag_and_camera_time_offset_estimation import (
    Clocks,
    are_commands_changing,
    camera_time_offsets,
    clock_offset_and_drive_lag_by_recording,
    recording_with_clock_offset_and_lag_applied,
)
from vision.corner_observations import Observations
from vision.predict import predict_corners
from vision.recording_adjustment import Measurement

AFTER = 1e-3  # s by which exposures are moved for a derivative
ROUNDS = 3  # of finding by how much cameras' times differ
APART = 0.02  # s by which clocks may be apart and drives behind, standard deviation where nobody knows


@dataclass(frozen=True, slots=True, eq=False)
class Rates:
    """rate, curvature : (F, 6) tangents on the right, per s and per s^2, of the platform at exposures
    delays : (F, cameras) s by which cameras exposed after a frame's time; apart : s, standard deviation of the moment
    at which the rates are taken
    """

    rate: Floats
    curvature: Floats
    delays: Floats
    apart: float = APART


def commanded_rates(recording: Recording, clocks: Sequence[Clocks] = ()) -> Rates | None:
    """Rates of the platform by a recording's commands.

    None where nothing is commanded or moves, or one camera exposes all rows at the frame's time.
    clocks : as far as they are known, else () for those as logged
    Raises what `simulate_machine_run` does
    """
    design, delays = recording.design, recording.exposures.delays([camera.name for camera in recording.design.cameras])
    if recording.commands is None or (len(design.cameras) < 2 and not _are_rows_late(design)):
        return None
    recording = recording_with_clock_offset_and_lag_applied(recording, clocks)
    commands, (_, t) = recording.commands, recording.exposures.times()
    assert commands is not None
    moving = are_commands_changing(commands, t)
    if not moving.any():
        return None
    apart = max([one.offset_sigma for one in clocks], default=APART)
    rates = Rates(np.zeros((len(t), 6)), np.zeros((len(t), 6)), delays, apart)
    run = simulate_machine_run(design, commands, t[moving], (), recording.sensors, rates=True)
    rates.rate[moving], rates.curvature[moving] = run.rate, run.curvature
    return rates


def _are_rows_late(design: Design) -> bool:
    """Whether a camera is stated to expose row by row."""
    return any(camera.shutter == "rolling" for camera in design.cameras)


def _late(observed: Observations, design: Design, rates: Rates) -> Floats:
    """(n,) s by which corners are exposed after their frame's time; 0 on the base."""
    delay = rates.delays[observed.frame, observed.camera]
    return np.where(observed.on_platform, delay + _read_out(observed, design), 0.0)


def _read_out(observed: Observations, design: Design) -> Floats:
    """(n,) s by which corners are exposed after their camera's time."""
    row_time = np.array([c.row_time if c.shutter == "rolling" else 0.0 for c in design.cameras])[observed.camera]
    middle = np.array([c.height / 2 for c in design.cameras])[observed.camera]
    return np.asarray((observed.uv[:, 1] - middle) * row_time)


def observations_with_readout_motion(observed: Observations, design: Design, rates: Rates) -> Observations:
    """Observations that carry the platform's motion until the row of each corner is exposed."""
    late = _late(observed, design, rates)[:, None]
    step = late * rates.rate[observed.frame] + late**2 / 2 * rates.curvature[observed.frame]
    return replace(observed, motion=exp(step).as_matrix()[:, :3])


def measurement_with_uncertainty_of_rates(measured: Measurement, rates: Rates) -> Measurement:
    """The Measurement with the uncertainty of rates.

    With what rates that are taken at another moment would make of its poses.
    """
    o = measured.observations
    count = np.bincount(o.frame, o.on_platform, len(o.frames))
    late = np.bincount(o.frame, _late(o, measured.design, rates), len(o.frames)) / np.maximum(count, 1)
    at = np.searchsorted(o.frames, measured.frames)
    off = (late[:, None] * rates.apart * rates.curvature)[at]
    return replace(measured, covariance=measured.covariance + off[:, :, None] * off[:, None, :])


class ReadoutMotion:
    """Measurement of a recording whose corners are exposed at other moments than their frames. The first measurement
    tells the clocks, and by how much cameras' times differ, which later ones use.
    rates : Rates by the clocks as known so far; offsets : (cameras,) s by which each camera was found to expose later
    than its times say, relative to the first
    """

    def __init__(self, recording: Recording, rates: Rates) -> None:
        self._recording, self.rates = recording, rates
        self.offsets = np.zeros(len(recording.design.cameras))
        self._clocks: tuple[Clocks, ...] | None = None

    @property
    def _acts(self) -> bool:
        """Whether corners are exposed at other moments than their frames."""
        late = np.abs(self.rates.delays).max() > SIMULTANEOUS
        return bool(late or self.offsets.any() or _are_rows_late(self._recording.design))

    def measured(self, observed: Observations, adjusted: Callable[[Observations], Measurement]) -> Measurement:
        """Measurement of Observations. adjusted : makes one of the Observations with their motion"""
        found = adjusted(self._moved(observed))
        if self._clocks is None:
            own = found.covariance - found.common @ np.swapaxes(found.common, 1, 2)
            self._clocks = clock_offset_and_drive_lag_by_recording(
                self._recording, found.frames, found.T_base_platform, own, found.common
            )
            known = commanded_rates(self._recording, self._clocks) if self._clocks else None
            if known is not None:
                self.rates = known
                found = adjusted(self._moved(observed)) if self._acts else found
            for _ in range(ROUNDS if self._clocks else 0):
                more = self._more_offsets(found)
                if not more.any():
                    break
                self.offsets = self.offsets + more
                self.rates = replace(self.rates, delays=self.rates.delays + more)
                found = adjusted(self._moved(observed))
        if not self._acts:
            return found
        found = replace(found, camera_offsets=tuple(self.offsets.tolist()) if self.offsets.any() else ())
        return measurement_with_uncertainty_of_rates(self._with_shift_to_frame_times(found), self.rates)

    def _moved(self, observed: Observations) -> Observations:
        design = self._recording.design
        return observations_with_readout_motion(observed, design, self.rates) if self._acts else observed

    def _more_offsets(self, found: Measurement) -> Floats:
        """(cameras,) s by which cameras still expose later than is taken into account, 0 for what is not certain."""
        design = found.design
        if any(camera.mount != "fixed" for camera in design.cameras):
            return np.zeros(len(self.offsets))
        at, (now, later) = self._of_solved_frames(found, replace(self.rates, delays=self.rates.delays + AFTER))
        known = np.searchsorted(found.observations.frames, found.frames)
        moving = np.abs(self.rates.rate[known]).max(axis=1) > 0
        state = found.adjustment.state
        offsets = camera_time_offsets(now, later, AFTER, found.residuals[at], state, moving)
        return np.zeros(len(self.offsets)) if offsets is None else offsets.certain

    def _of_solved_frames(
        self, measured: Measurement, other: Rates
    ) -> tuple[Integers, tuple[Observations, Observations]]:
        """(rows, (Observations of the solved frames, the same with other Rates)), their frames numbered as these."""
        o = measured.observations
        at = np.flatnonzero(np.isin(o.frames[o.frame], measured.frames))
        whole = o.take(at)
        alike = observations_with_readout_motion(whole, measured.design, other)

        def solved(one: Observations) -> Observations:
            frame = np.searchsorted(measured.frames, one.frames[one.frame])
            return replace(one, frames=measured.frames, frame=frame)

        return at, (solved(whole), solved(alike))

    def _with_shift_to_frame_times(self, measured: Measurement) -> Measurement:
        """The Measurement with by how much its corners would lie elsewhere had all cameras exposed at their frame's
        time.
        """
        if np.abs(self.rates.delays).max() <= SIMULTANEOUS and not self.offsets.any():
            return measured
        at, solved = self._of_solved_frames(measured, replace(self.rates, delays=0 * self.rates.delays))
        own, at_once = (predict_corners(one, measured.adjustment.state)[0] for one in solved)
        shift = np.zeros((len(measured.observations), 2))
        shift[at] = at_once - own
        return replace(measured, to_frame_time=shift)
