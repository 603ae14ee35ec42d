"""The tour on real data: its commands run on the first rows of the table that it names."""

import json

import numpy as np
import pytest

from rig.recording.recording_folder import load_recording
from tests.bench.tour import PAGE, write_inputs
from tests.cli import run
from tests.docs.told import commands, words

ROWS = 60


def test_the_import_finds_units_and_rotations_as_the_page_says(shared, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_inputs(tmp_path, slice(ROWS))
    said = "".join(run(*words(one)).stdout for one in commands(PAGE) if words(one)[0] in ("new", "import", "check"))
    assert "semicolons between the cells, decimal commas" in said and "positions are in mm" in said
    assert "rotations are Euler angles" in said and "nothing wrong or unlikely was found" in said
    found, kept = load_recording(tmp_path / "REC").poses, load_recording(shared / "recordings/arm-1").poses
    away = (kept.T_base_platform[:ROWS].inv() * found.T_base_platform).as_matrix() - np.eye(4)
    assert len(found.frame) == ROWS and np.abs(away).max() < 1e-6


@pytest.mark.slow
def test_the_rest_of_the_tour_runs_on_few_rows(shared, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_inputs(tmp_path, slice(ROWS))
    for command in commands(PAGE):
        if words(command)[0] in ("new", "import"):
            run(*words(command))
    lines = (tmp_path / "REC/poses.csv").read_text().splitlines()
    (tmp_path / "wanted.csv").write_text("\n".join([lines[0], *lines[-3:]]) + "\n")
    told = [one.replace("1000-1494", "40-59").replace("0-999", "0-39") for one in commands(PAGE)]
    for command in told[3:6]:
        run(*words(command))
    assert json.loads((tmp_path / "calibration.json").read_text())["held_out"]["after"]["n"] > 0
    assert len((tmp_path / "commands.csv").read_text().splitlines()) == 4 and (tmp_path / "verified.html").exists()
