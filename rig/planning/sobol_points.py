"""Sobol points, scrambled, identical to SciPy's, without its import time.

Direction numbers of Joe and Kuo for the first dimensions, scrambled by random lower triangular matrices and a shift.
Source: Joe and Kuo, Constructing Sobol sequences with better two-dimensional projections, SIAM J. Sci. Comput. 30,
2008; Matousek, On the L2-discrepancy for anchored boxes, J. Complexity 14, 1998 (the scrambling)
"""

from typing import cast

import numpy as np
import scipy

from rig.arrays import Floats, Integers

BITS = 30
# polynomials, their ends included, and first direction numbers of the dimensions from the second on
KNOWN = (
    (3, (1,)),
    (7, (1, 3)),
    (11, (1, 3, 1)),
    (13, (1, 1, 1)),
    (19, (1, 1, 3, 3)),
    (25, (1, 3, 5, 13)),
    (37, (1, 1, 5, 5, 17)),
    (41, (1, 1, 5, 5, 5)),
    (47, (1, 1, 7, 11, 19)),
    (55, (1, 1, 5, 1, 1)),
    (59, (1, 1, 1, 3, 11)),
)


def sobol_points(axes: int, count: int, seed: int) -> Floats:
    """Scrambled Sobol points (count, axes) of the unit cube, 0 to 1."""
    whole = int(np.ceil(np.log2(max(count, 2))))
    if axes > len(KNOWN) + 1:
        return np.asarray(scipy.stats.qmc.Sobol(axes, rng=np.random.default_rng(seed)).random_base2(whole)[:count])
    directions, shift = _scrambled(
        np.stack([_directions(i) for i in range(axes)]), np.random.default_rng(seed).spawn(1)[0]
    )
    out = np.empty((count, axes), np.uint64)
    out[0] = shift
    change = np.array([(k & -k).bit_length() - 1 for k in range(1, count)], int)  # of Gray codes, the bit that differs
    out[1:] = shift ^ np.bitwise_xor.accumulate(directions.T[change], axis=0)
    return cast(Floats, out * 2.0**-BITS)


def _directions(i: int) -> Integers:
    """(BITS,) direction numbers of a dimension, counted from 0."""
    if i == 0:
        return np.uint64(1) << np.arange(BITS - 1, -1, -1, dtype=np.uint64)
    polynomial, first = KNOWN[i - 1]
    degree, v = len(first), list(first)
    for j in range(degree, BITS):
        new = v[j - degree]
        for k in range(degree):
            if polynomial >> (degree - 1 - k) & 1:
                new ^= v[j - k - 1] << (k + 1)
        v.append(new)
    return np.array([value << (BITS - 1 - j) for j, value in enumerate(v)], np.uint64)


def _scrambled(directions: Integers, rng: np.random.Generator) -> tuple[Integers, Integers]:
    """(directions (axes, BITS) scrambled, shift (axes,)), in the order in which SciPy draws."""
    axes = len(directions)
    powers = np.uint64(1) << np.arange(BITS, dtype=np.uint64)
    shift = rng.integers(2, size=(axes, BITS), dtype=np.uint32).astype(np.uint64) @ powers
    lower = np.tril(rng.integers(2, size=(axes, BITS, BITS), dtype=np.uint32)).astype(np.uint64)
    lower[:, np.arange(BITS), np.arange(BITS)] = 1
    bits = directions[..., None] >> np.arange(BITS - 1, -1, -1, dtype=np.uint64) & np.uint64(
        1
    )  # (axes, BITS, place), highest first
    mixed = np.einsum("apk,ajk->ajp", lower, bits) & np.uint64(1)
    return mixed @ powers[::-1], shift
