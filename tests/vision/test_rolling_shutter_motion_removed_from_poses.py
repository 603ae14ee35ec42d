"""Poses in motion: a stated rolling shutter is taken out of them, and what clocks may be apart is in the covariance."""

import json
import re
from dataclasses import replace

import numpy as np

from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.recording.recording_folder import load_recording
from tests.cli import run
from tests.truth import rigid
from vision import platform_motion_between_frame_time_and_corner_exposure
from vision.recording_measurement import measure_recording

ROW_TIME = 1.5e-5  # s; 15 ms an image
FAST = 0.02  # m/s


def rolling(text):
    """A rig.toml whose cameras expose row by row, and whose axes are fast."""
    text = text.replace('shutter = "global"', f'shutter = "rolling"\nrow_time = {ROW_TIME}')
    return re.sub(r"^max_speed = .*$", "max_speed = 0.3", text, flags=re.MULTILINE)


def measured(folder, text, plan):
    """(Recording, Measurement, (n, 4, 4) its true poses, (n,) m/s of the axes)."""
    (folder / "rig.toml").write_text(text)
    words = ["simulate", folder / "rig.toml", "--plan", plan, "--seed", "5", "--out", folder / "REC"]
    run(*words, "--truth", folder / "t.json")
    recording = load_recording(folder / "REC")
    found, _ = measure_recording(recording)
    truth = np.array(json.loads((folder / "t.json").read_text())["poses"]).reshape(-1, 4, 4)[found.frames]
    frames, t = recording.exposures.times()
    t = t[np.searchsorted(frames, found.frames)]
    speed = np.abs(recording.commands.at(t + 1e-3) - recording.commands.at(t - 1e-3)).max(axis=1) / 2e-3
    return recording, found, truth, speed


def at_once(camera):
    """The camera as if all its rows were exposed at once."""
    return replace(camera, shutter="global", row_time=0.0)


def test_poses_of_a_moving_platform_are_as_good_as_of_one_that_stands(tmp_path):
    text = rolling(
        hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.9)
    )  # large, so that its waves are fast
    recording, found, truth, speed = measured(tmp_path, text, "sobol:14,moving:24")
    stands, moves = speed < 1e-6, speed >= FAST
    error = rigid.errors(found.T_base_platform.as_matrix(), truth)
    assert stands.sum() > 10 and moves.sum() > 5
    at_rest, moving = rigid.rms(error[stands]), rigid.rms(error[moves])
    assert moving[0] <= 1.5 * at_rest[0] and moving[1] <= 1.5 * at_rest[1]
    observed = replace(
        recording, design=replace(recording.design, cameras=tuple(map(at_once, recording.design.cameras)))
    )
    without = rigid.errors(measure_recording(observed)[0].T_base_platform.as_matrix(), truth)
    assert rigid.rms(without[moves])[0] > 3 * moving[0]
    scaled = np.linalg.solve(np.linalg.cholesky(found.covariance), error[..., None])[..., 0]
    assert (scaled**2).mean() < 2.0
    rates = platform_motion_between_frame_time_and_corner_exposure.commanded_platform_rates(recording)
    assert not rates.rate[stands].any() and (np.abs(rates.rate[moves]).max(axis=1) > FAST / 3).all()


def test_where_a_platform_turns_round_what_clocks_may_be_apart_is_in_the_covariance(tmp_path):
    text = rolling(hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3))
    _, found, _, speed = measured(tmp_path, text, "sobol:8,zigzag:8")
    size = np.sqrt(np.trace(found.covariance[:, :3, :3], axis1=1, axis2=2))
    assert np.median(size[speed > 0.1]) > 3 * np.median(size[speed < 1e-6])


def test_nothing_that_is_exposed_at_once_or_stands_has_rates(tmp_path):
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=1)
    for lines, plan in ((text, "moving:4"), (rolling(text), "sobol:4")):
        (tmp_path / "rig.toml").write_text(lines)
        run("simulate", tmp_path / "rig.toml", "--plan", plan, "--seed", "1", "--out", tmp_path / "REC", "--force")
        assert (
            platform_motion_between_frame_time_and_corner_exposure.commanded_platform_rates(
                load_recording(tmp_path / "REC")
            )
            is None
        )
