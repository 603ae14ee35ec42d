"""The page on mounts that point: its rig.toml is the example's, and its commands run."""

import json
import shutil

import numpy as np

from tests.cli import run
from tests.conftest import ROOT

PAGE, EXAMPLE = ROOT / "docs" / "pointing.md", ROOT / "docs" / "pointing" / "mount.toml"


def test_the_page_shows_the_example():
    assert f"```toml\n{EXAMPLE.read_text()}```" in PAGE.read_text()


def test_the_commands_of_the_page_run(tmp_path, monkeypatch):
    shutil.copy(EXAMPLE, tmp_path)
    shutil.copy(EXAMPLE.with_name("stars.dat"), tmp_path)
    (tmp_path / "wanted.csv").write_text("frame,azimuth,elevation\n0,0.6,0.5\n1,2.0,1.3\n2,5.0,0.9\n")
    monkeypatch.chdir(tmp_path)
    lines = [line.split()[1:] for line in PAGE.read_text().splitlines() if line.startswith("    rig ")]
    assert [words[0] for words in lines] == [
        "plan",
        "simulate",
        "calibrate",
        "simulate",
        "verify",
        "certify",
        "correct",
        "diagnose",
        "import",
        "calibrate",
    ]
    outputs = {}
    for words in lines:
        done = run(*words)
        outputs[words[0]] = outputs.get(words[0], "") + done.stdout + done.stderr
    assert "Cramer-Rao bound" in outputs["plan"] and " TF" in outputs["plan"]
    assert (
        "pointing terms of an altazimuth mount" in outputs["calibrate"]
        and "TF cannot be distinguished" in outputs["calibrate"]
    )
    assert (
        "30 stars of an altazimuth mount" in outputs["import"]
        and outputs["calibrate"].count("pointing terms of an") == 2
    )
    assert "times better" in outputs["verify"] and "RuntimeWarning" not in "".join(outputs.values())
    assert "3 of 3 poses written" in outputs["correct"] and "uncertainty of the directions: 0.0" in outputs["correct"]
    assert json.loads((tmp_path / "found" / "diagnosis.json").read_text())["fit"]["unit"] == "rad"
    assert "95 % of directions in this part of the sky lie within" in outputs["certify"]
    refused = run("certify", "calibration.json", "NEW", "--out", "c.xml", ok=False)
    assert "a certificate of directions is written as .json or .html" in refused.stderr
    rows = np.genfromtxt("commands.csv", delimiter=",", names=True)
    assert np.abs(rows["q1"] - [0.6, 2.0, 5.0]).max() < 0.02
    first = (tmp_path / "NEW" / "poses.csv").read_text().replace("\n0,", "\n0,1", 1)
    (tmp_path / "NEW" / "poses.csv").write_text(first)
    assert "a direction has length 1" in run("verify", "calibration.json", "NEW", ok=False).stderr
