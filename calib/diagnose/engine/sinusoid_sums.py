"""Sums of many columns against sinusoids of many orders of an angle at once: a non-uniform fast Fourier transform.

Each pose's values are spread onto an even grid by a short kernel, the grid is transformed, and the kernel's own
transform divided out. Source: Barnett, Magland and af Klinteberg, SIAM J. Sci. Comput. 41, 2019, C479-C504 (type 1;
kernel eq. 1.8, upsampling 2).
"""

from functools import lru_cache

import numpy as np
from scipy.fft import next_fast_len
from scipy.sparse import csr_array

WIDTH = 10  # grid points that a pose is spread onto; errors are about ten to the power of 1 - WIDTH
SHAPE = 2.30 * WIDTH
NODES = 60  # of the quadrature for the kernel's transform


def sinusoid_sums(q: np.ndarray, values: np.ndarray, step: float, first: int, count: int) -> np.ndarray:
    """(count, p) complex: sum over poses of values * exp(1j * order * q) at orders step * (first, first + 1, ..).

    q : (m,) rad, its span times step below 2 pi; values : (m, p); step : cycles per radian times 2 pi, between orders;
        first : at least 0
    """
    last = first + count
    size = next_fast_len(4 * last + 2 * WIDTH)
    centre = (q.min() + q.max()) / 2
    at = (q - centre) * step * size / (2 * np.pi)  # in grid steps
    start = np.ceil(at - WIDTH / 2).astype(int)
    cells = start[:, None] + np.arange(WIDTH)
    rows = np.repeat(np.arange(len(q)), WIDTH)
    spread = csr_array(
        (_kernel(2 * (cells - at[:, None]) / WIDTH).ravel(), ((cells % size).ravel(), rows)), shape=(size, len(q))
    )
    order = np.arange(first, last)
    grid = np.fft.rfft(spread @ values, axis=0)[order].conj()
    return grid * (np.exp(1j * order * step * centre) / _transform(size, first, count))[:, None]


def _kernel(z: np.ndarray) -> np.ndarray:
    """The kernel at z in -1..1 (half its width is 1)."""
    return np.exp(SHAPE * (np.sqrt(np.maximum(1 - z**2, 0)) - 1))


@lru_cache(maxsize=64)
def _transform(size: int, first: int, count: int) -> np.ndarray:
    """(count,) transform of the kernel, in grid steps, at orders first, first + 1, .. of a grid of a size."""
    z, weight = np.polynomial.legendre.leggauss(NODES)
    frequency = np.arange(first, first + count) / size
    return WIDTH / 2 * np.cos(np.pi * WIDTH * frequency[:, None] * z) @ (weight * _kernel(z))
