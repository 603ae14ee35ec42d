"""Exposures while the struts move: clock offset and lag are found, and poses in motion predicted as those at rest."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from calib.files import calibration_file
from rig.model.machine_motion_simulation import simulate_machine_run
from rig.recording.recording_folder import load_recording
from tests.cli import run
from tests.conftest import ROOT
from tests.truth import rigid

OFFSET, LAG = 0.013, 0.018  # s
FAST = 0.02  # m/s


@pytest.mark.slow
def test_offset_and_lag_are_found_and_poses_in_motion_are_predicted(tmp_path, capsys, monkeypatch):
    """By the commands of the page."""
    page = (ROOT / "docs" / "measuring.md").read_text().split("\n## Poses in motion\n")[1].split("\n## ")[0]
    monkeypatch.chdir(tmp_path)
    for line in re.findall(r"^    rig (.*)$", page, re.MULTILINE):
        run(*line.split())
    calibration, recording = calibration_file.load(tmp_path / "calibration.json"), load_recording(tmp_path / "REC")
    found = {effect.name: effect for effect in calibration.physics.effects}
    assert set(found) == {"time_offset", "servo_lag"}
    assert abs(found["time_offset"].offset - OFFSET) < 2e-4 and abs(found["servo_lag"].time_constant - LAG) < 2e-4

    _, t = recording.exposures.times()
    design = replace(recording.design, mechanism=calibration.correction.fitted)
    predicted = simulate_machine_run(design, recording.commands, t, calibration.physics.effects).T_base_platform
    truth = np.array(json.loads((tmp_path / "truth.json").read_text())["poses"]).reshape(-1, 4, 4)
    error = rigid.errors(predicted.as_matrix(), truth)
    path = recording.commands
    speed = np.abs(path.at(t + 1e-3) - path.at(t - 1e-3)).max(axis=1) / 2e-3
    at_rest, moving = rigid.rms(error[speed < 1e-6]), rigid.rms(error[speed >= FAST])
    with capsys.disabled():
        print(f"\nRMS m, rad: {at_rest} at rest, {moving} of {(speed >= FAST).sum()} at {FAST * 1e3:g} mm/s or more")
    assert (speed >= FAST).sum() > 20
    assert moving[0] <= 1.5 * at_rest[0] and moving[1] <= 1.5 * at_rest[1]
