"""rig diagnose --next: a plan that the simulator runs, whose chance is said before, and after which one name is
left.
"""

import json

import numpy as np
import pytest

from rig.cli.command_line import main
from rig.planning.recording_plan import build_plan
from rig.planning.timed_plan_and_visiting_order import write_plan_table


def test_a_plan_in_time_comes_back_with_its_payload(design, tmp_path):
    plan = build_plan(design, "sobol:3,payload:2,dwell:4", 3)
    write_plan_table(tmp_path / "plan.csv", plan, design.mechanism.axes)
    reloaded = build_plan(design, f"commands:{tmp_path / 'plan.csv'}")
    np.testing.assert_allclose(reloaded.t, plan.t, atol=1e-4)
    np.testing.assert_allclose(reloaded.commands.at(plan.t), plan.commands.at(plan.t), atol=2e-6)
    changed = np.r_[True, np.diff(plan.payload[:, 1]) != 0]
    np.testing.assert_allclose(reloaded.payload, plan.payload[changed], atol=1e-3)
    assert (reloaded.payload[:, 1] > 0).sum() == 1


def test_what_cannot_be_meant_is_refused(rig_text, recording_folder, tmp_path, capsys):
    (tmp_path / "rig.toml").write_text(rig_text + '\n[experiment]\nmay = ["paylaod"]\n')
    assert main(["simulate", str(tmp_path / "rig.toml"), "--out", str(tmp_path / "rec")]) == 1
    assert "experiment.may must list what experiments may do, of 'payload', 'wait'" in capsys.readouterr().err
    for words, says in (
        (["--next", str(tmp_path / "n.csv"), "--minutes", "0"], "--minutes takes a time above 0"),
        (["--standing"], "--standing and --may are for"),
    ):
        assert main(["diagnose", str(recording_folder), "--out", str(tmp_path / "out"), *words]) == 1
        assert says in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_lag_is_told_from_a_clock_by_the_plan_that_is_written(rig_text, tmp_path, capsys):
    rig, one, two = (str(tmp_path / name) for name in ("rig.toml", "one", "two"))
    (tmp_path / "rig.toml").write_text(rig_text)
    assert (
        main(
            [
                "simulate",
                rig,
                "--plan",
                "moving:30,sobol:40",
                "--effect",
                "servo_lag:rig:time_constant=0.012",
                "--seed",
                "1",
                "--out",
                one,
                "--truth",
                str(tmp_path / "truth.json"),
            ]
        )
        == 0
    )
    assert main(["diagnose", one, "--out", str(tmp_path / "first"), "--next", str(tmp_path / "next.csv")]) == 0
    output = capsys.readouterr().out
    assert (
        "ambiguous: servo lag at rig" in output
        and "next: zigzag" in output
        and "settles this with a chance of" in output
    )
    result = json.loads((tmp_path / "first" / "next.json").read_text())
    assert {h["title"] for h in result["questions"][0]["hypotheses"]} == {
        "servo lag at rig",
        "time offset at clock",
        "something in no catalogue",
    }
    assert result["experiments"][0]["settles"] > 0.9 > result["experiments"][-1]["settles"]
    assert (
        main(
            [
                "simulate",
                rig,
                "--plan",
                f"commands:{tmp_path / 'next.csv'}",
                "--machine",
                str(tmp_path / "truth.json"),
                "--seed",
                "2",
                "--out",
                two,
            ]
        )
        == 0
    )
    assert main(["diagnose", one, two, "--out", str(tmp_path / "second"), "--next", str(tmp_path / "third.csv")]) == 0
    assert "nothing is ambiguous" in capsys.readouterr().out and not (tmp_path / "third.csv").exists()
    (finding,) = json.loads((tmp_path / "second" / "diagnosis.json").read_text())["findings"]
    assert (finding["effect"], finding["cannot_be_told_from"]) == ("servo_lag", [])
