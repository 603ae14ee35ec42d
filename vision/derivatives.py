"""How corners move when the platform, a camera or a lens does: the Jacobians of the forward model of seeing, without effects."""

import numpy as np

from rig.pose import skew
from vision import lens
from vision.predict import base_points, by_camera, in_camera


def derivatives(observations, state):
    """[(camera index, rows, J_platform (m, 2, 6), J_camera (m, 2, 6), J_lens (m, 2, 4 + terms))] for each camera that sees something.

    observations : Observations; state : State. Tangents stand on the right (px/m, px/rad); J_platform is zero on base markers
    """
    base, R_platform = base_points(observations, state), state.platform.rotation.as_matrix()
    out = []
    for i, camera, rows in by_camera(observations, state):
        frame, on = observations.frame[rows], observations.on_platform[rows]
        ahead = in_camera(base[rows], frame, state, i)
        _, J_point, J_lens = lens.project_jacobian(ahead, camera.matrix, camera.distortion)
        R_camera = state.moving[i].rotation.as_matrix()[frame] if i in state.moving else camera.pose.rotation.as_matrix()
        J_platform = np.zeros((len(frame), 2, 6))
        J_platform[on, :, :3] = (J_point @ (np.swapaxes(R_camera, -1, -2) @ R_platform[frame]))[on]
        J_platform[on, :, 3:] = -(J_platform[on, :, :3] @ skew(observations.points[rows][on]))
        out.append((i, rows, J_platform, np.concatenate([-J_point, J_point @ skew(ahead)], axis=-1), J_lens))
    return out
