"""The command line around parameters: plans, exports, poses one at a time, measuring limbs."""

import json
import re
import shutil

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.samples.exposure_conditions import approach_direction
from calib.samples.position_confounds_and_poses_on_one_clock import confounds_of_experimental_design
from rig.cli.command_line import main
from rig.formats.csv_and_parquet_tables_and_time_origin import read_csv_table
from rig.formats.rig_toml.design_from_rig_toml import load_design
from rig.model import mechanisms
from rig.planning.recording_plan import build_plan


@pytest.fixture
def rig_file(tmp_path, rig_text):
    path = tmp_path / "rig.toml"
    path.write_text(rig_text)
    return path


@pytest.mark.parametrize("purpose", [("--for", "parameters", "--count", "30"), ("--promise", "20um")])
def test_what_a_written_plan_does_depends_on_no_place(rig_file, tmp_path, capsys, purpose):
    """The outermost configurations, reached straight, are always reached from within; the plan, as it is run, is judged
    by its commands alone.
    """
    out = tmp_path / "plan.csv"
    assert main(["plan", str(rig_file), *purpose, "--out", str(out)]) == 0
    assert "no cause is confounded with place" in capsys.readouterr().out
    design = load_design(rig_file)
    run = build_plan(design, f"commands:{out}")
    places = mechanisms.axis_place_texts(design.mechanism)
    found = confounds_of_experimental_design(
        run.commands.at(run.t), approach_direction(run.commands, run.t), run.t, {}, places
    )
    directions = [row for row in found.rows if row.cause == "direction of approach"]
    assert len(directions) == 6 and not found.serious
    assert max(row.share - row.chance for row in directions) < 0.1


def test_plan_for_parameters_is_written_and_can_be_run(rig_file, tmp_path, capsys):
    out = tmp_path / "plan.csv"
    assert (
        main(
            [
                "plan",
                str(rig_file),
                "--for",
                "parameters",
                "--count",
                "10",
                "--out",
                str(out),
                "--page",
                str(tmp_path / "p.html"),
            ]
        )
        == 0
    )
    page = (tmp_path / "p.html").read_text()
    headline = re.search("<strong>(?:good|check)</strong> (.*?)</p>", page)[1]
    assert re.fullmatch(
        r"10 configurations (determine all 42 parameters, [\d.]+ times as precisely as evenly spread ones"
        r"|leave \d+ of 42 combinations of the parameters undetermined: visit more)\.", headline
    )  # fmt: skip
    assert f"commands:{out}" in page and "<li>10 configurations: condition number of the 42" in page
    output = capsys.readouterr().out
    assert "condition number of the 42" in output and "evenly spread" in output and " um " in output
    assert [frame for frame in read_csv_table(out, ("frame", "l1")).text("frame") if frame] == [*map(str, range(10))]
    assert main(["simulate", str(rig_file), "--plan", f"commands:{out}", "--out", str(tmp_path / "rec")]) == 0
    second_plan = tmp_path / "more.csv"
    assert (
        main(
            [
                "plan",
                str(rig_file),
                "--for",
                "parameters",
                "--count",
                "6",
                "--given",
                str(tmp_path / "rec"),
                "--out",
                str(second_plan),
            ]
        )
        == 0
    )
    assert "besides 10 given" in capsys.readouterr().out


def test_of_a_promise_that_is_met_no_plan_is_written(rig_file, tmp_path, capsys):
    plan, more, page = (str(tmp_path / name) for name in ("plan.csv", "more.csv", "more.html"))
    promised = ["plan", str(rig_file), "--promise"]
    assert main([*promised, "20um", "--out", plan]) == 0
    assert main([*promised, "30um", "--given", plan, "--out", more, "--page", page]) == 0
    output = capsys.readouterr().out
    assert (
        "the promise of 30 µm is met by the 12 configurations given" in output
        and f"nothing is written to {more}; look at {page}" in output
    )
    assert not (tmp_path / "more.csv").exists() and "rig run" not in (tmp_path / "more.html").read_text()
    before = (tmp_path / "plan.csv").read_text()
    assert main([*promised, "2m", "--out", plan]) == 0
    output = capsys.readouterr().out
    assert (
        "is met by the stated geometry" in output and f"nothing is written to {plan}, which remains unchanged" in output
    )
    assert (tmp_path / "plan.csv").read_text() == before


def test_parts_of_a_plan_are_written_as_configurations(rig_file, tmp_path, capsys):
    out = tmp_path / "plan.csv"
    assert main(["plan", str(rig_file), "--parts", "axes:2,combined:2", "--out", str(out)]) == 0
    output = capsys.readouterr().out
    assert (
        "48 configurations of axes:2,combined:2" in output
        and "rz -" in output
        and len(read_csv_table(out, ("frame", "l1"))) == 48
    )
    assert main(["simulate", str(rig_file), "--plan", f"commands:{out}", "--out", str(tmp_path / "rec")]) == 0
    assert main(["plan", str(rig_file), "--parts", "combinde:2", "--out", str(tmp_path / "none.csv")]) == 1
    assert "there is no part 'combinde'" in capsys.readouterr().err
    assert main(["plan", str(rig_file), "--parts", "moving:5", "--out", str(tmp_path / "none.csv")]) == 1


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["--count", "0"], "positive"),
        (["--count", "3"], "3 configurations cannot determine"),
        (["--given", "typo.csv"], "typo.csv: no such file"),
    ],
)
def test_plan_refuses(rig_file, tmp_path, capsys, arguments, says):
    assert main(["plan", str(rig_file), "--for", "parameters", "--out", str(tmp_path / "p.csv"), *arguments]) == 1
    assert says in capsys.readouterr().err and not (tmp_path / "p.csv").exists()


@pytest.mark.slow
def test_a_missed_step_in_a_recording_is_told(rig_file, tmp_path, capsys):
    effect = "missed_steps:strut3:jump=9e-5,time=400"
    assert (
        main(
            [
                "simulate",
                str(rig_file),
                "--plan",
                "sobol:110",
                "--effect",
                effect,
                "--out",
                str(tmp_path / "rec"),
                "--truth",
                str(tmp_path / "truth.json"),
            ]
        )
        == 0
    )
    times = read_csv_table(tmp_path / "rec" / "frames.csv", ("frame", "t"))
    first = int(times.numbers("frame")[times.numbers("t") > 400][0])
    state = tmp_path / "state.json"
    capsys.readouterr()
    assert main(["online", str(tmp_path / "rec"), "--state", str(state), "--page", str(tmp_path / "learnt.html")]) == 0
    page = (tmp_path / "learnt.html").read_text()
    assert "<strong>check</strong> 1 change," in page and "What jumped" in page and "on strut 3 is longer" in page
    output = capsys.readouterr().out
    assert "1 change in 110 poses from corners.csv" in output
    assert f"from frame {first} on strut 3 is longer by +0.0" in output and output.count("longer") == 1
    assert main(["online", str(tmp_path / "rec"), "--state", str(state)]) == 1
    assert "counted twice" in capsys.readouterr().err
    more = [
        "--machine",
        str(tmp_path / "truth.json"),
        "--plan",
        "sobol:8",
        "--seed",
        "9",
        "--out",
        str(tmp_path / "more"),
    ]
    assert main(["simulate", str(rig_file), *more]) == 0
    assert main(["online", str(tmp_path / "more"), "--state", str(state)]) == 0
    assert "in 8 poses from corners.csv, learnt one at a time after 110 before" in capsys.readouterr().out
    state.write_text("{")
    assert main(["online", str(tmp_path / "rec"), "--state", str(state)]) == 1
    assert "cut off" in capsys.readouterr().err


def test_exports_are_written_or_refused(rig_file, tmp_path, capsys):
    out = tmp_path / "machine.hal"
    assert main(["export", str(rig_file), "--format", "genhexkins", "--out", str(out)]) == 0
    assert "setp genhexkins.base.0.x 291.1" in out.read_text() and "setp offset.5.offset" in out.read_text()
    assert main(["export", str(rig_file), "--format", "csv"]) == 0
    assert "strut,base_x" in capsys.readouterr().out
    assert main(["export", str(rig_file), "--format", "urdf"]) == 0
    assert capsys.readouterr().out.startswith("<?xml")
    assert main(["design", "--arm", "scara", "--out", str(tmp_path / "arm.toml")]) == 0
    assert main(["export", str(tmp_path / "arm.toml"), "--format", "sdf"]) == 1
    assert "sdf takes a mechanism of kind hexapod" in capsys.readouterr().err
    assert main(["export", str(tmp_path / "typo.json"), "--format", "json"]) == 1
    assert "typo.json: no such file" in capsys.readouterr().err


@pytest.mark.slow
def test_accepted_limbs_stand_for_vision_until_one_slips(limbed, tmp_path, capsys):
    rec, second_folder, limbs, state = (
        limbed[1].folder,
        tmp_path / "again",
        tmp_path / "limbs.json",
        tmp_path / "state.json",
    )
    shutil.copytree(rec.parent / "again", second_folder)
    assert (
        main(
            [
                "insitu",
                str(rec),
                "--state",
                str(state),
                "--tolerance",
                "1e-4",
                "4e-4",
                "--out",
                str(limbs),
                "--page",
                str(tmp_path / "limbs.html"),
            ]
        )
        == 0
    )
    assert "<strong>good</strong> the measuring limbs pass on all six axes" in (tmp_path / "limbs.html").read_text()
    output = capsys.readouterr().out
    assert (
        "the measuring limbs pass" in output
        and "verdict accepted" in output
        and "nothing jumped in 80 poses from measuring limbs" in output
    )
    assert (
        main(["measure", str(second_folder), "--limbs", str(limbs), "--out", str(tmp_path / "poses"), "--check", "10"])
        == 0
    )
    assert "40 poses from the measuring limbs; vision checked 4 of them and agrees" in capsys.readouterr().out
    assert len(read_csv_table(tmp_path / "poses" / "poses.csv", ("frame", "x", "c55"))) == 40
    angles = read_csv_table(tmp_path / "poses" / "rpy.csv", ("frame", "roll", "pitch", "yaw", "u_roll", "u_z"))
    turned = read_csv_table(tmp_path / "poses" / "poses.csv", ("rx",)).matrix(("rx", "ry", "rz"))
    np.testing.assert_allclose(
        Rotation.from_euler("xyz", angles.matrix(("roll", "pitch", "yaw"))).as_rotvec(), turned, atol=1e-9
    )
    assert main(["calibrate", str(second_folder), "--limbs", str(limbs), "--out", str(tmp_path / "c.json")]) == 0
    result = json.loads((tmp_path / "c.json").read_text())["provenance"]
    assert "limbs.json" in result["inputs_sha256"] and set(json.loads(limbs.read_text())["provenance"]["data"]) < set(
        result["data"]
    )
    assert main(["online", str(second_folder), "--limbs", str(limbs), "--state", str(state)]) == 0
    assert "40 poses from measuring limbs, learnt one at a time after 80 before" in capsys.readouterr().out
    assert (
        main(
            [
                "online",
                str(second_folder),
                "--limbs",
                str(limbs),
                "--learner",
                "drifting",
                "--state",
                str(tmp_path / "d.json"),
                "--json",
            ]
        )
        == 0
    )
    out, words = capsys.readouterr()
    followed = json.loads(out)
    assert followed["schema"] == "followed/1" and (followed["learner"], followed["drift"], followed["poses"]) == (
        "drifting",
        1e-7,
        40,
    )
    assert "by drifting (drift 1e-07)" in words and f"by {followed['first_quarter']:.3g} standard deviations" in words
    rows = [line.split(",") for line in (second_folder / "sensors.csv").read_text().splitlines()]
    column = rows[0].index("m4")
    for row in rows[len(rows) // 2 :]:
        row[column] = f"{float(row[column]) + 3e-5:.8f}" if row[column] else ""
    (second_folder / "sensors.csv").write_text("\n".join(map(",".join, rows)) + "\n")
    assert main(["measure", str(second_folder), "--limbs", str(limbs), "--out", str(tmp_path / "none")]) == 1
    assert "limb 4 is longer by -" in capsys.readouterr().err and not (tmp_path / "none").exists()
    assert main(["online", str(second_folder), "--limbs", str(limbs)]) == 1
    assert "acceptance of these limbs was withdrawn at frame" in capsys.readouterr().err


@pytest.mark.parametrize(
    "command, options, says",
    [
        ("online", ["--limbs", "typo.json"], "typo.json: no such file"),
        ("online", ["--check", "3"], "--vision-every takes"),
        ("calibrate", ["--limbs", "RIG", "--out", "c.json"], "not valid JSON"),
        ("online", ["--learner", "forgetting", "--step", "1e-3"], "--step is of"),
        ("measure", ["--limbs", "RIG", "--places", "free", "--out", "m"], "omit them with --limbs"),
        ("online", ["--learner", "drifting", "--drift", "-1"], "--drift: drift must be at"),
        ("online", ["--learner", "first-order", "--state", "RIG"], "is a file of the recording"),
    ],
)
def test_limbs_and_learners_that_cannot_be_are_refused(limbed, tmp_path, capsys, monkeypatch, command, options, says):
    rec = limbed[1].folder
    monkeypatch.chdir(tmp_path)
    assert main([command, str(rec), *[str(rec / "rig.toml") if word == "RIG" else word for word in options]]) == 1
    assert says in capsys.readouterr().err


def test_a_rig_without_limbs_says_so(rig_file, tmp_path, capsys):
    assert main(["simulate", str(rig_file), "--plan", "sobol:3", "--out", str(tmp_path / "rec")]) == 0
    assert main(["insitu", str(tmp_path / "rec")]) == 1
    assert "no [insitu] table" in capsys.readouterr().err


@pytest.mark.slow
def test_learning_goes_on_from_a_calibration(rig_file, tmp_path, capsys):
    for name, effect in (("before", []), ("after", ["--effect", "missed_steps:strut5:jump=-9e-5,time=0.5"])):
        assert main(["simulate", str(rig_file), "--plan", "sobol:40", *effect, "--out", str(tmp_path / name)]) == 0
    assert main(["calibrate", str(tmp_path / "before"), "--out", str(tmp_path / "c.json")]) == 0
    capsys.readouterr()
    assert main(["online", str(tmp_path / "after"), "--calibration", str(tmp_path / "c.json")]) == 0
    output = capsys.readouterr().out
    assert "frame 1: from frame 0 on strut 5 is longer by -0.0" in output and output.count("longer") == 1
    assert main(["online", str(tmp_path / "after"), "--calibration", str(tmp_path / "typo.json")]) == 1
