"""The section on tilt sensors: its tables are read, and its commands run."""

import json
import re
import shutil

import numpy as np
import pytest

from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.recording.recording_folder import load_recording
from tests.cli import run
from tests.conftest import ROOT

PAGE = (ROOT / "docs" / "arms.md").read_text()


@pytest.mark.slow
def test_the_commands_of_the_section_run(tmp_path, monkeypatch):
    section = PAGE[PAGE.index("## Tilt sensors") : PAGE.index("## Instruments that measure")]
    monkeypatch.chdir(tmp_path)
    run("new", "design", "--arm", "ur10", "--out", "rig.toml")
    text = (tmp_path / "rig.toml").read_text()
    text = text.replace('base = "free"', 'base = "rig"').replace('tool = "free"', 'tool = "rig"')
    tables = re.search("```toml\n(.*?)```", section, re.DOTALL)
    (tmp_path / "rig.toml").write_text(text + "\n" + tables[1])
    outputs = {}
    for line in section.splitlines():
        if line.startswith("    rig "):
            words = line.split()[1:]
            done = run(*words)
            outputs[words[0]] = done.stdout + done.stderr
    assert "effects compensated by commands: base lean at rig" in outputs["calibrate"]
    assert "tilt sensor column on the base: 60 of 60 readings used" in outputs["calibrate"]
    assert outputs["verify"].startswith("good") and "base_lean at rig: rms" in outputs["diagnose"]
    assert "NOT kept" not in run("certify", "calibration.json", "NEW", "--coverage", "0.9", "--out", "c.json").stdout
    found = json.loads((tmp_path / "found" / "diagnosis.json").read_text())["findings"]
    assert [one["effect"] for one in found] == ["base_lean"]
    (tmp_path / "rig.toml").write_text(text + "\n" + tables[1].replace("sigma = 2e-4 # rad", "sigmas = 2e-4 # rad"))
    assert "is 'sigma' meant?" in run("simulate", "rig.toml", "--out", "no", ok=False).stderr


def test_the_section_on_platforms_is_read(tmp_path, monkeypatch):
    page = (ROOT / "docs" / "measuring.md").read_text()
    section = page[page.index("## Tilt sensors on a platform") :]
    lines = [line[4:] for line in section.splitlines()[2:6]]
    monkeypatch.chdir(tmp_path)
    run("new", "design", "--radius", "0.3", "--out", "rig.toml")
    text = (tmp_path / "rig.toml").read_text()
    (tmp_path / "rig.toml").write_text(text + "\n" + "\n".join(lines) + "\n")
    run("simulate", "rig.toml", "--plan", "sobol:16", "--out", "REC")
    assert "tilt_level_x_rad,tilt_level_y_rad" in (tmp_path / "REC" / "sensors.csv").read_text()
    with_them, without = tmp_path / "REC", tmp_path / "PLAIN"
    shutil.copytree(with_them, without)
    (without / "rig.toml").write_text(text)
    turned = [
        np.sqrt(np.trace(sample_recording(load_recording(folder)).samples.total_covariance()[:, 3:5, 3:5].mean(axis=0)))
        for folder in (with_them, without)
    ]
    assert turned[0] < 0.85 * turned[1]
