"""Clocks of cameras and commands by exposures in motion: found with the geometry, used for rows and late cameras."""

import re
from dataclasses import replace

import numpy as np
import pytest

from rig.recording.recording_folder import Commands, load_recording
from tests.cli import run
from tests.moving_run import ROW_TIME, write_moving_recording
from tests.truth import rigid
from tests.truth.camera_sets import HIGH
from vision.clock_offset_drive_lag_and_camera_time_offset_estimation import (
    clock_offset_and_drive_lag_by_recording,
    lagged_commands,
)
from vision.recording_measurement import measure_recording

OFFSET = 0.0073  # s
DELAYS = np.array([0.0, 0.021, 0.013])  # s
SPEED = 0.02  # m/s


def own(found):
    """(f, 6, 6) covariance of each pose without what all share."""
    return found.covariance - found.common @ np.swapaxes(found.common, 1, 2)


def clocks(recording, found):
    return clock_offset_and_drive_lag_by_recording(
        recording, found.frames, found.T_base_platform, own(found), found.common
    )


@pytest.fixture(scope="module")
def moving(tmp_path_factory):
    """(Recording of a machine that never rests, its cameras rolling, apart and early; (n, 4, 4) its true poses)."""
    folder = tmp_path_factory.mktemp("moving")
    case, at = write_moving_recording(folder, OFFSET, DELAYS, SPEED)
    return load_recording(folder), case.machine.forward(at), case


@pytest.mark.slow
def test_poses_and_clocks_of_a_machine_that_moves(moving):
    recording, truth, case = moving
    found, _ = measure_recording(recording)
    (found_clocks,) = clocks(recording, found)
    assert abs(found_clocks.offset - OFFSET) < 2e-4 and found_clocks.lag == 0
    assert abs(found_clocks.offset - OFFSET) < 3 * found_clocks.offset_sigma and found_clocks.moving > 30
    assert SPEED / 2 < found_clocks.speed < SPEED
    error = rigid.rms(rigid.errors(found.T_base_platform.as_matrix(), truth[found.frames]))
    exposures = recording.exposures
    at_once = replace(exposures, t=exposures.times()[1][exposures.frame])
    alike, _ = measure_recording(replace(recording, exposures=at_once))
    assert np.abs(np.array(alike.camera_offsets) - DELAYS).max() < 2e-4, "which are found where nobody states them"
    unstated = rigid.rms(rigid.errors(alike.T_base_platform.as_matrix(), truth[alike.frames]))
    assert unstated[0] < 1.2 * error[0] and found.camera_offsets == ()
    assert found.to_frame_time is not None and np.linalg.norm(found.to_frame_time, axis=1).max() > 1.0
    still = np.linalg.norm(found.to_frame_time[found.observations.camera == 0], axis=1)
    assert still.max() < 1e-9, "the first camera's time is the frame's"


@pytest.mark.slow
def test_cameras_whose_stamps_are_late_by_different_times(moving):
    recording, truth, case = moving
    names, late = [camera.name for camera in recording.design.cameras], np.array([0.0, 0.004, -0.0025])  # s
    e = recording.exposures
    stamped = replace(e, t=e.t + late[[names.index(name) for name in e.camera]])
    found, _ = measure_recording(replace(recording, exposures=stamped))
    assert np.abs(np.array(found.camera_offsets) + late).max() < 2e-4
    error = rigid.rms(rigid.errors(found.T_base_platform.as_matrix(), truth[found.frames]))
    rest, _ = measure_recording(recording)
    assert rest.camera_offsets == ()
    assert error[0] < 1.2 * rigid.rms(rigid.errors(rest.T_base_platform.as_matrix(), truth[rest.frames]))[0]
    assert abs(clocks(replace(recording, exposures=stamped), found)[0].offset - OFFSET) < 2e-4


def test_a_rolling_shutter_that_nobody_stated_is_no_difference_of_stamps(moving):
    recording, _, _ = moving
    cameras = tuple(replace(camera, shutter="global", row_time=0.0) for camera in recording.design.cameras)
    found, _ = measure_recording(replace(recording, design=replace(recording.design, cameras=cameras)))
    assert found.camera_offsets == ()
    assert [one.camera for one in found.readouts] == ["cam0", "cam1", "cam2"]
    for one in found.readouts:
        assert abs(one.time - HIGH * ROW_TIME) < 4 * one.sigma and 'state shutter = "rolling"' in str(one)
    assert all(camera.shutter == "global" for camera in found.design.cameras), "which rig.toml states"


def test_an_offset_and_a_lag_are_told_apart_by_reversals(tmp_path):
    from rig.planning.layout import hexapod_layout_and_camera_placement

    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.9)
    (tmp_path / "rig.toml").write_text(re.sub(r"^max_speed = .*$", "max_speed = 0.3", text, flags=re.MULTILINE))
    words = ["simulate", tmp_path / "rig.toml", "--plan", "sobol:20,moving:20,zigzag:20", "--seed", "5"]
    effects = ["--effect", "servo_lag:rig:time_constant=0.01", "--effect", "time_offset:clock:offset=-0.005"]
    run(*words, *effects, "--out", tmp_path / "REC")
    recording = load_recording(tmp_path / "REC")
    (found,) = clocks(recording, measure_recording(recording)[0])
    assert abs(found.offset + 0.005) < 2e-4 and abs(found.lag - 0.01) < 2e-4
    assert abs(found.offset + 0.005) < 4 * found.offset_sigma and abs(found.lag - 0.01) < 4 * found.lag_sigma
    assert "5.0" in str(found) and "late" in str(found)


def test_a_lagged_way_is_behind_by_the_lag_at_a_steady_speed_and_arrives():
    commands = Commands(np.array([0.0, 1.0, 2.0, 4.0]), np.array([[0.0], [0.0], [1.0], [1.0]]))
    lagged = lagged_commands(commands, 0.05, np.array([1.9, 3.9]))
    assert lagged.at(1.9)[0] == pytest.approx(0.85, abs=1e-7)
    assert lagged.at(3.9)[0] == pytest.approx(1.0, abs=1e-9) and lagged.at(1.0)[0] == 0


def test_a_recording_at_rest_has_no_clocks(moving, tmp_path):
    recording, _, _ = moving
    found, _ = measure_recording(recording)
    dwelling = Commands(np.array([0.0]), recording.commands.values[:1])
    assert clocks(replace(recording, commands=dwelling), found) == ()
