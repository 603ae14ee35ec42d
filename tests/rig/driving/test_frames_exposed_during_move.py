"""Runs that expose during the moves: what commands.csv and frames.csv say, what is kept, stopped and resumed."""

import csv
import shutil
from dataclasses import replace

import numpy as np
import pytest

from rig.driving import move_and_record_loop
from rig.driving.axis_driver import Driver
from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import (
    ELSEWHERE,
    CameraError,
    SynchronisedCameras,
)
from rig.driving.controller_status_and_limits import PositionReport
from rig.driving.frames_exposed_during_move import FramesDuringMove, interpolated_reported_strut_lengths
from rig.driving.run_journal import (
    Arrival,
    Began,
    Departure,
    Ended,
    Exposed,
    PositionReports,
    PositionUnknown,
    Remark,
    Resumed,
    read_journal_rows_and_valid_length,
)
from rig.driving.run_steps_from_plan_and_progress_from_journal import (
    Step,
    interrupted_move_text_and_goal_reached,
    progress_from_journal,
)
from rig.errors import LinkLost, PositionLost, RigError, Stopped
from rig.recording import recording_folder
from tests.emulated_run import RigInThread

SPEED = 0.25  # m/s


@pytest.fixture
def made(tmp_path):
    rig = RigInThread(tmp_path)
    yield rig
    rig.close()


def rows(out):
    return read_journal_rows_and_valid_length(out / "journal.jsonl")[0]


def moving(rig, out, plan="sobol:1", **options):
    return rig.run(out, plan, **{"in_motion": SPEED, "interval": 0.03} | options)


def test_commands_are_where_the_struts_truly_were_at_the_exposures(made, tmp_path):
    out = tmp_path / "rec"
    count = moving(made, out, "sobol:3")  # of which a busy machine exposes enough
    recording = recording_folder.load_recording(out)
    frames, t, commanded = recording.commanded()
    assert count == len(frames) > 5
    began = rows(out)[0].wall
    t = t + began - ELSEWHERE  # commands.csv begins so much before the run
    true = made.emulator.lengths_at(t)
    speed = np.abs(made.emulator.lengths_at(t + 1e-3) - true).max(axis=1) / 1e-3
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
    grab, apart = SynchronisedCameras.grab, [0.0, 0.2, 0.0]

    def two(self):
        (frame,) = grab(self).values()
        late = replace(frame, t=frame.t + (apart.pop(0) if len(apart) > 1 else apart[0]))
        return {"cam0": frame, "cam1": late}

    monkeypatch.setattr(SynchronisedCameras, "grab", two)
    moving(made, tmp_path / "rec")
    remarks = [row.text for row in rows(tmp_path / "rec") if isinstance(row, Remark)]
    assert sum("discarded, as cameras exposed more than 0.1 s from cam0: cam1 +0.2" in text for text in remarks) == 1
    apart[:] = [-0.3]
    with pytest.raises(CameraError, match="4 frames in a row.* cannot expose in motion together"):
        moving(made, tmp_path / "apart")


def test_it_can_be_stopped_in_the_move(made, tmp_path):
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


def last_move(out):
    """(step, whether it was reached) of a run's last move."""
    (*_, arrival) = [row for row in rows(out) if isinstance(row, Arrival)]
    return arrival.step, arrival.reached


def moves_to(out, step):
    """Whether each move of a step reached its goal."""
    return [row.reached for row in rows(out) if isinstance(row, Arrival) and row.step == step]


def require_commands_as_moved(made, folder, out, count):
    """The commands of a folder's first `count` frames at least are where the struts truly were, within 2 mm."""
    frames, t, commanded = recording_folder.load_recording(folder).commanded()
    true = made.emulator.lengths_at(rows(out)[0].wall + t - ELSEWHERE)
    assert len(frames) >= count and np.abs(commanded - true).max() < 2e-3
    return frames, true


@pytest.mark.parametrize("moment", ["sensors", "departure"])
def test_a_stop_just_before_a_move_keeps_it_from_being_made(made, tmp_path, monkeypatch, moment):
    run, calls = move_and_record_loop.RunOperator, []
    look, write = run._look, run.write

    def look_and_stop(self):
        look(self)
        calls.append("sensors")
        if len(calls) == 3:  # before and after the first move, before the second
            self.watcher.ask_stop("button")

    def write_and_stop(self, row):
        write(self, row)
        if isinstance(row, Departure) and row.step == 1:
            self.watcher.ask_stop("button")

    monkeypatch.setattr(run, "_look", look_and_stop if moment == "sensors" else look)
    monkeypatch.setattr(run, "write", write_and_stop if moment == "departure" else write)
    with pytest.raises(Stopped, match="button"):
        moving(made, tmp_path / "rec", plan="sobol:2")
    assert len(made.emulator.machine.executed) == 1
    assert last_move(tmp_path / "rec") == ((0, True) if moment == "sensors" else (1, False))


def test_a_camera_that_fails_before_the_move_keeps_it_from_being_made(made, tmp_path, monkeypatch):
    enter, moves = FramesDuringMove.__enter__, []

    def fail(self):
        raise CameraError("cam0 is gone")

    def enter_and_fail(self):
        moves.append(self)
        if len(moves) < 2:
            return enter(self)
        with monkeypatch.context() as patched:
            patched.setattr(SynchronisedCameras, "grab", fail)
            enter(self)
            self._thread.join()
        return self

    monkeypatch.setattr(FramesDuringMove, "__enter__", enter_and_fail)
    with pytest.raises(CameraError, match="cam0 is gone"):
        moving(made, tmp_path / "rec", plan="sobol:2")
    assert len(made.emulator.machine.executed) == 1 and last_move(tmp_path / "rec") == (1, False)
    monkeypatch.setattr(FramesDuringMove, "__enter__", enter)
    moving(made, tmp_path / "rec", plan="sobol:2", resume=True)
    assert moves_to(tmp_path / "rec", 1) == [False, True]


def test_a_step_that_failed_with_the_struts_at_its_goal_is_made_again_from_its_start(made, tmp_path, monkeypatch):
    profile, moves = move_and_record_loop.move_profile_fitted_to_reports, []

    def fail(*arguments):
        moves.append(arguments)
        if len(moves) == 2:
            raise RigError("a failure of the frames")
        return profile(*arguments)

    monkeypatch.setattr(move_and_record_loop, "move_profile_fitted_to_reports", fail)
    with pytest.raises(RigError, match="a failure of the frames"):
        moving(made, tmp_path / "rec", plan="sobol:2")
    assert last_move(tmp_path / "rec") == (1, False)
    before = len([row for row in rows(tmp_path / "rec") if isinstance(row, Exposed)])
    moving(made, tmp_path / "rec", plan="sobol:2", resume=True)
    first, back, repeated = [row for row in rows(tmp_path / "rec") if isinstance(row, Departure) and row.step == 1]
    assert moves_to(tmp_path / "rec", 1) == [False, False, True]
    assert repeated.start == back.goal == first.start and repeated.goal == first.goal
    frames, true = require_commands_as_moved(made, tmp_path / "rec", tmp_path / "rec", before + 3)
    late = [row.frame for row in rows(tmp_path / "rec") if isinstance(row, Exposed) and row.step == 1]
    path = true[np.isin(frames, [frame for frame in late if frame >= before])]
    assert np.ptp(path, axis=0).max() > 0.3 * np.abs(np.array(repeated.goal) - repeated.start).max()


def test_a_way_back_that_was_broken_off_is_no_step_that_was_done():
    """Not even with the struts still at the goal of the step, where the way back begins."""
    steps = tuple(Step(np.full(6, length), 0, 0.02) for length in (0.45, 0.46))
    goal, start = (tuple(step.goal.tolist()) for step in reversed(steps))
    found = [
        Began(0.0, 0.0, 2, "", start),
        Departure(1.0, 0, start, start),
        Arrival(2.0, 0, start, True),
        Departure(3.0, 1, start, goal),
        Arrival(4.0, 1, goal, False),
        Departure(5.0, 1, goal, start),
    ]
    state = progress_from_journal(found, steps)
    for position in (goal, start):
        text, done = interrupted_move_text_and_goal_reached(state, steps, np.array(position), 1e-5)
        assert not done and text == "step 1 was on its way back to its start"


def test_a_move_in_motion_that_ended_while_nobody_looked_is_made_again():
    """A controller finishes the move of a killed process, whose exposures then are missing."""
    steps = tuple(Step(np.full(6, length), 0, 0.02) for length in (0.45, 0.46))
    goal, start = (tuple(step.goal.tolist()) for step in reversed(steps))
    found = [Began(0.0, 0.0, 2, "", start), Departure(1.0, 0, start, start), Arrival(2.0, 0, start, True)]
    state = progress_from_journal([*found, Departure(3.0, 1, start, goal)], steps)
    text, done = interrupted_move_text_and_goal_reached(state, steps, np.array(goal), 1e-5)
    assert not done and "is made again" in text
    standing = tuple(Step(step.goal, 0, None) for step in steps)
    assert interrupted_move_text_and_goal_reached(state, standing, np.array(goal), 1e-5)[1]


@pytest.mark.parametrize("kind", ["position lost", "stop fails"])
def test_frames_of_a_move_after_which_nothing_is_known_are_where_the_struts_were(made, tmp_path, monkeypatch, kind):
    watch, stop = Driver._watch, Driver.stop

    def lose(self, start, target, verdict, report):
        def report_and_lose(found):
            report(found)
            if np.abs(found.lengths - start).max() > 0.02:
                self._known = kind != "position lost"
                raise PositionLost("the controller has restarted")

        return watch(self, start, target, verdict, report_and_lose)

    def fail(self):
        stop(self)
        raise LinkLost("no answer to the stop")

    monkeypatch.setattr(Driver, "_watch", lose)
    if kind == "stop fails":
        monkeypatch.setattr(Driver, "stop", fail)
    with pytest.raises(PositionLost):
        moving(made, tmp_path / "rec")
    assert isinstance(rows(tmp_path / "rec")[-1], Ended)
    assert any(isinstance(row, PositionUnknown) for row in rows(tmp_path / "rec")) == (kind == "position lost")
    _, true = require_commands_as_moved(made, tmp_path / "rec", tmp_path / "rec", 2)
    assert np.ptp(true, axis=0).max() > 0.01


@pytest.mark.slow
def test_a_run_that_was_killed_in_a_move_has_the_frames_whose_commands_are_known(made, tmp_path, monkeypatch):
    write, exposed, killed_in = move_and_record_loop.RunOperator.write, [], []

    def write_and_copy(self, row):
        write(self, row)
        if isinstance(row, Exposed):
            exposed.append(row.step)
            if row.step >= 2 and exposed.count(row.step) == 2 and not killed_in:
                killed_in.append(row.step)
                shutil.copytree(tmp_path / "rec", tmp_path / "killed")  # what is on disk if it is killed now

    monkeypatch.setattr(move_and_record_loop.RunOperator, "write", write_and_copy)
    # on a busy machine too, one of so many moves is long enough for two exposures
    moving(made, tmp_path / "rec", plan="sobol:6")
    frames, _ = require_commands_as_moved(made, tmp_path / "killed", tmp_path / "rec", 2)
    assert len(frames) == sum(step < killed_in[0] for step in exposed)
    assert len(recording_folder.load_recording(tmp_path / "rec").commanded()[0]) == len(exposed)


@pytest.mark.parametrize("behind", [0.2, 4.9])
def test_a_camera_whose_clock_is_behind_makes_a_recording_that_loads(made, tmp_path, monkeypatch, behind):
    grab = SynchronisedCameras.grab
    monkeypatch.setattr(
        SynchronisedCameras, "grab", lambda self: {k: replace(f, t=f.t - behind) for k, f in grab(self).items()}
    )
    count = moving(made, tmp_path / "rec")
    recording = recording_folder.load_recording(tmp_path / "rec")
    assert len(recording.commanded()[0]) == count > 3
    assert np.ptp(recording.commands.values[:2], axis=0).max() == 0, "before the run the struts stood"


def test_lengths_are_read_off_reports_that_another_thread_adds_to():
    class Growing(list):
        def __iter__(self):
            yield from super().__iter__()
            self.append(self[-1])

    t = np.arange(20) * 0.01 + np.sin(np.arange(20)) * 0.002
    lengths = np.cumsum(np.ones((20, 6)) * [1, 2, 3, 4, 5, 6], axis=0) ** 1.2
    reports = Growing(PositionReport(a - 1e-3, a + 1e-3, row) for a, row in zip(t, lengths))
    for at in (-1.0, t[0], 0.031, t[7], 0.1234, t[-1], 1.0):
        wanted = [np.interp(at, t, column) for column in lengths.T]
        np.testing.assert_allclose(interpolated_reported_strut_lengths(reports, at, np.zeros(6)), wanted, rtol=1e-12)
    assert (interpolated_reported_strut_lengths([], 0.0, np.full(6, 0.5)) == 0.5).all()


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
