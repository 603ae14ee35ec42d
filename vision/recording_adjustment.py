"""Adjustment of a recording's corners: cameras, and the platform's pose in every frame with covariance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.model.design import Camera, Design
from rig.recording.recording_tables import Corners
from rig.report.pages.html_and_svg_elements import result_html
from vision.bundle.bundle_adjustment import Adjustment, adjust_bundle
from vision.bundle.printing_error_estimation import adjust_with_estimated_printing_errors
from vision.bundle.robust_adjustment import adjust_robustly, inflate_repeated_corner_covariance
from vision.corner_observations import Observations, observations_of_frames
from vision.pose.body_pose import FINEST
from vision.pose.frame_and_camera_poses import (
    Frames,
    Views,
    camera_poses_from_body_poses,
    locate_cameras_without_base_targets,
    locate_fixed_cameras,
    locate_frames,
)
from vision.predict import State, predict_corners
from vision.targets import MarkerMap

FAR = 30.0  # px; a corner that lies farther from where it ought to be says no more by it
# standard deviations; what a draw that all poses share moves all of them together by, below which each pose bears it
# alone
NEGLIGIBLE = 1e-2
UNSURE = 3.0  # px; where places are free, what stated ones may be off by before a frame that they hold is doubted


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """What a recording's images say.

    design : Design with cameras as adjusted; frames : (f,) numbers of the solved frames
    T_base_platform : RigidTransform (f,); covariance : (f, 6, 6) on the right, cameras' uncertainty included
    common : (f, 6, k) the part of it shared by all frames: error = common[f] z + its own, z ~ N(0, I)
    unsolved : {frame number: reason}; observations : all corners, covariance scaled to the scatter seen
    inliers : (n,) bool; residuals : (n, 2) px, NaN where the frame is unsolved
    noise : px, standard deviation of a corner per axis; standing : px, the part of a corner's error that comes back in
    every frame where neither camera nor marker moves; weights : (k, 2, 2) px^2 covariance of the solved frames' corners
    with that allowed for; factor : what stated covariances were multiplied by
    adjustment : the last Adjustment, for its shared unknowns
    stages : {number (from 1): Measurement} of a chain's stages below the last that carry targets, of T_base_stage;
        common has the same draws
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

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        total = len(self.frames) + len(self.unsolved)
        position, rotation = (
            np.sqrt(np.mean(np.trace(self.covariance[:, part, part], axis1=1, axis2=2))) * 1e3
            for part in (slice(0, 3), slice(3, 6))
        )
        missed = [f"frame {frame} has no pose: {reason}" for frame, reason in list(self.unsolved.items())[:5]]
        return result_html(
            f"{len(self.frames)} of {total} frames solved",
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
        solved = np.searchsorted(self.observations.frames, self.frames)
        kept = replace(observations_of_frames(self.observations, solved), covariance=self.weights)
        return kept.take(self.inliers[np.isin(self.observations.frame, solved)])

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
    free : what is adjusted, see `adjust_bundle`; progress : called with (label, done, of), or None
    t : (F,) s of the frames; with it, one sighting alone counts where the frames before and after confirm its pose
    cameras : to locate frames by, where they are better known than the design has them
    Returns Measurement. Raises NotEnoughData where no frame can be solved, with the reasons.
    """
    places = bool({"markers", "targets"} & set(free))
    count = len(observations.frames)
    stated = State(design.cameras, None, {}, marker_map)
    cameras, markers = cameras or design.cameras, marker_map
    finest, covariance = UNSURE if places else FINEST, observations.covariance
    for _ in range(2 if places else 1):  # once to find the places, once more with these
        views = Views(replace(observations, covariance=covariance), cameras, markers, finest)
        found = locate_fixed_cameras(views, cameras) if "poses" in free else {}
        cameras = tuple(replace(c, pose=found.get(i, c.pose)) for i, c in enumerate(cameras))
        frames, cameras = _located(
            views, cameras, t, set(found) if "poses" in free else None, progress and partial(progress, "locating")
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
    solved, keep = fit.solved, np.isin(observations.frame, fit.solved)
    observations = replace(observations, covariance=fit.covariance)
    kept, good = observations_of_frames(observations, solved), fit.inliers[keep]
    weights, standing = inflate_repeated_corner_covariance(kept, good, fit.adjustment.state)
    result = adjust_bundle(
        replace(kept, covariance=weights).take(good),
        fit.adjustment.state,
        free,
        stated=stated,
        printing=fit.adjustment.printing,
    )
    numbers, covariance = observations.frames[solved], result.platform_covariance
    result, common = _in_order(result)
    residuals = np.full((len(observations), 2), np.nan)
    residuals[keep] = kept.uv - predict_corners(kept, result.state)[0]
    noise = np.sqrt(np.median(np.einsum("nii->n", kept.covariance)) / 2)
    return Measurement(
        replace(design, cameras=result.state.cameras),
        numbers,
        result.state.platform,
        covariance,
        common,
        {int(observations.frames[f]): reason for f, reason in unsolved.items()},
        observations,
        fit.inliers,
        residuals,
        float(noise),
        standing,
        weights,
        fit.scale**2,
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
    views: Views,
    cameras: tuple[Camera, ...],
    t: Floats | None,
    held: set[int] | None,
    progress: Callable[[int, int], None] | None,
) -> tuple[Frames, tuple[Camera, ...]]:
    """(Frames, cameras) located by cameras as they are, or, where they may move and no base says where they stand, as
    the body relates them if
    the corners agree better so. held : indices of those that the base placed, None where none may move"""
    found = locate_frames(views, cameras, t, progress)
    other = (
        {}
        if held is None
        else locate_cameras_without_base_targets(views, cameras)
        or camera_poses_from_body_poses(views, cameras, found, held, t, progress)
    )
    if not other:
        return found, cameras
    moved = tuple(replace(c, pose=other.get(i, c.pose)) for i, c in enumerate(cameras))
    again = locate_frames(views, moved, t, progress)
    if _disagreement(views, again, moved) < _disagreement(views, found, cameras):
        return again, moved
    return found, cameras


def _disagreement(views: Views, frames: Frames, cameras: tuple[Camera, ...]) -> float:
    """px, mean by which corners lie from where the frames' poses put them, FAR at the most, so much for each of an
    unsolved frame's.
    """
    o, count = views.observations, len(views.observations.frames)
    uv, ahead = predict_corners(o, State(cameras, frames.all_poses(count), frames.all_moving(count), views.map))
    off = np.linalg.norm(o.uv - uv, axis=1)
    off[(ahead[:, 2] <= 0) | ~np.isfinite(off) | np.isin(o.frame, list(frames.unsolved))] = FAR
    return float(np.minimum(off, FAR).mean())
