"""Edges of printed squares that move inward, and where their corners then are."""

import numpy as np

from rig.arrays import Floats


def move_edges_inward(quads: Floats, distance: float) -> Floats:
    """Corners (..., 4, 2) px of squares whose edges have each moved inward by a distance px, negative for outward."""
    edge = np.roll(quads, -1, axis=-2) - quads  # edge k runs from corner k to k + 1
    unit = edge / np.linalg.norm(edge, axis=-1, keepdims=True)
    before = np.roll(unit, 1, axis=-2)
    # a corner moves along both its edges by the distance / sin of the angle between them
    sine = np.abs(before[..., 0] * unit[..., 1] - before[..., 1] * unit[..., 0])
    return np.asarray(quads + distance / sine[..., None] * (unit - before))
