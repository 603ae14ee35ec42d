"""A recording folder: what is read, and every way to spoil it, each with a complaint that names its place."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from rig.errors import FileError, RigError
from rig.formats import csv_and_parquet_tables_and_time_origin
from rig.model.pose import pose, pose_difference
from rig.recording import corner_and_pose_csv_tables
from rig.recording import recording_folder as recording
from rig.recording.frame_selection_and_content_hashes import remove_frames
from tests.conftest import BENCH, SHARED


def edit(path, change):
    lines = path.read_text().splitlines()
    path.write_text("\n".join(change(lines)) + "\n")


def replaced(line, column, value):
    def change(lines):
        cells = lines[line - 1].split(",")
        cells[column - 1] = value
        lines[line - 1] = ",".join(cells)
        return lines

    return change


def swapped(a, b):
    def change(lines):
        lines[a - 1], lines[b - 1] = lines[b - 1], lines[a - 1]
        return lines

    return change


def later(lines):
    return lines[:1] + [f"{float(line.split(',')[0]) + 500},{line.split(',', 1)[1]}" for line in lines[1:]]


def without_column(name):
    def change(lines):
        at = lines[0].split(",").index(name)
        return [",".join(cell for i, cell in enumerate(line.split(",")) if i != at) for line in lines]

    return change


def test_a_sound_recording_is_read(recording_folder):
    found = recording.load_recording(recording_folder)
    frames, t, commanded = found.commanded()
    assert frames.tolist() == list(range(6)) and commanded.shape == (6, 6) and (np.diff(t) > 0).all()
    assert found.corners.uv.shape[1] == 2 and found.poses is None and not found.has_images


def test_a_last_row_that_does_not_end_is_said_to_be_cut_off(tmp_path):
    path = tmp_path / "table.csv"
    for text, says in (
        ("a,b\n1,2\n3", "1 cells in a table of 2 columns (cut off?)"),
        ("a,b\n1\n3,4\n", "1 cells in a table of 2 columns"),
    ):
        path.write_text(text)
        with pytest.raises(FileError) as refused:
            csv_and_parquet_tables_and_time_origin.read_csv_table(path, ("a", "b"))
        assert str(refused.value).endswith(says)


@pytest.mark.parametrize(
    "file, change, line, column, says",
    [
        ("commands.csv", swapped(4, 5), 5, 1, "time must increase"),
        ("commands.csv", replaced(3, 4, "nan"), 3, 4, "'l3' is not finite"),
        ("commands.csv", replaced(3, 4, "x"), 3, 4, "'l3' is not a number"),
        ("commands.csv", replaced(3, 4, ""), 3, 4, "'l3' is empty"),
        ("commands.csv", without_column("l4"), 1, None, "'l4' is missing"),
        ("commands.csv", lambda lines: [lines[0] + ",l7"] + [line + ",1" for line in lines[1:]], 1, 8, "only 6 axes"),
        ("commands.csv", lambda lines: lines[:5], 5, 1, "cut off"),
        ("commands.csv", lambda lines: lines[:1], 1, None, "no rows"),
        ("commands.csv", lambda lines: [], 1, None, "is empty"),
        (
            "commands.csv",
            lambda lines: lines[:-1] + [lines[-1][: len(lines[-1]) // 2]],
            None,
            None,
            "cells in a table of 7",
        ),
        ("commands.csv", later, 2, 1, "before the first"),
        ("frames.csv", swapped(2, 8), 3, 1, "in order"),
        ("frames.csv", replaced(5, 2, "0.1"), 5, 2, "backwards"),
        ("frames.csv", replaced(3, 2, "99"), 3, 2, "simultaneous"),
        ("frames.csv", replaced(3, 3, "cam9"), 3, 3, "unknown camera 'cam9'"),
        ("frames.csv", replaced(3, 3, "cam0"), 3, 1, "listed twice, first in line 2"),
        ("frames.csv", replaced(3, 1, "-1"), 3, 1, "whole number"),
        ("frames.csv", replaced(3, 4, "images/none.png"), None, None, "no such image"),
        ("corners.csv", replaced(7, 3, "99"), 7, 3, "unknown marker 99"),
        ("corners.csv", replaced(7, 4, "4"), 7, 4, "corners 0..3"),
        ("corners.csv", replaced(7, 2, "cam7"), 7, 2, "unknown camera 'cam7'"),
        ("corners.csv", replaced(7, 1, "77"), 7, 1, "not in frames.csv"),
        ("corners.csv", replaced(7, 5, "inf"), 7, 5, "not finite"),
        ("corners.csv", lambda lines: lines[:9] + [lines[8]] + lines[9:], 10, 3, "listed twice.*first in line 9"),
        (
            "corners.csv",
            lambda lines: [lines[0] + ",sigma"] + [line + ",0" for line in lines[1:]],
            2,
            7,
            "sigma must be positive",
        ),
        (
            "corners.csv",
            lambda lines: [lines[0] + ",sigam"] + [line + ",1" for line in lines[1:]],
            1,
            7,
            "'sigma' meant",
        ),
        ("corners.csv", lambda lines: [lines[0].replace("v", "u")] + lines[1:], 1, 6, "given twice"),
    ],
)
def test_every_spoiled_file_names_its_place(recording_folder, file, change, line, column, says):
    edit(recording_folder / file, change)
    with pytest.raises(FileError, match=says) as caught:
        recording.load_recording(recording_folder)
    if line:
        assert caught.value.path == str(recording_folder / file)
        assert (caught.value.line, caught.value.column) == (line, column)


@pytest.mark.parametrize("file", ["rig.toml", "frames.csv"])
def test_what_every_recording_has_is_asked_for(recording_folder, file):
    (recording_folder / file).unlink()
    with pytest.raises(FileError, match="no such file"):
        recording.load_recording(recording_folder)


def test_folders_that_are_none(tmp_path, recording_folder):
    (tmp_path / "new").mkdir()
    with pytest.raises(FileError, match="empty folder"):
        recording.load_recording(tmp_path / "new")
    with pytest.raises(FileError, match="no such folder"):
        recording.load_recording(tmp_path / "typo")
    with pytest.raises(FileError, match="is a file"):
        recording.load_recording(recording_folder / "rig.toml")


@pytest.fixture
def images(tmp_path):
    shutil.copytree(BENCH / "check", tmp_path / "rec")
    return tmp_path / "rec"


def test_an_image_cut_in_half_is_found_before_any_is_read(images):
    name = images / "images/cam1/00002.png"
    name.write_bytes(name.read_bytes()[: name.stat().st_size // 2])
    with pytest.raises(FileError, match=r"00002.png: is cut off after \d+ bytes.*frames.csv, line 9"):
        recording.load_recording(images)


def test_an_image_of_another_size_is_refused(images):
    edit(images / "rig.toml", lambda lines: [line.replace("width = 480", "width = 640") for line in lines])
    with pytest.raises(FileError, match="is 480 x 384 px, but camera 'cam0' has 640 x 384"):
        recording.load_recording(images)


def test_an_empty_image_is_refused(images):
    (images / "images/cam0/00000.png").write_bytes(b"")
    with pytest.raises(FileError, match="is an empty file"):
        recording.load_recording(images)


def test_commands_are_linear_between_rows_and_dwell_after_the_last():
    commands = recording.Commands(np.array([0.0, 1.0, 2.0]), np.array([[0.0], [1.0], [1.0]]))
    np.testing.assert_allclose(commands.at([0.25, 1.5, 7.0])[:, 0], [0.25, 1, 1])
    with pytest.raises(RigError, match="before the first"):
        commands.at(-0.1)


def test_frames_that_are_masked_are_in_no_poses():
    poses = corner_and_pose_csv_tables.Poses(
        np.arange(4), pose(np.zeros((4, 3)), np.zeros((4, 3))), np.tile(np.eye(6), (4, 1, 1))
    )
    whole = replace(recording.load_recording(BENCH / "check"), poses=poses, stages={1: poses})
    left = remove_frames(whole, "1-2")
    for own in (left.poses, left.stages[1]):
        assert own.frame.tolist() == [0, 3] and len(own.T_base_platform) == len(own.covariance) == 2
    assert not np.isin(left.exposures.frame, (1, 2)).any()


def test_poses_survive_writing(tmp_path):
    rng = np.random.default_rng(0)
    A = rng.normal(size=(4, 6, 6)) * 1e-5
    from rig.model.pose import exp

    poses = recording.Poses(
        np.array([0, 2, 3, 9]), exp(rng.normal(size=(4, 6)) * 0.2), A @ np.swapaxes(A, 1, 2) + 1e-12 * np.eye(6)
    )
    corner_and_pose_csv_tables.write_poses(tmp_path / "poses.csv", poses)
    loaded = corner_and_pose_csv_tables.load_poses(tmp_path / "poses.csv", {0, 2, 3, 9})
    assert loaded.frame.tolist() == [0, 2, 3, 9]
    assert np.abs(pose_difference(loaded.T_base_platform, poses.T_base_platform)).max() < 2e-10
    np.testing.assert_allclose(loaded.covariance, poses.covariance, rtol=1e-6)


@pytest.mark.parametrize(
    "rows, says",
    [
        ("frame,x,y,z,rx,ry\n0,0,0,0,0,0", "'rz' is missing"),
        ("frame,x,y,z,rx,ry,rz\n0,0,0,450,0,0,0", "in metres"),
        ("frame,x,y,z,rx,ry,rz\n0,0,0,0,0,0,0\n0,0,0,0,0,0,0", "listed twice, first in line 2"),
        ("frame,x,y,z,rx,ry,rz,c00\n0,0,0,0,0,0,0,1", "'c01' is missing"),
        ("frame,x,y,z,rx,ry,rz\n0.5,0,0,0,0,0,0", "whole number"),
    ],
)
def test_poses_that_are_none(tmp_path, rows, says):
    (tmp_path / "poses.csv").write_text(rows + "\n")
    with pytest.raises(FileError, match=says):
        corner_and_pose_csv_tables.load_poses(tmp_path / "poses.csv")


def test_a_covariance_must_be_one(tmp_path):
    header = ",".join(
        ["frame", *corner_and_pose_csv_tables.POSE_COLUMNS, *corner_and_pose_csv_tables.COVARIANCE_COLUMNS]
    )
    (tmp_path / "poses.csv").write_text(header + "\n0" + ",0" * 6 + ",-1" + ",0" * 20 + "\n")
    with pytest.raises(FileError, match="not positive definite"):
        corner_and_pose_csv_tables.load_poses(tmp_path / "poses.csv")


def test_corners_survive_writing(recording_folder):
    found = recording.load_recording(recording_folder).corners
    n = len(found.frame)
    covariance = np.tile(np.array([[4e-4, 1e-4], [1e-4, 9e-4]]), (n, 1, 1))
    loaded = recording.Corners(found.frame, found.camera, found.marker, found.corner, found.uv, covariance)
    corner_and_pose_csv_tables.write_corners(recording_folder / "corners.csv", loaded)
    loaded = recording.load_recording(recording_folder).corners
    np.testing.assert_allclose(loaded.uv, found.uv, atol=1e-5)
    np.testing.assert_allclose(loaded.covariance, covariance, rtol=1e-3)


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the shared recordings beside the project")
@pytest.mark.parametrize("folder", sorted(SHARED.glob("recordings/*")), ids=lambda p: p.name)
def test_every_shared_recording_is_read(folder):
    found = recording.load_recording(folder)
    assert len(found.exposures.frame)
