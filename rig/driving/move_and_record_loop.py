"""Loop of a run: move, settle, grab, journal; each journal row is on disk before the next move."""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np

from rig.array_and_json_types import Floats, Pixels
from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import (
    Frame,
    StampDifferences,
    SynchronisedCameras,
)
from rig.driving.controller_status_and_limits import PositionReport
from rig.driving.driver_opening_and_settling import Settling
from rig.driving.driving_clock import Clock
from rig.driving.frames_exposed_during_move import (
    FramesDuringMove,
    interpolated_reported_strut_lengths,
    journal_row_of_position_reports,
)
from rig.driving.move_profiles_and_path_check import TimedShares, move_profile_fitted_to_reports
from rig.driving.readings_entered_by_operator_during_run import ReadingForm
from rig.driving.recording_from_run_journal import GrowingRecording
from rig.driving.run_journal import (
    Arrival,
    Departure,
    Ended,
    Exposed,
    Journal,
    PositionUnknown,
    Readings,
    Remark,
    Resumed,
    Row,
)
from rig.driving.run_steps_from_plan_and_progress_from_journal import (
    Progress,
    Step,
    interrupted_move_text_and_goal_reached,
    progress_from_journal,
    start_position_of_step,
)
from rig.errors import MotionError, RigError, Stopped
from rig.formats.output_files.atomic_file_writing_and_process_locks import sync_folder

REST_POLL, READ_EVERY, TICK = 0.5, 30.0, 1e-3  # s between looks whether a rest is to stop, and readings; of no rest
ENTRY_POLL = 0.1  # s between looks whether an operator who is asked has stopped the run


class Machine(Protocol):
    """What the loop needs of a driver; see rig.driving.axis_driver.Driver."""

    @property
    def position_known(self) -> bool:
        """Whether what it reads can be believed."""

    def lengths(self) -> Floats:
        """(axes,) m, as the controller reads them."""

    def move(
        self,
        lengths: Floats,
        share: float = 1.0,
        speed: float | None = None,
        report: Callable[[PositionReport], None] | None = None,
        permit: Callable[[], None] | None = None,
    ) -> object:
        """Move there; returns once the axes rest and read back within tolerance. Raises MotionError otherwise, and what
        `permit` raises, which is called just before the move begins.
        """

    def stop(self) -> object:
        """Stop the axes now."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedFrame:
    """One frame: its number, step, time (s), the lengths commanded (axes,) m, and {camera: Frame}."""

    number: int
    step: int
    t: float
    commanded: Floats
    frames: dict[str, Frame]


class RunWatcher(Protocol):
    """Observer: notified of every row on disk and of every frame; may request a stop."""

    def happened(self, row: Row) -> None:
        """A row is on disk."""

    def seen(self, shot: RecordedFrame) -> None:
        """A frame was exposed, and is on disk."""

    def stop(self) -> str:
        """Why the run should stop, "" while it should not."""

    def ask(self, frame: int, question: str) -> None:
        """Show the operator what is asked at the place of a frame; what was entered before answers nothing."""

    def operator_entry(self, seconds: float) -> str | None:
        """What the operator entered since, waited for so many s at most; None where that is nothing yet."""


@dataclass(frozen=True, slots=True, eq=False)
class RunEquipment:
    """What a run works with. tolerance : m, of a read-back; time_profile : (start, goal (axes,) m, from, until s) ->
    share of the way through time
    readings : {channel: value} of sensors now, or None; limbs : their (6,) m, or None; save : (path, image) puts an
        image on disk; interval : s from one exposure in motion to the next, at least; form : of an operator's readings,
        None where none is asked; unit : name of a thousandth of the axes' m or rad"""

    machine: Machine
    shutter: SynchronisedCameras | None
    clock: Clock
    settling: Settling
    tolerance: float
    time_profile: Callable[[Floats, Floats, float, float], TimedShares]
    save: Callable[[Path, Pixels], None]
    readings: Callable[[], dict[str, float]] | None = None
    limbs: Callable[[], Floats] | None = None
    interval: float = 0.25
    form: ReadingForm | None = None
    unit: str = "mm"


class RunOperator:
    """One process that carries a run on. planned : Steps; origin : s, the clock's time at t = 0 of the recording."""

    def __init__(
        self,
        bench: RunEquipment,
        planned: tuple[Step, ...],
        journal: Journal,
        axes: tuple[str, ...],
        origin: float,
        watcher: RunWatcher,
    ) -> None:
        self.bench, self.planned, self.watcher = bench, planned, watcher
        self._journal, self._origin, self._folder = journal, origin, journal.path.parent
        in_motion = any(step.speed is not None for step in planned)
        self._growing = GrowingRecording(self._folder, axes, journal.rows, in_motion, bench.form is not None)
        self._writing = threading.RLock()
        self._stamps = StampDifferences()

    def now(self) -> float:
        """s on the recording's clock."""
        return self.bench.clock.now() - self._origin

    def run(self) -> None:
        """Carry on to the end of the plan. Whatever ends it early stops the struts, is written down with its reason,
        and raised.
        """
        try:
            state = progress_from_journal(self._journal.rows, self.planned)
            for index in range(state.step, len(self.planned)):
                if index != state.step:
                    state = self._next(index)
                self._do(state)
                state = progress_from_journal(self._journal.rows, self.planned)
            for line in self._stamps.lines():
                self.remark(line)
            self.write(Ended(self.now(), ""))
        except BaseException as error:
            self._end(error)
            raise

    def go_on(self, homed: bool = False) -> str:
        """Read the position after another process ended, and write down what it says of the move that was under way;
        returns that.

        homed : whether the struts were homed before, so that their position says nothing of it
        """
        state = progress_from_journal(self._journal.rows, self.planned)
        position = self._read()
        if homed:
            found, reached = f"the axes had to be homed; step {state.step + 1} is approached from there", False
        else:
            found, reached = interrupted_move_text_and_goal_reached(
                state, self.planned, np.array(position), self.bench.tolerance, self.bench.unit
            )
        goal = tuple(self.planned[state.step].goal.tolist())
        self.write(Resumed(self.now(), goal if reached else position, found))
        if state.pending is not None:
            self.write(Arrival(self.now(), state.step, goal if reached else position, reached))
        return found

    def remark(self, text: str) -> None:
        """Write a message to the operator into the journal; from any thread."""
        self.write(Remark(self.now(), text))

    def write(self, row: Row) -> None:
        """A row on disk, then in the recording's files, then before those who look on; from any thread."""
        with self._writing:
            self._journal.append(row)
            self._growing.add(row)
            self.watcher.happened(row)

    def _read(self) -> tuple[float, ...]:
        return tuple(float(value) for value in self.bench.machine.lengths())

    def _next(self, index: int) -> Progress:
        """Progress at the start of a step."""
        now = progress_from_journal(self._journal.rows, self.planned)
        return Progress(index, 0, now.number, now.position, None, False, now.t, None)

    def _do(self, state: Progress) -> None:
        """One step from the present position: the move unless it is done, the missing frames."""
        step = self.planned[state.step]
        if step.frames and state.frames >= step.frames:  # wherever the struts stand by now
            return self._rest(step.rest_before(step.frames))
        if not state.arrived:
            self._wanted()
            if step.speed is None:
                self._move(state.step, state.position, step.goal)
            else:
                self._move_exposing(self._begin(state), step.goal, step.speed)
        number = state.number
        for k in range(state.frames, step.frames):
            self._wanted()
            self._rest(step.rest_before(k))
            frame = number + k - state.frames
            self._expose(state.step, frame, self._settle(frame, step.goal))
        self._rest(step.rest_before(step.frames))

    def _rest(self, seconds: float) -> None:
        """Stand as long as the plan does (s) since the last arrival or exposure on record, and read sensors."""
        since = next((row.t for row in reversed(self._journal.rows) if isinstance(row, Arrival | Exposed)), self.now())
        end, looked = since + seconds, self.now()
        if end - looked > TICK:
            self.remark(f"rests for {end - looked:.0f} s, as the plan does")
        while (left := end - self.now()) > TICK:
            self._wanted()
            if self.now() - looked >= READ_EVERY:
                self._look()
                looked = self.now()
            self.bench.clock.sleep(min(left, REST_POLL))

    def _wanted(self) -> None:
        reason = self.watcher.stop()
        if reason:
            raise Stopped(reason)

    def _move(self, index: int, start: Floats, goal: Floats, reached: bool = True) -> None:
        """A move between exposures. reached : whether its goal is that of the step"""
        self.write(Departure(self.now(), index, tuple(start.tolist()), tuple(goal.tolist())))
        begun = self.now()
        self.bench.machine.move(goal, permit=self._wanted)
        ended = self.now()
        self.write(
            Arrival(ended, index, tuple(goal.tolist()), reached, self.bench.time_profile(start, goal, begun, ended))
        )

    def _begin(self, state: Progress) -> Progress:
        """Progress where a step in motion can begin: one that failed at its goal lacks frames, and goes back."""
        begin = start_position_of_step(self._journal.rows, self.planned, state.step)
        goal, tolerance = self.planned[state.step].goal, self.bench.tolerance
        if np.abs(state.position - goal).max() > tolerance or np.abs(begin - goal).max() <= tolerance:
            return state
        self.remark(f"step {state.step + 1} lacks frames: back to its start")
        self._move(state.step, state.position, begin, reached=False)
        self._wanted()
        return progress_from_journal(self._journal.rows, self.planned)

    def _move_exposing(self, state: Progress, goal: Floats, speed: float) -> None:
        """A move at a speed (m/s) during which frames are taken, each written once the positions about it are."""
        bench, index, number, start = self.bench, state.step, state.number, state.position
        if bench.shutter is None:
            raise RigError("exposures in motion take cameras")
        self._look()
        self._wanted()
        self.write(Departure(self.now(), index, tuple(start.tolist()), tuple(goal.tolist())))

        def keep(frames: dict[str, Frame], reports: list[PositionReport]) -> None:
            nonlocal number
            self._write_reports(reports)
            names = self._save(number, frames)
            self._stamps.add(frames)
            times = tuple(float(frame.t) - self._origin for frame in frames.values())
            sigma = tuple(float(frame.t_sigma) for frame in frames.values())
            self.write(Exposed(times[0], index, number, sigma, tuple(frames), names, (), times))
            at = interpolated_reported_strut_lengths(exposing.reports, times[0] + self._origin, start)
            self.watcher.seen(RecordedFrame(number, index, times[0], at, frames))
            number += 1

        def permit() -> None:
            self._wanted()
            exposing.require_no_failure()

        exposing = FramesDuringMove(bench.shutter, bench.clock, bench.interval, keep, bench.machine.stop, self.remark)
        try:
            with exposing:
                bench.machine.move(goal, speed=speed, report=exposing.report, permit=permit)
                ended = self.now()
        finally:
            self._write_reports(exposing.unwritten())
        found = move_profile_fitted_to_reports(start, goal, exposing.reports, speed)
        travel = tuple((t - self._origin, share) for t, share in found.travel)
        self.write(Arrival(max(ended, travel[-1][0] if travel else ended), index, tuple(goal.tolist()), True, travel))
        if found.rms is not None and not travel:
            self.remark(f"step {index + 1}: the reported positions follow no trapezoid; they stand for the way")
        self._look()

    def _write_reports(self, reports: list[PositionReport]) -> None:
        if reports:
            self.write(journal_row_of_position_reports(self.now(), reports, self._origin))

    def _settle(self, number: int, goal: Floats) -> tuple[float, ...]:
        """Wait until the platform rests; returns an operator's reading (m, rad) of the place, () where there is none"""
        bench, shutter = self.bench, self.bench.shutter
        images = (lambda: [frame.image for frame in shutter.grab().values()]) if shutter else None
        ask = None if bench.form is None else partial(self._ask, number, goal, bench.form)
        return bench.settling.wait(bench.clock, images, bench.limbs, ask)

    def _ask(self, number: int, goal: Floats, form: ReadingForm) -> tuple[float, ...]:
        """An operator's reading of a place, as long as that takes. Raises Stopped as soon as the run is to stop."""
        so_far = {len(row.reading) for row in self._journal.rows if isinstance(row, Exposed) and row.reading}
        sizes = tuple(so_far) or form.sizes  # poses.csv has one kind of row
        question = form.question(number, goal, sizes)
        self.watcher.ask(number, question)
        while True:
            while (text := self.watcher.operator_entry(ENTRY_POLL)) is None:
                self._wanted()
            try:
                return form.reading(text, sizes)
            except RigError as error:
                self.watcher.ask(number, f"{error}. {question}")

    def _look(self) -> None:
        """Sensors' readings written down; before and after an exposure, so that their log covers it."""
        if self.bench.readings is not None:
            values = self.bench.readings()
            self.write(Readings(self.now(), tuple(values), tuple(values.values())))

    def _expose(self, index: int, number: int, reading: tuple[float, ...] = ()) -> None:
        """Grab a frame, put its images on disk, and then write that it is there, with an operator's reading (m, rad).

        Raises MotionError for one during which the axes did not rest at the goal: it is not kept.
        """
        bench, goal = self.bench, self.planned[index].goal
        at = self._rest_position(number, goal, goal, "before")
        self._look()
        frames = bench.shutter.grab() if bench.shutter else {}
        self._look()
        self._rest_position(number, goal, at, "after")
        names = self._save(number, frames)
        self._stamps.add(frames)
        t = float(np.mean([frame.t for frame in frames.values()])) - self._origin if frames else self.now()
        self.write(
            Exposed(
                t,
                index,
                number,
                tuple(float(f.t_sigma) for f in frames.values()),
                tuple(frames),
                names,
                tuple(at.tolist()),
                reading=reading,
            )
        )
        self.watcher.seen(RecordedFrame(number, index, t, goal, frames))

    def _save(self, number: int, frames: dict[str, Frame]) -> tuple[str, ...]:
        """Put a frame's images on disk; returns their names in the folder, one for each camera."""
        names = {camera: f"images/{camera}/{number:05d}.png" for camera in frames}
        with ThreadPoolExecutor(max(len(frames), 1)) as pool:  # packing an image takes as long as reading it
            list(pool.map(lambda camera: self.bench.save(self._folder / names[camera], frames[camera].image), frames))
        for folder in {
            place for name in names.values() for place in (self._folder / name).parents if self._folder in place.parents
        }:
            sync_folder(folder)
        return tuple(names.values())

    def _rest_position(self, number: int, goal: Floats, at: Floats, when: str) -> Floats:
        """(axes,) m read now. Raises MotionError where that is neither the goal nor where they were before, `at`."""
        position = np.array(self._read())
        off = float(max(np.abs(position - goal).max(), np.abs(position - at).max()))
        if off > self.bench.tolerance:
            raise MotionError(
                f"frame {number} is discarded: {when} its exposure the axes read {off * 1e3:.3f} {self.bench.unit} "
                f"from where they were to rest (at {(position * 1e3).round(3).tolist()} {self.bench.unit}); did "
                "something else command them?"
            )
        return position

    def _end(self, error: BaseException) -> None:
        """Stop the struts; journal the reason, and their position if it can be read."""
        reason = str(error) or type(error).__name__
        try:
            self.bench.machine.stop()
            pending = progress_from_journal(self._journal.rows, self.planned).pending
            if pending is not None and self.bench.machine.position_known:
                position = self._read()
                near = bool(np.abs(np.array(position) - np.array(pending.goal)).max() <= self.bench.tolerance)
                done = near and self.planned[pending.step].speed is None  # in motion some frames are missing
                self.write(Arrival(self.now(), pending.step, pending.goal if near else position, done))
        except RigError as further:  # the first reason stands; this one is told beside it
            reason += f"; and stopping: {further}"
        if not self.bench.machine.position_known:
            self.write(PositionUnknown(self.now(), reason))
        self.write(Ended(self.now(), reason))
