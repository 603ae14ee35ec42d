"""The operator's loop: what it leaves is a recording; killed at any instant it goes on from where the struts stand, and no move is repeated."""

from pathlib import Path

import numpy as np
import pytest

from rig import design_file, layout, recording
from rig.cameras.settled import settling
from rig.cameras.source import CameraError, Frame
from rig.cameras.together import Shutter
from rig.clock import SimulatedClock
from rig.errors import ControllerFault, RigError, Stopped, Unreachable
from rig.journal import Arrival, Began, Departure, Ended, Exposed, Journal, Resumed, read
from rig.operate import Bench, Operator
from rig.plan import build
from rig.steps import check, steps
from rig.way import trapezoid

SPEED, RAMP = 0.05, 0.2  # m/s, s
AXES = tuple(f"l{i}" for i in range(1, 7))


class Killed(BaseException):
    """kill -9: no handler runs."""


class Instants:
    """Counts instants, and kills at one of them. at : which, or None; wound : whether a row under way is torn"""

    def __init__(self):
        self.count, self.at = 0, None

    def pass_(self):
        self.count += 1
        if self.count == self.at:
            raise Killed


class Struts:
    """A machine that outlives whoever drives it. visits : what it was told to go to; half : whether a killed driver's move stops half way"""

    def __init__(self, clock, instants, start):
        self.clock, self.instants, self.at, self.visits, self.half, self.stops = clock, instants, np.array(start, float), [], False, 0

    def lengths(self):
        self.instants.pass_()
        return self.at + 1e-7 * np.sin(self.clock.now())

    def move(self, goal):
        self.instants.pass_()
        self.visits.append(goal.copy())
        start, self.at = self.at, goal.copy()
        try:
            self.instants.pass_()
        except Killed:
            self.at = start + 0.4 * (goal - start) if self.half else goal.copy()
            raise
        self.clock.sleep(np.abs(goal - start).max() / SPEED + RAMP)
        self.instants.pass_()

    def home(self):
        self.at = self.at * 0 + 0.45

    def stop(self):
        self.stops += 1


class Eye:
    name, can_set_exposure = "cam0", False

    def __init__(self, clock, instants):
        self.clock, self.instants, self.fails = clock, instants, 0

    def grab(self):
        self.instants.pass_()
        if self.fails:
            self.fails -= 1
            raise CameraError("camera 'cam0' gives no frame")
        self.clock.sleep(0.01)
        return Frame(np.full((48, 64), 7, np.uint8), self.clock.now(), 1e-3)

    def close(self):
        pass


class Onlooker:
    def __init__(self):
        self.rows, self.shots, self.why = [], [], ""

    def happened(self, row):
        self.rows.append(row)

    def seen(self, shot):
        self.shots.append(shot)

    def stop(self):
        return self.why


@pytest.fixture
def rig(tmp_path):
    text = layout.layout(0.3, cameras=1, width=64, height=48)
    (tmp_path / "rec").mkdir()
    (tmp_path / "rec" / "rig.toml").write_text(text)
    return design_file.load(tmp_path / "rec" / "rig.toml")


class Room:
    """A rig in a folder that runs are started on, one process after the other."""

    def __init__(self, design, folder, plan="sobol:3,repeat:2"):
        self.folder, self.clock, self.instants = Path(folder), SimulatedClock(1.7e9), Instants()
        self.planned = steps(build(design, plan, 1))
        self.struts = Struts(self.clock, self.instants, design.mechanism.strut_range.mean(axis=1) - 1e-3)
        self.eye, self.onlooker, self.reported = Eye(self.clock, self.instants), Onlooker(), []

    def save(self, path, image):
        import cv2

        path.parent.mkdir(parents=True, exist_ok=True)
        self.instants.pass_()
        path.write_bytes(cv2.imencode(".png", image)[1].tobytes())

    def process(self, end_is_told=True):
        """One process, from the journal on, to the end or until it is killed."""
        way = lambda start, goal, begun, ended: trapezoid(begun, ended, np.abs(goal - start).max() / SPEED, RAMP)  # noqa: E731
        shutter = Shutter((self.eye,), self.clock)
        bench = Bench(self.struts, shutter, self.clock, settling("time:0.5"), 1e-5, way, self.save)
        self.onlooker = Onlooker()
        try:
            with Journal(self.folder / "journal.jsonl") as journal:
                fresh = not journal.rows
                if fresh:
                    journal.append(Began(0.0, self.clock.now(), len(self.planned), "x", tuple(self.struts.at.tolist())))
                origin = journal.rows[0].wall
                operator = Operator(bench, self.planned, journal, AXES, origin, self.onlooker)
                if not end_is_told:
                    operator._end = lambda error: None
                if not fresh:
                    operator.go_on()
                operator.run()
        finally:
            self.reported += [row for row in self.onlooker.rows if not isinstance(row, Arrival)]
            shutter.close()
        return self


def test_a_run_is_a_recording_as_any_other(rig, tmp_path):
    room = Room(rig, tmp_path / "rec").process()
    found = recording.load(tmp_path / "rec")
    frames, t, commanded = found.commanded()
    assert frames.tolist() == list(range(5)) and all(np.diff(t) > 0)
    exposed = [k for k, step in enumerate(room.planned) for _ in range(step.frames)]
    np.testing.assert_allclose(commanded, [room.planned[k].goal for k in exposed], atol=2e-9)
    assert len(room.struts.visits) == len(room.planned), "places passed on the way are visited too"
    rows = read(tmp_path / "rec" / "journal.jsonl")[0]
    moves = [(a, b) for a, b in zip(rows, rows[1:]) if isinstance(a, Departure)]
    for departure, arrival in moves:  # half way in time is half way in length, and the first tenth is slow
        way = np.abs(np.array(departure.goal) - departure.start).max()
        if way < SPEED * RAMP:
            continue
        middle, early = (found.commands.at(departure.t + s * (arrival.t - departure.t)) for s in (0.5, 0.05))
        np.testing.assert_allclose(middle, (np.array(departure.start) + departure.goal) / 2, atol=1e-6)
        assert np.abs(early - departure.start).max() < 0.05 * way
    assert len(moves) == len(room.planned) and isinstance(rows[-1], Ended) and rows[-1].reason == "" and len(room.onlooker.shots) == 5


def test_it_can_be_read_while_it_grows(rig, tmp_path):
    room = Room(rig, tmp_path / "rec")
    counts = []
    seen = Onlooker.seen

    def look(self, shot):
        seen(self, shot)
        counts.append(len(recording.load(tmp_path / "rec").exposures.frame))

    room.onlooker.seen = None
    Onlooker.seen = look
    try:
        room.process()
    finally:
        Onlooker.seen = seen
    assert counts == [1, 2, 3, 4, 5]


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
            room.process(end_is_told=False)
        if at % 3 == 0:  # the row that was being written is torn
            with open(folder / "journal.jsonl", "ab") as file:
                file.write(b'{"row": 17, "kind": "depart')
        room.process()
        rows = read(folder / "journal.jsonl")[0]
        assert all(row in rows for row in room.reported), "a row that was reported is there"
        broken = half and len(room.struts.visits) == len(room.planned) + 1  # it was begun, and stopped half way
        assert len(room.struts.visits) == len(room.planned) or broken, "no goal is gone to twice, unless the struts were found half way"
        assert ("broken off" in next(row for row in rows if isinstance(row, Resumed)).found) == broken
        found = recording.load(folder)
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
        room.process(end_is_told=False)
    room.eye.grab = grab
    room.struts.at += 2e-3
    room.process()
    rows = read(tmp_path / "rec" / "journal.jsonl")[0]
    assert "2.000 mm from where they were left: somebody moved them" in next(row for row in rows if isinstance(row, Resumed)).found
    recording.load(tmp_path / "rec")


def test_what_is_done_is_not_gone_back_to(rig, tmp_path):
    room = Room(rig, tmp_path / "rec").process()
    visits = len(room.struts.visits)
    room.struts.at += 2e-3
    room.process()
    assert len(room.struts.visits) == visits
    recording.load(tmp_path / "rec")


def test_a_fault_stops_the_struts_and_is_written_down(rig, tmp_path):
    room = Room(rig, tmp_path / "rec")
    whole = room.struts.move

    def fail(goal):
        if len(room.struts.visits) == 2:
            room.struts.at = room.struts.at + 0.3 * (goal - room.struts.at)
            raise ControllerFault("axis 4 in error")
        whole(goal)

    room.struts.move = fail
    with pytest.raises(ControllerFault):
        room.process()
    rows = read(tmp_path / "rec" / "journal.jsonl")[0]
    assert rows[-1].reason == "axis 4 in error" and room.struts.stops == 1
    assert isinstance(rows[-2], Arrival) and not rows[-2].reached
    room.struts.move = whole
    room.process()
    assert read(tmp_path / "rec" / "journal.jsonl")[0][-1].reason == ""
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
    for text, why in (("moving:5", "while the struts move"), ("zigzag:5", "while the struts move"), ("payload:3", "payload")):
        with pytest.raises(RigError, match=why):
            steps(build(rig, text))


def test_every_place_is_checked_before_anything_moves(rig):
    planned = steps(build(rig, "sobol:4"))

    def refuse(start, goal):
        if np.allclose(goal, planned[2].goal):
            raise Unreachable("not moved: the way comes too near a singularity", [0], ["20% along"])

    with pytest.raises(Unreachable, match="1 of 5 moves of the plan.*\n  step 2: .*singularity"):
        check(planned, rig.mechanism.strut_range.mean(axis=1), refuse)


def test_a_journal_of_another_plan_is_refused(rig, tmp_path):
    Room(rig, tmp_path / "rec").process()
    with pytest.raises(RigError, match="plan of 8 steps, this one has 3"):
        Room(rig, tmp_path / "rec", "sobol:2").process()


@pytest.mark.parametrize(("cruise", "ramp", "whole"), [(1.0, 0.2, 1.2), (1.0, 0.2, 1.5), (0.01, 0.2, 0.3), (1.0, None, 1.3), (1.0, None, 1.0),
                                                       (1.0, 0.0, 1.1)])
def test_a_trapezoid_moves_evenly_and_arrives(cruise, ramp, whole):
    way = trapezoid(5.0, 5.0 + whole, cruise, ramp)
    t, share = np.array([(5.0, 0.0), *way, (5.0 + whole, 1.0)]).T
    assert (np.diff(t) > 0).all() and (np.diff(share) >= 0).all()
    if ramp is None:
        ramp = whole - cruise
    moving = cruise + ramp if ramp < cruise else 2 * np.sqrt(ramp * cruise)
    fine = np.linspace(0, moving, 4001)
    peak = 1 / cruise if ramp < cruise else 2 / moving
    rise = ramp if ramp < cruise else moving / 2
    speed = peak * np.clip(np.minimum(fine, moving - fine) / max(rise, 1e-12), 0, 1)
    exact = np.r_[0, np.cumsum((speed[1:] + speed[:-1]) / 2) * fine[1]]
    assert np.abs(np.interp(5.0 + fine, t, share) - exact).max() < (rise / moving) / 400 + 1e-3
