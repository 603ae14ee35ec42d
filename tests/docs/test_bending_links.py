"""The section on links that bend: its commands run, and name the link that was simulated."""

import json
import re

import pytest

from tests.cli import run
from tests.conftest import ROOT

PAGE = (ROOT / "docs" / "arms.md").read_text()


@pytest.mark.slow
def test_the_commands_of_the_section_run(tmp_path, monkeypatch):
    section = PAGE[PAGE.index("## Links that bend") : PAGE.index("## Tilt sensors")]
    monkeypatch.chdir(tmp_path)
    run("new", "design", "--arm", "ur10", "--out", "rig.toml")
    text = (tmp_path / "rig.toml").read_text()
    (tmp_path / "rig.toml").write_text(text + "\n" + re.search("```toml\n(.*?)```", section, re.DOTALL)[1])
    outputs = {}
    for line in section.splitlines():
        if line.startswith("    rig "):
            words = line.split()[1:]
            outputs[words[0]] = run(*words).stdout
    (found,) = json.loads((tmp_path / "found" / "diagnosis.json").read_text())["findings"]
    assert (found["effect"], found["place"]) == ("link_bending", "joint 2")
    low, high = found["parameters"]["stiffness"]["ci95"]
    assert low < 2e4 < high
    assert outputs["verify"].startswith("good")
