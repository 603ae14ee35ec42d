"""Execution of a given plan at the machine.

The machine is driven, and the run recorded.
"""

import hashlib
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass
from pathlib import Path
from threading import Thread

import numpy as np

from calib.online.live_learner_limb_watch_run_state_and_display import RunDisplay
from calib.online.observer_of_run_frames import RunObserver, RunStop
from calib.online.run_options_cameras_sensors_and_observer import RunOptions as RunOptions
from calib.online.run_options_cameras_sensors_and_observer import (
    compile_kernels_for_run,
    make_run_observer,
    open_cameras,
    open_sensors_and_assemble_equipment,
    set_camera_exposures_and_report_lines,
)
from rig.array_and_json_types import Floats
from rig.driving import move_profiles_and_path_check
from rig.driving.axis_display_units_and_controller_counts import axes_word, axis_milliunit_name
from rig.driving.axis_driver import Driver
from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import SynchronisedCameras
from rig.driving.controller_status_and_limits import TRUST, ControllerStatus, require_goals_within_limits
from rig.driving.driver_opening_and_settling import Settling, await_settled_status, open_driver, parse_settling
from rig.driving.driving_clock import Clock, SystemClock
from rig.driving.emulators.emulator_opening_and_serving_over_terminal_or_tcp import home_lengths
from rig.driving.move_and_record_loop import RunOperator
from rig.driving.run_journal import Began, CameraExposures, Journal
from rig.driving.run_steps_from_plan_and_progress_from_journal import (
    Progress,
    Step,
    position_loss_reason,
    progress_from_journal,
    require_all_steps_permitted,
    steps_of_plan,
    steps_with_exposures_in_motion,
)
from rig.driving.user_protocol_camera_sensor_classes_and_sensor_reader import refuse_programs_of_untrusted_rig_toml
from rig.errors import ControllerFault, PositionLost, RigError, Unreachable
from rig.formats.local_and_remote_input_files import read_bytes
from rig.formats.output_files import write_bytes
from rig.formats.rig_toml.design_from_rig_toml import load_entries
from rig.model.design import Design, quarter_turns_of_cubes
from rig.model.design_contradictions_and_cube_quarter_turns import turning_instructions
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_axes
from rig.planning.recording_plan import build_plan
from vision.checks.severe_mistake_refusal_and_cube_placement_remarks import Notice, ignore_notice

STANDARD = RunOptions()
Displays = Callable[[RunObserver], AbstractContextManager[list[RunDisplay]]]


@dataclass(frozen=True, slots=True, eq=False)
class PlannedRun:
    """A run that may begin. design; path : of its rig.toml; plan : in words; steps; settling; options"""

    design: Design
    path: Path
    plan: str
    steps: tuple[Step, ...]
    settling: Settling
    options: RunOptions

    @property
    def frames(self) -> int:
        """How many frames are taken at rest; 0 in motion, where cameras expose for as long as the moves take."""
        return sum(step.frames for step in self.steps)

    def travel(self) -> Floats:
        """(steps, axes) m or rad that each axis goes from home on. Raises Unreachable where the driver would refuse
        one
        """
        c = self.design.driver()
        start = c.home if c.home is not None else home_lengths(require_axes(self.design.mechanism))
        require_all_steps_permitted(self.steps, start, make_function_refusing_unsafe_moves(self.design))
        return np.diff(np.array([start, *(step.goal for step in self.steps)]), axis=0)

    def seconds(self) -> float:
        """How long the moves take from home on, without ramps. Raises Unreachable as `travel` does."""
        travel = np.abs(self.travel())
        if self.options.in_motion is not None:
            return float(travel.max(axis=1).sum() / self.options.in_motion)
        return float((travel / self.design.driver().max_speed).max(axis=1).sum())

    def controller_warnings(self, driver: Driver) -> list[str]:
        """Lines where the controller's own limits are tighter than the rig.toml's. Raises Unreachable where it would
        refuse a goal of the plan.
        """
        own = driver.limits()
        if own is not None:
            goals = np.array([step.goal for step in self.steps])
            require_goals_within_limits(own, goals, self.design.driver().zero, require_axes(self.design.mechanism))
        return driver.limit_warnings()

    def compare_with_controller(self) -> list[str]:
        """Lines of the controller's own limits before a run, or of why it was not reached; nothing moves. Raises
        Unreachable where it would refuse a goal of the plan.
        """
        try:
            with open_driver(self.design, self.options.trace, ignore_notice) as driver:
                return [f"warning: {line}" for line in self.controller_warnings(driver)]
        except Unreachable:
            raise
        except RigError as error:
            return [f"the controller's own limits were not compared: {error}"]

    def carry_out(
        self, out: Path, displays: Displays = lambda _: nullcontext([]), notice: Notice = ignore_notice
    ) -> int:
        """How many frames were taken, by now, once the run is over: a recording in the folder `out`.

        displays : gives, for an observer, those who show the run; notice : called with what is to be said on the way
        Raises what ends a run early, of which the recording has the reason; RigError for a folder that is there
            already, or for one to go on with that is of another plan
        """
        _require_place(out, self.options.resume)
        options, clock = self.options, SystemClock()
        with ExitStack() as stack:
            journal = stack.enter_context(Journal(out / "journal.jsonl"))
            if journal.torn:
                notice(
                    f"the journal's last line was cut off ({journal.torn} bytes) and is removed: nothing of "
                    "it was reported"
                )
            fresh = not journal.rows
            before: Progress | None = None
            if not fresh:
                self._require_same_plan(_began(journal), out)
                before = progress_from_journal(journal.rows, self.steps)
                if before.ended == "":
                    notice(f"{out} is finished: every step of its plan is done; nothing was opened or moved")
                    return before.number
            seeing = options.uses_cameras(self.design)
            shutter = open_cameras(self.design, clock) if seeing else None
            if shutter is not None:
                stack.callback(shutter.close)
            listeners: list[Callable[[str], None]] = [notice]  # of what the driver reports: later the journal too
            if options.measure and seeing:
                Thread(target=compile_kernels_for_run, args=(self.design,), daemon=True).start()
            driver = stack.enter_context(
                open_driver(self.design, options.trace, lambda text: _report(listeners, text), clock)
            )
            for line in self.controller_warnings(driver):
                notice(f"warning: {line}")
            homes, status = self._home(driver, await_settled_status(driver, clock), before, notice)
            require_all_steps_permitted(self.steps, status.lengths, make_function_refusing_unsafe_moves(self.design))
            bench = open_sensors_and_assemble_equipment(
                self.design,
                driver,
                shutter,
                self.settling,
                clock,
                options.interval,
                load_entries(self.path).in_stated_units().units,
            )
            exposures = self._set_exposures(shutter, before, notice)
            if fresh:
                write_bytes(out / "rig.toml", read_bytes(self.path))
                began = clock.now(), len(self.steps), _hash(self.steps), tuple(map(float, status.lengths))
                journal.append(Began(0.0, *began))
            origin = _origin(journal, clock, notice)
            if exposures and (before is None or exposures != before.exposures):
                journal.append(CameraExposures(clock.now() - origin, tuple(exposures), tuple(exposures.values())))
            stopping = RunStop(options.stop_on, driver.stop)
            observer = make_run_observer(self.design, self.steps, status.lengths, clock, stopping, options, out)
            observer.displays += stack.enter_context(displays(observer))
            operator = RunOperator(bench, self.steps, journal, self.design.mechanism.axes, origin, observer)
            observer.note = operator.remark
            listeners[:] = [operator.remark, lambda text: observer.update(phase=text)]
            try:
                if not fresh:
                    notice(f"going on: {operator.go_on(homed=homes)}")
                operator.run()
            finally:
                observer.finish()
            return progress_from_journal(journal.rows, self.steps).number

    def _home(
        self, driver: Driver, status: ControllerStatus, before: Progress | None, notice: Notice
    ) -> tuple[bool, ControllerStatus]:
        """(whether the struts were homed, Status from which the run begins). before : the run so far, or None

        Raises PositionLost where nobody knows where they stand, ControllerFault for an alarm that is not the one of a
        controller which must be homed first: homing out of it takes the operator's consent
        """
        c, m, trust = self.design.driver(), self.design.mechanism, self.options.trust_position
        lost = (
            ""
            if before is None
            else position_loss_reason(
                before, status.lengths, c.tolerance, driver.started_anew, c.homing, axis_milliunit_name(m)
            )
        )
        if trust or (before is None and not c.homing and status.known):
            driver.trust()
        believed = trust or (status.known and not lost)
        homes = c.homing and not (trust if before is None else believed)
        if not homes and not believed:
            raise PositionLost(f"{lost or f'the position of the {axes_word(m)} is not known'}; {TRUST}")
        if not homes:
            return False, status
        if (status.activity == "alarm" or status.fault) and not status.homing_required:
            raise ControllerFault(
                f"{status.fault or status.activity} ({status.controller_text}): a run does not home out of this by "
                "itself; see what is wrong at the machine, then rig home, and start the run again"
            )
        notice(f"homing: {lost}" if lost else "homing")
        return True, driver.home()

    def _set_exposures(
        self, shutter: SynchronisedCameras | None, before: Progress | None, notice: Notice
    ) -> dict[str, float]:
        """{camera: s} set; a run that is resumed keeps those that it had."""
        stated = self.options.exposure
        if isinstance(stated, str) or shutter is None:
            return {}
        made, lines = set_camera_exposures_and_report_lines(
            shutter, self.design, stated, before.exposures if before is not None else {}
        )
        for line in lines:
            notice(line)
        return made

    def _require_same_plan(self, began: Began, out: Path) -> None:
        """Raise RigError where a journal is not of this plan."""
        if began.sha256 != _hash(self.steps):
            raise RigError(
                f"{out} is of another plan than --plan {self.plan} --seed {self.options.seed} on {self.path}"
                + ("" if self.options.in_motion is None else f", in motion at {self.options.in_motion * 1e3:g} mm/s")
            )


def plan_run(design: Design, path: Path, plan: str, options: RunOptions = STANDARD) -> PlannedRun:
    """PlannedRun of a design, ready to start.

    It is checked, as `rig run` begins one; nothing moves yet.
    path : of its rig.toml; plan : as "sobol:40,ladder,repeat:20"
    Raises RigError for a plan of a cube put back turned, for options that do not suit the design, and for a rig.toml
    that names programs and is part of a recording
    """
    refuse_programs_of_untrusted_rig_toml(path, design)
    found = build_plan(design, plan, options.seed)
    steps = steps_of_plan(found)
    todo = turning_instructions(dict(found.turned), quarter_turns_of_cubes(design))
    if todo:
        raise RigError(
            f"the plan is for a cube put back turned; {'; '.join(todo)}, and state so in {path} under [turned]"
        )
    settling = parse_settling(options.settle)
    options.accepted_limbs(design)
    options.refuse_unsuited(design)
    if options.in_motion is not None:
        steps = steps_with_exposures_in_motion(steps, options.in_motion, design.driver().max_speed)
    return PlannedRun(design, path, plan, steps, settling, options)


def make_function_refusing_unsafe_moves(design: Design) -> Callable[[Floats, Floats], None]:
    """Function that refuses unsafe moves.

    A function that raises Unreachable where the driver would refuse the move.

    It takes start and goal, (axes,) m, and returns None.
    """
    c, m = design.driver(), require_axes(design.mechanism)

    def check(start: Floats, goal: Floats) -> None:
        move_profiles_and_path_check.require_safe_path(
            start, move_profiles_and_path_check.require_axis_values_in_range(goal, m), m, c.margin, c.max_step
        )

    return check


def _require_place(out: Path, resume: bool) -> None:
    """Make the recording's folder, or see that there is one to go on with. Raises RigError otherwise."""
    journal = out / "journal.jsonl"
    if resume:
        if not journal.exists():
            raise RigError(f"{out} has no journal.jsonl, so there is no run to resume")
        return
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise RigError(
            f"{out} already exists" + ("; --resume continues with it" if journal.exists() else "; name a new folder")
        )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RigError(f"{out} cannot be created: {error.strerror}") from None


def _report(listeners: list[Callable[[str], None]], text: str) -> None:
    for listener in listeners:
        listener(text)


def _began(journal: Journal) -> Began:
    """A journal's first row. Raises RigError where that is not how a run begins."""
    first = journal.rows[0]
    if not isinstance(first, Began):
        raise RigError(f"{journal.path} does not begin with the start of a run")
    return first


def _origin(journal: Journal, clock: Clock, notice: Notice) -> float:
    """s, the clock's time at t = 0 of the recording; where the computer's clock was set back since, so that time still
    goes on.
    """
    origin, last = _began(journal).wall, journal.rows[-1].t
    if clock.now() - origin > last:
        return origin
    notice(
        f"the computer's clock has been set back by {last - (clock.now() - origin):.1f} s or more since; the "
        "recording's goes on"
    )
    return clock.now() - last - 1.0


def _hash(planned: tuple[Step, ...]) -> str:
    """sha256 of the places, exposures and rests of a plan, and of the speed of exposures in motion."""
    digest = hashlib.sha256()
    for step in planned:
        digest.update(np.round(step.goal, 9).tobytes() + step.frames.to_bytes(4, "little"))
        if step.speed is not None:
            digest.update(f"in motion at {step.speed:.9f}".encode())
        if step.rests:
            digest.update(f"rests {[round(rest, 3) for rest in step.rests]}".encode())
    return digest.hexdigest()
