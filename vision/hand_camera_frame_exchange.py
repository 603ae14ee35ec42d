"""Frame exchange for hand cameras (on the platform): recording and design with base and platform exchanged.

In the platform's own frame such a camera stands still and the base's markers move. So it is measured like any rig, with
base and platform exchanged; the stated pose of the camera in the platform holds the platform's frame, the markers'
stated places the base's.
"""

from dataclasses import replace

import numpy as np

from rig.model.design import Design
from rig.model.pose import adjoint
from rig.recording.recording_folder import Recording
from vision.recording_adjustment import Measurement


def has_hand_cameras(design: Design) -> bool:
    """Whether the platform carries a design's cameras (mount "hand")."""
    return any(camera.mount == "hand" for camera in design.cameras)


def recording_seen_from_hand(recording: Recording) -> Recording:
    """A recording as seen from the hand: its cameras stand still, and the base's targets are on the body that moves;
    others as they are.
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


def invert_measured_poses(measured: Measurement) -> Measurement:
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
