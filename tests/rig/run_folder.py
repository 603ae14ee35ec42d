"""A rig in a folder that runs are started on and killed: struts that outlive their driver, a camera, who looks on."""

from pathlib import Path

import numpy as np

from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import (
    CameraError,
    Frame,
    SynchronisedCameras,
)
from rig.driving.driver_opening_and_settling import parse_settling
from rig.driving.driving_clock import SimulatedClock
from rig.driving.move_and_record_loop import RunEquipment, RunOperator
from rig.driving.move_profiles_and_path_check import trapezoidal_profile
from rig.driving.run_journal import Arrival, Began, Journal
from rig.driving.run_steps_from_plan_and_progress_from_journal import steps_of_plan
from rig.planning.recording_plan import build_plan

SPEED, RAMP = 0.05, 0.2  # m/s, s
AXES = tuple(f"l{i}" for i in range(1, 7))


class Killed(BaseException):
    """kill -9: no handler runs."""


class Instants:
    """Counts instants, and kills at one of them. at : which, or None"""

    def __init__(self):
        self.count, self.at = 0, None

    def pass_(self):
        self.count += 1
        if self.count == self.at:
            raise Killed


class Struts:
    """A machine that outlives whoever drives it. visits : what it was told to go to; half : whether a killed driver's
    move stops half way
    """

    def __init__(self, clock, instants, start):
        self.clock, self.instants, self.at, self.visits, self.half, self.stops = (
            clock,
            instants,
            np.array(start, float),
            [],
            False,
            0,
        )

    position_known = True

    def lengths(self):
        self.instants.pass_()
        return self.at + 1e-7 * np.sin(self.clock.now())

    def move(self, goal, permit):
        self.instants.pass_()
        permit()
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


class Room:
    """A rig in a folder that runs are started on, one process after the other."""

    def __init__(self, design, folder, plan="sobol:3,repeat:2"):
        self.folder, self.clock, self.instants = Path(folder), SimulatedClock(1.7e9), Instants()
        self.planned = steps_of_plan(build_plan(design, plan, 1))
        self.struts = Struts(self.clock, self.instants, design.mechanism.strut_range.mean(axis=1) - 1e-3)
        self.eye, self.onlooker, self.reported = Eye(self.clock, self.instants), Onlooker(), []

    def save(self, path, image):
        import cv2

        path.parent.mkdir(parents=True, exist_ok=True)
        self.instants.pass_()
        path.write_bytes(cv2.imencode(".png", image)[1].tobytes())

    def process(self, end_is_reported=True):
        """One process, from the journal on, to the end or until it is killed."""

        def profile(start, goal, begun, ended):
            return trapezoidal_profile(begun, ended, np.abs(goal - start).max() / SPEED, RAMP)

        shutter = SynchronisedCameras((self.eye,), self.clock)
        bench = RunEquipment(self.struts, shutter, self.clock, parse_settling("time:0.5"), 1e-5, profile, self.save)
        self.onlooker = Onlooker()
        try:
            with Journal(self.folder / "journal.jsonl") as journal:
                fresh = not journal.rows
                if fresh:
                    journal.append(Began(0.0, self.clock.now(), len(self.planned), "x", tuple(self.struts.at.tolist())))
                origin = journal.rows[0].wall
                operator = RunOperator(bench, self.planned, journal, AXES, origin, self.onlooker)
                if not end_is_reported:
                    operator._end = lambda error: None
                if not fresh:
                    operator.go_on()
                operator.run()
        finally:
            self.reported += [row for row in self.onlooker.rows if not isinstance(row, Arrival)]
            shutter.close()
        return self
