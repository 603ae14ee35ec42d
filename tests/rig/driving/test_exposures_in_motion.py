"""Runs that expose during the moves: what commands.csv and frames.csv say, what is kept, stopped and resumed."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from rig.driving.run_journal import Departure, Ended, Exposed, PositionReports, Remark, Resumed, read_journal
from rig.errors import RigError, Stopped
from rig.recording import recording_folder
from tests.emulated_run import RigInThread

SPEED = 0.25  # m/s


@pytest.fixture
def made(tmp_path):
    rig = RigInThread(tmp_path)
    yield rig
    rig.close()


def rows(out):
    return read_journal(out / "journal.jsonl")[0]


def moving(rig, out, **options):
    return rig.run(out, "sobol:1", **{"in_motion": SPEED, "interval": 0.03} | options)


def test_commands_are_where_the_struts_truly_were_at_the_exposures(made, tmp_path):
    out = tmp_path / "rec"
    count = moving(made, out)
    recording = recording_folder.load_recording(out)
    frames, t, commanded = recording.commanded()
    assert count == len(frames) > 5
    began = rows(out)[0].wall
    true = made.emulator.lengths_at(began + t)
    speed = np.abs(made.emulator.lengths_at(began + t + 1e-3) - true).max(axis=1) / 1e-3
    assert (speed > 0.9 * SPEED).sum() > 3
    assert np.median(np.abs(commanded - true).max(axis=1)) < 1e-3 * SPEED  # a millisecond at that speed
    with open(out / "position_reports.csv", encoding="utf-8") as file:
        reports = list(csv.DictReader(file))
    assert set(reports[0]) == {"t", "width", *(f"l{i}" for i in range(1, 7))}
    assert all(np.diff([float(row["t"]) for row in reports]) > 0)
    exposed = [row for row in rows(out) if isinstance(row, Exposed)]
    assert all(row.times == (row.t,) and not row.position for row in exposed)


def test_a_frame_is_written_after_a_report_that_follows_it(made, tmp_path):
    moving(made, tmp_path / "rec")
    reported, arrived = -np.inf, True
    for row in rows(tmp_path / "rec"):
        if isinstance(row, PositionReports):
            reported = row.times[-1]
        if isinstance(row, Departure):
            arrived = False
        if isinstance(row, Exposed) and not arrived:
            assert max(row.times) <= reported + 0.05


def test_a_camera_that_fails_stops_the_struts_in_the_move(made, tmp_path, monkeypatch):
    from rig.driving.cameras.camera_interface_and_synchronised_grabbing import CameraError, SynchronisedCameras

    grab, count = SynchronisedCameras.grab, 0

    def fail(self):
        nonlocal count
        count += 1
        if count == 4:
            raise CameraError("cam0 is gone")
        return grab(self)

    monkeypatch.setattr(SynchronisedCameras, "grab", fail)
    with pytest.raises(CameraError, match="cam0 is gone"):
        moving(made, tmp_path / "rec")
    last = rows(tmp_path / "rec")[-1]
    assert isinstance(last, Ended) and "cam0 is gone" in last.reason
    assert not made.emulator.busy
    recording_folder.load_recording(tmp_path / "rec")
    monkeypatch.setattr(SynchronisedCameras, "grab", grab)
    moving(made, tmp_path / "rec", resume=True)
    found = [row for row in rows(tmp_path / "rec") if isinstance(row, Resumed)]
    assert found and rows(tmp_path / "rec")[-1].reason == ""
    exposed = [row.frame for row in rows(tmp_path / "rec") if isinstance(row, Exposed)]
    assert exposed == list(range(len(exposed))), "frames go on in number"
    recording_folder.load_recording(tmp_path / "rec")


def test_cameras_that_expose_too_far_apart_make_no_frame(made, tmp_path, monkeypatch):
    from rig.driving.cameras.camera_interface_and_synchronised_grabbing import CameraError, SynchronisedCameras

    grab, apart = SynchronisedCameras.grab, [0.0, 0.2, 0.0]

    def two(self):
        (frame,) = grab(self).values()
        late = replace(frame, t=frame.t + (apart.pop(0) if len(apart) > 1 else apart[0]))
        return {"cam0": frame, "cam1": late}

    monkeypatch.setattr(SynchronisedCameras, "grab", two)
    moving(made, tmp_path / "rec")
    remarks = [row.text for row in rows(tmp_path / "rec") if isinstance(row, Remark)]
    assert sum("not kept, as cameras exposed more than 0.1 s from cam0: cam1 +0.200 s" in text for text in remarks) == 1
    apart[:] = [-0.3]
    with pytest.raises(CameraError, match="4 frames in a row.* cannot expose in motion together"):
        moving(made, tmp_path / "apart")


def test_it_can_be_stopped_in_the_move(made, tmp_path):
    from rig.driving import move_and_record_loop

    write = move_and_record_loop.RunOperator.write
    stopped = []

    def stop(self, row):
        write(self, row)
        if isinstance(row, Exposed) and not stopped:
            stopped.append(row)
            self.watcher.ask_stop("seen enough")

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(move_and_record_loop.RunOperator, "write", stop)
        with pytest.raises(Stopped):
            moving(made, tmp_path / "rec")
    assert not made.emulator.busy and isinstance(rows(tmp_path / "rec")[-1], Ended)
    moving(made, tmp_path / "rec", resume=True)
    assert rows(tmp_path / "rec")[-1].reason == ""


def test_another_speed_is_another_plan(made, tmp_path):
    moving(made, tmp_path / "rec")
    with pytest.raises(RigError, match="another plan .* in motion at 50 mm/s"):
        moving(made, tmp_path / "rec", in_motion=0.05, resume=True)
    with pytest.raises(RigError, match="another plan"):
        made.run(tmp_path / "rec", "sobol:1", resume=True)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"in_motion": 6.0}, "at most 5000 mm/s"),
        ({"in_motion": 0.0}, "--in-motion 0 mm/s"),
        ({"cameras": False}, "this run has none"),
        ({"stop_on": frozenset({"jump"})}, "clocks of cameras and controller"),
        ({"interval": -1.0}, "--interval takes seconds"),
    ],
)
def test_what_cannot_be_meant_is_refused_before_anything_moves(made, tmp_path, options, why):
    with pytest.raises(RigError, match=why):
        moving(made, tmp_path / "rec", **options)
    assert not made.emulator.machine.executed and not (tmp_path / "rec").exists()
