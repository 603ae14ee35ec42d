"""The same fault through all commands: one state, of the first line, the exit status, the JSON and the index."""

import json
import re

import pytest

from rig.cli.command_line import main
from rig.report import verdict_refutations_and_result_display
from rig.report.pages.page_templates_and_index_page import list_pages_below_folder
from tests import truth
from tests.truth.draw_faults import fits
from tests.truth.sights import SIGHTS

EFFECTS = [
    *(name for name in truth.FAULTS if fits(name, "hexapod")),
    *(name for name in SIGHTS if name != "marker_swap"),
]


def through(folder, capsys, effect, seed=1, strength="strong"):
    """{command: state} of a machine of the independent truth with a fault: recorded, calibrated, diagnosed, recorded
    again and examined.
    """
    case = truth.draw(seed, effect, strength, "shuffled", count=60)
    for name, one in (
        ("rec", case),
        ("second", truth.recorded_anew(case)),
        ("third", truth.recorded_anew(case, "sobol")),
    ):
        truth.record(one, folder / name)
    cal, out = folder / "calibration.json", {}

    def state(name, *words):
        status = main([str(word) for word in (name, *words)])
        output = capsys.readouterr()
        if (
            name == "certify" and status == 1
        ):  # a certificate takes poses at rest: where there are too few it is refused, and states nothing
            return
        assert status in (0, 3), output.err
        out[name] = re.match(r"(good|check|bad): ", output.out)[1]
        assert status == (3 if out[name] == "bad" and name in ("verify", "certify", "watch") else 0)

    state("calibrate", folder / "rec", "--out", cal)
    state("diagnose", folder / "rec", "--out", folder / "found")
    state("verify", cal, folder / "second", "--page", folder / "verified.html")
    state("certify", cal, folder / "second", "--out", folder / "certificate.html", "--scale-uncertainty", "1e-5")
    state("watch", cal, folder / "third")
    state("online", folder / "rec")
    out |= {f"index: {found.kind}": str(found.state) for found in list_pages_below_folder(folder)}
    assert json.loads((folder / "found" / "diagnosis.json").read_text())["verdict"]["state"] == out["diagnose"]
    return out


@pytest.mark.slow
@pytest.mark.parametrize("effect", EFFECTS)
def test_one_fault_has_one_verdict(tmp_path, capsys, effect):
    states = through(tmp_path, capsys, effect)
    assert len(set(states.values())) == 1, states


@pytest.mark.slow
def test_a_sound_machine_is_good_in_all_commands(tmp_path, capsys):
    assert set(through(tmp_path, capsys, "none", strength="none").values()) == {"good"}


def test_a_calibration_names_what_a_diagnosis_of_its_recording_finds(tmp_path, capsys):
    case = truth.draw(1, "screw_coupling", "strong", "shuffled", count=60)
    truth.record(case, tmp_path / "rec")
    cal = tmp_path / "calibration.json"
    assert main(["calibrate", str(tmp_path / "rec"), "--out", str(cal)]) == 0
    assert capsys.readouterr().out.startswith("check: ")
    assert "the model omits screw coupling at strut 5" in json.loads(cal.read_text())["claim"]["unexplained"]
    assert main(["calibrate", str(tmp_path / "rec"), "--out", str(cal), "--force", "--quick"]) == 0
    assert capsys.readouterr().out.startswith("check: ") and "not searched" in " ".join(
        json.loads(cal.read_text())["claim"]["unexplained"]
    )


@pytest.mark.slow
def test_what_shows_in_the_poses_that_a_fit_left_out_is_within_its_claim(tmp_path, capsys):
    """A joint's clearance that one pose of sixty shows: the fit leaves that pose out, the diagnosis names its cause,
    the claim holds for it.
    """
    states = through(tmp_path, capsys, "joint_clearance")
    assert set(states.values()) == {"check"}, states
    claim = json.loads((tmp_path / "calibration.json").read_text())["claim"]
    low, high = claim["after"][0][1:]
    assert low < 28e-6 < high and claim["ratio"][1] < claim["ratio"][0] < claim["ratio"][2]


@pytest.mark.slow
def test_what_a_calibration_leaves_unexplained_is_stated_of_all_else_that_is_learnt_from_its_recording(
    tmp_path, capsys
):
    """Play as small as two standard deviations of the instrument: the filter learns from it as from noise."""
    truth.record(truth.draw(1, "backlash", "weak", "shuffled", count=60), tmp_path / "rec")
    assert main(["online", str(tmp_path / "rec")]) == 0
    assert capsys.readouterr().out.startswith("good: ")
    assert main(["calibrate", str(tmp_path / "rec"), "--out", str(tmp_path / "calibration.json")]) == 0
    capsys.readouterr()
    left = json.loads((tmp_path / "calibration.json").read_text())["claim"]["unexplained"]
    assert main(["online", str(tmp_path / "rec"), "--json"]) == 0
    verdict = json.loads(capsys.readouterr().out)["verdict"]
    assert verdict["state"] == "check" and left and set(left) <= set(verdict["rests_on"])


@pytest.mark.slow
def test_what_spoils_a_recording_is_refused_by_all_that_learn_from_it(tmp_path, capsys):
    truth.record(truth.draw(1, "marker_swap", "strong", "shuffled", count=20), tmp_path / "rec")
    for words in (
        ["calibrate", "--out", str(tmp_path / "c.json")],
        ["diagnose", "--out", str(tmp_path / "found")],
        ["online"],
    ):
        assert main([words[0], str(tmp_path / "rec"), *words[1:]]) == 1
        assert "marker 10" in capsys.readouterr().err, words


def test_learning_goes_on_where_the_estimate_closes_on_no_pose(tmp_path, capsys):
    """Struts that settle late: a change that is none moves the estimate so far that it reaches the next command
    nowhere.
    """
    truth.record(truth.draw(1, "settling_error", "strong", "shuffled", count=60), tmp_path / "rec")
    assert main(["online", str(tmp_path / "rec"), "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert output["verdict"]["state"] == "check" and 23 in output["left_out"] and output["poses"] == 60


@pytest.mark.slow
def test_creep_has_one_verdict_and_marks_the_calibration(tmp_path, capsys):
    states = through(tmp_path, capsys, "creep")
    assert set(states.values()) == {"check"}, states
    (found,) = verdict_refutations_and_result_display.refutations_of_file(tmp_path / "calibration.json")
    assert (found.command, found.recording, found.state) == (
        "diagnose",
        "rec",
        "check",
    ) and "creep at strut 2" in found.finding


@pytest.mark.slow
def test_a_refuted_calibration_is_refuted_wherever_it_is_used(tmp_path, capsys):
    """A machine that is calibrated and then fails: one recording refutes, all commands show that from then on."""
    sound, failed = (
        truth.draw(1, effect, strength, "shuffled", count=60)
        for effect, strength in (("none", "none"), ("creep", "strong"))
    )
    for name, one in (("rec", sound), ("second", truth.recorded_anew(sound))):
        truth.record(one, tmp_path / name)
    cal = tmp_path / "calibration.json"
    assert main(["calibrate", str(tmp_path / "rec"), "--out", str(cal)]) == 0
    assert main(["verify", str(cal), str(tmp_path / "second")]) == 0
    assert "the claim is kept" in capsys.readouterr().out
    truth.record(failed, tmp_path / "failed")
    assert main(["verify", str(cal), str(tmp_path / "failed"), "--json"]) == 3
    output = json.loads(capsys.readouterr().out)
    assert (
        output["verdict"]["state"] == "bad" and output["claim"]["kept"] is False and "rig" in output["verdict"]["next"]
    )
    assert {found.kind: str(found.state) for found in list_pages_below_folder(tmp_path)} == {"calibrate": "bad"}
    assert main(["verify", str(cal), str(tmp_path / "second")]) == 3
    printed = capsys.readouterr()
    assert printed.out.startswith("bad: refuted on ") and "by failed" in printed.out and "where up to" in printed.out
    truth.write_wanted(truth.wanted(sound), tmp_path / "wanted.csv")
    assert (
        main(["correct", str(cal), "--poses", str(tmp_path / "wanted.csv"), "--out", str(tmp_path / "commands.csv")])
        == 0
    )
    assert "was refuted on" in capsys.readouterr().err
