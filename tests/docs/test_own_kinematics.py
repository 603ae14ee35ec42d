"""The page on kinematics of one's own: its file is the example's, and its commands run."""

import json
import shutil

import pytest

from rig.formats.rig_toml.design_from_rig_toml import load_design
from tests.cli import run
from tests.conftest import ROOT

PAGE, EXAMPLES = ROOT / "docs" / "own-kinematics.md", ROOT / "docs" / "kinematics"


def test_the_page_shows_the_example():
    assert f"```python\n{(EXAMPLES / 'delta.py').read_text()}```" in PAGE.read_text()


@pytest.mark.slow
def test_the_commands_of_the_page_run(tmp_path, monkeypatch):
    for end in ("py", "toml"):
        shutil.copy(EXAMPLES / f"delta.{end}", tmp_path)
    (tmp_path / "values.csv").write_text("frame,q1,q2,q3\n0,0.36,0.33,0.34\n")
    (tmp_path / "wanted.csv").write_text("frame,x,y,z,rx,ry,rz\n0,0.01,0.02,0.1,0,0,0\n1,-0.02,0,0.08,0,0,0.001\n")
    monkeypatch.chdir(tmp_path)
    lines = [line.split()[1:] for line in PAGE.read_text().splitlines() if line.startswith("    rig ")]
    assert len(lines) == 8
    output = ""
    for words in lines:
        done = run(*words)
        output += done.stdout + done.stderr
    assert "2 of 2 poses written" in output and "a machine of 3 axes cannot compensate every error" in output
    assert "8 iterations; settled at position (9.5981, 29.0407, 85.6340) mm" in output
    assert (tmp_path / "REC" / "delta.py").read_text() == (EXAMPLES / "delta.py").read_text()
    names = load_design(tmp_path / "delta.toml").mechanism.stated.names
    listed = run("export", "calibration.json", "--format", "csv", "--out", tmp_path / "delta.csv")
    rows = [line.split(",") for line in (tmp_path / "delta.csv").read_text().splitlines()[1:]]
    assert listed.returncode == 0 and tuple(row[0] for row in rows) == names
    tree = json.loads(run("export", "calibration.json", "--format", "json").stdout)
    assert [one["value"] for one in tree["parameters"]] == pytest.approx([float(row[3]) for row in rows], abs=1e-11)
    assert any(one["value"] != one["stated"] for one in tree["parameters"])
    said = run("export", "calibration.json", "--format", "linuxcnc-comp", "--out", tmp_path / "comp", ok=False).stderr
    assert "is for struts" in said
