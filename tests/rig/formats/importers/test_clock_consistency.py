"""Clocks that nothing ties are told by when the commands stand still; what tells nothing is not guessed."""

import re

import numpy as np
import pytest

from rig.checks.mistake_dataclass_and_clock_mistakes import (
    clock_offset_mistakes_of_frames_in_motion,
    clock_shift_putting_most_frames_into_dwells,
)
from rig.planning.recording_plan import build_plan
from rig.recording import recording_folder
from tests.calib.checks.test_mistakes import run_in_process
from tests.rig.formats.importers.test_importing import words


def log(gaps, rate=10.0):
    """(t (n,) s, values (n, 2) rad, middles of the dwells (m,) s): moves of as many seconds as gaps say, then 2 s of
    standing.
    """
    places = np.random.default_rng(3).normal(size=(len(gaps), 2))
    t, values, middles, now, last = [0.0], [np.zeros(2)], [], 0.0, np.zeros(2)
    for gap, place in zip(gaps, places):
        for share in np.arange(1, gap * rate + 1) / (gap * rate):
            t.append(now + share * gap)
            values.append(last + share * (place - last))
        for k in range(1, int(2 * rate) + 1):
            t.append(now + gap + k / rate)
            values.append(place)
        now, last = now + gap + 2, place
        middles.append(now - 1)
    return np.array(t), np.array(values), np.array(middles)


@pytest.mark.parametrize("noise", [0.0, 1e-5])
def test_frames_are_brought_to_where_the_commands_stand(noise):
    rng = np.random.default_rng(1)
    t, values, at = log(rng.choice([1.0, 2.0, 3.0, 4.0], 30))
    found = clock_shift_putting_most_frames_into_dwells(
        at - 5000.0 + rng.uniform(-0.5, 0.5, 30), t, values + noise * rng.uniform(-0.5, 0.5, values.shape)
    )
    assert found is not None and found.frames == 30 and abs(found.shift - 5000.0) <= found.room < 1.0


def test_what_repeats_or_is_short_tells_nothing():
    t, values, at = log(np.full(30, 3.0))
    assert clock_shift_putting_most_frames_into_dwells(at - 5000.0, t, values) is None
    t, values, at = log(np.random.default_rng(1).choice([1.0, 2.0, 3.0, 4.0], 4))
    assert clock_shift_putting_most_frames_into_dwells(at - 5000.0, t, values) is None
    assert (
        clock_shift_putting_most_frames_into_dwells(np.arange(30.0), np.arange(100.0), np.arange(100.0)[:, None])
        is None
    )


STATED = (
    "poses.rotation=rotvec",
    "poses.rotation_unit=rad",
    "commands.unit=m",
    "commands.time_unit=s",
    "poses.time_unit=s",
    "poses.unit=m",
)


def timed(good, folder):
    """commands.csv, and poses.csv with the times of its frames, between which random times pass."""
    frames = dict(line.split(",")[:2] for line in (good / "frames.csv").read_text().splitlines()[1:])
    seen = np.array([float(t) for t in frames.values()])
    later = seen + np.cumsum(np.random.default_rng(2).uniform(0, 8, len(seen)))
    header, *rows = (good / "poses.csv").read_text().splitlines()
    at = dict(zip(frames, later))
    lines = [f"{row.split(',')[0]},{at[row.split(',')[0]]:.4f},{row.split(',', 1)[1]}" for row in rows]
    (folder / "poses.csv").write_text("\n".join([header.replace("frame", "frame,t"), *lines]) + "\n")
    header, *rows = (good / "commands.csv").read_text().splitlines()
    t = [float(row.split(",")[0]) for row in rows]
    when = np.interp(t, [0, *seen, seen[-1] + 100], [0, *later, later[-1] + 100])
    lines = [f"{moment:.4f},{row.split(',', 1)[1]}" for moment, row in zip(when, rows)]
    (folder / "commands.csv").write_text("\n".join([header, *lines]) + "\n")
    return {"commands": folder / "commands.csv", "poses": folder / "poses.csv"}


def test_another_clock_is_refused_with_a_setting_that_works(good, tmp_path):
    files = timed(good, tmp_path)
    header, *rows = files["commands"].read_text().splitlines()
    moved = [f"{float(row.split(',')[0]) + 812345.0:.4f},{row.split(',', 1)[1]}" for row in rows]
    files["commands"].write_text("\n".join([header, *moved]) + "\n")
    status, text = run_in_process(*words(good, files, None, *STATED), "--out", tmp_path / "rec")
    setting = re.search(r"--set (poses\.shift=(\S+)) is what puts (\d+) of 60 frames", text)
    assert status == 1 and setting and abs(float(setting[2]) - 812345) < 3 and int(setting[3]) > 55, text
    status, text = run_in_process(*words(good, files, None, *STATED, setting[1]), "--out", tmp_path / "rec")
    assert status == 0, text


def test_rows_that_a_log_has_twice_are_taken_once(good, tmp_path):
    files = timed(good, tmp_path)
    lines = files["commands"].read_text().splitlines()
    files["commands"].write_text("\n".join([*lines[:5], lines[4], *lines[5:]]) + "\n")
    status, text = run_in_process(*words(good, files, None, *STATED), "--out", tmp_path / "rec")
    assert (
        status == 0
        and "commands.csv: 1 rows occur twice, with their times, and are used once; the first is line 6" in text
    ), text
    assert len(recording_folder.load_recording(tmp_path / "rec").commands.t) == len(lines) - 1
    files["commands"].write_text("\n".join([*lines[:5], f"{lines[4]}1", *lines[5:]]) + "\n")
    status, text = run_in_process(*words(good, files, None, *STATED), "--out", tmp_path / "again")
    assert status == 1 and "commands.csv:6: two rows are of one time" in text, text


@pytest.mark.parametrize("ahead", [37.4, -37.4, 12.0])
def test_clocks_that_differ_though_they_overlap_are_told_by_what_stands_still(ahead):
    rng = np.random.default_rng(1)
    t, values, at = log(rng.choice([1.0, 2.0, 3.0, 4.0], 30))
    assert not list(clock_offset_mistakes_of_frames_in_motion(at, t, values))
    (found,) = clock_offset_mistakes_of_frames_in_motion(at + ahead, t, values)
    assert (
        found.spoils
        and f"clock is {abs(ahead):.4g} s {'ahead of' if ahead > 0 else 'behind'} the commands'" in found.what
    )
    assert f"images.shift={-ahead:.3f}" in found.do


def test_frames_taken_on_the_way_say_nothing_of_clocks():
    rng = np.random.default_rng(1)
    t, values, at = log(rng.choice([1.0, 2.0, 3.0, 4.0], 30))
    assert not list(clock_offset_mistakes_of_frames_in_motion(np.sort(rng.uniform(0, t[-1], 40)), t, values))


@pytest.mark.parametrize(
    "parts",
    ["sobol:40", "ladder:2", "moving:30", "zigzag:30", "sobol:20,moving:20", "dwell:20", "warmup:20", "repeat:20"],
)
def test_a_plan_as_it_was_exposed_is_accused_of_no_clock(design, parts):
    found = build_plan(design, parts, 3)
    assert not list(clock_offset_mistakes_of_frames_in_motion(found.t, found.commands.t, found.commands.values))
