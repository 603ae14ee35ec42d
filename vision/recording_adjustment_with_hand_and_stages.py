"""Adjustment of a recording: of a platform, of a hand that carries cameras, of stages.

Its corners give cameras, and poses of the platform with covariance.

In the platform's own frame a hand camera stands still and the base's markers move. So it is measured like any rig, base
and platform exchanged: its stated pose holds the platform's frame, markers' stated places the base's.

To an adjustment a stage is as good as a platform that is seen in frames of its own: cameras are shared, poses are not.
So the recording's frames are followed by as many for each stage, adjusted together, and parted again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import cast

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.model.design import Camera, Design
from rig.model.pose import adjoint
from rig.recording.corner_and_pose_csv_tables import Corners
from rig.recording.recording_folder import Recording
from rig.report.verdict_refutations_and_result_display import OneLineRepr, result_html
from vision.bundle.adjustment_covariance_of_correlated_corner_errors import adjustment_with_correlated_error_covariance
from vision.bundle.bundle_adjustment import Adjustment
from vision.bundle.printing_error_variance_estimation import adjust_with_estimated_printing_errors
from vision.bundle.robust_adjustment import adjust_robustly, adjust_with_systematic_errors_weighed
from vision.corner_observations_and_merging import Observations, observations_of_frames
from vision.marker_corner_prediction import MarkerMap, State, predict_corners
from vision.pose.body_pose import FINEST
from vision.pose.frame_and_camera_poses import (
    Frames,
    UndistortedCorners,
    camera_poses_from_body_poses,
    locate_cameras_without_base_targets,
    locate_fixed_cameras,
    locate_platform_and_moving_cameras,
)
from vision.pose.marker_places_from_sightings import marker_places_from_sightings
from vision.pose.pose_refinement_and_choice_by_neighbour_frames import FAR
from vision.rolling_shutter_row_time_and_readout_result import Readout

FARTHEST = 30.0  # px; a corner that lies farther from where it ought to be says no more by it
NEGLIGIBLE = 1e-2  # standard deviations by which a shared draw moves all poses; below, each pose bears it alone
UNSURE = 3.0  # px; where places are free, what stated ones may be off by before a frame that they hold is doubted


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Measurement(OneLineRepr):
    """What a recording's images say.

    design : Design with cameras as adjusted; frames : (f,) numbers of the solved frames
    T_base_platform : RigidTransform (f,); covariance : (f, 6, 6) on the right, cameras' uncertainty included
    common : (f, 6, k) the part of it shared by all frames: error = common[f] z + its own, z ~ N(0, I)
    unsolved : {frame number: reason}; observations : all corners, covariance scaled to the scatter seen
    inliers : (n,) bool; residuals : (n, 2) px, NaN where the frame is unsolved
    noise : px, standard deviation of a corner per axis; standing : px, the part of a corner's error that comes back in
    every frame where neither camera nor marker moves; weights : (k, 2, 2) px^2 covariance of the solved frames' corners
    with that allowed for; factor : what stated covariances were multiplied by
    adjustment : the last Adjustment, for its shared unknowns; readouts : of cameras whose readout time was found
    stages : {number (from 1): Measurement} of a chain's lower stages, of T_base_stage; common has the same draws
    to_frame_time : (n, 2) px by which corners would lie elsewhere had all cameras exposed at once, None where they did
    camera_offsets : s by which each camera exposes later than its times say, relative to the first, () for nothing
    """

    design: Design
    frames: Integers
    T_base_platform: RigidTransform
    covariance: Floats
    common: Floats
    unsolved: dict[int, str]
    observations: Observations
    inliers: Booleans
    residuals: Floats
    noise: float
    standing: float
    weights: Floats
    factor: float
    adjustment: Adjustment
    stages: dict[int, Measurement] = field(default_factory=dict)
    to_frame_time: Floats | None = None
    camera_offsets: tuple[float, ...] = ()
    readouts: tuple[Readout, ...] = ()

    def __str__(self) -> str:
        return f"{len(self.frames)} of {len(self.frames) + len(self.unsolved)} frames solved"

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        position, rotation = (
            np.sqrt(np.mean(np.trace(self.covariance[:, part, part], axis1=1, axis2=2))) * 1e3
            for part in (slice(0, 3), slice(3, 6))
        )
        missed = [f"frame {frame} has no pose: {reason}" for frame, reason in list(self.unsolved.items())[:5]]
        return result_html(
            str(self),
            [
                f"poses to {position:.4f} mm and {rotation:.4f} mrad (standard uncertainty, RMS)",
                f"corners scatter by {self.noise:.4f} px; {self.inliers.sum()} of {len(self.inliers)} used",
                *missed,
            ],
        )

    @property
    def places_free(self) -> bool:
        """Whether places of markers or targets were adjusted."""
        return bool(self.adjustment.unknowns.markers or self.adjustment.unknowns.targets)

    def used(self) -> Observations:
        """Observations that were adjusted, with the weights they were given: the inliers of the solved frames."""
        retained, inliers = self._solved()
        return replace(retained, covariance=self.weights).take(inliers)

    def own_errors(self) -> Booleans:
        """(n,) of those observations, whether a corner's covariance is that of its own errors alone."""
        retained, inliers = self._solved()
        return cast(Booleans, (self.weights == retained.covariance).all(axis=(1, 2))[inliers])

    def _solved(self) -> tuple[Observations, Booleans]:
        solved = np.searchsorted(self.observations.frames, self.frames)
        used = self.inliers[np.isin(self.observations.frame, solved)]
        return observations_of_frames(self.observations, solved), used

    def ids(self) -> list[int]:
        """Identity of each row of the marker map."""
        return [number for target in self.design.targets for number in target.ids]

    def corners(self) -> Corners:
        """recording.Corners of all observations, those of stages too, with covariance."""
        seen, ids = [m.observations for m in (self, *self.stages.values())], np.array(self.ids(), int)
        names = [camera.name for camera in self.design.cameras]
        return Corners(
            np.concatenate([o.frames[o.frame] for o in seen]),
            [names[i] for o in seen for i in o.camera],
            np.concatenate([ids[o.marker] for o in seen]),
            np.concatenate([o.corner for o in seen]),
            np.concatenate([o.uv for o in seen]),
            np.concatenate([o.covariance for o in seen]),
        )


def measure_observations(
    observations: Observations,
    design: Design,
    marker_map: MarkerMap,
    free: Sequence[str] = ("poses", "lenses"),
    progress: Callable[[str, int, int], None] | None = None,
    t: Floats | None = None,
    cameras: tuple[Camera, ...] | None = None,
) -> Measurement:
    """Measurement of observations: platform poses with cameras, lenses and, if free, marker places adjusted.

    observations : Observations; design : Design, nominal; marker_map : MarkerMap as stated
    free : what is adjusted, see `adjust_bundle`; "markers" also where the pose of one that is seen is not stated
    progress : called with (label, done, of), or None
    t : (F,) s of the frames; with it, one sighting alone counts where the frames before and after confirm its pose
    cameras : to locate frames by, where they are better known than the design has them
    Returns Measurement. Raises NotEnoughData where no frame can be solved, with the reasons.
    """
    if not marker_map.stated[observations.marker].all():
        free = tuple(dict.fromkeys((*free, "markers")))
    places = bool({"markers", "targets"} & set(free))
    count = len(observations.frames)
    stated = State(design.cameras, None, {}, marker_map)
    cameras, markers = cameras or design.cameras, marker_map
    finest, covariance = UNSURE if places else FINEST, observations.covariance
    if "markers" in free:  # a target that is free moves as a whole: its markers stay where they are stated on it
        markers, _ = marker_places_from_sightings(observations, cameras, marker_map)
        stated = replace(stated, markers=marker_map.with_unstated_at(markers))
    for _ in range(2 if places else 1):  # once to find the places, once more with these
        undistorted = UndistortedCorners(replace(observations, covariance=covariance), cameras, markers, finest)
        found = locate_fixed_cameras(undistorted, cameras) if "poses" in free else {}
        cameras = tuple(replace(c, pose=found.get(i, c.pose)) for i, c in enumerate(cameras))
        frames, cameras = _located(
            undistorted, cameras, t, set(found) if "poses" in free else None, progress and partial(progress, "locating")
        )
        state = State(cameras, frames.all_poses(count), frames.all_moving(count), markers)
        unsolved = dict(frames.unsolved)
        fit = adjust_robustly(
            observations,
            state,
            free,
            unsolved,
            stated,
            frames.confirmed,
            5 * finest if places else 0.0,
            progress and partial(progress, "adjusting"),
        )
        covariance = fit.covariance
        cameras, markers = fit.adjustment.state.cameras, fit.adjustment.state.placed
    fit = fit if places else adjust_with_estimated_printing_errors(observations, fit, tuple(free))
    weighed = adjust_with_systematic_errors_weighed(observations, fit, free, stated)
    observations = replace(observations, covariance=weighed.variance * fit.covariance)
    retained = observations_of_frames(observations, fit.solved)
    result = adjustment_with_correlated_error_covariance(weighed.used, weighed.adjustment, weighed.own)
    covariance = result.platform_covariance
    result, common = _in_order(result)
    residuals = np.full((len(observations), 2), np.nan)
    residuals[np.isin(observations.frame, fit.solved)] = retained.uv - predict_corners(retained, result.state)[0]
    noise = np.sqrt(np.median(np.einsum("nii->n", retained.covariance)) / 2)
    return Measurement(
        replace(design, cameras=result.state.cameras),
        observations.frames[fit.solved],
        result.state.platform,
        covariance,
        common,
        {int(observations.frames[f]): reason for f, reason in unsolved.items()},
        observations,
        fit.inliers,
        residuals,
        float(noise),
        weighed.systematic_error,
        weighed.weights,
        weighed.variance * fit.scale**2,
        result,
    )


def _in_order(adjustment: Adjustment) -> tuple[Adjustment, Floats]:
    """(Adjustment whose shared draws are turned so that what moves the poses most comes first, (f, 6, k) of them that
    do not move them negligibly).

    Turning draws z ~ N(0, I) changes no covariance; of many hundred unknowns that cameras, lenses and prints have,
    poses feel a few score
    """
    common = adjustment.platform_common
    own = np.linalg.solve(np.linalg.cholesky(adjustment.platform_given_cameras), common).reshape(
        6 * len(common), common.shape[2]
    )
    squares, turn = np.linalg.eigh(own.T @ own)
    turn = turn[:, ::-1]
    turned = replace(adjustment, platform_common=common @ turn, shared_factor=adjustment.shared_factor @ turn)
    return turned, turned.platform_common[..., : int((squares > NEGLIGIBLE**2).sum())]


def _located(
    undistorted: UndistortedCorners,
    cameras: tuple[Camera, ...],
    t: Floats | None,
    held: set[int] | None,
    progress: Callable[[int, int], None] | None,
) -> tuple[Frames, tuple[Camera, ...]]:
    """(Frames, cameras) located by cameras as they are, or, where they may move and no base places them, as the body
    relates them if corners agree better so. held : indices of those that the base placed, None where none may move"""
    found = locate_platform_and_moving_cameras(undistorted, cameras, t, progress)
    other = (
        {}
        if held is None
        else locate_cameras_without_base_targets(undistorted, cameras)
        or camera_poses_from_body_poses(undistorted, cameras, found, held, t, progress)
    )
    if not other:
        return found, cameras
    moved = tuple(replace(c, pose=other.get(i, c.pose)) for i, c in enumerate(cameras))
    relocated = locate_platform_and_moving_cameras(undistorted, moved, t, progress)
    if _disagreement(undistorted, relocated, moved) < _disagreement(undistorted, found, cameras):
        return relocated, moved
    return found, cameras


def _disagreement(undistorted: UndistortedCorners, frames: Frames, cameras: tuple[Camera, ...]) -> float:
    """Px, mean by which corners lie from where poses put them, FARTHEST at the most and for unsolved frames."""
    o, count = undistorted.observations, len(undistorted.observations.frames)
    uv, ahead = predict_corners(o, State(cameras, frames.all_poses(count), frames.all_moving(count), undistorted.map))
    off = np.linalg.norm(o.uv - uv, axis=1)
    off[(ahead[:, 2] <= 0) | ~np.isfinite(off) | np.isin(o.frame, list(frames.unsolved))] = FARTHEST
    return float(np.minimum(off, FARTHEST).mean())


def has_hand_cameras(design: Design) -> bool:
    """Whether the platform carries a design's cameras (mount "hand")."""
    return any(camera.mount == "hand" for camera in design.cameras)


def recording_seen_from_hand(recording: Recording) -> Recording:
    """Recording as seen from the hand: its cameras stand still, and the base's targets move.

    Recordings without hand cameras as they are.
    """
    return (
        replace(recording, design=design_seen_from_hand(recording.design))
        if has_hand_cameras(recording.design)
        else recording
    )


def design_seen_from_hand(design: Design) -> Design:
    """The Design seen from the hand: cameras fixed, the targets on the moving body."""
    cameras = tuple(replace(camera, mount="fixed") for camera in design.cameras)
    return replace(
        design, cameras=cameras, targets=tuple(replace(target, body="platform") for target in design.targets)
    )


def measurement_with_inverted_poses(measured: Measurement) -> Measurement:
    """The Measurement with inverted poses, with their covariances.

    T exp(xi) of the one is T^-1 exp(-Ad xi) of the other, with Ad that of T.
    """
    seen = adjoint(measured.T_base_platform)
    return replace(
        measured,
        T_base_platform=measured.T_base_platform.inv(),
        covariance=seen @ measured.covariance @ np.swapaxes(seen, 1, 2),
        common=-seen @ measured.common,
    )


def _stage_numbers(markers: MarkerMap) -> list[int]:
    """Numbers (from 1) of the stages below the last that carry markers."""
    return np.unique(markers.stage[markers.stage > 0]).tolist()


def observations_with_separate_stage_frames(observations: Observations, markers: MarkerMap) -> Observations:
    """Observations with each stage's corners moved into frames of their own, numbered after all other frames."""
    o, count = observations, len(observations.frames)
    step = int(o.frames.max()) + 1
    bodies = [0, *_stage_numbers(markers)]
    frame = o.frame + count * np.searchsorted(bodies, markers.stage[o.marker])
    order = np.lexsort((o.corner, o.marker, frame, o.camera))
    return replace(
        o.take(order), frames=np.concatenate([o.frames + k * step for k in range(len(bodies))]), frame=frame[order]
    )


def stage_frame_times_shifted_apart(t: Floats, markers: MarkerMap) -> Floats:
    """Times (frames of all bodies,) s of the stage frames, each body's far from the others' in time."""
    gap = float(np.ptp(t)) + 4 * FAR
    return np.concatenate([t + k * gap for k in range(1 + len(_stage_numbers(markers)))])


def separate_stage_measurements(measured: Measurement, markers: MarkerMap) -> Measurement:
    """The Measurement with each stage's separate from the platform's, in its field `stages`."""
    bodies = [0, *_stage_numbers(markers)]
    platform, *below = (_part(measured, k, len(bodies)) for k in range(len(bodies)))
    return replace(platform, stages=dict(zip(bodies[1:], below)))


def _part(m: Measurement, k: int, bodies: int) -> Measurement:
    """Of body k (from 0) of so many."""
    o, a, count = m.observations, m.adjustment, len(m.observations.frames) // bodies
    rows, own = o.frame // count == k, np.searchsorted(o.frames, m.frames) // count == k
    solved = np.isin(o.frames[o.frame], m.frames)
    shift = int(o.frames[k * count] - o.frames[0])
    here = {
        frame - shift: reason for frame, reason in m.unsolved.items() if np.searchsorted(o.frames, frame) // count == k
    }
    used = rows[solved & m.inliers]
    adjustment = replace(
        a,
        state=a.state.at(own),
        residuals=a.residuals[used],
        whitened=a.whitened[used],
        platform_given_cameras=a.platform_given_cameras[own],
        platform_common=a.platform_common[own],
        unknowns=replace(a.unknowns, used=a.unknowns.used[own]),
    )
    part = o.take(rows)
    return replace(
        m,
        frames=m.frames[own] - shift,
        T_base_platform=m.T_base_platform[own],
        covariance=m.covariance[own],
        common=m.common[own],
        unsolved=here,
        observations=replace(part, frames=o.frames[:count], frame=part.frame - k * count),
        inliers=m.inliers[rows],
        residuals=m.residuals[rows],
        weights=m.weights[rows[solved]],
        adjustment=adjustment,
    )


def is_on_remounted_cube(observations: Observations, design: Design, markers: MarkerMap) -> Booleans:
    """Whether each corner (n,) is on a remounted cube: one taken off since its place was stated."""
    names = {target.name for target in design.targets if target.turned is not None}
    return np.array([name in names for name in markers.target])[observations.marker]


def measure_without_remounted_cubes(
    observations: Observations, on_remounted_cube: Booleans, measure: Callable[[Observations], Measurement]
) -> Measurement:
    """Measurement without the corners on remounted cubes, which are only listed as outliers.

    on_remounted_cube : (n,) bool, of each corner; measure : of Observations. Raises what it raises
    """
    if not on_remounted_cube.any():
        return measure(observations)
    found = measure(observations.take(~on_remounted_cube))
    covariance, inliers, residuals = (
        observations.covariance * found.factor,
        np.zeros(len(on_remounted_cube), bool),
        np.full((len(on_remounted_cube), 2), np.nan),
    )
    covariance[~on_remounted_cube] = found.observations.covariance
    inliers[~on_remounted_cube], residuals[~on_remounted_cube] = found.inliers, found.residuals
    solved = np.isin(observations.frames[observations.frame], found.frames)
    weights = covariance.copy()
    weights[solved & ~on_remounted_cube] = found.weights
    seen = replace(observations, covariance=covariance)
    at = np.flatnonzero(solved & on_remounted_cube)
    own = seen.take(at)
    own = replace(own, frames=found.frames, frame=np.searchsorted(found.frames, own.frames[own.frame]))
    residuals[at] = own.uv - predict_corners(own, found.adjustment.state)[0]
    return replace(found, observations=seen, inliers=inliers, residuals=residuals, weights=weights[solved])
