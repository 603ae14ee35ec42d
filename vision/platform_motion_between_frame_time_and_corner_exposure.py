"""Motion of the platform between a frame's time and the exposure of each corner.

It is removed from poses, as a rolling shutter needs.

A corner in row v of a rolling shutter is exposed (v - height / 2) * row_time after its camera's time, which may itself
be later than the frame's. The platform has moved on by then, at the rate that commands state. Where it speeds up, this
rate depends on the clocks of cameras and commands and on the lag of the drives. They are solved for by the poses
themselves (vision.clock_offset_drive_lag_and_camera_time_offset_estimation) where these move enough, and so is a
row_time that is not stated. How well they are known is in the covariance of the pose.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.model.design import Design
from rig.model.machine_motion_simulation import simulate_machine_run
from rig.model.pose import exp
from rig.recording.exposures_and_image_files import SIMULTANEOUS
from rig.recording.recording_folder import Recording
from vision.bundle.corner_jacobians_normal_equations_and_schur_complement import (
    corner_jacobians_to_poses_and_lens_by_camera,
)
from vision.clock_offset_drive_lag_and_camera_time_offset_estimation import (
    CameraTimes,
    Clocks,
    are_commands_changing,
    camera_times,
    clock_offset_and_drive_lag_by_recording,
    recording_with_clock_offset_and_lag_applied,
)
from vision.corner_observations_and_merging import Observations
from vision.marker_corner_prediction import predict_corners
from vision.recording_adjustment_with_hand_and_stages import Measurement
from vision.rolling_shutter_row_time_and_readout_result import Readout, rolling_shutter_row_time

AFTER = 1e-3  # s by which exposures are moved for a derivative
ROUNDS = 3  # of finding by how much cameras' times differ
APART = 0.02  # s by which clocks may be apart and drives behind, standard deviation where nobody knows
READOUT = 0.02  # s from the first row to the last, standard deviation where nobody knows
SETTLED = 0.2  # standard deviations by which times that are found may still change


@dataclass(frozen=True, slots=True, eq=False)
class Rates:
    """rate, curvature : (F, 6) tangents on the right, per s and per s^2, of the platform at exposures
    delays : (F, cameras) s by which cameras exposed after a frame's time; row_time, row_time_sigma : (cameras,) s from
    one row to the next, with standard deviation; apart : s, standard deviation of the moment at which the rates are
    taken
    """

    rate: Floats
    curvature: Floats
    delays: Floats
    row_time: Floats
    row_time_sigma: Floats
    apart: float = APART


def commanded_platform_rates(recording: Recording, clocks: Sequence[Clocks] = ()) -> Rates | None:
    """Rates of the platform by a recording's commands.

    None where nothing is commanded or moves, or one camera exposes all rows at the frame's time.
    clocks : as far as they are known, else () for those as logged
    Raises what `simulate_machine_run` does
    """
    design, delays = recording.design, recording.exposures.delays([camera.name for camera in recording.design.cameras])
    if recording.commands is None or (len(design.cameras) < 2 and not _has_late_rows(design).any()):
        return None
    recording = recording_with_clock_offset_and_lag_applied(recording, clocks)
    commands, (_, t) = recording.commands, recording.exposures.times()
    assert commands is not None
    moving = are_commands_changing(commands, t)
    if not moving.any():
        return None
    apart = max([one.offset_sigma for one in clocks], default=APART)
    row_time = np.array([rolling_shutter_row_time(camera) for camera in design.cameras])
    unknown = ~_is_readout_stated(design) & _has_late_rows(design)
    row_time_sigma = np.where(unknown, READOUT, 0.0) / _heights(design)
    rates = Rates(np.zeros((len(t), 6)), np.zeros((len(t), 6)), delays, row_time, row_time_sigma, apart)
    run = simulate_machine_run(design, commands, t[moving], (), recording.sensors, rates=True)
    rates.rate[moving], rates.curvature[moving] = run.rate, run.curvature
    return rates


def _has_late_rows(design: Design) -> Booleans:
    """(cameras,) whether each is stated to expose row by row."""
    return np.array([camera.shutter == "rolling" for camera in design.cameras])


def _is_readout_stated(design: Design) -> Booleans:
    """(cameras,) whether the time of each row is stated."""
    return np.array([camera.shutter == "rolling" and camera.row_time is not None for camera in design.cameras])


def _heights(design: Design) -> Floats:
    """(cameras,) px."""
    return np.array([camera.height for camera in design.cameras], float)


def _late(observed: Observations, design: Design, rates: Rates) -> Floats:
    """(n,) s by which corners are exposed after their frame's time; 0 on the base."""
    delay = rates.delays[observed.frame, observed.camera]
    return np.where(observed.on_platform, delay + _rows(observed, design) * rates.row_time[observed.camera], 0.0)


def _rows(observed: Observations, design: Design) -> Floats:
    """(n,) px by which corners lie below the middle of their image."""
    return np.asarray(observed.uv[:, 1] - _heights(design)[observed.camera] / 2)


def observations_with_readout_motion(observed: Observations, design: Design, rates: Rates) -> Observations:
    """Observations that carry the platform's motion until the row of each corner is exposed."""
    late = _late(observed, design, rates)[:, None]
    step = late * rates.rate[observed.frame] + late**2 / 2 * rates.curvature[observed.frame]
    return replace(observed, motion=exp(step).as_matrix()[:, :3])


def measurement_with_uncertainty_of_rates(measured: Measurement, rates: Rates) -> Measurement:
    """The Measurement with the uncertainty of rates.

    With what rates that are taken at another moment, and other row times, would make of its poses.
    """
    o = measured.observations
    at = np.searchsorted(o.frames, measured.frames)
    unsure = np.where(o.on_platform, _rows(o, measured.design) * rates.row_time_sigma[o.camera], 0.0)
    offs = [_pose_shifts(measured, _late(o, measured.design, rates) * rates.apart, rates.curvature[at])]
    offs += [
        _pose_shifts(measured, unsure * (o.camera == i), rates.rate[at]) for i in np.flatnonzero(rates.row_time_sigma)
    ]
    covariance = measured.covariance + sum(off[:, :, None] * off[:, None, :] for off in offs)
    return replace(measured, covariance=covariance)


def _pose_shifts(measured: Measurement, late: Floats, rate: Floats) -> Floats:
    """(F, 6) tangents by which poses of the solved frames come out elsewhere where their corners are exposed late by
    late (n,) s, at rates (F, 6) per s of the platform.

    Each corner weighs as it does in its frame's pose: a pose is turned, too, by rows that are late by zero on average.
    """
    at, F = _rows_of_solved_frames(measured), len(measured.frames)
    solved = _numbered_as_solved(measured.observations.take(at), measured)
    whole, moved = np.zeros((F, 6, 6)), np.zeros((F, 6, 6))
    for _, rows, J_platform, *_ in corner_jacobians_to_poses_and_lens_by_camera(solved, measured.adjustment.state):
        products = np.swapaxes(J_platform, 1, 2) @ np.linalg.solve(solved.covariance[rows], J_platform)
        np.add.at(whole, solved.frame[rows], products)
        np.add.at(moved, solved.frame[rows], late[at][rows, None, None] * products)
    return np.asarray(np.linalg.solve(whole, moved @ rate[..., None])[..., 0], float)


def _rows_of_solved_frames(measured: Measurement) -> Integers:
    """Indices of a Measurement's observations whose frames were solved."""
    o = measured.observations
    return np.flatnonzero(np.isin(o.frames[o.frame], measured.frames))


def _numbered_as_solved(observations: Observations, measured: Measurement) -> Observations:
    """Observations of solved frames, which are numbered as these."""
    frame = np.searchsorted(measured.frames, observations.frames[observations.frame])
    return replace(observations, frames=measured.frames, frame=frame)


class ReadoutMotion:
    """Measurement of a recording whose corners are exposed at other moments than their frames. The first measurement
    tells the clocks, and by how much cameras' times differ, which later ones use.
    rates : Rates by the clocks and row times as known so far; offsets : (cameras,) s by which each camera was found to
    expose later than its times say, relative to the first; times : CameraTimes as last estimated, or None
    """

    def __init__(self, recording: Recording, rates: Rates) -> None:
        self._recording, self.rates = recording, rates
        self.offsets = np.zeros(len(recording.design.cameras))
        self.times: CameraTimes | None = None
        self._clocks: tuple[Clocks, ...] | None = None

    @property
    def _acts(self) -> bool:
        """Whether corners are exposed at other moments than their frames."""
        late = np.abs(self.rates.delays).max() > SIMULTANEOUS
        return bool(late or self.offsets.any() or _has_late_rows(self._recording.design).any())

    def measured(self, observed: Observations, adjusted: Callable[[Observations], Measurement]) -> Measurement:
        """Measurement of Observations. adjusted : makes one of the Observations with their motion"""
        found = adjusted(self._moved(observed))
        if self._clocks is None:
            self._compare_clocks(found)
            found = adjusted(self._moved(observed)) if self._clocks and self._acts else found
            for _ in range(ROUNDS if self._clocks else 0):
                if not self._compare_cameras(found):
                    break
                found = adjusted(self._moved(observed))
                self._compare_clocks(found)
        found = replace(found, readouts=self._readouts())
        if not self._acts:
            return found
        cameras = tuple(
            camera if stated or not row_time else replace(camera, row_time=float(row_time))
            for camera, stated, row_time in zip(
                found.design.cameras, _is_readout_stated(self._recording.design), self.rates.row_time
            )
        )
        found = replace(
            found,
            design=replace(found.design, cameras=cameras),
            camera_offsets=tuple(self.offsets.tolist()) if self.offsets.any() else (),
        )
        return measurement_with_uncertainty_of_rates(self._with_shift_to_frame_times(found), self.rates)

    def _compare_clocks(self, found: Measurement) -> None:
        """Find the clocks by measured poses, and the rates by these."""
        own = found.covariance - found.common @ np.swapaxes(found.common, 1, 2)
        self._clocks = clock_offset_and_drive_lag_by_recording(
            self._recording, found.frames, found.T_base_platform, own, found.common
        )
        known = commanded_platform_rates(self._recording, self._clocks) if self._clocks else None
        if known is not None:
            self.rates = replace(self.rates, rate=known.rate, curvature=known.curvature, apart=known.apart)

    def _moved(self, observed: Observations) -> Observations:
        design = self._recording.design
        return observations_with_readout_motion(observed, design, self.rates) if self._acts else observed

    def _compare_cameras(self, found: Measurement) -> bool:
        """Find by how much cameras are late, and their rows. Returns whether what is taken into account has changed."""
        design = found.design
        if any(camera.mount != "fixed" for camera in design.cameras):
            return False
        at, (now, later) = self._of_solved_frames(found, replace(self.rates, delays=self.rates.delays + AFTER))
        known = np.searchsorted(found.observations.frames, found.frames)
        moving = np.abs(self.rates.rate[known]).max(axis=1) > 0
        state, stated = found.adjustment.state, _is_readout_stated(design)
        more = camera_times(now, later, AFTER, found.residuals[at], state, moving, stated)
        if more is None:
            return False
        heights, unknown = _heights(design), _has_late_rows(design) & ~stated
        readout = np.where(unknown, self.rates.row_time * heights, 0.0)
        self.times = times = more.beyond(self.offsets, readout)
        offsets, found_readout = times.certain_offset, np.where(unknown, times.certain_readout, 0.0)
        changed = np.abs(offsets - self.offsets) > SETTLED * times.offset_sigma
        changed |= np.abs(found_readout - readout) > SETTLED * times.readout_sigma
        sigma = np.where(found_readout != 0, times.readout_sigma, np.hypot(times.readout, times.readout_sigma))
        self.rates = replace(
            self.rates,
            delays=self.rates.delays + offsets - self.offsets,
            row_time=np.where(unknown, found_readout / heights, self.rates.row_time),
            row_time_sigma=np.where(unknown, np.minimum(sigma, READOUT) / heights, 0.0),
        )
        self.offsets = offsets
        return bool(changed.any())

    def _readouts(self) -> tuple[Readout, ...]:
        """Readouts of cameras whose row time is not stated, and of those that contradict a global shutter."""
        design, times = self._recording.design, self.times
        if times is None:
            return ()
        certain, finite = times.certain_readout != 0, np.isfinite(times.readout_sigma)
        return tuple(
            Readout(
                camera.name, float(times.readout[i]), float(times.readout_sigma[i]), bool(certain[i]), camera.shutter
            )
            for i, camera in enumerate(design.cameras)
            if finite[i] and not _is_readout_stated(design)[i] and (certain[i] or camera.shutter == "rolling")
        )

    def _of_solved_frames(
        self, measured: Measurement, other: Rates
    ) -> tuple[Integers, tuple[Observations, Observations]]:
        """(rows, (Observations of the solved frames, the same with other Rates)), their frames numbered as these."""
        at = _rows_of_solved_frames(measured)
        whole = measured.observations.take(at)
        alike = observations_with_readout_motion(whole, measured.design, other)
        return at, (_numbered_as_solved(whole, measured), _numbered_as_solved(alike, measured))

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
