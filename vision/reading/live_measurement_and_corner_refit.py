"""Live measurement of a growing recording, and corner refit with adjusted lenses.

Corners of all markers are fitted once more where the adjusted lenses bend markers otherwise. A marker is fitted as a
whole, its sides bent as the lens bends them: a lens as its owner states it, a thousandth off, moves the corners of a
large marker by some thousandths of a pixel, the same in every image where it stands there.

Live, each frame's corners and pose are measured, and cameras adjusted now and then. The first frames' images are
searched whole; from then on only the places are read where markers ought to be. Between two adjustments the cameras are
held, so that one that has moved shows. Adjusting takes seconds and is done beside: frames that come meanwhile are
measured with the cameras as they were.

The first images' corners are placed once more by the lens as measured, until that bends no marker otherwise. Else what
the stated lens did to their corners would be in all poses to come.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats, Pixels
from rig.compute.parallel_map_and_dask_cluster import path_seen_by_cluster_workers
from rig.compute.worker_processes import worker_count
from rig.errors import NotEnoughData
from rig.model.design import Camera, Design
from rig.model.pose import adjoint
from rig.recording.corner_and_pose_csv_tables import Corners
from rig.recording.exposures_and_image_files import read_grey_or_colour_image
from rig.recording.recording_folder import Recording
from vision.corner_observations_and_merging import Observations, empty_observations, observations_from_corners
from vision.corners import local_lens_and_fit_start
from vision.corners.edge_spread_function import PLAIN_EDGE_SPREAD, EdgeSpread
from vision.corners.marker_detection_and_corner_fit import (
    REACH,
    Detection,
    ReadMarkers,
    detect_markers,
    fit_read_markers,
    grey_image_at_full_depth,
)
from vision.marker_corner_prediction import (
    MarkerMap,
    State,
    expected_marker_rows_and_corners_in_image,
    marker_map,
    predict_corners,
)
from vision.pose.body_pose import FINEST
from vision.pose.frame_and_camera_poses import (
    UndistortedCorners,
    locate_fixed_cameras,
    locate_platform_and_moving_cameras,
)
from vision.reading.corner_reading_from_recording_images import (
    Collected,
    corners_and_correlation_from_detections,
    group_corners_by_image,
    learn_camera_edge_spread,
)
from vision.reading.parallel_image_map_rendered_markers_and_white_level import map_images_in_processes
from vision.recording_adjustment_with_hand_and_stages import (
    Measurement,
    design_seen_from_hand,
    has_hand_cameras,
    measure_observations,
)

SETTLED = 2e-3  # px, by which a lens may bend a marker otherwise than another: that moves corners by a tenth of it
ROUNDS = 3  # of placing and measuring; a round leaves a few hundredths of what the one before was off by
STRAIGHT = 3  # of a polynomial's terms: where a marker is, and how it is stretched, its corners have anyway


def largest_pixel_shift_between_lenses(
    corners: Corners, fitted_with: Mapping[str, Camera], cameras: Sequence[Camera]
) -> float:
    """Largest shift, px, of a marker between two lenses.

    The lenses fitted with and the adjusted ones.
    corners : all four of every marker
    """
    most, names, centres = (
        0.0,
        np.array(corners.camera)[::4],
        local_lens_and_fit_start.local_coordinate_origins_and_scales(corners.uv.reshape(-1, 4, 2)),
    )
    for camera in cameras:
        own = centres[names == camera.name]
        if len(own):
            bent = np.empty((2, len(own), 2, local_lens_and_fit_start.TERMS))
            for k, one in enumerate((fitted_with[camera.name], camera)):
                local_lens_and_fit_start.fill_local_lens_polynomials(
                    local_lens_and_fit_start.ideal_coordinate_table(one), own, bent[k]
                )
            apart = np.abs(bent[1] - bent[0])[..., STRAIGHT:].sum(axis=-1) * own[:, 2:]
            most = max(most, float(np.nanmax(apart)))
    return most


def refit_corners(
    recording: Recording,
    collected: Collected,
    adjusted_cameras: Sequence[Camera],
    marker_map: MarkerMap,
    progress: Callable[[int, int], None] | None = None,
) -> Collected:
    """Corners of all markers refitted with the adjusted cameras.

    Returns Collected
    Raises FileError naming the image that cannot be decoded
    """
    lenses, seen = {camera.name: camera for camera in adjusted_cameras}, group_corners_by_image(collected.corners)
    images = [
        (int(frame), camera, name, ReadMarkers(*seen[int(frame), camera]))
        for frame, camera, name in zip(recording.exposures.frame, recording.exposures.camera, recording.exposures.image)
        if name and (int(frame), camera) in seen
    ]
    folder, spread = path_seen_by_cluster_workers(recording.folder), collected.spread

    def one(image: tuple[int, str, str, ReadMarkers]) -> Detection:
        _, camera, name, read = image
        return fit_read_markers(
            grey_image_at_full_depth(read_grey_or_colour_image(folder / name)),
            lenses[camera],
            marker_map,
            read,
            spread.get(camera, PLAIN_EDGE_SPREAD),
            search_distance=0.0,
        )

    found = map_images_in_processes(one, images, progress)
    corners, correlation = corners_and_correlation_from_detections(
        [(frame, camera, d) for (frame, camera, *_), d in zip(images, found)]
    )
    return replace(collected, corners=corners, correlation=correlation, cameras=lenses)


Rows = tuple[tuple[int, str, Detection], ...]  # frame, camera, what its image shows
Images = tuple[tuple[int, str, Pixels], ...]  # frame, camera, its image
TAUGHT = (6, 12, 24, 48, 96)  # solved frames after which cameras are adjusted to all so far


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What one frame shows. T_base_platform : None where it is not solved, then `reason` says why.

    covariance : (6, 6) on the right, None too while the cameras have not been adjusted: their share is not known before
        that
    observations : Observations of this frame alone; residuals : (n, 2) px against the pose and the cameras held, NaN
        where unsolved
    inliers : (n,) bool; detections : {camera: Detection}; expected : {camera: identities that ought to be seen at the
        pose}
    """

    frame: int
    T_base_platform: RigidTransform | None
    covariance: Floats | None
    reason: str
    observations: Observations
    residuals: Floats
    inliers: Booleans
    detections: dict[str, Detection]
    expected: dict[str, tuple[int, ...]]


def sight_from_measuring_limbs(frame: int, T_base_platform: RigidTransform, covariance: Floats) -> Sight:
    """Result (Sight) of a frame whose pose and covariance (6, 6) come from measuring limbs, without images."""
    return Sight(
        frame, T_base_platform, covariance, "", empty_observations(frame), np.zeros((0, 2)), np.zeros(0, bool), {}, {}
    )


def _sight_from_hand(sight: Sight) -> Sight:
    """The Sight of a base that was seen from the platform: where the platform stands, by the inverse, with its
    covariance.
    """
    T = sight.T_base_platform
    if T is None:
        return sight
    inverted = adjoint(T)
    return replace(
        sight,
        T_base_platform=T.inv(),
        covariance=None if sight.covariance is None else inverted @ sight.covariance @ inverted.T,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Adjusted:
    """What an adjustment came to. refitted : {(frame, camera): Detection} placed anew; spread : {camera: Spread}, both
    empty where not learnt anew.
    """

    measurement: Measurement | None
    spread: dict[str, EdgeSpread]
    refitted: dict[tuple[int, str], Detection]


class Live:
    """The measuring of one run. design : Design as stated, one whose cameras are in the hand as seen from there (see
    vision.recording_measurement)
    cameras : as adjusted so far; noise : px of a corner, None before that."""

    def __init__(self, design: Design) -> None:
        if not design.cameras or not design.targets:
            raise NotEnoughData(
                f"measuring requires at least a camera and a target; rig.toml has {len(design.cameras)} and "
                f"{len(design.targets)}"
            )
        self._held = has_hand_cameras(design)
        design = design_seen_from_hand(design) if self._held else design.without_stages()
        self.design, self.markers = design, marker_map(design)
        self.cameras = design.cameras
        self.noise: float | None = None
        self._rows: list[tuple[int, str, Detection]] = []
        self._solved, self._factor = 0, 1.0
        self._measurement: Measurement | None = None
        self._first: list[
            tuple[int, str, Pixels]
        ] = []  # images from which the cameras' edges are learnt; none once they are
        self._spread = {camera.name: PLAIN_EDGE_SPREAD for camera in design.cameras}
        self._pool, self._adjusting_pool = ThreadPoolExecutor(worker_count()), ThreadPoolExecutor(1)
        self._adjusting: Future[_Adjusted] | None = None
        self._adjusted_frames = 0  # frames of the last adjustment that was begun

    def take(self, frame: int, images: dict[str, Pixels], T_expected: RigidTransform | None = None) -> Sight:
        """The sight of a frame. images : {camera: as cv2 reads it}; T_expected : where the platform ought to be, or
        None.
        """
        self._adopt()
        if self._held and T_expected is not None:
            T_expected = T_expected.inv()
        by_name = {camera.name: camera for camera in self.cameras}
        adjusted = self._measurement is not None and T_expected is not None
        work = [
            (
                name,
                self._pool.submit(
                    detect_markers,
                    image,
                    by_name[name],
                    self.markers,
                    self._spread[name],
                    T_expected if adjusted and by_name[name].mount == "fixed" else None,
                ),
            )
            for name, image in images.items()
        ]
        detections = {name: future.result() for name, future in work}
        rows = [(frame, name, detection) for name, detection in detections.items()]
        self._rows += rows
        if self._measurement is None and len(self._first) < TAUGHT[1] * len(images):
            self._first += [(frame, name, image) for name, image in images.items()]
        sight = self._locate(frame, rows, detections)
        self._solved += sight.T_base_platform is not None
        return _sight_from_hand(sight) if self._held else sight

    def adjust(self) -> None:
        """Begin to adjust cameras to all frames so far where it is time to; what comes of it is taken over with a frame
        to come.
        """
        due = max((count for count in TAUGHT if count <= self._solved), default=0)
        if due > self._adjusted_frames and self._adjusting is None:
            self._adjusted_frames = due
            self._adjusting = self._adjusting_pool.submit(
                self._adjusted, tuple(self._rows), tuple(self._first), {c.name: c for c in self.cameras}
            )
            self._first = self._first if self._measurement is None else []

    def _adopt(self) -> None:
        """Take over an adjustment that has come to its end. Raises what it raised."""
        if self._adjusting is None or not self._adjusting.done():
            return
        adjusting, self._adjusting = self._adjusting, None
        done = adjusting.result()
        self._spread |= done.spread
        self._rows = [
            (frame, name, done.refitted.get((frame, name), detection)) for frame, name, detection in self._rows
        ]
        if done.measurement is not None:
            m = self._measurement = done.measurement
            self.cameras, self.noise, self._factor = m.design.cameras, m.noise, m.factor

    def _adjusted(self, rows: Rows, first: Images, cameras: dict[str, Camera]) -> _Adjusted:
        """Cameras adjusted to all of some rows. first : images from which to learn how each camera's edges look and
        which are placed once more, or none; cameras : {name: Camera} by which these are placed at first"""
        full = {(frame, name): grey_image_at_full_depth(image) for frame, name, image in first}
        seen = {(frame, name): detection for frame, name, detection in rows if (frame, name) in full}
        spread = {
            name: learn_camera_edge_spread(
                [(full[key], d.read) for key, d in seen.items() if key[1] == name], camera, self.markers
            )
            for name, camera in cameras.items()
            if any(key[1] == name for key in seen)
        }
        measurement, refitted, placed_by = None, dict[tuple[int, str], Detection](), cameras
        for _ in range(1 + (ROUNDS if seen else 0)):
            refitted = {
                key: fit_read_markers(
                    full[key], placed_by[key[1]], self.markers, d.read, spread[key[1]], 0.0 if refitted else REACH
                )
                for key, d in (refitted or seen).items()
            }
            corners, correlation = corners_and_correlation_from_detections(
                [(frame, name, refitted.get((frame, name), detection)) for frame, name, detection in rows]
            )
            observed = observations_from_corners(
                corners, np.unique(corners.frame), self.design, self.markers, correlation
            )
            try:
                measurement = measure_observations(observed, self.design, self.markers)
            except NotEnoughData:
                return _Adjusted(None, spread, refitted)
            if (
                not seen
                or largest_pixel_shift_between_lenses(
                    corners_and_correlation_from_detections([(*key, d) for key, d in refitted.items()])[0],
                    placed_by,
                    measurement.design.cameras,
                )
                < SETTLED
            ):
                break
            placed_by = {camera.name: camera for camera in measurement.design.cameras}
        return _Adjusted(measurement, spread, refitted)

    def close(self) -> None:
        """End the threads, once what is adjusted has come to its end. Raises what that raised."""
        self._pool.shutdown()
        self._adjusting_pool.shutdown()
        if self._adjusting is not None:
            self._adjusting.result()

    def _locate(self, frame: int, rows: list[tuple[int, str, Detection]], detections: dict[str, Detection]) -> Sight:
        corners, correlation = corners_and_correlation_from_detections(rows)
        observed = observations_from_corners(corners, np.array([frame]), self.design, self.markers, correlation)
        observed = replace(observed, covariance=observed.covariance * self._factor)
        nothing = Sight(
            frame,
            None,
            None,
            "no marker of the rig is seen",
            observed,
            np.full((len(observed), 2), np.nan),
            np.zeros(len(observed), bool),
            detections,
            {},
        )
        if not len(observed):
            return nothing
        cameras = self.cameras if self._measurement is not None else self._resected(corners)
        undistorted_corners = UndistortedCorners(observed, cameras, self.markers, FINEST)
        found = locate_platform_and_moving_cameras(undistorted_corners, cameras)
        if 0 not in found.poses:
            return replace(nothing, reason=found.unsolved[0])
        T = RigidTransform.from_matrix(found.poses[0])
        state = State(cameras, found.all_poses(1), found.all_moving(1))
        on = np.flatnonzero(observed.on_platform)
        T_camera_base = np.array(
            [
                state.moving[i][0].inv().as_matrix() if i in state.moving else camera.pose.inv().as_matrix()
                for i, camera in enumerate(cameras)
            ]
        )
        located = undistorted_corners.locate(on, T_camera_base)
        inliers = np.ones(len(observed), bool)
        inliers[on] = located.inliers if located else True
        residuals = observed.uv - predict_corners(observed, state)[0]
        return replace(
            nothing,
            T_base_platform=T,
            covariance=self._uncertain(T, located.covariance) if located else None,
            reason="",
            residuals=residuals,
            inliers=inliers,
            expected={name: self._ought(cameras, name, T) for name in detections},
        )

    def _resected(self, corners: Corners) -> tuple[Camera, ...]:
        """Cameras where their own images of the base's markers put them, before they are adjusted."""
        every, correlation = corners_and_correlation_from_detections(self._rows)
        observed = observations_from_corners(every, np.unique(every.frame), self.design, self.markers, correlation)
        found = locate_fixed_cameras(
            UndistortedCorners(observed, self.design.cameras, self.markers, FINEST), self.design.cameras
        )
        return tuple(replace(camera, pose=found.get(i, camera.pose)) for i, camera in enumerate(self.design.cameras))

    def _ought(self, cameras: tuple[Camera, ...], name: str, T: RigidTransform) -> tuple[int, ...]:
        camera = next(camera for camera in cameras if camera.name == name)
        return (
            tuple(self.markers.id[expected_marker_rows_and_corners_in_image(camera, T, self.markers)[0]].tolist())
            if camera.mount == "fixed"
            else ()
        )

    def _uncertain(self, T: RigidTransform, own: Floats) -> Floats | None:
        """(6, 6) a pose's own covariance and what the cameras' adds, as it is at the nearest pose to which they were
        adjusted.
        """
        m = self._measurement
        if m is None:
            return None
        near = int(np.argmin(np.linalg.norm(m.T_base_platform.translation - T.translation, axis=1)))
        return own + m.common[near] @ m.common[near].T
