"""Runs begun or resumed at an emulated controller: what they home out of, what they believe, what stays as it was."""

import re
from datetime import datetime

import numpy as np
import pytest

from rig.driving.run_journal import CameraExposures, Ended, Exposed, PositionUnknown, read_journal_rows_and_valid_length
from rig.errors import ControllerFault, MotionError, PositionLost, RigError, Stopped
from rig.formats.rig_toml import design_from_rig_toml
from rig.recording import recording_folder
from tests.cli import run
from tests.emulated_run import RigInThread

NO_SWITCHES = "homing = false\nzero = 0.4\n"


@pytest.fixture
def made(tmp_path, request):
    rig = RigInThread(tmp_path, getattr(request, "param", ""))
    yield rig
    rig.close()


def rows(out):
    return read_journal_rows_and_valid_length(out / "journal.jsonl")[0]


def interrupted(rig, out, **options):
    """A run that ends after its first frame, as somebody asked for it."""
    from rig.driving import move_and_record_loop

    expose = move_and_record_loop.RunOperator._expose

    def stop(self, index, number, reading):
        expose(self, index, number, reading)
        raise Stopped("enough")

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(move_and_record_loop.RunOperator, "_expose", stop)
        with pytest.raises(Stopped):
            rig.run(out, **options)


def test_a_run_homes_out_of_the_alarm_that_only_wants_homing_and_out_of_no_other(made, tmp_path):
    made.emulator.settings[22] = 5
    made.emulator.power_cycle()
    assert made.run(tmp_path / "one") == 2
    made.emulator.alarm = 1  # a limit switch
    with pytest.raises(ControllerFault, match="alarm 1 .a limit switch was hit.*by itself.*rig home"):
        made.run(tmp_path / "two")
    moved = len(made.emulator.machine.executed)
    interrupted_folder = tmp_path / "three"
    made.emulator.alarm = 0
    interrupted(made, interrupted_folder)
    made.emulator.alarm = 1
    made.emulator.machine.homed = False
    with pytest.raises(ControllerFault, match="by itself"):
        made.run(interrupted_folder, resume=True)
    assert made.emulator.alarm == 1 and len(made.emulator.machine.executed) > moved
    assert not made.emulator.machine.homed


@pytest.mark.parametrize("made", [NO_SWITCHES], indirect=True)
def test_a_position_lost_in_a_run_is_lost_to_the_next_until_the_operator_says_otherwise(made, tmp_path):
    out, machine = tmp_path / "rec", made.emulator.machine
    go, count = machine.go, 0

    def cut(t, target, duration):
        nonlocal count
        go(t, target, duration)
        count += 1
        if count == 2:
            machine._known = False  # its counters are not absolute
            made.emulator.later(t + 1e-3, made.emulator.power_cycle)

    machine.go = cut
    with pytest.raises(MotionError):
        made.run(out)
    machine.go = go
    assert isinstance(rows(out)[-2], PositionUnknown) and isinstance(rows(out)[-1], Ended)
    moved = len(machine.executed)
    for _ in range(2):
        with pytest.raises(PositionLost, match="ended with the position lost.*--no-home"):
            made.run(out, resume=True)
    assert len(machine.executed) == moved
    machine._off = -machine.zero  # somebody has set it right
    assert made.run(out, resume=True, trust_position=True) == 2


@pytest.mark.parametrize("made", [NO_SWITCHES], indirect=True)
def test_a_power_cut_between_two_processes_is_noticed(made, tmp_path):
    out = tmp_path / "rec"
    interrupted(made, out)
    moved = len(made.emulator.machine.executed)
    made.emulator.power_cycle()  # its counters are true all the same, and nobody can know
    for _ in range(2):
        with pytest.raises(PositionLost, match="started anew since.*--no-home"):
            made.run(out, resume=True)
    assert len(made.emulator.machine.executed) == moved
    assert made.run(out, resume=True, trust_position=True) == 2


@pytest.mark.parametrize("made", [NO_SWITCHES], indirect=True)
def test_struts_that_read_elsewhere_where_nothing_can_home_take_consent(made, tmp_path):
    out = tmp_path / "rec"
    interrupted(made, out)
    made.emulator.machine._off = made.emulator.machine._off + 1e-4
    with pytest.raises(PositionLost, match=r"0\.100 mm from where the run left them.*lost its zeros"):
        made.run(out, resume=True)


def test_a_finished_run_that_is_resumed_says_so_and_moves_nothing(made, tmp_path):
    out, notices = tmp_path / "rec", []
    made.run(out)
    before, moved = rows(out), len(made.emulator.machine.executed)
    made.emulator.machine.homed = False
    assert made.run(out, notices=notices, resume=True) == 2
    assert "is finished" in notices[-1] and rows(out) == before
    assert len(made.emulator.machine.executed) == moved and not made.emulator.machine.homed


def test_a_resumed_run_keeps_its_exposures(made, tmp_path, monkeypatch):
    from calib.online import run_options_cameras_sensors_and_observer

    chosen = iter([0.0123, 0.0086])
    monkeypatch.setattr(
        run_options_cameras_sensors_and_observer,
        "set_marker_exposure_and_measure_white",
        lambda source, level, start: (source.set_exposure(next(chosen)), 200.0),
    )
    out, notices = tmp_path / "rec", []
    interrupted(made, out, exposure=None)
    made.run(out, notices=notices, exposure=None, resume=True)
    assert any("exposure 12.3 ms, as before" in line for line in notices)
    assert [row.seconds for row in rows(out) if isinstance(row, CameraExposures)] == [(0.0123,)]
    assert sum(isinstance(row, Exposed) for row in rows(out)) == 2
    np.testing.assert_equal(next(chosen), 0.0086)


@pytest.mark.parametrize("stated", [True, False], ids=["in rig.toml", "asked for"])
def test_a_run_without_cameras_leaves_visits_that_an_instruments_poses_are_joined_to(made, tmp_path, stated):
    if stated:
        made.path.write_text(re.sub(r"\n\[\[camera\]\]\n.*?(?=\n\[)", "\n", made.path.read_text(), flags=re.DOTALL))
        made.design = design_from_rig_toml.load_design(made.path)
        assert not made.design.cameras
    out = tmp_path / "rec"
    options = {"exposure": None, "measure": True, "cameras": stated}
    interrupted(made, out, **options)
    assert made.run(out, resume=True, **options) == 2
    visits = np.genfromtxt(out / "visits.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert visits["frame"].tolist() == [0, 1] and (visits["from"] <= visits["until"]).all()
    frames = [row for row in rows(out) if isinstance(row, Exposed)]
    began = rows(out)[0]
    for visit, row in zip(visits, frames):
        when = datetime.fromisoformat(str(visit["utc_until"])).timestamp()
        assert when == pytest.approx(began.wall + row.t, abs=2e-3)
        np.testing.assert_allclose([visit[f"l{i}_read"] for i in range(1, 7)], row.position, atol=1e-9)
    poses = "".join(f"{k},0.0,0.0,0.44,0.0,0.0,0.0\n" for k in visits["frame"])
    (out / "poses.csv").write_text("frame,x,y,z,rx,ry,rz\n" + poses)
    text = 'base = "free"\ntool = "free"\nposition_sigma = 2e-5\nrotation_sigma = 1e-4\n'
    (out / "rig.toml").write_text((out / "rig.toml").read_text() + "\n[instrument]\n" + text)
    found = recording_folder.load_recording(out)
    assert found.poses.frame.tolist() == [0, 1]
    np.testing.assert_allclose(
        found.commanded()[2], [[visit[f"l{i}"] for i in range(1, 7)] for visit in visits], atol=1e-8
    )


def test_what_takes_cameras_is_refused_without_them(made, tmp_path):
    with pytest.raises(RigError, match="in place of cameras: add --no-cameras"):
        made.run(tmp_path / "rec", settle="ask")
    with pytest.raises(RigError, match="without cameras there is neither --settle images"):
        made.run(tmp_path / "rec", cameras=False, settle="images")


def test_the_alarm_that_only_homing_ends_is_ended_by_homing_with_unlocking_too(made):
    made.emulator.settings[22] = 5
    made.emulator.power_cycle()
    assert "alarm 11 (homing is required)); rig home ends that" in run("status", made.path).stdout
    assert run("home", made.path, "--unlock").stdout.splitlines()[1] == "idle"
