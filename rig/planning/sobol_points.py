"""Scrambled Sobol points, those of `scipy.stats.qmc.Sobol` bit by bit, without the import of scipy.stats.

That import takes half a second.
"""

import numpy as np

from rig.array_and_json_types import Floats

BITS = 30  # of each coordinate
# Of each axis: its primitive polynomial's bits, and the first direction numbers.
# Source: Joe and Kuo, Constructing Sobol sequences with better two-dimensional projections, SIAM J. Sci. Comput. 30
# (2008), new-joe-kuo-6
DIRECTIONS = (
    (1, (1,)),
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


def scrambled_sobol_points(axes: int, power: int, seed: int) -> Floats:
    """The first 2 ** power scrambled Sobol points (2 ** power, axes) of the unit cube.

    axes : len(DIRECTIONS) at most
    Source: Owen, Scrambling Sobol and Niederreiter-Xing points, J. Complexity 14 (1998): matrix scramble and shift
    """
    rng = np.random.default_rng(seed).spawn(1)[0]  # as SciPy does, which is given a generator
    weights = 1 << np.arange(BITS)
    point = rng.integers(2, size=(axes, BITS), dtype=np.uint32) @ weights
    triangles = np.tril(rng.integers(2, size=(axes, BITS, BITS), dtype=np.uint32), -1) + np.eye(BITS, dtype=int)
    numbers = np.array([_direction_numbers(*DIRECTIONS[axis]) for axis in range(axes)])
    bits = numbers[:, :, None] >> np.arange(BITS)[::-1] & 1  # greatest first
    scrambled = (np.einsum("apk,avk->avp", triangles, bits) & 1) @ weights[::-1]
    steps = np.arange(1, 2**power)
    changed = np.log2(steps & -steps).astype(int)  # the one bit that Gray codes of neighbours differ in
    points = np.vstack([point, scrambled.T[changed]])
    return np.asarray(np.bitwise_xor.accumulate(points, axis=0) / 2.0**BITS)


def _direction_numbers(polynomial: int, first: tuple[int, ...]) -> list[int]:
    """Direction numbers of an axis, BITS of them, each shifted to the top of BITS bits."""
    degree, numbers = polynomial.bit_length() - 1, list(first)
    for k in range(len(numbers), BITS):
        if degree == 0:
            numbers.append(1)
            continue
        new = numbers[k - degree]
        for i in range(degree):
            if polynomial >> (degree - 1 - i) & 1:
                new ^= numbers[k - 1 - i] << (i + 1)
        numbers.append(new)
    return [number << (BITS - 1 - k) for k, number in enumerate(numbers)]
