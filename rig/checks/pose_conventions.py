"""Other ways in which six columns of a pose may have been written."""

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation


def other_poses(v: np.ndarray) -> Iterator[tuple[str, RigidTransform]]:
    """(what, RigidTransform (n,)) of other readings of poses.csv's six columns v (n, 6)."""
    p, r = v[:, :3], v[:, 3:]
    vectors = Rotation.from_rotvec(r)
    yield "poses are inverted (base in platform)", RigidTransform.from_components(p, vectors).inv()
    yield "rotations are inverted", RigidTransform.from_components(p, vectors.inv())
    yield "rotation vectors are in degrees", RigidTransform.from_components(p, Rotation.from_rotvec(np.radians(r)))
    for unit, factor in (("millimetres", 1e-3), ("centimetres", 1e-2), ("inches", 0.0254)):
        yield f"positions are in {unit}", RigidTransform.from_components(p * factor, vectors)
    for degrees, unit in ((False, ""), (True, " in degrees")):
        for seq in ("xyz", "zyx", "XYZ", "ZYX", "zxz", "ZYZ"):
            named = f"{seq.lower()} {'about fixed axes' if seq.islower() else 'about moving axes'}"
            yield (
                f"rotations are Euler angles ({named}{unit}), not rotation vectors",
                RigidTransform.from_components(p, Rotation.from_euler(seq, r, degrees=degrees)),
            )
        yield (
            f"rotations are Euler angles (rz ry rx as columns{unit}), not rotation vectors",
            RigidTransform.from_components(p, Rotation.from_euler("ZYX", r, degrees=degrees)),
        )
    if (np.linalg.norm(r, axis=1) <= 1 + 1e-6).all():
        w = np.sqrt(np.maximum(1 - (r**2).sum(axis=1), 0))
        yield (
            "rotations are the vector part of quaternions, not rotation vectors",
            RigidTransform.from_components(p, Rotation.from_quat(np.column_stack([r, w]))),
        )
    for order, names in (((1, 0, 2), "x and y"), ((0, 2, 1), "y and z"), ((2, 1, 0), "x and z")):
        yield f"{names} of positions are exchanged", RigidTransform.from_components(p[:, order], vectors)
    for axis in range(3):
        turned = p.copy()
        turned[:, axis] *= -1
        yield f"the sign of {'xyz'[axis]} is reversed", RigidTransform.from_components(turned, vectors)
