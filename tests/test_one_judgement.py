"""The same fault through all commands: one state, of the first line, the exit status, the JSON and the index."""

import json
import re

import pytest

from rig import refutations
from rig.cli import main
from rig.page.index import pages
from tests import truth
from tests.truth.draw_faults import fits

EFFECTS = [name for name in truth.FAULTS if fits(name, "hexapod")]


def through(folder, capsys, effect, seed=1, strength="strong"):
    """{command: state} of a machine of the independent truth with a fault: recorded, calibrated, diagnosed, recorded again and examined."""
    case = truth.draw(seed, effect, strength, "shuffled", count=60)
    for name, one in (("rec", case), ("second", truth.again(case)), ("third", truth.again(case, "sobol"))):
        truth.record(one, folder / name)
    cal, out = folder / "calibration.json", {}

    def state(name, *words):
        status = main([str(word) for word in (name, *words)])
        said = capsys.readouterr()
        if name == "certify" and status == 1:  # a certificate takes poses at rest: where there are too few it is refused, and states nothing
            return
        assert status in (0, 3), said.err
        out[name] = re.match(r"(good|check|bad): ", said.out)[1]
        assert status == (3 if out[name] == "bad" and name in ("verify", "certify", "watch") else 0)

    state("calibrate", folder / "rec", "--out", cal)
    state("diagnose", folder / "rec", "--out", folder / "found")
    state("verify", cal, folder / "second", "--page", folder / "verified.html")
    state("certify", cal, folder / "second", "--out", folder / "certificate.html", "--scale-uncertainty", "1e-5")
    state("watch", cal, folder / "third")
    state("online", folder / "rec")
    out |= {f"index: {found.kind}": str(found.state) for found in pages(folder)}
    assert json.loads((folder / "found" / "diagnosis.json").read_text())["verdict"]["state"] == out["diagnose"]
    return out


@pytest.mark.slow
@pytest.mark.parametrize("effect", EFFECTS)
def test_one_fault_has_one_verdict(tmp_path, capsys, effect):
    states = through(tmp_path, capsys, effect)
    assert len(set(states.values())) == 1, states


def test_creep_has_one_verdict_and_marks_the_calibration(tmp_path, capsys):
    states = through(tmp_path, capsys, "creep")
    assert set(states.values()) == {"check"}, states
    found, = refutations.of_file(tmp_path / "calibration.json")
    assert (found.command, found.recording, found.state) == ("diagnose", "rec", "check") and "creep at strut 2" in found.finding


def test_a_refuted_calibration_is_refuted_wherever_it_is_used(tmp_path, capsys):
    """A machine that is calibrated and then fails: one recording refutes, all commands show that from then on."""
    sound, failed = (truth.draw(1, effect, strength, "shuffled", count=60) for effect, strength in (("none", "none"), ("creep", "strong")))
    for name, one in (("rec", sound), ("second", truth.again(sound))):
        truth.record(one, tmp_path / name)
    cal = tmp_path / "calibration.json"
    assert main(["calibrate", str(tmp_path / "rec"), "--out", str(cal)]) == 0
    assert main(["verify", str(cal), str(tmp_path / "second")]) == 0
    assert "the claim is kept" in capsys.readouterr().out
    truth.record(failed, tmp_path / "failed")
    assert main(["verify", str(cal), str(tmp_path / "failed"), "--json"]) == 3
    told = json.loads(capsys.readouterr().out)
    assert told["verdict"]["state"] == "bad" and told["claim"]["kept"] is False and "rig" in told["verdict"]["next"]
    assert {found.kind: str(found.state) for found in pages(tmp_path)} == {"calibrate": "bad"}
    assert main(["verify", str(cal), str(tmp_path / "second")]) == 3
    said = capsys.readouterr()
    assert said.out.startswith("bad: refuted on ") and "by failed" in said.out and "where up to" in said.out
    truth.write_wanted(truth.wanted(sound), tmp_path / "wanted.csv")
    assert main(["correct", str(cal), "--poses", str(tmp_path / "wanted.csv"), "--out", str(tmp_path / "commands.csv")]) == 0
    assert "was refuted on" in capsys.readouterr().err
