"""Markers read: all of a rig's that an image shows, their corners to a pixel or so."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vision.corners.dark_pixels import LEFT, WINDOWS, mark_dark_pixels
from vision.corners.marker_bits import identify_markers, marker_codes
from vision.corners.outline_quadrangles import outline_buffers
from vision.corners.outline_tracing import trace_quadrangles
from vision.corners.quadrangle_candidates import marker_candidates
from vision.targets import MarkerMap

SHORTEST, LONGEST = 0.03, 4.0  # of the image's longer side, that a marker's outline has pixels
WORD = 8  # pixels that are looked at together
ROOM = 1024  # quadrangles, to begin with


class LeftOut(NamedTuple):
    """A marker that was read and not placed. marker : identity; reason : in words; repeated : whether it is that one
    image shows it twice.
    """

    marker: int
    reason: str
    repeated: bool = False


class Read(NamedTuple):
    """Markers whose corners are known to a pixel or so: as a reader saw them, or where they are expected.

    marker : (m,) identities; corners : (m, 4, 2) px; left_out : those that are not to be placed
    """

    marker: np.ndarray
    corners: np.ndarray
    left_out: Sequence[LeftOut] = ()


def read_markers(eight: np.ndarray, marker_map: MarkerMap) -> Read:
    """Read from an image (height, width) uint8; a marker that is seen twice is left out."""
    eight = np.require(eight, np.uint8, ["C", "W"])  # kernels are compiled for one kind of array
    found: dict[int, list[np.ndarray]] = {}
    left_out, all_ = [], dark_quadrangles(eight)
    for name in dict.fromkeys(marker_map.dictionary):
        own = tuple(number for number, other in zip(marker_map.id.tolist(), marker_map.dictionary) if other == name)
        wanted = marker_codes(name, own)
        for row, quad in zip(*identify_markers(eight, marker_candidates(all_, eight.shape, wanted.n + 2), wanted)):
            found.setdefault(own[row], []).append(quad)
    for number in [number for number, quads in found.items() if len(quads) > 1]:
        left_out.append(LeftOut(number, f"seen {len(found.pop(number))} times in one image", True))
    numbers = sorted(found)
    return Read(np.array(numbers, int), np.array([found[k][0] for k in numbers], float).reshape(-1, 4, 2), left_out)


def dark_quadrangles(eight: np.ndarray) -> np.ndarray:
    """(n, 4, 2) px, int32, clockwise: outlines with four corners of what is dark in an image (height, width) uint8, and
    of what is bright within.
    """
    height, width = eight.shape
    longer = max(height, width)
    words = np.zeros((height + 2 * LEFT, -(-(width + 2 * LEFT) // WORD)), np.uint64)
    marks, traced, parts = words.view(np.uint8), outline_buffers(int(LONGEST * longer)), []
    found = np.empty((ROOM, 4, 2), np.int32)
    for window in WINDOWS:
        mark_dark_pixels(eight, window, marks)
        count = trace_quadrangles(words, marks, int(SHORTEST * longer), traced, found)
        if count > len(found):
            found = np.empty((count, 4, 2), np.int32)
            mark_dark_pixels(eight, window, marks)
            trace_quadrangles(words, marks, int(SHORTEST * longer), traced, found)
        parts.append(found[:count][::-1].copy())
    return np.concatenate(parts)
