"""The page on arms: the commands and the program of an arm's controller run, and give what `rig correct` commands."""

import re
import subprocess

import numpy as np
import pytest

from tests.calib.controllers_in_c import COMPILER, needs_compiler
from tests.cli import run
from tests.conftest import ROOT


@needs_compiler
@pytest.mark.slow
def test_the_program_of_the_page_corrects_joint_commands(tmp_path, monkeypatch):
    text = (ROOT / "docs" / "arms.md").read_text()
    section = text.split("## The correction inside an arm's controller")[1].split("\n## ")[0]
    (tmp_path / "main.c").write_text(re.search(r"```c\n(.*?)```", section, re.DOTALL)[1])
    monkeypatch.chdir(tmp_path)
    *matches, compiled = re.findall(r"^    ((?:rig|cc) .*)$", section, re.MULTILINE)
    for line in matches:
        run(*line.split()[1:])
    assert compiled.startswith("cc ")
    done = subprocess.run([COMPILER, *compiled.split()[1:]], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr

    for name, *words in (("nominal.csv", "--uncorrected"), ("corrected.csv",)):
        run("correct", "calibration.json", "--poses", "REC/poses.csv", "--skip-unreachable", *words, "--out", name)
    nominal, wanted = (np.loadtxt(name, delimiter=",", skiprows=1) for name in ("nominal.csv", "corrected.csv"))
    both = np.intersect1d(nominal[:, 0], wanted[:, 0])
    nominal, wanted = (table[np.isin(table[:, 0], both), 1:] for table in (nominal, wanted))
    given = "".join(" ".join(map(repr, row)) + "\n" for row in nominal.tolist())
    lines = subprocess.run(["./corrected"], input=given, capture_output=True, text=True).stdout.splitlines()
    found = np.array([line.split() if "refused" not in line else [np.nan] * 6 for line in lines], float)
    same = np.abs(nominal - wanted).max(axis=1) < 0.05  # of the posture that `rig correct` took, and not near singular
    assert same.sum() > 60 and np.abs(found - wanted)[same].max() < 1e-9
    assert np.abs(nominal - wanted)[same].max(axis=1).min() > 1e-5
