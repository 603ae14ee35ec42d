"""Runs begun or resumed at an emulated controller: what they home out of, what they believe, what stays as it was."""

import numpy as np
import pytest

from rig.driving.run_journal_and_recording import CameraExposures, Ended, Exposed, PositionUnknown, read_journal
from rig.errors import ControllerFault, MotionError, PositionLost, Stopped
from tests.emulated_run import RigInThread

NO_SWITCHES = "homing = false\nzero = 0.4\n"


@pytest.fixture
def made(tmp_path, request):
    rig = RigInThread(tmp_path, getattr(request, "param", ""))
    yield rig
    rig.close()


def rows(out):
    return read_journal(out / "journal.jsonl")[0]


def interrupted(rig, out, **options):
    """A run that ends after its first frame, as somebody asked for it."""
    from rig.driving import move_and_record_loop

    expose = move_and_record_loop.RunOperator._expose

    def stop(self, index, number):
        expose(self, index, number)
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
    with pytest.raises(ControllerFault, match="alarm 1 .a limit switch was hit.*unasked.*rig home"):
        made.run(tmp_path / "two")
    moved = len(made.emulator.machine.executed)
    interrupted_folder = tmp_path / "three"
    made.emulator.alarm = 0
    interrupted(made, interrupted_folder)
    made.emulator.alarm = 1
    made.emulator.machine.homed = False
    with pytest.raises(ControllerFault, match="unasked"):
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
    from calib.online import run_options_and_equipment

    chosen = iter([0.0123, 0.0086])
    monkeypatch.setattr(
        run_options_and_equipment,
        "set_exposure_for_markers",
        lambda source, level, start: (source.set_exposure(next(chosen)), 200.0),
    )
    out, notices = tmp_path / "rec", []
    interrupted(made, out, exposure=None)
    made.run(out, notices=notices, exposure=None, resume=True)
    assert any("exposure 12.3 ms, as before" in line for line in notices)
    assert [row.seconds for row in rows(out) if isinstance(row, CameraExposures)] == [(0.0123,)]
    assert sum(isinstance(row, Exposed) for row in rows(out)) == 2
    np.testing.assert_equal(next(chosen), 0.0086)
