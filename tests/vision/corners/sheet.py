"""Markers on loose sheets, as the tests of corners see them."""

from dataclasses import replace

import cv2

from rig.model.design import Marker, Target
from rig.model.pose import pose
from vision.marker_corner_prediction import marker_map

NAME = "DICT_5X5_100"


def sheet(design, dictionary=NAME, ids=range(30), margin=0.9):
    """A marker map of loose sheets of one dictionary."""
    cells = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)).markerSize + 2
    listed = tuple(Marker(i, 1.0, pose([0, 0, 0], [0, 0, 0]), margin / cells) for i in ids)
    return marker_map(replace(design, targets=(Target("t", "platform", dictionary, listed=listed),)))
