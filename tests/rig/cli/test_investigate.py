"""rig investigate through the command line: what it asks by hand, what it refuses, and a lag found out by itself."""

import json

import pytest

from rig.cli.command_line import main
from tests.emulated_run import EmulatedRig


@pytest.fixture
def rig(tmp_path, rig_text):
    (tmp_path / "rig.toml").write_text(rig_text)
    return tmp_path / "rig.toml"


def test_by_hand_it_writes_what_is_to_be_done_and_waits(rig, tmp_path, capsys):
    words = ["investigate", str(rig), "--by-hand", "--out", str(tmp_path / "out"), "--plan", "sobol:4,payload:2"]
    assert main(words) == 0
    output = capsys.readouterr().out
    assert (
        "to do: carry out" in output
        and "plan1.csv (10 exposures" in output
        and "load 7.29 kg" in output
        and "--resume" in output
    )
    plan = (tmp_path / "out" / "plan1.csv").read_bytes()
    assert main([*words, "--resume", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert (
        printed["schema"] == "investigated/1"
        and not printed["looks"]
        and not printed["ended"]
        and "to do: carry out" in printed["waiting"]
    )
    assert printed["verdict"] is None  # nothing is recorded yet
    assert main([*words, "--resume", "--quiet"]) == 0 and capsys.readouterr().out == ""
    assert (tmp_path / "out" / "plan1.csv").read_bytes() == plan
    assert main([*words, "--resume"]) == 0 and (tmp_path / "out" / "plan1.csv").read_bytes() == plan
    assert main(words) == 1
    assert "--resume continues with it" in capsys.readouterr().err
    (tmp_path / "out" / "rec1").mkdir()
    (tmp_path / "out" / "rec1" / "frames.csv").write_text("frame,t\n")
    (tmp_path / "out" / "rec1" / "rig.toml").write_text(rig.read_text())
    assert main([*words, "--resume"]) == 1  # half a recording
    assert "frames.csv" in capsys.readouterr().err
    rig.write_text(rig.read_text().replace("mass = 12.15", "mass = 13.15"))
    assert main([*words, "--resume"]) == 1
    assert "is of another rig" in capsys.readouterr().err


def test_by_hand_it_asks_that_a_cube_is_turned_and_looks_whether_it_was(rig, tmp_path, capsys):
    words = ["investigate", str(rig), "--by-hand", "--out", str(tmp_path / "out"), "--plan", "turn:P1,sobol:4"]
    assert main(words) == 0
    output = capsys.readouterr().out
    assert (
        "before it begins: take cube P1 off its socket and put it back turned by a quarter turn" in output
        and "[turned] P1 = 1" in output
    )
    assert (
        main(["simulate", str(rig), "--plan", "sobol:4", "--out", str(tmp_path / "out" / "rec1")]) == 0
    )  # by somebody who did not
    assert main([*words, "--resume"]) == 1
    assert "is for cubes mounted as [turned] P1 = 1" in capsys.readouterr().err


def test_the_driver_moves_nothing_before_a_cube_is_turned(rig, tmp_path, capsys):
    driven = rig.read_text() + '\n[controller]\nprotocol = "grblhal"\nport = "/dev/null"\n'
    rig.write_text(driven)
    assert main(["run", str(rig), "--plan", "turn:P1,sobol:2", "--out", str(tmp_path / "rec"), "--dry-run"]) == 1
    assert "put it back turned by a quarter turn" in capsys.readouterr().err
    words = ["investigate", str(rig), "--out", str(tmp_path / "out"), "--plan", "turn:P1,sobol:2"]
    assert main(words) == 0
    output = capsys.readouterr().out
    assert (
        "to do, before the struts move:" in output
        and "[turned] P1 = 1, and give the same command with --resume" in output
    )
    rig.write_text(driven + "[turned]\nP1 = 1\n")
    assert main([*words, "--resume"]) == 1  # it goes on to the driver, whose port is none
    assert "rig run ended with" in capsys.readouterr().err


def test_what_cannot_be_investigated_is_refused(rig, tmp_path, capsys):
    out = ["--out", str(tmp_path / "out")]
    half = tmp_path / "half"
    half.mkdir()
    (half / "investigation.json").write_text('{"schema": "inv')
    for words, says in (
        ([str(tmp_path / "rgi.toml"), *out], "no such file"),
        ([str(rig), *out], "has no [controller]"),
        ([str(rig), *out, "--machine", str(tmp_path / "truht.json")], "no such file"),
        ([str(rig), *out, "--by-hand", "--verify", "3"], "--verify must be 12 to 400"),
        ([str(rig), *out, "--by-hand", "--plan", "sobl:3"], "there is no part"),
        ([str(rig), "--by-hand", "--resume", "--out", str(half)], "cut off"),
        ([str(rig), "--by-hand", "--resume", *out], "no such file"),
    ):
        assert main(["investigate", *words]) == 1, words
        assert says in capsys.readouterr().err, words
    with pytest.raises(SystemExit):
        main(["investigate", str(rig), *out, "--by-hand", "--budget", "2"])
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_lag_finds_its_name_and_goes_on_where_it_was_interrupted(rig, tmp_path, capsys):
    truth, out = tmp_path / "truth.json", tmp_path / "out"
    assert (
        main(
            [
                "simulate",
                str(rig),
                "--plan",
                "sobol:4",
                "--effect",
                "servo_lag:rig:time_constant=0.012",
                "--seed",
                "1",
                "--out",
                str(tmp_path / "first"),
                "--truth",
                str(truth),
            ]
        )
        == 0
    )
    words = ["investigate", str(rig), "--machine", str(truth), "--out", str(out), "--plan", "moving:30,sobol:40"]
    assert main([*words, "--budget", "5min", "--verify", "12"]) == 0
    assert "leaves no time for a more informative" in capsys.readouterr().out and not (out / "rec2").exists()
    assert main([*words, "--resume"]) == 0
    notebook = (out / "notebook.md").read_text()
    assert (
        "ambiguous: servo lag at rig" in notebook
        and "Tried: zigzag" in notebook
        and "dropped: time offset at clock" in notebook
    )
    assert "settled: yes" in notebook and "Nothing is ambiguous any more." in notebook
    page = (out / "notebook.html").read_text()
    assert "share over recording" in page and "chance to settle" in page
    assert json.loads((out / "certificate" / "certificate.json").read_text())["schema"].startswith("certificate/")
    (finding,) = json.loads((out / "diagnosis2" / "diagnosis.json").read_text())["findings"]
    assert (finding["effect"], finding["place"]) == ("servo_lag", "rig")
    for name in ("diagnosis2/next.json", "verify2.csv"):  # as if it had been interrupted before these
        (out / name).unlink()
    capsys.readouterr()
    assert main([*words, "--resume"]) == 0
    assert "written: " + str(out / "rec2") not in capsys.readouterr().out and (out / "verify2.csv").exists()


@pytest.mark.slow
def test_the_driver_carries_plans_out_and_is_not_asked_twice(tmp_path, capsys):
    """An emulated controller whose cameras see no marker: the moves are made and kept, the diagnosis says what is
    missing.
    """
    made = EmulatedRig(tmp_path)
    try:
        words = [
            "investigate",
            str(tmp_path / "rig.toml"),
            "--out",
            str(tmp_path / "out"),
            "--settle",
            "time:0.01",
            "--plan",
            "sobol:3",
        ]
        assert main([*words[:-1], "moving:4"]) == 1
        assert "while the struts move" in capsys.readouterr().err and not (tmp_path / "out").exists()
        assert main(words) == 1
        assert "see above; --resume continues from there" in capsys.readouterr().err
        assert len(made.commanded_goals()) == 4 and (tmp_path / "out" / "rec1" / "journal.jsonl").exists()
        assert main([*words, "--resume"]) == 1 and len(made.commanded_goals()) == 4
    finally:
        made.close()
