"""Observer of a run's frames.

Each is measured and learnt from as it comes, alarms are raised, displays updated.
"""

import queue
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Unpack

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certification.loop_closure_checks_of_redundant_measuring_limbs import has_six_measuring_limbs
from calib.online.information_filter_kernels_and_change_detection import change_sentence
from calib.online.live_learner_limb_watch_run_state_and_display import (
    Learner,
    Learnt,
    LimbWatch,
    MeasuredFrame,
    RunDisplay,
    RunState,
    RunStateChanges,
    journal_row_in_words,
)
from calib.online.measuring_limb_poses_checked_by_vision import Disagreement, LiveLimbPoses
from rig.array_and_json_types import Floats
from rig.driving.axis_display_units_and_controller_counts import axis_milliunit_name
from rig.driving.driving_clock import Clock
from rig.driving.move_and_record_loop import RecordedFrame
from rig.driving.run_journal import (
    CameraExposures,
    Departure,
    Ended,
    Exposed,
    PositionReports,
    PositionUnknown,
    Readings,
    Remark,
    Resumed,
    Row,
)
from rig.driving.run_steps_from_plan_and_progress_from_journal import Step, longest_axis_distance_of_steps
from rig.errors import NotConverged, RigError
from rig.model import mechanisms
from rig.model.design import Design
from rig.planning.recording_plan import axis_strokes
from vision.reading.live_measurement_and_corner_refit import Live, Sight, sight_from_measuring_limbs
from vision.reading.moved_camera_and_covered_marker_alarms import Alarm, Watch

WAITING = 4  # frames that may wait to be measured before the run waits for them
LOGGED = 60  # events that are kept for displays
LATEST = 30  # alarms that are kept for displays


@dataclass(frozen=True, slots=True)
class RunStop:
    """What a run is stopped for, and how. kinds : of Alarms; halt : stops the struts now, from any thread."""

    kinds: frozenset[str]
    halt: Callable[[], object]


class RunObserver:
    """See rig.driving.move_and_record_loop.RunWatcher. start : (axes,) m; live, learner : None where frames are not
    measured or poses not learnt from `displays` : who shows it."""

    def __init__(
        self,
        design: Design,
        planned: tuple[Step, ...],
        start: Floats,
        clock: Clock,
        live: Live | None,
        learner: Learner | None,
        stopping: RunStop,
    ) -> None:
        self.design, self._clock, self._live, self._learner = design, clock, live, learner
        self._stopping, self._reason = stopping, ""
        self._failed: Exception | None = None
        self.displays: list[RunDisplay] = []
        self.note: Callable[[str], None] = lambda text: (
            None
        )  # puts what is said on record; the operator's, once there is one
        self._unit = axis_milliunit_name(design.mechanism)
        self._watch = Watch(design)
        self._limbs = LimbWatch(design) if has_six_measuring_limbs(design) else None
        self._read: Floats | None = None
        self.source: LiveLimbPoses | None = None  # limbs whose poses stand for vision's
        self.withdraw: Callable[[LiveLimbPoses, int, str], None] = lambda source, frame, reason: (
            None
        )  # writes that they no longer do
        self._waiting: list[Alarm] = []  # jumps that vision has not confirmed
        self._begun, self._done, self._distances = clock.now(), 0, longest_axis_distance_of_steps(planned, start)
        speed = design.controller.max_speed.min() if design.controller else np.inf
        speeds = np.array([speed if step.speed is None else step.speed for step in planned])
        rests = np.array([sum(step.rests) for step in planned])
        self._travel, self._planned = self._distances / speeds + rests, planned
        frames = sum(step.frames for step in planned)
        self.state = RunState(
            tuple(zip(mechanisms.axis_place_texts(design.mechanism), mechanisms.axis_units(design.mechanism))),
            "starting",
            0,
            frames,
            0,
            len(planned),
            float("nan"),
            start,
            start,
            axis_strokes(design),
            (),
            None,
            None,
        )
        self._lock = threading.RLock()
        self._answers: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._queue: queue.Queue[tuple[RecordedFrame, Floats | None] | None] = queue.Queue(WAITING)
        self._worker = threading.Thread(target=self._work, daemon=True)
        self._worker.start()

    def happened(self, row: Row) -> None:
        """A row is on disk."""
        if text := journal_row_in_words(row, self._unit):
            self.update(events=(*self.state.events[1 - LOGGED :], (row.t, text)))
        if isinstance(row, Departure):
            self._done += 1
            self.update(
                activity="moving",
                then=self._then(row.step),
                phase=f"moving to step {row.step + 1}",
                step=row.step + 1,
                goal=np.array(row.goal),
                left=self._left(row.step),
            )
        elif isinstance(row, Exposed):
            self.update(phase="exposing in motion" if row.times else "exposed", frame=row.frame + 1)
        elif isinstance(row, Resumed):
            self.update(phase=row.found, lengths=np.array(row.position))
        elif isinstance(row, PositionReports):
            self.update(lengths=np.array(row.positions[-1]))
        elif isinstance(row, Remark | CameraExposures | PositionUnknown):
            return  # alarms are shown as such, and the end says why
        elif isinstance(row, Ended):
            phase = "done" if not row.reason else f"ended: {row.reason}"
            self.update(activity="ended", then="", phase=phase, ended=row.reason, left=0.0, question=None)
        elif isinstance(row, Readings):
            values = dict(zip(row.channels, row.values))
            self.update(readings=values)
            if self._limbs is not None and "m1" in values:
                self._read = np.array([values[name] for name in self._limbs.channels])
        else:
            self.update(
                activity="holding", phase="settling", lengths=np.array(getattr(row, "position", self.state.lengths))
            )

    def seen(self, shot: RecordedFrame) -> None:
        """A frame is on disk: it is measured while the run goes on."""
        self.update(shot=shot)
        if self._live is not None or self.source is not None:
            self._queue.put((shot, self._read))

    def _then(self, step: int) -> str:
        """What comes after the move of a step (from 0)."""
        frames = self._planned[step].frames
        here = f"{frames} frame{'s' * (frames != 1)} there" if frames else ""
        if step + 1 == len(self._planned):
            return ", ".join(filter(None, (here, "the end")))
        return ", ".join(filter(None, (here, f"step {step + 2} ({self._distances[step + 1] * 1e3:.1f} {self._unit})")))

    def ignore_limbs(self) -> None:
        """Compare no limbs with vision: in motion they are not read at the moment of the exposure."""
        self._limbs = None

    def stop(self) -> str:
        """Why the run should stop."""
        return self._reason

    def ask_stop(self, reason: str) -> None:
        """Stop the struts now and the run with them; from any thread."""
        self._reason = self._reason or reason
        self._stopping.halt()

    def ask(self, frame: int, question: str) -> None:
        """Ask the operator something at the place of a frame."""
        with self._lock:
            while not self._answers.empty():
                self._answers.get()
            self.update(phase=question, question=(frame, question))

    def answer(self, text: str, frame: int | None = None) -> bool:
        """Take what an operator entered, from any thread; False where nothing is asked, or not at a frame."""
        with self._lock:
            asked = self.state.question
            if asked is None or frame not in (None, asked[0]):
                return False
            self._answers.put(text)
            return True

    def operator_entry(self, seconds: float) -> str | None:
        """What an operator entered since it was asked, waited for so many s at most; None where that is nothing yet."""
        try:
            text = self._answers.get(timeout=seconds)
        except queue.Empty:
            return None
        self.update(phase="settling", question=None)
        return text

    def update(self, **changes: Unpack[RunStateChanges]) -> None:
        """Show what has changed of the state."""
        with self._lock:
            self.state = replace(self.state, **changes)
            for display in tuple(self.displays):
                try:
                    display.show(self.state)
                except (
                    Exception
                ) as error:  # of a display, whatever it is: the run goes on without that one, and reports it
                    self.displays.remove(display)
                    self._report_lost(display, error)

    def _report_lost(self, display: RunDisplay, error: Exception) -> None:
        text = f"{type(display).__name__} no longer shows the run, which continues: {error!r}"
        self.note(text)
        with suppress(OSError, ValueError):  # full, gone or closed: the journal alone has it
            print(text, file=sys.stderr)

    def warn(self, alarm: Alarm) -> None:
        """Say what is wrong, and stop the run where that was asked for."""
        self.update(alarms=(*self.state.alarms[1 - LATEST :], alarm))
        self.note(f"{alarm.kind}: {alarm.text}")
        if alarm.kind in self._stopping.kinds:
            self.ask_stop(alarm.text)

    def finish(self) -> None:
        """Measure what still waits, then let displays go."""
        self._queue.put(None)
        self._worker.join()
        try:
            if self._live is not None:
                self._live.close()
        finally:
            for display in self.displays:
                display.close()
        if self._failed is not None:
            raise self._failed

    def _left(self, step: int) -> float:
        """s until the plan is done: ways at full speed, its rests, and what the steps so far took beside theirs."""
        passed = self._clock.now() - self._begun
        done = max(self._done - 1, 0)
        overhead = (passed - self._travel[step - done : step].sum()) / done if done else 0.0
        return float(self._travel[step:].sum() + max(overhead, 0.0) * (len(self._planned) - step))

    def _work(self) -> None:
        while (item := self._queue.get()) is not None:
            shot, lengths = item
            try:
                if self._failed is None and self.source is not None and self.source.in_force and lengths is not None:
                    self._by_limbs(shot, lengths, self.source)
                elif self._failed is None and self._live is not None:
                    self._measure(shot, lengths, self._live)
            except RigError as error:
                self.warn(Alarm("unseen", f"frame {shot.number} could not be measured: {error}"))
            except Exception as error:  # ours, and no reason to lose the run: it is stopped, and `finish` raises it
                self._failed = error
                self.ask_stop(f"measuring frame {shot.number} failed: {error!r}")

    def _look(self, shot: RecordedFrame, live: Live) -> tuple[Sight, list[Alarm]]:
        """(what vision sees of a shot, what is wrong with that)."""
        sight = live.take(shot.number, {name: frame.image for name, frame in shot.frames.items()}, self._expected(shot))
        return sight, self._watch.look(sight, live.noise)

    def _by_limbs(self, shot: RecordedFrame, lengths: Floats, source: LiveLimbPoses) -> None:
        """A shot's pose from the limbs, learnt; vision looks where it is due, and what it has not confirmed is not
        said.
        """
        open_ = source.is_closed(lengths)
        if open_ is not None:
            self._withdrawn(source, shot.number, open_)
            if self._live is not None:
                self._measure(shot, lengths, self._live)
            return
        T, own, common = source.pose(lengths)
        learnt = None if self._learner is None else self._learner.learn(shot.commanded, T, own, common)
        sight, alarms, live = (
            sight_from_measuring_limbs(shot.number, T, own + common @ common.T),
            list[Alarm](),
            self._live,
        )
        if learnt is not None:
            self._waiting += [Alarm("jump", change_sentence(change, shot.number)) for change in learnt.changes]
        if live is not None and source.is_check_due(learnt is not None and (learnt.unsure or bool(learnt.changes))):
            seen, alarms = self._look(shot, live)
            if seen.T_base_platform is not None and seen.covariance is not None:
                found = source.check(lengths, seen.T_base_platform, seen.covariance)
                sight = seen
                if found is not None:
                    self._withdrawn(source, shot.number, found)
                elif not source.undecided:
                    alarms, self._waiting = alarms + self._waiting, []
                    if self._learner is not None:
                        self._learner.save()
        self._show(shot, sight, learnt)
        for alarm in alarms:
            self.warn(alarm)
        if live is not None:
            live.adjust()

    def _withdrawn(self, source: LiveLimbPoses, frame: int, found: Disagreement) -> None:
        """The limbs no longer stand for vision: on file, said, and what was learnt since the last check is
        forgotten.
        """
        self._waiting = []
        if self._learner is not None:
            self._learner.restore()
        self.withdraw(source, frame, found.reason)
        self.warn(
            Alarm(
                "limbs",
                f"frame {frame}: {found.reason}. {found.who}: their acceptance is withdrawn, "
                "what was learnt since they last agreed is forgotten, and vision measures",
            )
        )

    def _measure(self, shot: RecordedFrame, lengths: Floats | None, live: Live) -> None:
        sight, alarms = self._look(shot, live)
        learnt = None
        if self._learner is not None and sight.covariance is not None:
            learnt = self._learner.learn(shot.commanded, sight.T_base_platform, sight.covariance)
            alarms += [Alarm("jump", change_sentence(change, shot.number)) for change in learnt.changes]
            if learnt.drift:
                alarms.append(
                    Alarm(
                        "drift",
                        f"frame {shot.number}: poses have drifted from the calibration by "
                        f"{learnt.drift[0] * 1e3:.3f} mm and "
                        f"{learnt.drift[1] * 1e3:.3f} mrad, beyond the tolerance",
                    )
                )
        if (
            self._limbs is not None
            and self.source is None
            and lengths is not None
            and sight.covariance is not None
            and self._limbs.take(lengths, sight.T_base_platform, sight.covariance)
        ):
            alarms.append(Alarm("limbs", f"frame {shot.number}: the measuring limbs no longer agree with vision"))
        self._show(shot, sight, learnt)
        for alarm in alarms:
            self.warn(alarm)
        live.adjust()

    def _show(self, shot: RecordedFrame, sight: Sight, learnt: Learnt | None) -> None:
        """Have displays show a frame."""
        delay = self._clock.now() - max([frame.t for frame in shot.frames.values()], default=self._clock.now())
        o, good = sight.observations, sight.inliers & np.isfinite(sight.residuals[:, 0])
        rms = {
            camera.name: float(np.sqrt((sight.residuals[rows] ** 2).mean()))
            for i, camera in enumerate(self.design.cameras)
            if (rows := good & (o.camera == i)).any()
        }
        blur = {name: float(np.median(d.blur)) for name, d in sight.detections.items() if len(d.blur)}
        self.update(seen=MeasuredFrame(shot, sight, learnt, delay, rms, blur))

    def _expected(self, shot: RecordedFrame) -> RigidTransform | None:
        """Where the platform ought to be."""
        mechanism = self.design.mechanism
        try:
            if self._learner is not None:
                return self._learner.expected(shot.commanded)
            return (
                mechanisms.kinematics_of(mechanism).forward(shot.commanded, mechanism)
                if mechanism.plates is not None
                else None
            )
        except NotConverged:
            return None
