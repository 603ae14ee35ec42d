"""Prediction of marker corners in images.

This is the one forward model of the cameras.

It takes poses, cameras and the map of all markers of a rig on their bodies.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Protocol, cast

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.effects.framework.effect_base_class import Effect
from rig.errors import RigError
from rig.model.design import Camera, Design, markers_of_target
from rig.model.machine_motion_simulation import MachineRun
from rig.model.pose import exp, transform_points
from rig.recording.recording_folder import Sensors
from vision import opencv_lens_model as lens
from vision.rolling_shutter_row_time_and_readout_result import rolling_shutter_row_time

# corners 0..3, clockwise from the top left
SQUARE = np.array([[-0.5, 0.5, 0], [0.5, 0.5, 0], [0.5, -0.5, 0], [-0.5, -0.5, 0]])
NORMAL = np.array([0.0, 0.0, 1.0])  # out of the paper


@dataclass(frozen=True, slots=True, eq=False)
class MarkerMap:
    """All markers of a rig, one row each.

    id : (m,), as printed; on_platform : (m,) bool, on what moves: the platform, or a stage of a chain below it;
        stage : (m,) number (from 1) of that stage, 0 for the base's and the platform's own
    T_body_marker : RigidTransform (m,); side, margin : (m,) m; dictionary, target : m names
    shift : (m,) added to an identity where the same print is another row, as that of a cube put back turned
    stated : (m,) bool, whether rig.toml states the pose; one that is not is free when adjusted, and holds no frame
    heights : (m, 4) m by which the corners stand off the marker's plane, along its normal; (1, 4) zeros by default
    corners : (m, 4, 3) m, body frame, corner 0 the marker's own top left, then clockwise; they follow from pose, side
        and heights
    """

    id: Integers
    on_platform: Booleans
    T_body_marker: RigidTransform
    side: Floats
    margin: Floats
    dictionary: list[str]
    target: list[str]
    stage: Floats
    shift: Floats = field(default_factory=lambda: np.zeros(1, int))
    heights: Floats = field(default_factory=lambda: np.zeros((1, 4)))
    stated: Booleans = field(default_factory=lambda: np.ones(1, bool))
    corners: Floats = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "stated", np.broadcast_to(self.stated, self.id.shape))
        object.__setattr__(self, "corners", transform_points(self.T_body_marker, self.in_marker))

    def with_unstated_at(self, other: MarkerMap) -> MarkerMap:
        """The same with markers whose pose is not stated where another MarkerMap of the same markers has them."""
        own, theirs = self.T_body_marker.as_matrix(), other.T_body_marker.as_matrix()
        matrices = np.where(self.stated[:, None, None], own, theirs)
        return replace(self, T_body_marker=RigidTransform.from_matrix(matrices))

    @property
    def in_marker(self) -> Floats:
        """(m, 4, 3) m, the corners in each marker's frame."""
        return self.side[:, None, None] * SQUARE + self.heights[..., None] * NORMAL

    @property
    def key(self) -> Floats:
        """(m,) of each row, no two equal: its identity, shifted."""
        return self.id + self.shift

    def rows(self, keys: Integers) -> Integers:
        """Row of each key (n,) -> (n,); -1 for one that no target has."""
        own = self.key
        order = np.argsort(own)
        at = np.minimum(np.searchsorted(own[order], keys), len(order) - 1)
        return np.where(own[order][at] == keys, order[at], -1)


def are_all_marker_poses_known(design: Design) -> bool:
    """Whether the pose of every marker on its body is stated or found."""
    return all(marker.pose is not None for target in design.targets for marker in target.listed)


def marker_map(design: Design, unplaced: RigidTransform | None = None) -> MarkerMap:
    """MarkerMap of all markers of a Design.

    unplaced : pose of markers whose pose is neither stated nor found; None where there must not be any
    Raises ValueError for a design without targets, RigError for a marker without a pose
    """
    rows = [(marker, target) for target in design.targets for marker in markers_of_target(target)]
    if not rows:
        raise ValueError(f"design {design.name!r} has no targets")
    return MarkerMap(
        id=np.array([marker.id for marker, _ in rows]),
        on_platform=np.array([target.body != "base" for _, target in rows]),
        T_body_marker=RigidTransform.concatenate(
            [unplaced if marker.pose is None and unplaced is not None else marker.T_body_marker for marker, _ in rows]
        ),
        side=np.array([marker.side for marker, _ in rows]),
        margin=np.array([marker.margin for marker, _ in rows]),
        dictionary=[target.dictionary for _, target in rows],
        target=[target.name for _, target in rows],
        stage=np.array([target.stage for _, target in rows]),
        shift=np.array([target.shift for _, target in rows]),
        stated=np.array([marker.stated for marker, _ in rows]),
    )


@cache
def marker_cells(dictionary_name: str, number: int) -> Floats:
    """Cells (n + 4, n + 4) of a marker of a dictionary, 1 white, with black border and white ring."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary_name))
    bits = cv2.aruco.generateImageMarker(dictionary, number, dictionary.markerSize + 2) > 127
    return np.pad(bits, 1, constant_values=True).astype(np.float64)


STEEPEST = np.cos(np.radians(78))  # markers seen more obliquely than this are not expected
INSIDE = 2.0  # px; an expected marker's corners lie this far inside the image


class ObservedCorners(Protocol):
    """What is asked of n corners that were seen, sorted by camera; vision.corner_observations_and_merging has them."""

    @property
    def frame(self) -> Integers:
        """(n,) index of the frame."""

    @property
    def camera(self) -> Integers:
        """(n,) index of the camera."""

    @property
    def marker(self) -> Integers:
        """(n,) row of the marker map."""

    @property
    def corner(self) -> Integers:
        """(n,) 0..3."""

    def body_points(self, markers: MarkerMap | None) -> Floats:
        """(n, 3) m in the body's frame at the frame's time; markers : that have their places, None as stated"""

    @property
    def on_platform(self) -> Booleans:
        """(n,) bool."""

    def __len__(self) -> int: ...


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Cameras (fixed ones posed), platform : T_base_platform (F,), moving : {camera index: T_base_camera (F,)}.

    markers : MarkerMap where the markers' places are known better than the observations state them, else None
    """

    cameras: tuple[Camera, ...]
    platform: RigidTransform
    moving: dict[int, RigidTransform]
    markers: MarkerMap | None = None

    @property
    def placed(self) -> MarkerMap:
        """Its markers. Raises ValueError for a state that has none."""
        if self.markers is None:
            raise ValueError("expected a state that has its markers, got one whose markers belong to the observations")
        return self.markers

    def at(self, frames: Integers) -> State:
        """The same with only the frames of an index or mask (F,)."""
        return State(self.cameras, self.platform[frames], {i: T[frames] for i, T in self.moving.items()}, self.markers)


def predict_corners(observations: ObservedCorners, state: State) -> tuple[Floats, Floats]:
    """Predicted pixels (n, 2) of the observed corners, and their points (n, 3) m in the camera's frame."""
    base, uv, ahead = (
        observed_points_base(observations, state),
        np.empty((len(observations), 2)),
        np.empty((len(observations), 3)),
    )
    for i, camera, rows in iterate_observed_cameras(observations, state):
        ahead[rows] = base_points_in_camera_frame(base[rows], observations.frame[rows], state, i)
        uv[rows] = lens.project(ahead[rows], camera.matrix, camera.distortion)
    return uv, ahead


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """k markers in images. frame : (k,) index; camera : (k,) index; marker : (k,) row of the marker map."""

    frame: Integers
    camera: Integers
    marker: Integers

    def take(self, index: Booleans | Integers) -> Sightings:
        """Those of an index or mask (k,)."""
        return Sightings(self.frame[index], self.camera[index], self.marker[index])


def sightings_facing_cameras_anywhere(state: State, markers: MarkerMap, least_cosine: float = STEEPEST) -> Sightings:
    """Sightings of all markers in front of a camera and facing it, whether in its image or outside.

    least_cosine : of the tilt
    """
    base, normals = _quads(state.platform, markers)
    out = []
    for i, camera in enumerate(state.cameras):
        eye = state.moving[i].translation[:, None] if i in state.moving else camera.pose.translation
        R = state.moving[i].rotation.as_matrix()[:, None] if i in state.moving else camera.pose.rotation.as_matrix()
        sight = base.mean(axis=2) - eye
        cosine = -np.einsum("fmi,fmi->fm", normals, sight) / np.linalg.norm(sight, axis=2)
        depth = (sight[..., None, :] @ R)[..., 0, 2]
        frame, marker = np.nonzero((cosine > least_cosine) & (depth > 2 * markers.side))
        out.append((frame, np.full(len(frame), i), marker))
    return Sightings(*(np.concatenate(column) for column in zip(*out)))


def predict_sightings(
    sightings: Sightings,
    state: State,
    markers: MarkerMap,
    t: Floats | None = None,
    effects: Sequence[Effect] = (),
    sensors: Sensors | None = None,
    run: MachineRun | None = None,
) -> Floats:
    """Predicted corners (k, 4, 2) px of sightings, with all effects on markers, cameras and exposure time.

    state : State; markers : MarkerMap as stated; t : (F,) s of the frames, for effects in time; sensors : Sensors or
        None
    run : MachineRun with rates, needed where rows of a camera are exposed one after the other
    Raises RigError where an effect needs a sensor channel that is not there
    """
    for effect in effects:
        markers = effect.attach(markers)
    t = np.zeros(len(state.platform)) if t is None else np.asarray(t, float)
    used, seen_as = np.unique(sightings.marker, return_inverse=True)
    corners, _ = _quads(state.platform, markers, used)
    uv = np.empty((len(sightings.frame), 4, 2))
    for i in np.unique(sightings.camera):
        rows = np.flatnonzero(sightings.camera == i)
        frame, marker = sightings.frame[rows], sightings.marker[rows]
        points = corners[frame, seen_as[rows]]
        view = _view(state, int(i), t, effects, sensors)
        quads = view(points, frame)
        late = _late(state.cameras[i], effects, quads[..., 1])
        on = markers.on_platform[marker]
        if late.any() and run is not None:
            for _ in range(3):  # the row tells the moment, the moment tells the row
                quads = view(_delayed(points, markers, marker, state, frame, on, run, late), frame)
                late = _late(state.cameras[i], effects, quads[..., 1])
        for effect in effects:
            quads = effect.print_(state.cameras[i], quads)
        uv[rows] = quads
    return uv


def visible_marker_counts_over_all_cameras(
    cameras: tuple[Camera, ...], T_base_platform: RigidTransform, markers: MarkerMap
) -> Integers:
    """Counts (F,) of the markers visible at each of poses (F,).

    They are whole in an image; occlusion is ignored.
    What stands in the way is not looked at
    """
    held = {i: T_base_platform * camera.pose for i, camera in enumerate(cameras) if camera.mount == "hand"}
    state = State(cameras, T_base_platform, held)
    found = sightings_facing_cameras_anywhere(state, markers)
    found = found.take(markers.on_platform[found.marker] != bool(held))
    whole = is_inside_image(found, predict_sightings(found, state, markers), cameras)
    pairs = np.unique(np.stack([found.frame[whole], found.marker[whole]], axis=1), axis=0)
    return np.bincount(pairs[:, 0], minlength=len(T_base_platform))


def is_inside_image(sightings: Sightings, uv: Floats, cameras: Sequence[Camera], margin: float = INSIDE) -> Booleans:
    """Whether all corners (k, 4, 2) px of each sighting lie in their camera's image, by a margin (px)."""
    size = np.array([[camera.width, camera.height] for camera in cameras])[sightings.camera]
    return cast(Booleans, ((uv > margin) & (uv < size[:, None] - 1 - margin)).all(axis=(1, 2)))


def expected_marker_rows_and_corners_in_image(
    camera: Camera, T_base_platform: RigidTransform, marker_map: MarkerMap
) -> tuple[Integers, Floats]:
    """Markers expected whole in a fixed camera's image: their rows (k,), and their corners (k, 4, 2) px."""
    to_camera = camera.pose.inv().as_matrix()
    matrix = np.where(marker_map.on_platform[:, None, None], to_camera @ T_base_platform.as_matrix(), to_camera)
    ahead = marker_map.corners @ np.swapaxes(matrix[:, :3, :3], 1, 2) + matrix[:, None, :3, 3]
    middle, out = ahead.mean(axis=1), np.cross(ahead[:, 0] - ahead[:, 1], ahead[:, 2] - ahead[:, 1])
    cosine = -(out * middle).sum(axis=1) / np.sqrt((out**2).sum(axis=1) * (middle**2).sum(axis=1))
    rows = np.flatnonzero((cosine > STEEPEST) & (ahead[:, :, 2].min(axis=1) > marker_map.side))
    uv = lens.project(ahead[rows], camera.matrix, camera.distortion)
    size = np.array([camera.width, camera.height])
    whole = ((uv > INSIDE) & (uv < size - 1 - INSIDE)).all(axis=(1, 2))
    return rows[whole], uv[whole]


def _quads(platform: RigidTransform, markers: MarkerMap, rows: Integers | slice = slice(None)) -> tuple[Floats, Floats]:
    """Corners (F, m, 4, 3) m and normals (F, m, 3) of some markers' rows (m,) in the base frame, at poses platform
    (F,).
    """
    on = markers.on_platform[rows]
    matrix = platform.as_matrix()[:, None]
    own = markers.corners[rows]
    corners = np.broadcast_to(own, (len(platform), *own.shape)).copy()
    facing = markers.T_body_marker.rotation.as_matrix()[rows, :, 2]
    normals = np.broadcast_to(facing, (len(platform), len(on), 3)).copy()
    corners[:, on] = corners[:, on] @ np.swapaxes(matrix[..., :3, :3], -1, -2) + matrix[..., None, :3, 3]
    normals[:, on] = (matrix[..., :3, :3] @ normals[:, on][..., None])[..., 0]
    return corners, normals


def _view(
    state: State, i: int, t: Floats, effects: Sequence[Effect], sensors: Sensors | None
) -> Callable[[Floats, Integers], Floats]:
    """A function (points (k, 4, 3) m in the base, frame (k,)) -> pixels (k, 4, 2) through camera i with its effects."""
    camera = state.cameras[i]
    mount, focal = np.zeros((len(t), 6)), np.ones(len(t))

    def channel(*names: str) -> Floats:
        if sensors is None:
            raise RigError(
                f"the model needs a sensor channel {' or '.join(map(repr, names))}, and the recording has no "
                "sensors.csv"
            )
        return sensors.at(t, *names)

    for effect in effects:
        mount += effect.mount(camera, t, channel)
        focal *= effect.focal(camera, t, channel)
        camera = effect.camera(camera)
    poses = state.moving.get(i, camera.pose)
    matrix = np.broadcast_to((poses * exp(mount) if mount.any() else poses).inv().as_matrix(), (len(t), 4, 4))
    centre = camera.matrix[:2, 2]

    def look(points: Floats, frame: Integers) -> Floats:
        ahead = points @ np.swapaxes(matrix[frame, :3, :3], 1, 2) + matrix[frame, None, :3, 3]
        for effect in effects:
            ahead = effect.bend(camera, ahead)
        uv = lens.project(ahead, camera.matrix, camera.distortion)
        return uv if (focal == 1).all() else centre + (uv - centre) * focal[frame, None, None]

    return look


def _late(camera: Camera, effects: Sequence[Effect], v: Floats) -> Floats:
    """(k, 4) s by which corners in image rows v (k, 4) are exposed after the middle row."""
    late = (v - camera.height / 2) * rolling_shutter_row_time(camera)
    for effect in effects:
        late = late + effect.late(camera, v)
    return late


def _delayed(
    corners: Floats,
    markers: MarkerMap,
    marker: Integers,
    state: State,
    frame: Integers,
    on: Booleans,
    run: MachineRun,
    late: Floats,
) -> Floats:
    """Corners (k, 4, 3) m in the base, those on the platform where it is `late` (k, 4) s after its frame's exposure."""
    if run.rate is None or run.curvature is None:
        raise ValueError("a rolling shutter requires a run with rates; it has none")
    step = late[..., None] * run.rate[frame][:, None] + late[..., None] ** 2 / 2 * run.curvature[frame][:, None]
    moved = exp(step).as_matrix()
    body = (moved[..., :3, :3] @ markers.corners[marker][..., None])[..., 0] + moved[..., :3, 3]
    matrix = state.platform.as_matrix()[frame]
    base = body @ np.swapaxes(matrix[:, :3, :3], 1, 2) + matrix[:, None, :3, 3]
    return np.where(on[:, None, None], base, corners)


def iterate_observed_cameras(observations: ObservedCorners, state: State) -> Iterator[tuple[int, Camera, slice]]:
    """Iterate over the cameras with observed corners: (camera index, Camera, slice of its corners)."""
    edges = np.searchsorted(observations.camera, np.arange(len(state.cameras) + 1))
    for i, camera in enumerate(state.cameras):
        if edges[i] < edges[i + 1]:
            yield i, camera, slice(edges[i], edges[i + 1])


def observed_points_body(observations: ObservedCorners, state: State) -> Floats:
    """Observed points (n, 3) m in their body's frame, as it stands at the frame's exposure."""
    return observations.body_points(state.markers)


def observed_points_base(observations: ObservedCorners, state: State) -> Floats:
    """Observed points (n, 3) m in the base frame."""
    points = np.ascontiguousarray(observed_points_body(observations, state))
    out = np.empty(points.shape)
    lens.fill_base_frame_points(points, state.platform.as_matrix(), observations.frame, observations.on_platform, out)
    return out


def base_points_in_camera_frame(points_base: Floats, exposure: Integers, state: State, camera_index: int) -> Floats:
    """Points (n, 3) m of the base in the frame of one camera, each at its exposure (n,), the index of a frame."""
    if camera_index in state.moving:
        matrix = state.moving[camera_index].inv().as_matrix()[exposure]
        return (matrix[:, :3, :3] @ points_base[..., None])[..., 0] + matrix[:, :3, 3]
    return transform_points(state.cameras[camera_index].pose.inv(), points_base)
