"""Markers that disagree with rig.toml: named, with what they look like, and kept out of the poses."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from rig.effects.catalogue.marker_swap import MarkerSwap
from rig.model.pose import pose_difference
from tests.vision.drawn_observations import nees, scene
from vision.marker_corner_prediction import expected_marker_rows_and_corners_in_image, marker_cells, marker_map
from vision.reading.corner_reading_from_recording_images import Collected, Unplaced
from vision.reading.marker_identity_mistakes_and_expected_marker_places import (
    Suspect,
    find_suspicious_markers,
    no_marker_reason,
)
from vision.recording_adjustment_with_hand_and_stages import measure_observations


def spoilt(design, spoil=None, repeated=(), read=None, frames=12):
    """(suspects, NEES of the poses) of a recording whose corners were spoilt."""
    observations, stated, _, T = scene(design, 4, frames, spoil=spoil)
    m = measure_observations(observations, stated, marker_map(design))
    assert len(m.frames) == frames
    return find_suspicious_markers(m, marker_map(design), repeated, read), nees(
        pose_difference(m.T_base_platform, T), m.covariance
    ).mean()


def relabelled(change):
    """Corners whose marker identities are changed: {identity: (new one, new corner numbers)}."""

    def spoil(corners):
        marker, corner = corners.marker.copy(), corners.corner.copy()
        for old, (new, order) in change.items():
            rows = corners.marker == old
            marker[rows], corner[rows] = new, np.array(order)[corners.corner[rows]]
        return replace(corners, marker=marker, corner=corner)

    return spoil


def seen_often(design):
    """Identities of platform markers by how often they are seen in the scene, the most often first."""
    observations, _, _, _ = scene(design, 4)
    ids, count = np.unique(marker_map(design).id[observations.marker[observations.on_platform]], return_counts=True)
    return ids[np.argsort(-count)].tolist()


def test_a_sound_rig_has_no_suspects(design):
    found, squared = spoilt(design)
    assert found == () and squared < 15


def test_two_faces_exchanged_are_named_and_not_averaged_in(design):
    a, b = seen_often(design)[:2]
    same = range(4)
    found, squared = spoilt(design, relabelled({a: (b, same), b: (a, same)}))
    assert {(s.marker, s.kind, s.other, s.turn) for s in found} == {(a, "exchanged", b, 0), (b, "exchanged", a, 0)}
    assert f"marker {a}: is exchanged with marker {b}" in " ".join(map(str, found)) and all(
        s.like == s.of for s in found
    )
    assert squared < 15


@pytest.mark.parametrize("turn", [1, 2, 3])
def test_a_face_glued_on_turned_is_told_as_the_simulator_turns_it(design, turn):
    """The effect's own turn, and none of its own arithmetic in the test."""
    a, markers = seen_often(design)[0], marker_map(design)
    turned = MarkerSwap(f"marker {a}", turn=float(turn)).attach(markers)
    row = int(markers.rows([a])[0])
    order = [int(np.argmin(np.linalg.norm(markers.corners[row] - point, axis=1))) for point in turned.corners[row]]
    found, squared = spoilt(design, relabelled({a: (a, np.argsort(order))}))
    assert [(s.marker, s.kind, s.turn) for s in found] == [(a, "turned", turn)] and squared < 15


def test_corners_in_mirrored_order_are_told(design):
    a = seen_often(design)[0]
    found, squared = spoilt(design, relabelled({a: (a, [1, 0, 3, 2])}))
    assert [(s.marker, s.kind) for s in found] == [(a, "mirrored")] and squared < 15


def test_a_wrong_identity_is_where_another_should_be(design):
    """Face b carries a second a; where both are seen in an image, neither is used."""
    a, b = seen_often(design)[:2]

    def spoil(corners):
        keep = corners.marker != a
        corners = replace(
            corners,
            **{name: getattr(corners, name)[keep] for name in ("frame", "marker", "corner", "uv")},
            camera=[name for name, k in zip(corners.camera, keep) if k],
            covariance=None if corners.covariance is None else corners.covariance[keep],
        )
        return relabelled({b: (a, range(4))})(corners)

    found, _ = spoilt(design, spoil)
    assert [(s.marker, s.kind, s.other) for s in found] == [(a, "elsewhere", b)]


def test_a_face_askew_is_reported_without_a_name(design):
    a = seen_often(design)[0]

    def spoil(corners):
        return replace(corners, uv=corners.uv + np.where(corners.marker == a, 6.0, 0.0)[:, None])

    found, squared = spoilt(design, spoil)
    assert [(s.marker, s.kind) for s in found] == [(a, "askew")] and squared < 15


def test_what_was_seen_twice_in_an_image_is_reported(design):
    a = seen_often(design)[0]
    left_out = [Unplaced(0, "cam1", a, "seen 2 times in one image", True), Unplaced(1, "cam1", 999, "too small", False)]
    collected = Collected(None, None, left_out, {}, {}, {}, {})
    assert spoilt(design, repeated=collected.repeated)[0] == (Suspect(a, "twice", -1, 0, 1, 1),)


def printed(camera, T, markers, as_another):
    """(height, width) uint8 picture of all markers where they are expected, one printed as another: {identity:
    other}.
    """
    image = np.full((camera.height, camera.width), 128, np.uint8)
    for row, quad in zip(*expected_marker_rows_and_corners_in_image(camera, T, markers)):
        cells = marker_cells(markers.dictionary[row], as_another.get(int(markers.id[row]), int(markers.id[row])))
        n, big = len(cells) - 4, np.kron(cells * 255, np.ones((12, 12))).astype(np.uint8)
        inner = np.array([[1, 1], [n + 3, 1], [n + 3, n + 3], [1, n + 3]], np.float32) * 12 - 0.5
        H = cv2.getPerspectiveTransform(inner, quad.astype(np.float32))
        mask = cv2.warpPerspective(np.full_like(big, 255), H, image.shape[::-1])
        image[mask > 127] = cv2.warpPerspective(big, H, image.shape[::-1])[mask > 127]
    return image


@pytest.mark.slow
def test_an_identity_that_rig_toml_lacks_is_seen_in_its_place(design):
    a, markers = seen_often(design)[0], marker_map(design)
    observations, stated, true, T = scene(design, 4)
    observations = observations.take(markers.id[observations.marker] != a)
    m = measure_observations(observations, stated, markers)
    cameras = {camera.name: camera for camera in true.cameras}

    def read(frame, name):
        return printed(cameras[name], T[frame], markers, {a: 97})

    found = find_suspicious_markers(m, markers, (), read)
    assert [(s.marker, s.kind, s.other) for s in found if s.marker == a] == [(a, "other", 97)]
    assert (
        "marker 97 is in its place" in str(found[0]) and find_suspicious_markers(m, markers, (), lambda *_: None) == ()
    )


@pytest.mark.slow
@pytest.mark.parametrize("case", ["as stated", "another dictionary", "mirrored", "other identities", "nothing"])
def test_why_no_marker_was_found(design, case):
    markers, camera = marker_map(design), design.cameras[0]
    drawn = replace(markers, dictionary=["DICT_6X6_100"] * len(markers.id)) if case == "another dictionary" else markers
    other = {int(k): 60 + i for i, k in enumerate(markers.id)} if case == "other identities" else {}
    image = printed(camera, design.mechanism.home, drawn, other)
    if case == "mirrored":
        image = np.ascontiguousarray(image[:, ::-1])
    if case == "nothing":
        image = np.random.default_rng(0).integers(0, 256, image.shape, np.uint8)
    reason = no_marker_reason([image], markers)
    wanted = {
        "another dictionary": "DICT_6X6_1000",
        "mirrored": "the images are mirrored",
        "other identities": "other markers than rig.toml has: 6",
    }
    assert wanted.get(case, "") in reason and bool(reason) == (case in wanted)
