"""A secret machine: what its owner believes, and what it really is, drawn at random and kept apart."""

from dataclasses import dataclass, replace

import numpy as np

from rig.design import Design
from rig.pose import exp

JOINT = 3e-4  # m, standard deviation of a joint's coordinate from where the owner has it
ZERO = 3e-4  # m, of a strut's zero
MOUNT = (3e-3, 5e-3)  # m, rad, of a camera's stated pose
FOCAL, CENTRE = 4e-4, 1.0  # of the focal length; px
DISTORTION = np.array([1e-3, 5e-3, 5e-5, 5e-5, 0.0])  # of k1 k2 p1 p2 k3


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """stated : Design as its owner believes it; true : Design as it is."""

    stated: Design
    true: Design


def draw(stated, rng, size=1.0):
    """World around a stated design (a hexapod). rng : numpy Generator; size : multiplies every deviation."""
    m = stated.mechanism
    mechanism = replace(m, base_joints=m.base_joints + size * JOINT * rng.normal(size=(6, 3)),
                        platform_joints=m.platform_joints + size * JOINT * rng.normal(size=(6, 3)),
                        strut_zeros=m.strut_zeros + size * ZERO * rng.normal(size=6))
    return World(stated, replace(stated, mechanism=mechanism, cameras=tuple(_camera(camera, rng, size) for camera in stated.cameras)))


def _camera(camera, rng, size):
    moved = camera.pose * exp(size * np.r_[MOUNT[0] * rng.normal(size=3), MOUNT[1] * rng.normal(size=3)])
    matrix = camera.matrix.copy()
    matrix[[0, 1], [0, 1]] *= 1 + size * FOCAL * rng.normal()
    matrix[:2, 2] += size * CENTRE * rng.normal(size=2)
    terms = np.zeros(len(camera.distortion))
    terms[: min(5, len(terms))] = (size * DISTORTION * rng.normal(size=5))[: len(terms)]
    return replace(camera, pose=moved, matrix=matrix, distortion=camera.distortion + terms)
