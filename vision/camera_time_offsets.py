"""Times by which cameras' stamps differ among each other, from the corners of a platform in motion.

Cameras that expose at other moments than their stamps say see the platform at different places. A delay that all of
them share moves the measured pose alone; what differs from the first camera remains in the corners' residuals, along
the direction in which each corner moves. The pose of every frame is eliminated, and so is a delay that grows from row
to row: a rolling shutter that nobody stated is no difference of stamps.
"""

from dataclasses import dataclass

import numpy as np

from rig.array_and_json_types import Booleans, Floats
from vision.bundle.normal_equations_and_corner_jacobians import corner_jacobians
from vision.corner_observations import Observations
from vision.predict import State, predict_corners

FARTHEST = 5.0  # px of a residual, beyond which a corner says nothing of times
FEWEST = 12  # frames in motion
SURE, LEAST = 5.0, 1e-4  # standard deviations, s; a smaller difference counts as none


@dataclass(frozen=True, slots=True, eq=False)
class CameraTimeOffsets:
    """offset, sigma : (cameras,) s by which each camera exposed later than its stamps say, relative to the first"""

    offset: Floats
    sigma: Floats

    @property
    def certain(self) -> Floats:
        """(cameras,) s, the offsets that are beyond doubt; 0 for the others."""
        return np.where((np.abs(self.offset) > SURE * self.sigma) & (np.abs(self.offset) > LEAST), self.offset, 0.0)


def camera_time_offsets(
    observations: Observations, later: Observations, after: float, residuals: Floats, state: State, moving: Booleans
) -> CameraTimeOffsets | None:
    """CameraTimeOffsets of fixed cameras; None where too few frames move, or one camera alone sees them.

    observations : of solved frames, with the motion to each corner's exposure; later : the same with all exposures so
    much later (after, s); residuals : (n, 2) px; state : State of these frames; moving : (F,) whether they move
    """
    count = len(state.cameras)
    near = np.isfinite(residuals[:, 0]) & (np.nan_to_num(np.abs(residuals)).max(axis=1) < FARTHEST)
    rows = np.flatnonzero(observations.on_platform & moving[observations.frame] & near)
    if count < 2 or len(np.unique(observations.frame[rows])) < FEWEST:
        return None
    seen, shown = observations.take(rows), predict_corners(observations.take(rows), state)[0]
    speed = (predict_corners(later.take(rows), state)[0] - shown) / after  # px/s
    J = np.empty((len(rows), 2, 6))
    for _, at, J_platform, *_ in corner_jacobians(seen, state):
        J[at] = J_platform
    own_camera = seen.camera[:, None, None] == np.arange(count)
    rows_late = seen.uv[:, 1] / np.array([camera.height for camera in state.cameras])[seen.camera] - 0.5
    unstated = [camera.shutter != "rolling" for camera in state.cameras]
    late = rows_late[:, None, None] * own_camera[..., unstated]
    G = speed[..., None] * np.concatenate([own_camera[..., 1:], late], axis=2)
    width = G.shape[2]
    normal, right, squares, free = np.zeros((width, width)), np.zeros(width), 0.0, 0
    for frame in np.unique(seen.frame):
        own = seen.frame == frame
        if len(np.unique(seen.camera[own])) < 2:
            continue
        Q, _ = np.linalg.qr(J[own].reshape(-1, 6))
        left = np.column_stack([G[own].reshape(-1, width), residuals[rows[own]].ravel()])
        left -= Q @ (Q.T @ left)
        normal += left[:, :-1].T @ left[:, :-1]
        right += left[:, :-1].T @ left[:, -1]
        squares += float(left[:, -1] @ left[:, -1])
        free += len(left) - 6
    if free <= width or np.linalg.matrix_rank(normal) < width:
        return None
    found = np.linalg.solve(normal, right)
    scale = max(squares - float(found @ right), 0.0) / (free - width)
    sigma = np.sqrt(scale * np.diag(np.linalg.inv(normal)))
    return CameraTimeOffsets(np.r_[0.0, found[: count - 1]], np.r_[0.0, sigma[: count - 1]])
