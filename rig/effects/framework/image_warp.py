"""Smooth warp of an image: products of Chebyshev polynomials of the position, and what each displaces."""

import numpy as np

from rig.arrays import Floats
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
