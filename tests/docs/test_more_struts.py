"""The page on more than six struts: its commands run, and the struts no longer fight."""

import re

import pytest

from tests.cli import run
from tests.conftest import ROOT
from tests.docs.document_commands import commands, words

PAGE = ROOT / "docs" / "more-struts.md"
FIGURES = re.compile(r"give way by ([0-9.]+) µm RMS as the nominal model commands and by ([0-9.]+) µm corrected")


@pytest.mark.slow
def test_the_commands_of_the_page_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "wanted.csv").write_text("frame,x,y,z,rx,ry,rz\n0,0.01,0.02,0.45,0,0,0\n1,-0.02,0,0.46,0,0.02,0.05\n")
    outputs = {}
    for command in commands(PAGE):
        outputs[command.split()[1] + command.split()[-1]] = run(*words(command)).stdout
        if command.startswith("rig new"):
            lines = (tmp_path / "rig.toml").read_text().splitlines(keepends=True)
            (tmp_path / "all.toml").write_text("".join(line for line in lines if not line.startswith("followers")))
    assert len(outputs) == 10 and outputs["diagnosefound"].startswith("good: nothing is unmodelled")
    assert "2 of 2 poses written" in outputs["correctcommands.csv"] and "the claim is kept" in outputs["verifyNEW"]
    before, after = map(float, FIGURES.search(outputs["verifyNEW"]).groups())
    assert before > 50 and after < 0.1
    fights = re.search(r"each gives way by ([0-9.]+) (µm|nm) RMS", outputs["simulateDRIVEN"])
    assert float(fights[1]) * {"µm": 1.0, "nm": 1e-3}[fights[2]] < 0.1 and "gives way" not in outputs["simulateNEW"]
    assert "2 poses lie within" in outputs["verifywanted.csv"] and "give way" not in outputs["verifywanted.csv"]
    refused = run("calibrate", "DRIVEN", "--out", "no.json", ok=False).stderr
    assert "all 8 struts are driven" in refused and "named as followers" in refused
