"""Chebyshev warp of an image, and printed edge shift: edges of printed squares moved inward."""

import numpy as np

from rig.array_and_json_types import Floats
from rig.model.design import Camera


def chebyshev_products(camera: Camera, uv: Floats, degree: int) -> Floats:
    """Chebyshev products (..., m) of image positions uv (..., 2) px, from the second degree up to a degree."""
    x = np.clip((np.asarray(uv) - [camera.width / 2, camera.height / 2]) / (camera.width / 2), -1, 1)
    T = [np.polynomial.chebyshev.chebvander(x[..., c], degree) for c in range(2)]
    return np.stack(
        [T[0][..., i] * T[1][..., j] for i in range(degree + 1) for j in range(degree + 1 - i) if i + j > 1], axis=-1
    )


def warp_columns(camera: Camera, uv: Floats, degree: int) -> Floats:
    """(..., 2, 2 m) px that image positions uv (..., 2) px move per unit of each number of a warp: m in u, then v."""
    basis = chebyshev_products(camera, uv, degree)
    zero = np.zeros_like(basis)
    return np.stack([np.concatenate([basis, zero], axis=-1), np.concatenate([zero, basis], axis=-1)], axis=-2)


def move_edges_inward(quads: Floats, distance: float) -> Floats:
    """Corners (..., 4, 2) px of squares whose edges have each moved inward by a distance px, negative for outward."""
    edge = np.roll(quads, -1, axis=-2) - quads  # edge k runs from corner k to k + 1
    unit = edge / np.linalg.norm(edge, axis=-1, keepdims=True)
    before = np.roll(unit, 1, axis=-2)
    # a corner moves along both its edges by the distance / sin of the angle between them
    sine = np.abs(before[..., 0] * unit[..., 1] - before[..., 1] * unit[..., 0])
    return np.asarray(quads + distance / sine[..., None] * (unit - before))
