"""Expected places of markers in unread images.

By cameras and poses learned from images already read.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, Integers
from rig.errors import NotConverged, NotEnoughData
from rig.model import mechanisms
from rig.model.design import Camera, Design
from rig.model.pose import exp, pose_difference
from rig.recording.recording_folder import Recording
from rig.recording.recording_tables import Corners
from vision.corner_observations import observations_from_corners
from vision.pose.body_pose import FINEST
from vision.pose.frame_and_camera_poses import UndistortedCorners, locate_frames
from vision.predict import MarkerMap, State, predict_corners
from vision.reading.marker_identity_mistakes import find_suspicious_markers
from vision.recording_adjustment import Measurement, measure_observations

WORTH_FOLLOWING = 3.0  # px, RMS over a frame, within which a command must predict what is seen to be worth following
LEAST = 4  # frames that teach anything


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
            locate_frames(UndistortedCorners(observations, self.cameras, self.markers, FINEST), self.cameras).poses
            if len(observations)
            else {}
        )
        return RigidTransform.from_matrix(poses[0]) if 0 in poses else None


def learn_expected_places(
    recording: Recording, corners: Corners, correlation: Floats, repeated_ids: Sequence[int], markers: MarkerMap
) -> Expectation | None:
    """Expectation of marker places, learned from the corners of fully searched images.

    None if not as stated.
    corners, correlation : Corners and (n, 2, 8); repeated_ids : identities that one of those images shows twice
    What is not as stated (a marker exchanged, turned, printed twice, frames that are not solved) must be looked for in
    every image, and so must what is on the stages of a chain, one of whose bodies does not say where the others are.
    """
    frames, design = np.unique(corners.frame), recording.design
    if len(frames) < LEAST or len(repeated_ids) or markers.stage.any():
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
