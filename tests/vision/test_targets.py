"""Where a cube's corners are, worked by hand from the convention."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from rig.model.design import FACES, face_pose
from rig.model.pose import transform_points
from vision.marker_corner_prediction import marker_map

HALF, EDGE = 0.5, 2.0
# corner 0 (top left, seen from outside, top to +z on the sides and +y on +z and -z) and corner 1 (top right) of a
# marker of side 1
BY_HAND = {
    "+x": ([1, -0.5, 0.5], [1, 0.5, 0.5]),
    "-x": ([-1, 0.5, 0.5], [-1, -0.5, 0.5]),
    "+y": ([0.5, 1, 0.5], [-0.5, 1, 0.5]),
    "-y": ([-0.5, -1, 0.5], [0.5, -1, 0.5]),
    "+z": ([-0.5, 0.5, 1], [0.5, 0.5, 1]),
    "-z": ([0.5, 0.5, -1], [-0.5, 0.5, -1]),
}


@pytest.mark.parametrize("face", FACES)
def test_faces_are_hand_worked(face):
    corners = transform_points(face_pose(face, EDGE), np.array([[-HALF, HALF, 0], [HALF, HALF, 0]]))
    np.testing.assert_allclose(corners, BY_HAND[face], atol=1e-12)


def test_a_marker_faces_outward(design):
    markers = marker_map(design)
    for i in range(len(markers.id)):
        a, b, _, d = markers.corners[i]
        out = np.cross(d - a, b - a)
        assert out @ markers.T_body_marker[i].rotation.as_matrix()[:, 2] > 0


def test_rows_find_identities(design):
    markers = marker_map(design)
    assert markers.rows(np.array([7, 99, 0])).tolist() == [
        markers.id.tolist().index(7),
        -1,
        markers.id.tolist().index(0),
    ]


def test_a_design_without_targets_is_refused(design):
    from dataclasses import replace

    with pytest.raises(ValueError, match="no targets"):
        marker_map(replace(design, targets=()))


def test_an_unknown_face_is_refused():
    with pytest.raises(ValueError, match="face"):
        face_pose("+w", 1.0)
    assert isinstance(face_pose("+x", 1.0), RigidTransform)
