"""The operator's loop: what it leaves is a recording; killed at any instant it goes on from where the struts stand, and
no move is repeated.
"""

import numpy as np
import pytest

from rig.driving.run_journal import Arrival, Departure, Ended, Exposed, Resumed, read_journal_rows_and_valid_length
from rig.driving.run_steps_from_plan_and_progress_from_journal import (
    require_all_steps_permitted,
    steps_of_plan,
    steps_with_exposures_in_motion,
)
from rig.errors import ControllerFault, MotionError, RigError, Stopped, Unreachable
from rig.formats.rig_toml import design_from_rig_toml
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.planning.recording_plan import build_plan
from rig.recording import recording_folder
from tests.rig.run_folder import RAMP, SPEED, Killed, Onlooker, Room


@pytest.fixture
def rig(tmp_path):
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=1, width=64, height=48)
    (tmp_path / "rec").mkdir()
    (tmp_path / "rec" / "rig.toml").write_text(text)
    return design_from_rig_toml.load_design(tmp_path / "rec" / "rig.toml")


def test_a_run_is_a_recording_as_any_other(rig, tmp_path):
    room = Room(rig, tmp_path / "rec").process()
    found = recording_folder.load_recording(tmp_path / "rec")
    frames, t, commanded = found.commanded()
    assert frames.tolist() == list(range(5)) and all(np.diff(t) > 0)
    exposed = [k for k, step in enumerate(room.planned) for _ in range(step.frames)]
    np.testing.assert_allclose(commanded, [room.planned[k].goal for k in exposed], atol=2e-9)
    assert len(room.struts.visits) == len(room.planned), "places passed on the way are visited too"
    rows = read_journal_rows_and_valid_length(tmp_path / "rec" / "journal.jsonl")[0]
    moves = [(a, b) for a, b in zip(rows, rows[1:]) if isinstance(a, Departure)]
    for departure, arrival in moves:  # half way in time is half way in length, and the first tenth is slow
        distance = np.abs(np.array(departure.goal) - departure.start).max()
        if distance < SPEED * RAMP:
            continue
        middle, early = (found.commands.at(departure.t + s * (arrival.t - departure.t)) for s in (0.5, 0.05))
        np.testing.assert_allclose(middle, (np.array(departure.start) + departure.goal) / 2, atol=1e-6)
        assert np.abs(early - departure.start).max() < 0.05 * distance
    assert (
        len(moves) == len(room.planned)
        and isinstance(rows[-1], Ended)
        and rows[-1].reason == ""
        and len(room.onlooker.shots) == 5
    )


def test_it_can_be_read_while_it_grows(rig, tmp_path):
    room = Room(rig, tmp_path / "rec")
    counts = []
    seen = Onlooker.seen

    def look(self, shot):
        seen(self, shot)
        counts.append(len(recording_folder.load_recording(tmp_path / "rec").exposures.frame))

    room.onlooker.seen = None
    Onlooker.seen = look
    try:
        room.process()
    finally:
        Onlooker.seen = seen
    assert counts == [1, 2, 3, 4, 5]


@pytest.mark.slow
@pytest.mark.parametrize("half", [False, True])
def test_killed_at_every_instant_it_goes_on_and_repeats_no_move(rig, tmp_path, half):
    plan = "sobol:2,repeat:1"
    whole = Room(rig, tmp_path / "rec", plan).process()
    count = whole.instants.count
    (tmp_path / "rec" / "journal.jsonl").unlink()
    for at in range(1, count + 1):
        folder = tmp_path / f"rec{at}"
        folder.mkdir()
        (folder / "rig.toml").write_bytes((tmp_path / "rec" / "rig.toml").read_bytes())
        room = Room(rig, folder, plan)
        room.struts.half, room.instants.at = half, at
        with pytest.raises(Killed):
            room.process(end_is_reported=False)
        if at % 3 == 0:  # the row that was being written is torn
            with open(folder / "journal.jsonl", "ab") as file:
                file.write(b'{"row": 17, "kind": "depart')
        room.process()
        rows = read_journal_rows_and_valid_length(folder / "journal.jsonl")[0]
        assert all(row in rows for row in room.reported), "a row that was reported is there"
        broken = half and len(room.struts.visits) == len(room.planned) + 1  # it was begun, and stopped half way
        assert len(room.struts.visits) == len(room.planned) or broken, (
            "no goal is gone to twice, unless the struts were found half way"
        )
        assert ("broken off" in next(row for row in rows if isinstance(row, Resumed)).found) == broken
        found = recording_folder.load_recording(folder)
        exposed = [k for k, step in enumerate(room.planned) for _ in range(step.frames)]
        assert [row.step for row in rows if isinstance(row, Exposed)] == exposed
        np.testing.assert_allclose(found.commanded()[2], [room.planned[k].goal for k in exposed], atol=2e-9)


def test_what_stands_elsewhere_is_said_and_gone_back_to(rig, tmp_path):
    room = Room(rig, tmp_path / "rec")
    grab = room.eye.grab

    def killed():
        raise Killed

    room.eye.grab = killed
    with pytest.raises(Killed):
        room.process(end_is_reported=False)
    room.eye.grab = grab
    room.struts.at += 2e-3
    room.process()
    rows = read_journal_rows_and_valid_length(tmp_path / "rec" / "journal.jsonl")[0]
    assert (
        "2.000 mm from where they were left: somebody moved them"
        in next(row for row in rows if isinstance(row, Resumed)).found
    )
    recording_folder.load_recording(tmp_path / "rec")


def test_what_is_done_is_not_gone_back_to(rig, tmp_path):
    room = Room(rig, tmp_path / "rec").process()
    visits = len(room.struts.visits)
    room.struts.at += 2e-3
    room.process()
    assert len(room.struts.visits) == visits
    recording_folder.load_recording(tmp_path / "rec")


def test_a_fault_stops_the_struts_and_is_written_down(rig, tmp_path):
    room = Room(rig, tmp_path / "rec")
    whole = room.struts.move

    def fail(goal, permit):
        if len(room.struts.visits) == 2:
            room.struts.at = room.struts.at + 0.3 * (goal - room.struts.at)
            raise ControllerFault("axis 4 in error")
        whole(goal, permit)

    room.struts.move = fail
    with pytest.raises(ControllerFault):
        room.process()
    rows = read_journal_rows_and_valid_length(tmp_path / "rec" / "journal.jsonl")[0]
    assert rows[-1].reason == "axis 4 in error" and room.struts.stops == 1
    assert isinstance(rows[-2], Arrival) and not rows[-2].reached
    room.struts.move = whole
    room.process()
    assert read_journal_rows_and_valid_length(tmp_path / "rec" / "journal.jsonl")[0][-1].reason == ""
    with pytest.raises(RigError, match="silent|no frame"):
        other = Room(rig, tmp_path / "rec", "sobol:9")
        other.eye.fails = 3
        (tmp_path / "rec" / "journal.jsonl").unlink()
        other.process()


def test_who_looks_on_can_stop_it_and_it_goes_on_later(rig, tmp_path):
    room = Room(rig, tmp_path / "rec")
    seen = Onlooker.seen

    def stop(self, shot):
        self.why = "camera 'cam0' has moved"
        self.shots.append(shot)

    Onlooker.seen = stop
    try:
        with pytest.raises(Stopped, match="has moved"):
            room.process()
    finally:
        Onlooker.seen = seen
    assert len(room.onlooker.shots) == 1
    room.process()
    assert len(room.onlooker.shots) == 4


def test_a_plan_that_moves_while_exposing_or_loads_the_platform_is_refused(rig):
    for text, why in (
        ("moving:5", "while the struts move"),
        ("zigzag:5", "while the struts move"),
        ("payload:3", "payload"),
    ):
        with pytest.raises(RigError, match=why):
            steps_of_plan(build_plan(rig, text))


@pytest.mark.parametrize("plan", ["sobol:1,wait:20,sobol:1", "dwell:6", "warmup:4"])
def test_rests_of_the_plan_that_are_longer_than_a_settling_are_kept(rig, tmp_path, plan):
    """Exposures stand as far apart as in the plan, and a stop ends a rest."""
    room, wanted = Room(rig, tmp_path / "rec", plan), build_plan(rig, plan, 1)
    room.process()
    apart, planned = np.diff([shot.t for shot in room.onlooker.shots]), np.diff(wanted.t)
    long = planned > 30
    assert long.any() and (apart[long] > 0.95 * planned[long]).all()
    assert (apart[long] < 1.05 * planned[long] + 20).all() and (apart[~long] < 60).all()


def test_a_run_of_scattered_configurations_rests_no_longer_than_it_settles(rig):
    assert not any(any(step.rests) for step in steps_of_plan(build_plan(rig, "sobol:9,repeat:4,ladder:2")))


def test_a_rest_of_the_plan_ends_when_the_run_is_to_stop(rig, tmp_path, monkeypatch):
    room = Room(rig, tmp_path / "rec", "sobol:1,wait:20,sobol:1")
    begun = room.clock.now()
    monkeypatch.setattr(Onlooker, "stop", lambda self: "asked to" if room.clock.now() > begun + 300 else "")
    with pytest.raises(Stopped, match="asked to"):
        room.process()
    assert room.clock.now() < begun + 305
    first = room.onlooker.shots[0].t
    monkeypatch.setattr(Onlooker, "stop", lambda self: "")
    room.clock.sleep(100.0)  # until the run is resumed
    room.process()
    (second,) = room.onlooker.shots  # the first was taken before the rest, of which it rests what is left
    assert 1200 <= second.t - first < 1260


def test_a_place_passed_on_the_way_is_left_when_the_plan_leaves_it_and_in_motion_too(rig):
    steps = steps_of_plan(build_plan(rig, "sobol:1,wait:20,sobol:1", 1))
    in_motion = steps_with_exposures_in_motion(steps, 0.005, np.full(6, 0.02))
    assert sum(sum(step.rests) for step in steps) == sum(sum(step.rests) for step in in_motion) > 1200
    assert all(len(step.rests) == 1 for step in in_motion if step.rests)


def test_every_place_is_checked_before_anything_moves(rig):
    planned = steps_of_plan(build_plan(rig, "sobol:4"))

    def refuse(start, goal):
        if np.allclose(goal, planned[2].goal):
            raise Unreachable("not moved: the path comes too near a singularity", [0], ["20% along"])

    with pytest.raises(Unreachable, match="1 of 9 moves of the plan.*\n  step 2: .*singularity"):
        require_all_steps_permitted(planned, rig.mechanism.strut_range.mean(axis=1), refuse)


def test_a_journal_of_another_plan_is_refused(rig, tmp_path):
    Room(rig, tmp_path / "rec").process()
    with pytest.raises(RigError, match="plan of 13 steps, this one has 5"):
        Room(rig, tmp_path / "rec", "sobol:2").process()


@pytest.mark.parametrize("during", [False, True], ids=["before", "during"])
def test_a_frame_in_which_somebody_else_moved_the_struts_is_not_kept(rig, tmp_path, during):
    room = Room(rig, tmp_path / "rec")
    grab, wait = room.eye.grab, room.clock.sleep

    def jogged():
        frame = grab()
        room.struts.at = room.struts.at + 2e-3 * during
        return frame

    def settle(seconds):
        wait(seconds)
        if seconds == 0.5 and not during:
            room.struts.at = room.struts.at + 2e-3

    room.eye.grab, room.clock.sleep = jogged, settle
    with pytest.raises(MotionError, match="frame 0 is discarded: .* 2.000 mm from where they were to rest"):
        room.process()
    rows = read_journal_rows_and_valid_length(tmp_path / "rec" / "journal.jsonl")[0]
    assert not any(isinstance(row, Exposed) for row in rows) and "discarded" in rows[-1].reason
    assert not list((tmp_path / "rec").glob("images/**/*.png"))
    room.eye.grab, room.clock.sleep = grab, wait
    room.process()
    assert (
        "moved them"
        in next(
            row
            for row in read_journal_rows_and_valid_length(tmp_path / "rec" / "journal.jsonl")[0]
            if isinstance(row, Resumed)
        ).found
    )
