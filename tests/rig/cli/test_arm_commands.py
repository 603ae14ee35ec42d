"""The loop of an arm that an instrument sees, through the commands: one off the shelf, simulated, calibrated,
corrected, driven, verified.
"""

import json
import re

import numpy as np
import pytest

from rig.formats import csv_and_parquet_tables_and_time_origin
from rig.model.pose import pose_difference
from rig.recording import corner_and_pose_csv_tables
from tests.cli import command


@pytest.fixture
def rig(capsys):
    return command(capsys)


def loop(folder, name, rig):
    """(verification of the drive against the poses that the commands were to give, the same against those wanted, what
    `rig correct` said).
    """
    rig("design", "--mechanism", "arm", "--arm", name, "--out", folder / "rig.toml")
    truth = folder / "truth.json"
    rig("simulate", folder / "rig.toml", "--plan", "sobol:60", "--seed", "4", "--out", folder / "rec", "--truth", truth)
    rig(
        "simulate",
        folder / "rig.toml",
        "--plan",
        "sobol:24",
        "--seed",
        "5",
        "--machine",
        truth,
        "--out",
        folder / "seen",
    )
    rig("calibrate", folder / "rec", "--out", folder / "cal.json")
    output = rig(
        "correct", folder / "cal.json", "--poses", folder / "seen" / "poses.csv", "--out", folder / "commands.csv"
    )
    drive = f"commands:{folder / 'commands.csv'}"
    rig("simulate", folder / "rig.toml", "--plan", drive, "--seed", "6", "--machine", truth, "--out", folder / "drive")
    result = [
        json.loads(rig("verify", folder / "cal.json", folder / "drive", "--json", "--wanted", wanted))["wanted"]
        for wanted in (folder / "commands.poses.csv", folder / "seen" / "poses.csv")
    ]
    return *result, output


@pytest.mark.parametrize("name", [pytest.param("scara", marks=pytest.mark.slow), "gantry"])
def test_the_loop_of_an_arm_with_slides_closes(tmp_path, rig, name):
    reached, wanted, output = loop(tmp_path, name, rig)
    for part in ("position", "rotation"):
        assert reached[part]["rms"] < 2 * reached["stated_uncertainty"][part]
    assert wanted["position"]["rms"] < 2 * wanted["stated_uncertainty"]["position"]  # a position is met whole
    joints = {"scara": 4, "gantry": 3}[name]
    left = re.search(rf"a machine of {joints} axes .* is (\S+) mm RMS, .* and (\S+) mrad RMS", output)
    assert (
        float(left[1]) == 0 and 0.05 < float(left[2]) < 0.3
    )  # the tracker's own 0.1 mrad, of which few joints can follow little
    poses, wanted_poses = (
        corner_and_pose_csv_tables.load_poses(tmp_path / path) for path in ("commands.poses.csv", "seen/poses.csv")
    )
    rest = pose_difference(poses.T_base_platform, wanted_poses.T_base_platform)
    assert np.sqrt((rest[:, 3:] ** 2).sum(axis=1).mean()) * 1e3 == pytest.approx(float(left[2]), abs=1e-3)
    assert csv_and_parquet_tables_and_time_origin.read_csv_table(
        tmp_path / "commands.csv", ("frame", "q1", "q2", "q3")
    ).columns == ("frame", *(f"q{i + 1}" for i in range(joints)))


@pytest.mark.parametrize(
    "options, says",
    [
        (("--arm", "scarab"), "there is no arm 'scarab'; there are gantry, panda"),
        (("--mechanism", "arm"), "takes --arm"),
        (("--arm", "scara", "--radius", "0.2"), "--arm brings its own figures"),
        ((), "takes --radius"),
    ],
)
def test_an_arm_that_cannot_be_designed_says_why(rig, options, says):
    assert says in rig("design", *options, ok=False)


def test_a_slides_limits_and_effects_are_in_metres(tmp_path, rig):
    rig("design", "--arm", "scara", "--out", tmp_path / "rig.toml")
    done = rig(
        "simulate",
        tmp_path / "rig.toml",
        "--plan",
        "sobol:8",
        "--effect",
        "backlash:joint3:gap=2e-4",
        "--effect",
        "scale_error:slide3:scale=1e-3",
        "--out",
        tmp_path / "rec",
        "--truth",
        tmp_path / "truth.json",
    )
    assert "backlash at slide 3, scale error at slide 3" in done.replace("_", " ")
    assert [e["place"] for e in json.loads((tmp_path / "truth.json").read_text())["effects"]] == ["slide 3", "slide 3"]
    refused = rig(
        "simulate", tmp_path / "rig.toml", "--effect", "backlash:joint3:gap=2e-2", "--out", tmp_path / "rec2", ok=False
    )
    assert "gap must lie in 0 .. 0.001 m" in refused
    (tmp_path / "far.csv").write_text("frame,q1,q2,q3,q4\n0,0.1,0.2,0.5,0\n")
    refused = rig(
        "simulate",
        tmp_path / "rig.toml",
        "--plan",
        f"commands:{tmp_path / 'far.csv'}",
        "--out",
        tmp_path / "rec2",
        ok=False,
    )
    assert "slide 3 is commanded out of its range" in refused


@pytest.mark.slow
def test_what_a_slide_leaves_out_is_told_in_metres(tmp_path, rig):
    """A SCARA's slide with a play and a wrong lead, the whole catalogue asked: in the text, in JSON and on the page
    lengths are lengths.
    """
    rig("design", "--mechanism", "arm", "--arm", "scara", "--out", tmp_path / "rig.toml")
    rig(
        "simulate",
        tmp_path / "rig.toml",
        "--plan",
        "sobol:150,ladder:4",
        "--seed",
        "3",
        "--effect",
        "backlash:slide 3:gap=2e-4",
        "--effect",
        "scale_error:joint 3:scale=6e-4",
        "--out",
        tmp_path / "rec",
    )
    output = rig("diagnose", tmp_path / "rec", "--out", tmp_path / "found")
    assert (
        re.search(r"backlash at slide 3: gap 0\.000\d+ m \(", output)
        and "slide 3: scale" in output
        and "rad" not in output
    )
    tree = json.loads((tmp_path / "found" / "diagnosis.json").read_text())
    found = {one["effect"]: one for one in tree["findings"]}
    assert set(found) == {"backlash", "scale_error"} and {one["place"] for one in tree["findings"]} == {"slide 3"}
    gap, scale = found["backlash"]["parameters"]["gap"], found["scale_error"]["parameters"]["scale"]
    assert gap["unit"] == "m" and gap["ci95"][0] < 2e-4 < gap["ci95"][1] and scale["ci95"][0] < 6e-4 < scale["ci95"][1]
    assert [one["reason"] for one in tree["not_asked"] if one["effect"] == "cyclic_error"] == [
        "at slide 3 it needs [actuator] screw_lead in rig.toml"
    ]
    assert [one["place"] for one in tree["held_out_by_region"]] == ["joint 1", "joint 2", "slide 3", "joint 4"]
    page = (tmp_path / "found" / "diagnosis.html").read_text()
    assert "slide 3" in page and "joint 3" not in page
