"""Data are known again by their content: through measuring, copying, renumbering and other clocks, and nothing counts
twice.
"""

import json
import shutil

import numpy as np
import pytest

from rig.cli import command_line
from rig.recording import frame_selection_and_content_hashes, recording_folder
from tests.conftest import BENCH, make_recording


@pytest.fixture(scope="module")
def two(tmp_path_factory, design, rig_text):
    """Two recordings of one machine by the same commands, and what was measured from the first."""
    base = tmp_path_factory.mktemp("provenance")
    for k, name in enumerate(("fit", "check")):
        make_recording(base / name, design, rig_text, 7, count=30, noise=0.04 + 1e-3 * k)
    assert command_line.main(["measure", str(base / "fit"), "--out", str(base / "measured")]) == 0
    assert command_line.main(["calibrate", str(base / "measured"), "--out", str(base / "c.json")]) == 0
    return base


def of(folder):
    return frame_selection_and_content_hashes.content_hashes_of_frames(recording_folder.load_recording(folder))


def known(folder):
    return frame_selection_and_content_hashes.sorted_hashes_of_frames(of(folder))


@pytest.mark.slow
def test_another_recording_by_the_same_commands_shares_nothing(two):
    assert not frame_selection_and_content_hashes.frames_with_known_hashes(of(two / "check"), known(two / "fit"))


def test_what_was_measured_is_what_it_was_measured_from(two):
    frames = list(range(30))
    assert (
        frame_selection_and_content_hashes.frames_with_known_hashes(of(two / "measured"), known(two / "fit")) == frames
    )
    assert (
        frame_selection_and_content_hashes.frames_with_known_hashes(of(two / "fit"), known(two / "measured")) == frames
    )


def test_a_copy_cut_short_renumbered_and_by_another_clock_is_known_again(two, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(two / "fit", folder)
    for name in ("frames.csv", "corners.csv", "commands.csv", "sensors.csv"):
        head, *rows = (folder / name).read_text().splitlines()
        cells = [row.split(",") for row in rows]
        at = head.split(",").index("t") if "t" in head.split(",") else None
        for row in cells:
            if at is not None:
                row[at] = f"{float(row[at]) + 3600:.4f}"
            if head.startswith("frame"):
                row[0] = str(int(row[0]) + 100)
        if head.startswith("frame"):
            cells = [row for row in cells if int(row[0]) < 112]
        (folder / name).write_text("\n".join([head, *map(",".join, cells)]) + "\n")
    assert frame_selection_and_content_hashes.frames_with_known_hashes(of(folder), known(two / "fit")) == list(
        range(100, 112)
    )


@pytest.mark.slow
def test_images_and_what_was_measured_from_them_are_the_same_data(tmp_path):
    assert command_line.main(["measure", str(BENCH / "check"), "--out", str(tmp_path / "m")]) == 0
    shutil.copytree(BENCH / "check", tmp_path / "copy")
    frames = recording_folder.load_recording(BENCH / "check").exposures.times()[0].tolist()
    assert (
        frame_selection_and_content_hashes.frames_with_known_hashes(of(tmp_path / "copy"), known(tmp_path / "m"))
        == frames
    )
    assert (
        frame_selection_and_content_hashes.frames_with_known_hashes(of(tmp_path / "m"), known(BENCH / "check"))
        == frames
    )
    assert not frame_selection_and_content_hashes.frames_with_known_hashes(of(BENCH / "fit"), known(tmp_path / "m"))


def test_poses_are_data_and_what_repeats_is_no_mark(two, tmp_path):
    folder = tmp_path / "tracker"
    shutil.copytree(two / "measured", folder)
    (folder / ".rig-made.json").unlink()
    (folder / "corners.csv").unlink()
    head, *rows = (folder / "poses.csv").read_text().splitlines()
    rows[5] = ",".join([rows[5].split(",")[0], *rows[4].split(",")[1:]])  # two readings alike
    (folder / "poses.csv").write_text("\n".join([head, *rows]) + "\n")
    assert frame_selection_and_content_hashes.frames_with_known_hashes(of(folder), known(two / "measured")) == [
        k for k in range(30) if k not in (4, 5)
    ]


@pytest.mark.parametrize("name", ["fit", "measured"])
def test_verify_says_what_is_not_held_out(name, two, capfd):
    capfd.readouterr()
    assert command_line.main(["verify", str(two / "c.json"), str(two / name), "--json"]) == 0
    tree = json.loads(capfd.readouterr().out)
    assert tree["held_out"] is False and len(tree["frames_used_in_fitting"]) == 30
    assert command_line.main(["verify", str(two / "c.json"), str(two / name)]) == 0
    assert "30 of this recording's 30 frames" in capfd.readouterr().err


def test_verify_holds_out_another_recording(two, capfd):
    capfd.readouterr()
    assert command_line.main(["verify", str(two / "c.json"), str(two / "check"), "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["held_out"] is True


@pytest.mark.slow
def test_on_line_learning_takes_each_frame_once(two, tmp_path, capfd):
    state = tmp_path / "state.json"
    for rec, status in (("fit", 0), ("fit", 1), ("measured", 1), ("check", 0), ("check", 1)):
        before = state.read_bytes() if state.exists() else b""
        assert command_line.main(["online", str(two / rec), "--state", str(state)]) == status
        output = capfd.readouterr()
        if status:
            assert (
                "learnt already; once more they would be counted twice" in output.err and state.read_bytes() == before
            )
    assert json.loads(state.read_text())["number"] == 60
    assert command_line.main(["online", str(two / "fit"), "--calibration", str(two / "c.json")]) == 1
    assert "count twice" in capfd.readouterr().err
    assert (
        command_line.main(
            ["diagnose", str(two / "fit"), "--calibration", str(two / "c.json"), "--out", str(tmp_path / "d")]
        )
        == 1
    )
    assert "made from 30 of the frames" in capfd.readouterr().err and not (tmp_path / "d").exists()


@pytest.mark.slow
def test_a_recording_that_has_grown_adds_what_is_new(two, tmp_path, capfd):
    short = tmp_path / "short"
    shutil.copytree(two / "fit", short)
    for name in ("frames.csv", "corners.csv"):
        head, *rows = (short / name).read_text().splitlines()
        (short / name).write_text("\n".join([head, *(row for row in rows if int(row.split(",")[0]) < 20)]) + "\n")
    state = tmp_path / "state.json"
    assert command_line.main(["online", str(short), "--state", str(state)]) == 0
    assert command_line.main(["online", str(two / "fit"), "--state", str(state)]) == 0
    assert "20 of 30 frames have been learnt already and are skipped" in capfd.readouterr().out
    assert json.loads(state.read_text())["number"] == 30 and np.isfinite(json.loads(state.read_text())["p"]).all()
