"""The commands as a user gives them: from images to corrected commands."""

import json
import os
import pty
import re
import shutil
import subprocess
import termios

import numpy as np
import pytest

from rig.formats.rig_toml import design_from_rig_toml
from rig.model.mechanisms import hexapod
from rig.model.pose import pose_difference
from rig.recording import corner_and_pose_csv_tables, recording_folder
from tests.cli import RIG, Links, run, run_process
from tests.conftest import BENCH, make_recording


@pytest.fixture(scope="module")
def worked(tmp_path_factory, design, rig_text):
    """A fit and a check recording of one machine, measured, calibrated: what most commands start from."""
    base = tmp_path_factory.mktemp("worked")
    secret, _ = make_recording(base / "fit", design, rig_text, 7, count=60)
    make_recording(base / "check", design, rig_text, 7, count=20)
    for command, out in (("measure", "measured"), ("calibrate", "calibration.json")):
        (base / f"{command}.said").write_text(run(command, base / "fit", "--out", base / out, "--json").stdout)
    return base, secret


def test_measure_writes_what_the_contract_says(worked):
    base, _ = worked
    out = base / "measured"
    header = (out / "poses.csv").read_text().splitlines()[0].split(",")
    assert header[:7] == ["frame", "x", "y", "z", "rx", "ry", "rz"] and header[7:] == list(
        corner_and_pose_csv_tables.COVARIANCE_COLUMNS
    )
    assert (out / "corners.csv").read_text().splitlines()[0].startswith("frame,camera,marker,corner,u,v,sigma")
    nominal, adjusted = (
        design_from_rig_toml.load_design(base / "fit" / "rig.toml"),
        design_from_rig_toml.load_design(out / "rig.toml"),
    )
    assert np.abs(pose_difference(nominal.cameras[0].pose, adjusted.cameras[0].pose)).max() > 1e-4
    loaded = recording_folder.load_recording(out)  # what was measured is itself a recording
    assert loaded.poses.covariance.shape == (60, 6, 6)
    page = (out / "report.html").read_text()
    links = Links()
    links.feed(page)
    assert (
        not links.outside
        and page.count('<svg class="figure"') >= 5
        and "://" not in page
        and "<strong>good</strong>" in page
    )


def test_results_for_programs_are_whole_json_and_say_what_the_files_say(worked, tmp_path):
    base, _ = worked
    measured, calibrated = (json.loads((base / f"{command}.said").read_text()) for command in ("measure", "calibrate"))
    assert (measured["schema"], measured["frames"], measured["solved"], measured["unsolved"]) == (
        "measured/1",
        60,
        60,
        {},
    )
    np.testing.assert_allclose(
        measured["cameras"][0]["matrix"],
        design_from_rig_toml.load_design(base / "measured" / "rig.toml").cameras[0].matrix,
        atol=1e-6,
    )
    stored = json.loads((base / "calibration.json").read_text())
    assert (
        calibrated["held_out"] == stored["held_out"]
        and calibrated["claim"] == stored["claim"]
        and calibrated["poses"] == 60
    )
    done = run(
        "correct",
        base / "calibration.json",
        "--poses",
        base / "measured" / "poses.csv",
        "--out",
        tmp_path / "c.csv",
        "--json",
    )
    result, rows = json.loads(done.stdout), np.loadtxt(tmp_path / "c.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose([row["values"] for row in result["commands"]], rows[:, 1:], atol=1e-10)
    assert "60 of 60 poses written" in done.stderr
    both = run(
        "correct",
        base / "calibration.json",
        "--poses",
        base / "measured" / "poses.csv",
        "--out",
        "-",
        "--json",
        ok=False,
    )
    assert "both write to the standard output" in both.stderr and not both.stdout


def test_the_recording_stays_as_it_was(worked, tmp_path, design, rig_text):
    folder = tmp_path / "rec"
    make_recording(folder, design, rig_text, 1, count=10)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    run("measure", folder, "--out", tmp_path / "out")
    done = run("measure", folder, "--out", folder, ok=False)
    assert "remains unchanged" in done.stderr
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_calibration_corrects_the_true_machine(worked, tmp_path):
    base, secret = worked
    wanted = hexapod.forward(
        secret.stated.mechanism.strut_range.mean(axis=1) + 0.02 * np.random.default_rng(0).uniform(-1, 1, (30, 6)),
        secret.stated.mechanism,
    )
    corner_and_pose_csv_tables.write_poses(
        tmp_path / "wanted.csv", recording_folder.Poses(np.arange(30) * 2, wanted, None)
    )
    run("correct", base / "calibration.json", "--poses", tmp_path / "wanted.csv", "--out", tmp_path / "commands.csv")
    lines = (tmp_path / "commands.csv").read_text().splitlines()
    assert lines[0] == "frame,l1,l2,l3,l4,l5,l6" and [int(line.split(",")[0]) for line in lines[1:]] == list(
        range(0, 60, 2)
    )
    commands = np.array([line.split(",")[1:] for line in lines[1:]], float)
    after = pose_difference(wanted, hexapod.forward(commands, secret.true.mechanism))
    before = pose_difference(
        wanted, hexapod.forward(hexapod.inverse(wanted, secret.stated.mechanism), secret.true.mechanism)
    )
    assert np.linalg.norm(before[:, :3], axis=1).mean() > 15 * np.linalg.norm(after[:, :3], axis=1).mean()


def test_calibration_says_where_it_comes_from(worked):
    tree = json.loads((worked[0] / "calibration.json").read_text())
    origin = tree["provenance"]
    assert set(origin["inputs_sha256"]) == {"rig.toml", "commands.csv", "frames.csv", "corners.csv", "sensors.csv"}
    assert origin["seed"] == 0 and "numpy" in origin["versions"] and origin["arguments"][0] == "calibrate"
    assert tree["held_out"]["after"]["n"] == 60 and (worked[0] / "calibration.html").exists()


@pytest.mark.slow
def test_same_input_same_output(worked, tmp_path):
    base, _ = worked
    run("calibrate", base / "fit", "--out", tmp_path / "again.json")
    first, second = (json.loads(path.read_text()) for path in (base / "calibration.json", tmp_path / "again.json"))
    for tree in (first, second):
        del tree["provenance"]
    assert first == second


@pytest.mark.slow
def test_verify_reports_held_out_figures(worked):
    base, _ = worked
    tree = json.loads(run("verify", base / "calibration.json", base / "check", "--json").stdout)
    assert tree["n"] == 20 and tree["held_out"] is True
    assert tree["before"]["position"]["rms"] > 15 * tree["after"]["position"]["rms"]
    assert tree["after"]["position"]["rms"] <= tree["after"]["position"]["max"] and "p95" in tree["after"]["rotation"]
    text = run("verify", base / "calibration.json", base / "check", "--page", base / "verified.html").stdout
    assert "N = 20" in text and re.search(r"corrected\s+0\.0", text)
    page = (base / "verified.html").read_text()
    state = tree["verdict"]["state"]
    assert f"<strong>{state}</strong>" in page and text.startswith(f"{state}: ") and state != "bad"
    assert "the claim is kept" in page and 'href="calibration.html"' in page and 'id="stage-data"' in page
    same = run("verify", base / "calibration.json", base / "fit")
    assert "not held out" in same.stderr


@pytest.mark.slow
def test_calibrating_what_was_measured_gives_the_same(worked, tmp_path):
    base, _ = worked
    run("calibrate", base / "measured", "--out", tmp_path / "c.json")
    one, two = (
        np.array(json.loads(path.read_text())["fitted"]["base_joints"])
        for path in (base / "calibration.json", tmp_path / "c.json")
    )
    np.testing.assert_allclose(one, two, atol=3e-6)


@pytest.mark.slow
def test_poses_from_outside_are_calibrated_too(worked, tmp_path):
    base, secret = worked
    folder = tmp_path / "tracker"
    shutil.copytree(base / "measured", folder)
    (folder / "corners.csv").unlink()
    assert "poses.csv" in run("calibrate", folder, "--out", tmp_path / "c.json").stdout


def test_images_go_all_the_way(tmp_path):
    run_process("calibrate", BENCH / "fit", "--out", tmp_path / "c.json")
    tree = json.loads(run_process("verify", tmp_path / "c.json", BENCH / "check", "--json").stdout)
    assert tree["n"] == 6 and tree["ratio"]["position"] > 8
    assert tree["after"]["position"]["rms"] < tree["measurement_uncertainty"]["position"]
    assert any(
        "images" in name for name in json.loads((tmp_path / "c.json").read_text())["provenance"]["inputs_sha256"]
    )


def test_unreachable_poses_are_listed_and_nothing_is_written(worked, tmp_path):
    base, _ = worked
    (tmp_path / "wanted.csv").write_text(
        "frame,x,y,z,rx,ry,rz\n4,0,0,0.45,0,0,0\n5,0,0,0.75,0,0,0\n6,0.4,0,0.45,0,0,0\n"
    )
    arguments = (
        "correct",
        base / "calibration.json",
        "--poses",
        tmp_path / "wanted.csv",
        "--out",
        tmp_path / "commands.csv",
    )
    done = run(*arguments, ok=False)
    assert (
        "2 of 3 wanted poses cannot be reached" in done.stderr
        and "frame 5: strut 1" in done.stderr
        and "frame 6:" in done.stderr
    )
    assert not (tmp_path / "commands.csv").exists()
    done = run(*arguments, "--skip-unreachable")
    assert "excluded, as requested" in done.stderr
    assert [line.split(",")[0] for line in (tmp_path / "commands.csv").read_text().splitlines()] == ["frame", "4"]


@pytest.mark.parametrize(
    "arguments, says",
    [
        (("measure", "nowhere", "--out", "x"), "no such folder"),
        (("calibrate", "nowhere", "--out", "x.json"), "no such folder"),
        (("correct", "nowhere.json", "--poses", "p.csv", "--out", "c.csv"), "no such file"),
        (("verify", "nowhere.json", "nowhere"), "no such file"),
    ],
)
def test_a_typo_in_a_path_is_said_in_one_line(arguments, says):
    done = run(*arguments, ok=False)
    assert says in done.stderr and done.stderr.count("\n") == 1 and done.returncode == 1


def test_more_that_goes_wrong(worked, tmp_path):
    base, _ = worked
    (tmp_path / "empty").mkdir()
    assert "empty folder" in run("measure", tmp_path / "empty", "--out", tmp_path / "o", ok=False).stderr
    assert not (tmp_path / "o").exists()
    assert "'lens'" in run("measure", base / "fit", "--out", tmp_path / "o", "--hold", "lens", ok=False).stderr
    assert "create it first" in run("calibrate", base / "fit", "--out", tmp_path / "no/c.json", ok=False).stderr
    assert "is a folder" in run("calibrate", base / "fit", "--out", tmp_path, ok=False).stderr
    (tmp_path / "half.json").write_text((base / "calibration.json").read_text()[:5000])
    assert "cut off" in run("verify", tmp_path / "half.json", base / "check", ok=False).stderr
    output = run(
        "calibrate", base / "fit", "--out", tmp_path / "c.json", "--diagnosis", base / "check", ok=False
    ).stderr
    assert "holds no diagnosis.json; --diagnosis requires a folder that `rig diagnose` wrote" in output
    (tmp_path / "wanted.csv").write_text("x;y;z;rx;ry;rz\n0;0;0,45;0;0;0\n")
    output = run(
        "correct", base / "calibration.json", "--poses", tmp_path / "wanted.csv", "--out", tmp_path / "o.csv", ok=False
    ).stderr
    assert "separated by semicolons, and tables here are by commas" in output
    still = tmp_path / "still"
    shutil.copytree(base / "check", still)
    (still / "commands.csv").unlink()
    assert "no commands.csv" in run("calibrate", still, "--out", tmp_path / "c.json", ok=False).stderr


def test_held_cameras_stay(worked, tmp_path):
    base, _ = worked
    run("measure", base / "measured", "--out", tmp_path / "o", "--hold", "poses,lenses")
    one, two = (
        design_from_rig_toml.load_design(base / "measured" / "rig.toml"),
        design_from_rig_toml.load_design(tmp_path / "o" / "rig.toml"),
    )
    assert np.abs(pose_difference(one.cameras[0].pose, two.cameras[0].pose)).max() < 1e-9


@pytest.mark.slow
def test_bars_on_a_terminal_and_none_in_a_pipe(tmp_path):
    assert "%" not in run("measure", BENCH / "check", "--out", tmp_path / "o").stderr
    try:
        main, other = pty.openpty()
    except OSError:
        pytest.skip("no pseudo-terminals here")
    termios.tcsetwinsize(other, (24, 80))
    process = subprocess.Popen(
        [*RIG, "measure", str(BENCH / "check"), "--out", str(tmp_path / "p")], stderr=other, stdout=subprocess.DEVNULL
    )
    os.close(other)
    seen = b""
    try:
        while chunk := os.read(main, 65536):
            seen += chunk
    except OSError:
        pass  # the terminal closed: all has been read
    assert process.wait(timeout=60) == 0
    assert (
        any(label in seen for label in (b"reading images", b"locating", b"adjusting")) and b"%" in seen
    )  # what is over at once shows none


@pytest.mark.slow
def test_measure_names_markers_that_are_exchanged(tmp_path, design, rig_text):
    from rig.effects.catalogue.marker_swap import MarkerSwap

    folder = tmp_path / "swapped"
    marker = next(
        face[1] for target in design.targets if target.body == "platform" for face in target.faces if face[0] == "+z"
    )
    other = next(
        face[1]
        for target in design.targets[::-1]
        if target.body == "platform"
        for face in target.faces
        if face[0] == "+z"
    )
    assert marker != other
    _, truth = make_recording(
        folder, design, rig_text, 5, count=10, effects=(MarkerSwap(f"marker {marker}", other=float(other)),)
    )
    done = run("measure", folder, "--out", tmp_path / "out")
    message = f"marker {marker}: is exchanged with marker {other}"
    assert "2 markers are not as in rig.toml" in done.stdout and message in done.stdout
    assert message in (tmp_path / "out/report.html").read_text()
    assert (
        np.abs(
            pose_difference(corner_and_pose_csv_tables.load_poses(tmp_path / "out/poses.csv").T_base_platform, truth)
        ).max()
        < 1e-3
    )
