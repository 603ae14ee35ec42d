"""The tutorial with the simulated rig: every command in it is run, in its order, as a reader would."""

import re

import pytest

from tests.cli import run
from tests.docs.document_commands import ROOT, commands, words

PAGE = ROOT / "docs" / "tutorial-simulated.md"


def wanted() -> str:
    """The table of wanted poses that the page shows."""
    rows = re.search(r"^    frame,x,y,z,rx,ry,rz\n(?:    [-\d.,]+\n)+", PAGE.read_text(), re.MULTILINE)[0]
    return rows.replace("    ", "")


@pytest.mark.slow
def test_every_command_of_the_tutorial_does_what_it_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "wanted.csv").write_text(wanted())
    outputs = {}
    for command in commands(PAGE):
        outputs[command] = run(*words(command)).stdout
    assert len(outputs) >= 11
    one = {
        key: text
        for command, text in outputs.items()
        for key in ("measure", "calibrate first", "verify", "diagnose")
        if f"rig {key}" in command
    }
    assert "24 of 24 frames solved" in one["measure"] and "times better" in one["calibrate first"]
    assert "the claim is kept" in one["verify"] and "backlash at strut 3" in one["diagnose"]
    assert len((tmp_path / "commands.csv").read_text().splitlines()) == 3
