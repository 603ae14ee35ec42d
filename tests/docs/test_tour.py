"""The tour on real data: its commands run on the first rows of the table that it names."""

import json
import re

import numpy as np
import pytest

from rig.recording.recording_folder import load_recording
from tests.bench.tour import PAGE, write_inputs
from tests.cli import run
from tests.docs.document_commands import commands, words

ROWS = 60


@pytest.mark.slow
def test_the_import_finds_units_and_rotations_as_the_page_says(shared, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_inputs(tmp_path, slice(ROWS))
    output = "".join(run(*words(one)).stdout for one in commands(PAGE) if words(one)[0] in ("new", "import", "check"))
    assert "semicolons between the cells, decimal commas" in output and "positions are in mm" in output
    assert "rotations are Euler angles" in output and "nothing wrong or unlikely was found" in output
    found, original = load_recording(tmp_path / "REC").poses, load_recording(shared / "recordings/arm-1").poses
    away = (original.T_base_platform[:ROWS].inv() * found.T_base_platform).as_matrix() - np.eye(4)
    assert len(found.frame) == ROWS and np.abs(away).max() < 1e-6


@pytest.mark.slow
def test_block_and_board_give_what_the_page_says(shared, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_inputs(tmp_path, slice(ROWS))
    made = {one[0]: run(*one) for one in map(words, commands(PAGE)) if one[0] in ("measure", "view", "lens")}
    done = {name: one.stdout + one.stderr for name, one in made.items()}
    page = PAGE.read_text(encoding="utf-8")
    assert "474 of 542 frames solved" in done["measure"] and "2.46 as stated, 0.99 as adjusted" in done["measure"]
    assert "1.018 +- 0.030" in done["measure"] and "none" in done["measure"].partition("flipped")[2].splitlines()[0]
    assert "[327 / 474 of 542]" in page and "68 frames have no pose" in page
    found = re.search(r"(\d+) of \d+ corners of the board", done["lens"])
    assert found is not None and f"finds {found[1]} corners" in page
    for model, figure in (("4 distortion terms", "0.30 px"), ("no distortion", "0.45 px")):
        line = next(line for line in done["lens"].splitlines() if line.strip().startswith(model))
        assert f"{float(line.removesuffix('<- chosen').split()[-1]):.2f} px" == figure and figure in page
    for one in ("measured/report.html", "view.html"):  # nothing was commanded, so nothing can be calibrated
        assert "rig calibrate" not in (tmp_path / one).read_text(encoding="utf-8"), one
    assert (tmp_path / "view.html").exists() and (tmp_path / "lens/camera.toml").exists()


@pytest.mark.slow
def test_the_rest_of_the_tour_runs_on_few_rows(shared, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_inputs(tmp_path, slice(ROWS))
    for command in commands(PAGE):
        if words(command)[0] in ("new", "import"):
            run(*words(command))
    lines = (tmp_path / "REC/poses.csv").read_text().splitlines()
    (tmp_path / "wanted.csv").write_text("\n".join([lines[0], *lines[-3:]]) + "\n")
    shortened = [one.replace("1000-1494", "40-59").replace("0-999", "0-39") for one in commands(PAGE)]
    for command in shortened[3:6]:
        run(*words(command))
    assert json.loads((tmp_path / "calibration.json").read_text())["held_out"]["after"]["n"] > 0
    assert len((tmp_path / "commands.csv").read_text().splitlines()) == 4 and (tmp_path / "verified.html").exists()
