"""The page on several hands: its commands run, and find what was simulated."""

import json

import numpy as np
import pytest

from rig.recording.corner_and_pose_csv_tables import Poses, write_poses
from rig.recording.frame_selection_and_content_hashes import select_hand
from rig.recording.recording_folder import load_recording
from tests.cli import run
from tests.conftest import ROOT
from tests.docs.document_commands import commands, words

PAGE, EXAMPLES = ROOT / "docs" / "several-hands.md", ROOT / "docs" / "hands"


def wanted_poses(path, folder):
    """Write five poses of the right hand that it took in a recording, to be taken again."""
    seen = select_hand(load_recording(folder), "right").poses
    write_poses(path, Poses(np.arange(5), seen.T_base_platform[:5], None))


@pytest.mark.slow
def test_the_commands_of_the_page_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "humanoid.toml").write_text((EXAMPLES / "humanoid.toml").read_text())
    outputs = {}
    for command in commands(PAGE):
        if "robot.urdf" in command:
            continue
        if command.startswith("rig correct"):
            wanted_poses(tmp_path / "wanted.csv", tmp_path / "NEW")
        outputs[command.split()[1] + command.split()[-1]] = run(*words(command)).stdout
    assert outputs["verifyleft"].startswith("good") and outputs["verifyright"].startswith("good")
    assert (
        "of the hand 'right' alone" in outputs["certifycertificate.html"] and "5 of 5" in outputs["correctcommands.csv"]
    )
    found = json.loads((tmp_path / "found" / "diagnosis.json").read_text())["findings"]
    assert sorted(one["place"] for one in found) == ["joint 10", "joint 2", "joint 3", "joint 4"]
    seen = (tmp_path / "NEW" / "poses.csv").read_text()
    exchanged = seen.replace(",left,", ",l,").replace(",right,", ",left,").replace(",l,", ",right,")
    (tmp_path / "NEW" / "poses.csv").write_text(exchanged)
    assert "the hands left and right are exchanged" in run("check", "NEW", ok=False).stdout
    (tmp_path / "NEW" / "poses.csv").write_text(seen)


@pytest.mark.slow
def test_a_shorter_way_of_the_page(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run("simulate", EXAMPLES / "humanoid.toml", "--plan", "sobol:24", "--out", "REC", "--truth", "truth.json")
    assert "nothing wrong or unlikely" in run("check", "REC").stdout
    run("calibrate", "REC", "--quick", "--out", "c.json")
    run("simulate", EXAMPLES / "humanoid.toml", "--plan", "sobol:12", "--machine", "truth.json", "--out", "NEW")
    assert "the claim is kept" in run("verify", "c.json", "NEW", "--hand", "left").stdout
    assert "NEW is of several hands (left, right)" in run("verify", "c.json", "NEW", ok=False).stderr
    assert "no hand 'lefd'; there are left, right" in run("verify", "c.json", "NEW", "--hand", "lefd", ok=False).stderr
    wanted_poses(tmp_path / "wanted.csv", tmp_path / "NEW")
    wanted = ("correct", "c.json", "--poses", "wanted.csv")
    assert "choose one with --hand: left, right" in run(*wanted, "--out", "no.csv", ok=False).stderr
    run(*wanted, "--hand", "right", "--start", ",".join(["0.1"] * 15), "--out", "commands.csv")
    commanded = np.loadtxt(tmp_path / "commands.csv", delimiter=",", skiprows=1)[:, 1:]
    np.testing.assert_allclose(commanded[:, 3:9], 0.1)
    both = ("correct", "c.json", "--poses", "NEW/poses.csv", "--hand", "right", "--start", ",".join(["0.1"] * 15))
    run(*both, "--out", "both.csv")
    np.testing.assert_array_equal(np.loadtxt("both.csv", delimiter=",", skiprows=1)[:5, 1:], commanded)
    for hand in ("left", "right"):
        output = run("verify", "c.json", "NEW", "--hand", hand, "--wanted", "NEW/poses.csv").stdout
        assert "against the wanted poses: position 0.0000 mm RMS" in output
    assert "NEW is of several hands" in run("verify", "c.json", "NEW", "--wanted", "NEW/poses.csv", ok=False).stderr
    for refused in (("watch", "c.json", "NEW"), ("export", "c.json", "--format", "c", "--out", "c.c")):
        assert (
            "is of an arm with several hands (left, right), for which this is not done"
            in run(*refused, ok=False).stderr
        )
    assert (
        "one hand" in run("plan", EXAMPLES / "humanoid.toml", "--for", "parameters", "--out", "p.csv", ok=False).stderr
    )
    assert "one hand" in run("calibrate", "REC", "--extend", "auto", "--out", "e.json", ok=False).stderr
