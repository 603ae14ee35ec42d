"""Whole-image reader of markers: quadrangles, their bits, the identities of a rig's markers.

Source: Garrido-Jurado et al., Pattern Recognition 47, 2014
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from rig.array_and_json_types import Floats, Integers, Pixels
from vision.predict import MarkerMap

CELL_PIXELS = 8  # pixels each way that are sampled in a cell
# of a candidate's perimeter, within which another one is taken for the same marker. OpenCV's 0.125 takes the marker and
# the outline of its white margin, or of the cube's face, for one, and then reads only one of them
SAME_MARKER = 0.07


class ExcludedMarker(NamedTuple):
    """A marker that was read and not placed. marker : identity; reason : in words; repeated : whether it is that one
    image shows it twice.
    """

    marker: int
    reason: str
    repeated: bool = False


class ReadMarkers(NamedTuple):
    """Markers whose corners are known to a pixel or so: as a reader saw them, or where they are expected.

    marker : (m,) identities; corners : (m, 4, 2) px; left_out : those that are not to be placed
    """

    marker: Integers
    corners: Floats
    left_out: Sequence[ExcludedMarker] = ()


@lru_cache
def opencv_detector(dictionary_name: str, numbers: tuple[int, ...] = ()) -> cv2.aruco.ArucoDetector:
    """cv2.aruco.ArucoDetector of a dictionary (OpenCV name), corners to whole pixels.

    numbers : identities that are looked for, whose places in `numbers` the detector returns; all where it is empty
    """
    dictionary, parameters = (
        cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary_name)),
        cv2.aruco.DetectorParameters(),
    )
    if numbers:
        codes = np.ascontiguousarray(dictionary.bytesList[list(numbers)])
        dictionary = cv2.aruco.Dictionary(codes, dictionary.markerSize, dictionary.maxCorrectionBits)
    parameters.perspectiveRemovePixelPerCell = CELL_PIXELS
    parameters.minMarkerDistanceRate = SAME_MARKER
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    return cv2.aruco.ArucoDetector(dictionary, parameters)


def read_markers(image: Pixels, marker_map: MarkerMap) -> ReadMarkers:
    """Read the markers of a rig in a whole image (height, width) uint8; repeated ones are excluded."""
    image = np.ascontiguousarray(image)
    found: dict[int, list[Floats]] = {}
    for name in dict.fromkeys(marker_map.dictionary):
        numbers = tuple(number for number, other in zip(marker_map.id.tolist(), marker_map.dictionary) if other == name)
        quads, places, _ = opencv_detector(name, numbers).detectMarkers(image)
        for place, quad in zip([] if places is None else places.ravel().tolist(), quads):
            found.setdefault(numbers[int(place)], []).append(quad[0])
    left_out = [
        ExcludedMarker(number, f"seen {len(found.pop(number))} times in one image", True)
        for number in [number for number, quads in found.items() if len(quads) > 1]
    ]
    numbers_read = sorted(found)
    corners = np.array([found[number][0] for number in numbers_read], float).reshape(-1, 4, 2)
    return ReadMarkers(np.array(numbers_read, int), corners, left_out)
