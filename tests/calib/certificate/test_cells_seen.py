"""Boxes that lie behind each other are drawn as rectangles that do not overlap, each with the worst of what is behind
it.
"""

import numpy as np

from calib.certificate.certificate_page import disjoint_rectangles_of_greatest_value


def test_rectangles_seen_cover_the_boxes_once_with_the_worst_behind_each():
    rng = np.random.default_rng(5)
    for _ in range(30):
        corners = np.sort(rng.integers(0, 9, (rng.integers(1, 8), 2, 2)).astype(float), axis=1)
        boxes = corners[(np.diff(corners, axis=1) > 0).all(axis=(1, 2))]
        values = rng.integers(1, 5, len(boxes)).astype(float)
        drawn = disjoint_rectangles_of_greatest_value(boxes, values)
        for place in np.argwhere(np.ones((9, 9))) + 0.5:
            behind = values[((place > boxes[:, 0]) & (place < boxes[:, 1])).all(axis=1)]
            here = [value for (x0, y0, x1, y1), value in drawn if x0 < place[0] < x1 and y0 < place[1] < y1]
            assert here == ([behind.max()] if len(behind) else [])


def test_boxes_side_by_side_stay_as_they_are():
    boxes = np.array([[[0.0, 0.0], [1.0, 2.0]], [[1.0, 0.0], [3.0, 2.0]]])
    assert disjoint_rectangles_of_greatest_value(boxes, np.array([5.0, 7.0])) == [
        ((0.0, 0.0, 1.0, 2.0), 5.0),
        ((1.0, 0.0, 3.0, 2.0), 7.0),
    ]
