"""What goes to Rerun: cameras, cubes, poses, corners, images and curves where they are; told by what a stand-in for its
library is given.
"""

import builtins
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from rig.formats.exporters import recording_as_rerun_tum_parquet
from rig.model.mechanisms import hexapod
from rig.recording import recording_folder
from rig.recording.corner_and_pose_csv_tables import write_poses
from rig.recording.recording_folder import Poses
from tests.calib.checks.good import recorded
from tests.calib.checks.test_mistakes import run_in_process


class Stream:
    """What a RecordingStream is given: (place, what, times) in order."""

    def __init__(self, name):
        self.logged, self.times, self.columns = [], {}, []

    def save(self, path):
        self.path = path

    def set_time(self, timeline, **value):
        self.times[timeline] = next(iter(value.values()))

    def log(self, place, what, static=False):
        self.logged.append((place, what, {} if static else dict(self.times)))

    def send_columns(self, place, indexes, columns):
        self.columns.append((place, indexes, columns))

    def flush(self):
        """All is there."""

    disconnect = flush


def archetype(kind):
    return lambda *given, **named: SimpleNamespace(kind=kind, given=given, **named)


@pytest.fixture
def stand_in():
    streams = []
    names = ("Transform3D", "Pinhole", "Boxes3D", "EncodedImage", "Points2D", "LineStrips3D", "TimeColumn")
    return streams, SimpleNamespace(
        RecordingStream=lambda name: streams.append(Stream(name)) or streams[-1],
        ViewCoordinates=SimpleNamespace(RIGHT_HAND_Z_UP="up", RDF="right, down, ahead"),
        Scalars=SimpleNamespace(columns=lambda scalars: scalars),
        **{name: archetype(name) for name in names},
    )


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """A recording with corners, poses, commands and one image."""
    folder = tmp_path_factory.mktemp("seen") / "rec"
    _, done = recorded(folder)
    write_poses(folder / "poses.csv", Poses(np.arange(len(done.plan.t)), done.run.T_base_platform, None))
    rows = (folder / "frames.csv").read_text().splitlines()
    (folder / "images").mkdir()
    cv2.imwrite(str(folder / "images" / "a.png"), np.zeros((1024, 1280), np.uint8))
    rows[1] = rows[1].rstrip(",") + ",images/a.png"
    (folder / "frames.csv").write_text("\n".join(rows) + "\n")
    return folder


def test_all_that_a_recording_holds_is_where_it_is(seen, stand_in, tmp_path):
    streams, rr = stand_in
    loaded = recording_folder.load_recording(seen)
    loaded = replace(loaded, stages={1: loaded.poses})
    assert recording_as_rerun_tum_parquet.write_rerun_file(loaded, tmp_path / "x.rrd", rr) == 0
    logged = streams[0].logged
    for camera in loaded.design.cameras:
        T, lens = (
            next(what for place, what, _ in logged if place == f"base/{camera.name}{end}") for end in ("", "/image")
        )
        np.testing.assert_array_equal(T.mat3x3, camera.pose.rotation.as_matrix())
        np.testing.assert_array_equal(lens.image_from_camera[:2, 2], camera.matrix[:2, 2] + 0.5)
    moved = [(what, times) for place, what, times in logged if place == "base/platform"]
    t = dict(zip(*(values.tolist() for values in loaded.exposures.times())))
    assert len(moved) == len(loaded.poses.frame) == 60
    for k, (what, times) in enumerate(moved):
        np.testing.assert_array_equal(what.translation, loaded.poses.T_base_platform[k].translation)
        assert times == {"t": t[int(loaded.poses.frame[k])], "frame": int(loaded.poses.frame[k])}
    stage = [(what.translation.tolist(), times) for place, what, times in logged if place == "base/stage_1"]
    assert sorted(stage, key=str) == sorted(((what.translation.tolist(), times) for what, times in moved), key=str)
    struts = [what.given[0] for place, what, _ in logged if place == "base/struts"]
    lengths = np.linalg.norm(np.diff(struts[7], axis=1)[:, 0], axis=1) - loaded.design.mechanism.strut_zeros
    np.testing.assert_allclose(
        lengths, hexapod.inverse(loaded.poses.T_base_platform[7], loaded.design.mechanism), atol=1e-12
    )
    corners = [(place, what.given[0], times) for place, what, times in logged if place.endswith("/corners")]
    assert sum(len(uv) for _, uv, _ in corners) == len(loaded.corners.uv)
    place, uv, times = corners[5]
    own = (loaded.corners.frame == times["frame"]) & (np.array(loaded.corners.camera) == place.split("/")[1])
    np.testing.assert_array_equal(uv - 0.5, loaded.corners.uv[own])
    assert [what.media_type for _, what, _ in logged if getattr(what, "kind", "") == "EncodedImage"] == ["image/png"]
    assert [place for place, *_ in streams[0].columns][:6] == [f"commands/l{i}" for i in range(1, 7)]


def test_a_missing_library_says_what_installs_it(seen, tmp_path, monkeypatch):
    whole = builtins.__import__
    monkeypatch.setattr(
        builtins,
        "__import__",
        lambda name, *rest, **more: (
            (_ for _ in ()).throw(ImportError(name)) if name == "rerun" else whole(name, *rest, **more)
        ),
    )
    status, text = run_in_process("view", seen, "--rerun", tmp_path / "x.rrd")
    assert status == 1 and "pip install 'rig[rerun]'" in text and not (tmp_path / "x.rrd").exists()


@pytest.mark.slow
def test_rerun_itself_reads_what_is_written(seen, tmp_path):
    pytest.importorskip("rerun")
    status, text = run_in_process("view", seen, "--rerun", tmp_path / "x.rrd")
    assert status == 0 and "60 frames" in text, text
    done = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(tmp_path / "x.rrd")], capture_output=True, text=True
    )
    assert done.returncode == 0 and "verified without error" in done.stdout + done.stderr
