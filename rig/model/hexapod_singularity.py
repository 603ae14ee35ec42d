"""Hexapods that no strut lengths hold: singular by their architecture, at every pose, or just at home."""

import numpy as np

from rig.model.design import Hexapod
from rig.model.pose import exp

SINGULAR = 1e-6  # of the largest singular value of the Jacobian, rotations weighed by the platform's size
MOVES = np.array(
    [[0.1, 0, 0, 0, 0, 0], [0, 0.1, 0, 0.1, 0, 0], [0, 0, 0.1, 0, 0.1, 0], [0, 0, 0, 0, 0, 0.1]]
)  # platform sizes, rad


def singularity_text(hexapod: Hexapod) -> str | None:
    """What makes a hexapod's platform loose at home, in words, or None where its struts hold it.

    Joints on similar hexagons, one plate turned against the other or not, leave it loose wherever it stands.
    Sources: Ma and Angeles, Architecture singularities of parallel manipulators, 1992; Merlet, Parallel Robots, 2nd
    ed., ch. 6
    """
    size = max(
        float(np.linalg.norm(hexapod.platform_joints - hexapod.platform_joints.mean(axis=0), axis=1).mean()), 1e-9
    )
    if _least(hexapod, np.zeros(6), size) > SINGULAR:
        return None
    if all(_least(hexapod, move, size) <= SINGULAR for move in MOVES * np.repeat([size, 1.0], 3)):
        return (
            "is singular by its architecture: whatever the strut lengths, the platform is loose at every "
            "pose, since base and platform joints "
            "lie on similar hexagons or the like (Ma and Angeles 1992); set the joints of one plate nearer in pairs"
        )
    return (
        "is singular: there the strut lengths do not hold the platform, and no pose follows from them; another "
        "home is needed, turned or tilted"
    )


def _least(hexapod: Hexapod, move: np.ndarray, size: float) -> float:
    """Least singular value of the Jacobian at home moved by a tangent (m, rad), as a share of the largest; 0 where a
    strut has no length.
    """
    matrix = (hexapod.home * exp(move)).as_matrix()
    R, a = matrix[:3, :3], hexapod.platform_joints
    struts = (a @ R.T + matrix[:3, 3] - hexapod.base_joints) @ R
    lengths = np.linalg.norm(struts, axis=1)
    if lengths.min() <= 0:
        return 0.0
    u = struts / lengths[:, None]
    values = np.linalg.svd(np.hstack([u, np.cross(a, u) / size]), compute_uv=False)
    return float(values[-1] / values[0])
