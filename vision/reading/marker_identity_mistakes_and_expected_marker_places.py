"""Mistakes of marker identity, and places of markers expected in unread images.

Markers may be turned, exchanged, mirrored, repeated, of another dictionary. A sighting most of whose corners were set
aside is held against every place that a marker of the rig has, in every turn and mirrored: a marker that is mostly seen
where something else should be is that. Nothing is mended here; the sightings stay set aside.

Places are expected by cameras and poses learned from images already read.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, Integers, Pixels
from rig.errors import NotConverged, NotEnoughData
from rig.model import mechanisms
from rig.model.design import Camera, Design
from rig.model.pose import exp, pose_difference
from rig.recording.corner_and_pose_csv_tables import Corners
from rig.recording.recording_folder import Recording
from vision.corner_observations_and_merging import observations_from_corners
from vision.corners.marker_detection_and_corner_fit import opencv_detector, read_marker_ids
from vision.marker_corner_prediction import (
    MarkerMap,
    Sightings,
    State,
    expected_marker_rows_and_corners_in_image,
    predict_corners,
    predict_sightings,
    sightings_facing_cameras_anywhere,
)
from vision.pose.body_pose import FINEST
from vision.pose.frame_and_camera_poses import UndistortedCorners, locate_platform_and_moving_cameras
from vision.recording_adjustment_with_hand_and_stages import Measurement, measure_observations

LEAST = 3  # sightings from which anything is said of a marker
MOSTLY = 0.5  # share of a marker's sightings that are set aside, from which it is reported whatever it looks like
ALIKE = 0.7  # share of those set aside that must look like one and the same thing
FIT = 0.1  # of a marker's side; corners this near to another place, on average, are there
MOST = 40  # sightings of a marker that are held against all places
LOOKED_AT = 4  # images in which a marker that is never seen is looked for, and dictionaries are tried
_TURNS = np.array([[(k + q) % 4 for k in range(4)] for q in range(4)])
_ORDERS = np.concatenate([_TURNS, _TURNS[:, ::-1]])  # (8, 4): turned by so many quarters; then mirrored as well
FAMILIES = (
    "DICT_4X4_1000",
    "DICT_5X5_1000",
    "DICT_6X6_1000",
    "DICT_7X7_1000",
    "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_16h5",
    "DICT_APRILTAG_25h9",
    "DICT_APRILTAG_36h10",
    "DICT_APRILTAG_36h11",
    "DICT_ARUCO_MIP_36h12",
)


ReadImage = Callable[[int, str], Pixels | None]  # see `suspects`


@dataclass(frozen=True, slots=True)
class Suspect:
    """A marker that disagrees with rig.toml.

    marker : identity; kind : "turned", "mirrored", "elsewhere", "exchanged", "twice", "other" or "askew";
        other : identity of the
    marker whose place it has, or that has its place, or -1; turn : quarters counter-clockwise seen from outside;
    like : sightings of `of` that look so
    """

    marker: int
    kind: str
    other: int
    turn: int
    like: int
    of: int

    def __str__(self) -> str:
        quarters = f"turned by {self.turn} quarter{'s' * (self.turn > 1)} counter-clockwise"
        turned = f", {quarters}" if self.turn else ""
        share = f" in {self.like} of {self.of} sightings"
        return (
            f"marker {self.marker}: "
            + {
                "turned": f"is {quarters}{share}",
                "mirrored": f"has its corners in mirrored order{share}",
                "elsewhere": f"sits where marker {self.other} should{turned}{share}",
                "exchanged": f"is exchanged with marker {self.other}{turned} and found there{share}",
                "twice": f"is present more than once in {self.like} images: which is meant is unclear, none is used",
                "other": f"is never seen; in {self.like} of {self.of} images examined, marker {self.other} is in its "
                "place",
                "askew": f"is rejected{share}, and no place or turn of another explains it: a tilted face, a wrong "
                "size or position in rig.toml",
            }[self.kind]
        )


def find_suspicious_markers(
    measurement: Measurement,
    marker_map: MarkerMap,
    repeated_ids: Iterable[int] = (),
    image_reader: ReadImage | None = None,
) -> tuple[Suspect, ...]:
    """Find the suspicious markers (Suspects) of a Measurement.

    They are those not as rig.toml states.
    repeated_ids : identities that one image shows more than once, as often as there are such images; image_reader :
        called with
    (frame number, camera name), returns that image, None where there is none; without it markers that are never seen
    are not looked for Those of a cube that was put back, which sits where nobody has stated, are no suspects
    """
    found = _misplaced(measurement, marker_map)
    found.update(
        {
            number: Suspect(number, "twice", -1, 0, count, count)
            for number, count in Counter(repeated_ids).items()
            if number not in found
        }
    )
    if image_reader:
        found.update(_usurped(measurement, marker_map, image_reader))
    pairs = {k: s.other for k, s in found.items() if s.kind == "elsewhere"}
    for number, s in found.items():
        if s.kind == "elsewhere" and pairs.get(s.other) == number:
            found[number] = Suspect(
                number, "exchanged", *(getattr(s, name) for name in ("other", "turn", "like", "of"))
            )
    loose = {target.name for target in measurement.design.targets if target.turned is not None}
    return tuple(
        found[number]
        for number, name in zip(marker_map.id.tolist(), marker_map.target)
        if number in found and name not in loose
    )


def _misplaced(m: Measurement, marker_map: MarkerMap) -> dict[int, Suspect]:
    """{identity: Suspect} of markers whose sightings were set aside, by what they look like."""
    o, found = m.observations, {}
    solved = np.full(len(o.frames), -1)
    solved[np.searchsorted(o.frames, m.frames)] = np.arange(len(m.frames))
    rows = np.flatnonzero(solved[o.frame] >= 0)
    key = np.stack([o.marker[rows], o.camera[rows], solved[o.frame[rows]]])
    keys, index, count = np.unique(key, axis=1, return_inverse=True, return_counts=True)
    index = index.ravel()
    quads = np.full((len(count), 4, 2), np.nan)
    quads[index, o.corner[rows]] = o.uv[rows]
    aside = (np.bincount(index, weights=m.inliers[rows], minlength=len(count)) <= 1) & (count == 4)
    likely = {}
    for marker in np.unique(keys[0][aside]):
        own, off = keys[0] == marker, np.flatnonzero((keys[0] == marker) & aside)
        some = off[np.unique(np.linspace(0, len(off) - 1, min(MOST, len(off))).round().astype(int))]
        looks = Counter(
            _look(m, marker_map, marker, camera, frame, quad)
            for camera, frame, quad in zip(keys[1, some], keys[2, some], quads[some])
        )
        (look, votes), number = looks.most_common(1)[0], int(marker_map.id[marker])
        if look and votes >= ALIKE * len(some):
            likely[number] = Suspect(number, *look, round(votes / len(some) * len(off)), int(own.sum()))
        elif len(off) >= LEAST and len(off) > MOSTLY * own.sum():
            found[number] = Suspect(number, "askew", -1, 0, len(off), int(own.sum()))
    for number, suspect in likely.items():
        other = likely.get(
            suspect.other
        )  # one that is seldom seen is believed where the other of the pair says the same
        if suspect.like >= LEAST or (other and other.other == number and other.like >= LEAST):
            found[number] = suspect
    return found


def _look(
    m: Measurement, marker_map: MarkerMap, marker: int, camera: int, frame: int, quad: Floats
) -> tuple[str, int, int] | None:
    """(kind, other identity, turn) of the place that a quad (4, 2) px of a marker is in, or None."""
    count = len(marker_map.id)
    places = predict_sightings(
        Sightings(np.full(count, frame), np.full(count, camera), np.arange(count)), m.adjustment.state, marker_map
    )
    sides = np.linalg.norm(places - np.roll(places, 1, axis=1), axis=2).mean(axis=1)
    distance = np.linalg.norm(places[:, _ORDERS] - quad, axis=3).mean(axis=2) / sides[:, None]  # (markers, orders)
    distance[np.arange(count) != marker, 4:] = np.inf  # the far side of a cube looks like a mirrored one
    distance[~np.isfinite(distance)] = np.inf
    other, order = np.unravel_index(np.argmin(distance), distance.shape)
    if distance[other, order] > FIT or (other == marker and order == 0):
        return None
    turn = int(-order % 4)  # its corner 0 is in the place of the order's first one, so many quarters clockwise
    if other != marker:
        return "elsewhere", int(marker_map.id[other]), turn
    return ("turned", -1, turn) if order < 4 else ("mirrored", -1, 0)


def _usurped(m: Measurement, marker_map: MarkerMap, read: ReadImage) -> dict[int, Suspect]:
    """{identity: Suspect} of markers that are never seen, though they should be, because another is in their place."""
    o, found = m.observations, {}
    missing = np.setdiff1d(np.arange(len(marker_map.id)), o.marker)
    cameras = m.design.cameras
    for row in missing:
        sights = sightings_facing_cameras_anywhere(m.adjustment.state, marker_map)
        sights = sights.take(sights.marker == row)
        visible = []
        for frame, camera in zip(sights.frame, sights.camera):
            if cameras[camera].mount != "moving":
                rows, places = expected_marker_rows_and_corners_in_image(
                    cameras[camera], m.T_base_platform[frame], marker_map
                )
                if row in rows:
                    visible.append((int(m.frames[frame]), cameras[camera].name, places[rows == row][0]))
        visible = (
            [
                visible[k]
                for k in np.unique(np.linspace(0, len(visible) - 1, min(LOOKED_AT, len(visible))).round().astype(int))
            ]
            if visible
            else []
        )
        images = [(read(frame, name), place) for frame, name, place in visible]
        readings = [_reads_at(image, place, marker_map.dictionary[row]) for image, place in images if image is not None]
        votes = Counter(number for number in readings if number is not None)
        if votes and max(votes.values()) >= min(LEAST, len(visible)):
            other, like = votes.most_common(1)[0]
            found[int(marker_map.id[row])] = Suspect(int(marker_map.id[row]), "other", other, 0, like, len(visible))
    return found


def _reads_at(image: Pixels, place: Floats, name: str) -> int | None:
    """Identity that is read in an image at a place (4, 2) px, turned or not, or None."""
    corners, ids, _ = opencv_detector(name).detectMarkers(image)
    side = np.linalg.norm(place - np.roll(place, 1, axis=0), axis=1).mean()
    for number, quad in zip([] if ids is None else ids.ravel().tolist(), corners):
        if np.linalg.norm(quad[0].mean(axis=0) - place.mean(axis=0)) < 2 * FIT * side:
            return int(number)
    return None


def no_marker_reason(images: Sequence[Pixels], marker_map: MarkerMap) -> str:
    """Reason why no marker of a rig was found in images [(height, width) uint8].

    Another dictionary, mirrored.

    "" where none is found.
    """
    stated = sorted(set(marker_map.dictionary))
    for name in stated:
        seen = [_count(cv2.flip(image, 1), name, marker_map.id) for image in images]
        if sum(seen):
            return f"{sum(seen)} markers of {name} are seen mirrored: the images are mirrored, left to right"
    for name in stated:
        strange = {number for image in images for number in read_marker_ids(image, name)} - set(marker_map.id.tolist())
        if strange:
            return (
                f"markers of {name} are seen, but other markers than rig.toml has: "
                f"{', '.join(map(str, sorted(strange)[:12]))}"
            )
    others = [
        name
        for name in FAMILIES
        if name.rsplit("_", 1)[0] not in {other.rsplit("_", 1)[0] for other in stated} or "X" not in name
    ]
    best = max(
        ((sum(_count(image, name, marker_map.id) for image in images), name) for name in others if name not in stated),
        default=(0, ""),
    )
    if best[0] >= max(LEAST, len(images)):
        return (
            f"{best[0]} markers with rig.toml's identities are of {best[1]} (or a smaller one of its kind), not "
            f"of {', '.join(stated)}"
        )
    return ""


def _count(image: Pixels, name: str, wanted: Integers) -> int:
    return int(np.isin(read_marker_ids(image, name), wanted).sum())


WORTH_FOLLOWING = 3.0  # px, RMS over a frame, within which a command must predict what is seen to be worth following
LEAST_FRAMES = 4  # frames that teach anything


@dataclass(frozen=True, slots=True, eq=False)
class Expectation:
    """cameras : as adjusted to the frames that taught; markers : MarkerMap; commanded : {frame: T_base_platform}, empty
    where commands do not tell where the platform is: then the frame before does."""

    cameras: tuple[Camera, ...]
    markers: MarkerMap
    commanded: dict[int, RigidTransform]

    def camera(self, name: str) -> Camera | None:
        """The camera of that name, or None for one that moves: where it stands is not known before its image is
        read.
        """
        return next((camera for camera in self.cameras if camera.name == name and camera.mount != "moving"), None)

    def locate(self, corners: Corners, frame: int, design: Design) -> RigidTransform | None:
        """T_base_platform of a frame from its Corners alone, or None."""
        observations = observations_from_corners(corners, np.array([frame]), design, self.markers)
        poses = (
            locate_platform_and_moving_cameras(
                UndistortedCorners(observations, self.cameras, self.markers, FINEST), self.cameras
            ).poses
            if len(observations)
            else {}
        )
        return RigidTransform.from_matrix(poses[0]) if 0 in poses else None


def learn_expected_marker_places(
    recording: Recording, corners: Corners, correlation: Floats, repeated_ids: Sequence[int], markers: MarkerMap
) -> Expectation | None:
    """Expectation of marker places, learned from the corners of fully searched images.

    None if not as stated.
    corners, correlation : Corners and (n, 2, 8); repeated_ids : identities that one of those images shows twice
    What is not as stated (a marker exchanged, turned, printed twice, frames that are not solved) must be looked for in
    every image, and so must what is on the stages of a chain, one of whose bodies does not say where the others are.
    """
    frames, design = np.unique(corners.frame), recording.design
    if len(frames) < LEAST_FRAMES or len(repeated_ids) or markers.stage.any():
        return None
    try:
        m = measure_observations(
            observations_from_corners(corners, frames, design, markers, correlation), design, markers
        )
    except NotEnoughData:
        return None
    if m.unsolved or find_suspicious_markers(m, markers):
        return None
    return Expectation(m.design.cameras, markers, _commanded(recording, m, frames))


def _commanded(recording: Recording, m: Measurement, frames: Integers) -> dict[int, RigidTransform]:
    """{frame: pose} that the commands say, brought to the frames measured; empty where that is not where the platform
    is seen.
    """
    if recording.commands is None or recording.design.mechanism.plates is None:
        return {}
    numbers, _, values = recording.commanded()
    mechanism = recording.design.mechanism
    try:
        T = mechanisms.kinematics_of(mechanism).forward(values, mechanism)
    except NotConverged:
        return {}
    at = np.searchsorted(numbers, frames)
    T = T * exp(np.median(pose_difference(T[at], m.T_base_platform), axis=0))
    o = m.observations
    here = State(m.design.cameras, T[at], m.adjustment.state.moving)
    miss = ((o.uv - predict_corners(o, here)[0]) ** 2).sum(axis=1)[m.inliers & o.on_platform]
    count = np.bincount(o.frame[m.inliers & o.on_platform], minlength=len(frames))
    rms = np.sqrt(
        np.bincount(o.frame[m.inliers & o.on_platform], weights=miss, minlength=len(frames)) / np.maximum(count, 1)
    )
    return dict(zip(numbers.tolist(), T)) if (rms < WORTH_FOLLOWING).all() else {}
