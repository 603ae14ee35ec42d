"""Images read where markers ought to be: as much is found as in whole images, and what is not as stated is searched
for.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from rig.model import mechanisms
from rig.model.design import Marker, Target
from rig.model.pose import exp, pose_difference
from rig.recording.recording_folder import Commands, Exposures, Recording
from tests.vision.reading.test_marker_identity import printed
from vision.corners import marker_detection_and_corner_fit
from vision.marker_corner_prediction import marker_map
from vision.reading import corner_reading_from_recording_images as collecting
from vision.reading import marker_identity_mistakes_and_expected_marker_places
from vision.reading.corner_reading_from_recording_images import LEARN_FROM, read_corners_of_all_images
from vision.reading.marker_identity_mistakes_and_expected_marker_places import find_suspicious_markers
from vision.recording_measurement import measure_recording

FRAMES = 28
SHOWN = {
    "platform": [0, 8, 11, 17],
    "base": [24, 26, 31, 37],
}  # faces that none of the others covers in the first camera's images


@pytest.fixture(scope="module")
def drawn(design, tmp_path_factory):
    """(Recording of one camera, images in its folder, true poses); the platform moves little from frame to frame."""
    folder, rng = tmp_path_factory.mktemp("drawn"), np.random.default_rng(0)
    m = marker_map(design)
    listed = {
        body: tuple(Marker(int(m.id[k]), m.side[k], m.T_body_marker[k], m.side[k] / 7) for k in m.rows(SHOWN[body]))
        for body in SHOWN
    }
    one = replace(
        design,
        cameras=design.cameras[:1],
        targets=tuple(Target(body, body, m.dictionary[0], listed=listed[body]) for body in SHOWN),
    )
    wave = np.sin(np.outer(np.arange(FRAMES), [0.1, 0.13, 0.17, 0.11, 0.07, 0.19]))
    T = one.mechanism.home * exp(wave * [0.005, 0.005, 0.005, 0.02, 0.02, 0.02])
    write(folder, one, T, rng, {})
    t = np.arange(FRAMES) * 0.1
    exposures = Exposures(np.arange(FRAMES), t, [one.cameras[0].name] * FRAMES, [f"{k}.png" for k in range(FRAMES)])
    commands = Commands(t, mechanisms.kinematics_of(one.mechanism).inverse(T, one.mechanism))
    return Recording(folder, one, commands, exposures, None, None, None), T


def write(folder, design, T, rng, as_another, frames=range(FRAMES)):
    for k in frames:
        image = printed(design.cameras[0], T[k], marker_map(design), as_another)
        image = cv2.GaussianBlur(image, (0, 0), 0.6) * 0.8 + 20 + rng.normal(0, 1, image.shape)
        cv2.imwrite(str(folder / f"{k}.png"), np.clip(np.rint(image), 0, 255).astype(np.uint8))


@pytest.fixture
def searches(monkeypatch):
    """How many whole images are searched, counted."""
    monkeypatch.setenv("OMP_NUM_THREADS", "1")  # what other processes search is not counted here
    count, search = [], marker_detection_and_corner_fit.read_markers

    def counted(*arguments):
        count.append(1)
        return search(*arguments)

    monkeypatch.setattr(marker_detection_and_corner_fit, "read_markers", counted)
    monkeypatch.setattr(collecting, "read_markers", counted)
    return count


@pytest.mark.slow
@pytest.mark.parametrize("how", ["commanded", "the frame before", "commands that lie"])
def test_only_the_images_that_teach_are_searched(drawn, searches, monkeypatch, how):
    recording, T = drawn
    if how == "the frame before":
        recording = replace(recording, commands=None)
    if how == "commands that lie":
        values = recording.commands.values + 0.02 * np.random.default_rng(1).normal(size=(FRAMES, 6))
        recording = replace(recording, commands=Commands(recording.commands.t, values))
    markers = marker_map(recording.design)
    found = read_corners_of_all_images(recording, markers)
    assert len(searches) == LEARN_FROM and found.left_out == []
    monkeypatch.setattr(
        marker_identity_mistakes_and_expected_marker_places, "learn_expected_marker_places", lambda *_: None
    )
    whole = read_corners_of_all_images(recording, markers)
    assert len(searches) == 2 * LEARN_FROM + FRAMES - LEARN_FROM

    def keyed(c):
        return {
            key: uv
            for *key, uv in (
                (f, m, k, uv) for f, m, k, uv in zip(c.frame.tolist(), c.marker.tolist(), c.corner.tolist(), c.uv)
            )
            for key in [tuple(key)]
        }

    ours, theirs = keyed(found.corners), keyed(whole.corners)
    both = sorted(ours.keys() & theirs.keys())
    assert len(both) > 0.97 * len(theirs)
    away = np.array([ours[key] - theirs[key] for key in both])
    assert np.sqrt(np.mean(away**2)) < 0.01 and np.median(np.abs(away)) < 2e-3


@pytest.mark.slow
def test_poses_are_the_same_and_right(drawn):
    recording, T = drawn
    m, _ = measure_recording(recording)
    assert len(m.frames) == FRAMES and not find_suspicious_markers(m, marker_map(recording.design))
    assert np.abs(pose_difference(m.T_base_platform, T)[:, :3]).max() < 5e-4


def test_images_that_teach_are_placed_by_the_lens_that_they_teach(drawn, monkeypatch):
    recording, T = drawn
    camera, markers, place, by = (
        recording.design.cameras[0],
        marker_map(recording.design),
        collecting.fit_read_markers,
        [],
    )
    taught = replace(camera, distortion=camera.distortion + 1e-4)
    monkeypatch.setattr(
        marker_identity_mistakes_and_expected_marker_places,
        "learn_expected_marker_places",
        lambda *_: marker_identity_mistakes_and_expected_marker_places.Expectation(
            (taught,), markers, dict(enumerate(T))
        ),
    )

    def placed(full, camera, *arguments, **options):
        by.append((camera is taught, full.tobytes()))
        return place(full, camera, *arguments, **options)

    monkeypatch.setattr(collecting, "fit_read_markers", placed)
    found = read_corners_of_all_images(recording, markers)
    assert len({image for anew, image in by if anew}) == LEARN_FROM and by[-1][0]  # once each, after all that taught
    assert found.cameras == {camera.name: taught}


@pytest.mark.slow
@pytest.mark.parametrize("case, searched", [("hidden", 0), ("turned", 1), ("another", 1), ("half of them hidden", 1)])
def test_an_image_is_searched_where_something_else_is_in_a_markers_place(drawn, searches, tmp_path, case, searched):
    recording, T = drawn
    taught = {round(k) for k in np.linspace(0, FRAMES - 1, LEARN_FROM)}
    odd = next(k for k in range(FRAMES) if k not in taught)
    for k in range(FRAMES):
        image = cv2.imread(str(recording.folder / f"{k}.png"), cv2.IMREAD_UNCHANGED)
        rows, places = expect_places(recording, T[k])
        first = places[0].astype(np.int32)
        (x0, y0), (x1, y1) = first.min(axis=0) - 12, first.max(axis=0) + 13
        if k == odd and case == "turned":
            image[y0:y1, x0:x1] = image[y0:y1, x0:x1][::-1, ::-1].copy()
        elif k == odd and case == "another":
            write(
                tmp_path,
                recording.design,
                T,
                np.random.default_rng(0),
                {int(marker_map(recording.design).id[rows[0]]): 97},
                [k],
            )
            continue
        elif k == odd:
            for place in places[: 1 if case == "hidden" else 3]:
                cv2.fillConvexPoly(image, place.astype(np.int32), 120)
        cv2.imwrite(str(tmp_path / f"{k}.png"), image)
    found = read_corners_of_all_images(replace(recording, folder=tmp_path), marker_map(recording.design))
    assert len(searches) == LEARN_FROM + searched and found.left_out == []


def expect_places(recording, T):
    from vision.marker_corner_prediction import expected_marker_rows_and_corners_in_image

    return expected_marker_rows_and_corners_in_image(recording.design.cameras[0], T, marker_map(recording.design))


@pytest.mark.parametrize("case", [pytest.param("two faces exchanged", marks=pytest.mark.slow), "another identity"])
def test_what_is_not_as_stated_is_still_found_and_named(drawn, searches, tmp_path, case):
    recording, T = drawn
    markers = marker_map(recording.design)
    rows, _ = expect_places(recording, T[0])
    a, b = markers.id[[row for row in rows if markers.on_platform[row]][:2]].tolist()
    write(
        tmp_path,
        recording.design,
        T,
        np.random.default_rng(0),
        {a: b, b: a} if case == "two faces exchanged" else {a: 97},
    )
    spoilt = replace(recording, folder=tmp_path)
    m, collected = measure_recording(spoilt)
    assert (
        len(searches) == FRAMES
    )  # each of them: the teaching ones, and those where something is not where it should be
    from vision.reading.corner_reading_from_recording_images import image_reader

    named = {
        (s.marker, s.kind, s.other)
        for s in find_suspicious_markers(m, markers, collected.repeated, image_reader(spoilt))
    }
    wanted = {(a, "exchanged", b), (b, "exchanged", a)} if case == "two faces exchanged" else {(a, "other", 97)}
    assert wanted <= named and collected.left_out == []
    assert np.abs(pose_difference(m.T_base_platform, T[m.frames])[:, :3]).max() < 5e-4
