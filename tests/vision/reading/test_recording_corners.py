"""Images of a recording, whole: what is seen, a second look, and files that are none."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from rig.errors import FileError, NotEnoughData
from rig.model.pose import pose_difference
from rig.recording import recording_folder
from tests.conftest import BENCH, make_recording
from vision.marker_corner_prediction import marker_map
from vision.reading.corner_reading_from_recording_images import read_corners_of_all_images
from vision.reading.live_measurement_and_corner_refit import SETTLED, largest_pixel_shift_between_lenses
from vision.recording_measurement import measure_recording


@pytest.fixture(scope="module")
def check():
    return recording_folder.load_recording(BENCH / "check")


@pytest.fixture(scope="module")
def measured(check):
    return measure_recording(check)


@pytest.mark.slow
def test_poses_from_images_are_within_their_covariance(measured):
    m, _ = measured
    truth = RigidTransform.from_matrix(
        np.array(json.loads((BENCH / "check-truth.json").read_text())["poses"]).reshape(-1, 4, 4)
    )
    errors = pose_difference(m.T_base_platform, truth)
    assert len(m.frames) == 6 and m.noise < 0.02
    assert np.abs(errors[:, :3]).max() < 6e-5 and np.abs(errors[:, 3:]).max() < 2e-4
    assert (
        np.mean(np.einsum("ni,nij,nj->n", errors, np.linalg.inv(m.covariance), errors)) < 12.6
    )  # 6 degrees, one draw: 5 %


def test_a_second_look_adds_markers_in_their_places(check, measured):
    first = read_corners_of_all_images(check, marker_map(check.design))
    m, second = measured
    assert len(second.corners.frame) > len(first.corners.frame)
    added = np.arange(len(second.corners.frame)) >= len(first.corners.frame)
    key = {
        (f, c, k): i
        for i, (f, c, k) in enumerate(
            zip(second.corners.frame.tolist(), second.corners.camera, second.corners.marker.tolist())
        )
    }
    assert len(key) * 4 == len(second.corners.frame)  # none twice
    assert added.sum() % 4 == 0


def test_corners_are_placed_by_the_lens_as_measured(check, measured):
    m, second = measured
    stated, true = check.design.cameras, m.design.cameras
    first = replace(second, cameras={camera.name: camera for camera in stated})
    assert (
        largest_pixel_shift_between_lenses(second.corners, second.cameras, true)
        < SETTLED
        < largest_pixel_shift_between_lenses(first.corners, first.cameras, true)
    )
    assert largest_pixel_shift_between_lenses(first.corners, first.cameras, stated) == 0
    bent = [
        [replace(camera, distortion=camera.distortion + [by, 0, 0, 0, 0]) for camera in stated] for by in (1e-3, 2e-3)
    ]
    assert largest_pixel_shift_between_lenses(first.corners, first.cameras, bent[1]) == pytest.approx(
        2 * largest_pixel_shift_between_lenses(first.corners, first.cameras, bent[0]), rel=0.02
    )
    shifted = [replace(camera, matrix=camera.matrix + [[0, 0, 1], [0, 0, 1], [0, 0, 0]]) for camera in stated]
    assert (
        largest_pixel_shift_between_lenses(first.corners, first.cameras, shifted)
        < largest_pixel_shift_between_lenses(first.corners, first.cameras, bent[0]) / 2
    )  # it moves a marker as a whole


def test_progress_counts_every_image(check):
    calls = []
    read_corners_of_all_images(check, marker_map(check.design), lambda done, of: calls.append((done, of)))
    assert calls == [(i, 18) for i in range(1, 19)]


def test_an_image_that_cannot_be_decoded_is_named(tmp_path):
    shutil.copytree(BENCH / "check", tmp_path / "rec")
    path = tmp_path / "rec/images/cam2/00001.png"
    whole = path.read_bytes()
    path.write_bytes(whole[:2000] + b"\0" * 20000 + whole[-60:])  # head and tail are sound
    with pytest.raises(FileError, match="00001.png"):
        read_corners_of_all_images(
            recording_folder.load_recording(tmp_path / "rec"),
            marker_map(recording_folder.load_recording(tmp_path / "rec").design),
        )


@pytest.mark.slow
def test_what_cannot_be_measured_says_why(tmp_path, design, rig_text):
    folder = tmp_path / "rec"
    make_recording(folder, design, rig_text, 1, count=3)
    (folder / "corners.csv").unlink()
    with pytest.raises(NotEnoughData, match="no images and there is no corners.csv"):
        measure_recording(recording_folder.load_recording(folder))
    text = (folder / "rig.toml").read_text()
    (folder / "rig.toml").write_text(text.replace('body = "platform"', 'body = "base"'))
    with pytest.raises(NotEnoughData, match="no target on the platform"):
        measure_recording(recording_folder.load_recording(folder))
    shutil.copytree(BENCH / "check", tmp_path / "blind")
    text = (tmp_path / "blind/rig.toml").read_text()
    (tmp_path / "blind/rig.toml").write_text(text.replace("DICT_5X5_100", "DICT_APRILTAG_36h11"))
    with pytest.raises(
        NotEnoughData,
        match="no marker of rig.toml was found in any of 18 images; of 8 .* identities are of DICT_5X5_1000",
    ):
        measure_recording(recording_folder.load_recording(tmp_path / "blind"))
