"""The same fault through all commands: one state, of the page, the first line, the JSON and the index."""

import json
import re

import pytest

from rig.cli import main
from rig.page.index import pages
from tests import truth

EXAMINED = (0, 3)


def through(folder, capsys, effect, seed=0, strength="strong"):
    """{command: state} of a machine with a fault, recorded three times."""
    case = truth.draw(seed, effect, strength, "shuffled", count=40)
    rec, second, third = (truth.record(one, folder / name) for name, one in
                          (("rec", case), ("second", truth.again(case)), ("third", truth.again(case, "sobol"))))
    cal, out = folder / "calibration.json", {}

    def state(name, *words, json_too=True):
        status = main([str(word) for word in (name, *words)])
        said = capsys.readouterr()
        assert status in EXAMINED, said.err
        out[name] = re.match(r"(good|check|bad): ", said.out)[1]
        assert status == (3 if out[name] == "bad" and name in ("verify", "certify", "watch") else 0)

    state("calibrate", rec, "--out", cal)
    state("diagnose", rec, "--out", folder / "found")
    state("verify", cal, second, "--page", folder / "verified.html")
    state("certify", cal, second, "--out", folder / "certificate.html", "--scale-uncertainty", "1e-5")
    state("watch", cal, second, third)
    state("online", rec)
    out |= {f"index of {found.kind}": str(found.state) for found in pages(folder)}
    assert json.loads((folder / "found" / "diagnosis.json").read_text())["verdict"]["state"] == out["diagnose"]
    return out


@pytest.mark.parametrize("effect", ["backlash"])
def test_one_fault_has_one_verdict(tmp_path, capsys, effect):
    states = through(tmp_path, capsys, effect)
    assert "good" not in states.values(), states
