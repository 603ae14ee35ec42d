"""A table with a row for each pose is no log: its machine stood still while it was measured."""

import numpy as np
import pytest

from rig.recording import recording_folder
from tests.calib.checks.test_mistakes import run_in_process

RIG = """schema = "rig/1"
[mechanism]
kind = "arm"
joints = [[0.0, 0.3, 0.4, 0.0], [0.0, 0.0, 0.3, 0.0], ["prismatic", 0.0, 0.1, 0.0, 0.0]]
limits = [[-2.0, 2.0], [-2.5, 2.5], [0.0, 0.2]]
[instrument]
base = "rig"
tool = "rig"
position_sigma = 2e-5
"""
COUNT = 20


def configurations():
    """(t (n,) s of rows, values (n, 3), t (n,) s of poses): twelve seconds apart, clocks of two programs."""
    rng = np.random.default_rng(5)
    t = 100 + np.cumsum(rng.uniform(10, 14, COUNT))
    values = rng.uniform([-2, -2.5, 0], [2, 2.5, 0.2], (COUNT, 3))
    at = t + rng.normal(0, 0.02, COUNT)
    at[0] = t[0] - 0.03  # before all commands
    return t, values, at


def imported(folder, t, values, at, *settings):
    """(status, text, Recording or None) of tables written by hand; positions by plain trigonometry."""
    (folder / "rig.toml").write_text(RIG)
    rows = [f"{s:.4f},{a!r},{b!r},{c!r}" for s, (a, b, c) in zip(t, values.tolist())]
    (folder / "log.csv").write_text("\n".join(["t [s],q1 [rad],q2 [rad],q3 [m]", *rows]) + "\n")
    a, b = values[:, 0], values.sum(axis=1) - values[:, 2]
    x, y = 0.4 * np.cos(a) + 0.3 * np.cos(b), 0.4 * np.sin(a) + 0.3 * np.sin(b)
    rows = [f"{s:.4f},{p:.7f},{q:.7f},{0.4 + c:.7f}" for s, p, q, c in zip(at, x, y, values[:, 2])]
    (folder / "tracker.csv").write_text("\n".join(["t [s],x [m],y [m],z [m]", *rows]) + "\n")
    options = [word for setting in settings for word in ("--set", setting)]
    files = ("--rig", folder / "rig.toml", "--commands", folder / "log.csv", "--poses", folder / "tracker.csv")
    status, text = run_in_process("import", *files, "--out", folder / "rec", *options)
    return status, text, recording_folder.load_recording(folder / "rec") if status == 0 else None


def test_each_pose_is_of_its_own_row_though_the_clocks_jitter(tmp_path):
    t, values, at = configurations()
    status, text, recording = imported(tmp_path, t, values, at)
    assert status == 0 and "commands.rows=moving" in text, text
    commands, at = recording.commands, at - (at[0] - 1.0)  # whose clock begins with the first dwell
    assert np.abs(commands.at(at) - values).max() < 1e-9
    for s in (-0.25, 0.25):  # at rest before and after, so that nothing is of a machine in motion
        assert np.abs(commands.at(at + s) - values).max() < 1e-9


def test_a_pose_may_lack_and_the_others_keep_their_rows(tmp_path):
    t, values, at = configurations()
    keep = np.setdiff1d(np.arange(COUNT), [4, 11])
    (tmp_path / "whole").mkdir()
    status, text, _ = imported(tmp_path / "whole", t, values, at)
    lines = (tmp_path / "whole" / "tracker.csv").read_text().splitlines()
    kept = [lines[0], *(lines[1 + k] for k in keep)]
    (tmp_path / "whole" / "tracker.csv").write_text("\n".join(kept) + "\n")
    files = [tmp_path / "whole" / name for name in ("rig.toml", "log.csv", "tracker.csv")]
    words = ("--rig", files[0], "--commands", files[1], "--poses", files[2], "--out", tmp_path / "rec")
    status, text = run_in_process("import", *words)
    assert status == 0, text
    commands = recording_folder.load_recording(tmp_path / "rec").commands
    assert np.abs(commands.at((at - (at[0] - 1.0))[keep]) - values[keep]).max() < 1e-9


@pytest.mark.parametrize("settings", [("commands.rows=moving",), ()])
def test_a_log_of_moves_remains_one(tmp_path, settings):
    t, values, at = configurations()
    if not settings:  # every row on one slow path
        values = np.stack([np.sin(t / 60), np.cos(t / 60), 0.1 + 0.05 * np.sin(t / 40)], axis=1)
    at = np.maximum(at, t[0])
    status, text, recording = imported(tmp_path, t, values, at, *settings)
    assert status == 0 and "stand still" not in text, text
    assert len(recording.commands.t) == COUNT


def test_rows_stated_as_held_with_two_poses_each_are_refused(tmp_path):
    t, values, at = configurations()
    at[1] = t[0] + 2.0
    status, text, _ = imported(tmp_path, t, values, np.sort(at), "commands.rows=held")
    assert status == 1 and "two frames or more are nearest to one row" in text, text
