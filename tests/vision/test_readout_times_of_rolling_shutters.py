"""Readout times of rolling shutters that nobody stated: found from exposures in motion, with the clocks."""

from dataclasses import replace

import numpy as np
import pytest

import vision
from rig.model.pose import log
from rig.recording.recording_folder import load_recording
from tests.moving_run import ROW_TIME, rig_text, write_moving_recording, write_standing_recording
from tests.truth import rigid
from tests.truth.camera_sets import HIGH
from vision.platform_motion_between_frame_time_and_corner_exposure import (
    commanded_platform_rates,
    measurement_with_uncertainty_of_rates,
)

OFFSET = 0.0073  # s
DELAYS = np.array([0.0, 0.021, 0.013])  # s
SPEED = 0.02  # m/s
READOUT = 0.03  # s


def measured(folder, case, at):
    """(MeasurementResult of a folder whose rig.toml leaves row times open, (m, rad) RMS of its poses' errors)."""
    (folder / "rig.toml").write_text(rig_text(case, False).replace('"global"', '"rolling"'))
    found = vision.measure(load_recording(folder))
    m, truth = found.measurement, case.machine.forward(at)
    return found, rigid.rms(rigid.errors(m.T_base_platform.as_matrix(), truth[m.frames]))


def moving(folder, seed, moves, readout):
    """(Case, (n, 6) m its true lengths, MeasurementResult, RMS errors) of a recording in motion. readout : s"""
    folder.mkdir()
    case, at = write_moving_recording(folder, OFFSET, DELAYS, SPEED, seed, moves, readout / HIGH)
    return case, at, *measured(folder, case, at)


@pytest.mark.slow
def test_poses_in_motion_of_rolling_shutters_are_as_good_as_at_rest_over_seeds(tmp_path, capsys):
    apart = []
    for seed in (1, 2, 3, 4):
        case, at, found, error = moving(tmp_path / f"moving{seed}", seed, 28, READOUT)
        (standing := tmp_path / f"standing{seed}").mkdir()
        write_standing_recording(case, standing, at, 6 + seed)
        rest, rest_error = measured(standing, case, at)
        assert error[0] <= 1.5 * rest_error[0] and error[1] <= 1.5 * rest_error[1]
        assert abs(found.clocks[0].offset - OFFSET) <= 2e-4
        assert all(one.certain for one in found.measurement.readouts)
        apart += [(one.time - READOUT) / one.sigma for one in found.measurement.readouts]
        assert rest.measurement.readouts == () and "neither stated nor determined" in "".join(rest.statement)
        with capsys.disabled():
            print(f"\nseed {seed}: RMS m, rad {error} in motion, {rest_error} standing; offset off by", end=" ")
            print(f"{found.clocks[0].offset - OFFSET:.1e} s; readouts off by, in standard deviations, {apart[-3:]}")
    assert len(apart) == 12 and (np.abs(apart) > 1.96).sum() <= 2 and np.abs(apart).max() < 4


def test_a_readout_time_is_found_reported_and_written(tmp_path):
    _, _, found, _ = moving(tmp_path / "moving", 1, 10, READOUT)
    for one, camera in zip(found.measurement.readouts, found.measurement.design.cameras, strict=True):
        assert one.certain and abs(one.time - READOUT) < 3 * one.sigma < 0.006
        assert camera.row_time * HIGH == pytest.approx(one.time, abs=one.sigma / 2)
    assert "camera 'cam0' reads its rows in" in "".join(found.statement)
    assert found.tree()["readouts"][2]["camera"] == "cam2"
    (tmp_path / "out").mkdir()
    found.write(tmp_path / "out")
    again = load_recording(tmp_path / "out").design.cameras
    assert [camera.row_time for camera in again] == pytest.approx(
        [camera.row_time for camera in found.measurement.design.cameras], abs=1e-12
    )


def test_a_camera_that_sees_nothing_that_moves_leaves_the_others_their_readouts(tmp_path):
    (folder := tmp_path / "moving").mkdir()
    case, at = write_moving_recording(folder, OFFSET, DELAYS, SPEED, 1, 10, READOUT / HIGH)
    lines = (folder / "corners.csv").read_text().splitlines(keepends=True)
    (folder / "corners.csv").write_text("".join(line for line in lines if ",cam2," not in line))
    found, _ = measured(folder, case, at)
    readouts = {one.camera: one for one in found.measurement.readouts}
    assert set(readouts) == {"cam0", "cam1"} and all(one.certain for one in readouts.values())
    assert all(abs(one.time - READOUT) < 3 * one.sigma for one in readouts.values())


@pytest.mark.slow
def test_a_global_shutter_is_given_no_readout_time(tmp_path):
    for seed in (1, 2):
        _, _, found, _ = moving(tmp_path / f"moving{seed}", seed, 14, 0.0)
        assert len(found.measurement.readouts) == 3
        for one, camera in zip(found.measurement.readouts, found.measurement.design.cameras):
            assert not one.certain and abs(one.time) < 3 * one.sigma and camera.row_time is None
            assert "no readout time beyond doubt" in str(one)


def test_uncertain_rows_count_in_poses_as_wrong_ones_move_them(tmp_path):
    """What a wrong row time of one camera makes of each pose, position and rotation, is what its uncertainty adds."""
    (folder := tmp_path / "moving").mkdir()
    case, _ = write_moving_recording(folder, OFFSET, 0 * DELAYS, SPEED, 1, 10, READOUT / HIGH)
    off = 0.1 * READOUT / HIGH

    def measured_with(row_times):
        text = rig_text(case, True)
        for one in row_times:
            text = text.replace(f"row_time = {ROW_TIME}", f"row_time = {one!r}  # s", 1)
        (folder / "rig.toml").write_text(text)
        return vision.measure(load_recording(folder)).measurement

    right = measured_with([READOUT / HIGH] * 3)
    wrong = measured_with([READOUT / HIGH, READOUT / HIGH + off, READOUT / HIGH])
    moved = log(right.T_base_platform.inv() * wrong.T_base_platform)
    rates = commanded_platform_rates(load_recording(folder), ())
    unsure = replace(rates, row_time_sigma=np.array([0.0, off, 0.0]), apart=0.0)
    grown = measurement_with_uncertainty_of_rates(right, unsure).covariance - right.covariance
    sizes = np.sqrt(np.einsum("fii->fi", grown))
    ratio = np.sqrt((sizes**2).mean(axis=0) / (moved**2).mean(axis=0))
    assert (np.abs(ratio - 1) < 0.15).all(), ratio
    alike = [float(np.corrcoef(np.abs(moved[:, i]), sizes[:, i])[0, 1]) for i in range(6)]
    assert min(alike) > 0.6, alike
