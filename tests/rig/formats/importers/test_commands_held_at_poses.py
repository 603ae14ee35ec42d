"""A table with a row for each pose is no log: its machine stood still while it was measured."""

import tracemalloc
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest

from rig.errors import RigError
from rig.formats.importers.commands_held_at_poses import commands_held_at_poses
from rig.formats.importers.exposures_from_image_names import ImportedExposures
from rig.formats.importers.foreign_command_table import ImportedCommands
from rig.formats.importers.foreign_file_import_recipe import ForeignTable, Images
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
    assert "18 of 20 rows of log.csv have a pose of their own" in text
    own = t - (at[0] - 1.0)  # rows without a pose remain, with a dwell like the others
    assert len(commands.t) == 2 * COUNT
    for s in (-0.25, 0.0, 0.25):
        assert np.abs(commands.at(own[[4, 11]] + s) - values[[4, 11]]).max() < 1e-9


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


def decimals(t):
    return [Decimal(f"{s:.4f}") for s in t]


def held(t, values, at, frame=None, rows=None):
    """commands_held_at_poses of rows at t (n,) s and exposures at (m,) s; frame : (m,) numbers."""
    numbers = list(range(len(at))) if frame is None else list(frame)
    names, paths = [f"cam{k}" for k in range(len(at))], [Path()] * len(at)
    exposed = ImportedExposures(numbers, decimals(at), names, paths, Images(()), ())
    table = ForeignTable(Path("log.csv"), rows=rows)
    return commands_held_at_poses(exposed, ImportedCommands(decimals(t), values, None, table, ()))


def test_a_long_log_is_told_without_a_table_of_all_pairs():
    """100 000 rows and 1000 frames: all pairs took 1.65 GB and 5 s; stated as held, they are dwelt at all the same."""
    t = 5.0 * np.arange(100_000)
    values, at = np.random.default_rng(1).uniform(-1, 1, (len(t), 3)), t[::100] + 0.01
    commanded = ImportedCommands(decimals(t), values, None, ForeignTable(Path("log.csv"), rows="held"), ())
    paths = [Path()] * len(at)
    exposed = ImportedExposures(list(range(len(at))), decimals(at), ["a"] * len(at), paths, Images(()), ())
    tracemalloc.start()
    done = commands_held_at_poses(exposed, commanded)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(done.t) == 2 * len(t) and most < 3e8, most
    assert len(held(t, values, at).t) == len(t)


@pytest.mark.parametrize("period", [None, 3.0, 5.5])
@pytest.mark.parametrize("late", [0.0, 0.08])
def test_a_log_of_a_row_each_second_is_not_held(period, late):
    """Random targets, and paths of short periods, which look no smoother."""
    t, rng = np.arange(60.0), np.random.default_rng(3)
    phases = np.array([0.0, 1.0, 2.0])
    values = rng.uniform(-1, 1, (60, 3)) if period is None else np.sin(2 * np.pi * t[:, None] / period + phases)
    assert len(held(t, values, t + late).t) == len(t)


@pytest.mark.parametrize("late", [0.4, -0.4])
def test_poses_that_are_all_late_are_of_another_clock(late):
    """Within a tenth of the time between rows; that they are late remains to be found, and is reported."""
    t, values, at = configurations()
    found = held(t, values, at + late)
    assert len(found.t) == COUNT
    (line,) = found.remarks
    assert f"{'after' if late > 0 else 'before'} the rows of log.csv" in line and "commands.rows=held" in line
    shift = float(line.split("commands.shift=")[1].split()[0])
    assert shift == pytest.approx((at + late - t).mean(), abs=1e-3)
    assert len(held(t + shift, values, at + late).t) == 2 * COUNT
    assert len(held(t, values, at + late, rows="held").t) == 2 * COUNT


def test_rows_out_of_order_are_not_stated_as_held():
    t, values, at = configurations()
    with pytest.raises(RigError, match="in order of time"):
        held(t[::-1], values, at, rows="held")


def test_scatter_about_rows_that_is_wider_than_a_clock_is_known_is_held():
    t, values, _ = configurations()
    assert len(held(t, values, t + np.random.default_rng(4).normal(0, 0.3, COUNT)).t) == 2 * COUNT


def test_cameras_with_times_of_their_own_are_one_frame():
    t, values, _ = configurations()
    at = np.stack([t + 0.010, t + 0.014], axis=1).ravel()
    found = held(t, values, at, np.repeat(np.arange(COUNT), 2))
    assert len(found.t) == 2 * COUNT and "20 of 20 rows" in found.remarks[0]
    assert (np.array(found.t, float)[1::2] >= t + 0.014).all()


@pytest.mark.parametrize("setting", ["poses.rows=held", "poses.rows=moving"])
def test_rows_of_poses_are_not_stated(tmp_path, setting):
    status, text, _ = imported(tmp_path, *configurations(), setting)
    assert status == 1 and f"{setting} states what rows are, and only commands.rows does; leave it out" in text, text
