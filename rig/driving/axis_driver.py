"""Driver of a machine's axes (struts, joints, slides).

It checks, sends and monitors each move, and stops on failure.
"""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO, TypeVar, cast

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving import move_profiles_and_path_check, protocols
from rig.driving.axis_display_units_and_controller_counts import axes_word, axis_values_text, greatest_distance_text
from rig.driving.controller_status_and_limits import (
    ANEW,
    CANNOT_HOME,
    OUT_OF_JOINT_RANGE,
    OUT_OF_RANGE,
    TRUST,
    ControllerLimits,
    ControllerStatus,
    FinishedMove,
    PositionReport,
    limits_of_linuxcnc_ini,
    operator_advice,
    tighter_controller_limit_warnings,
)
from rig.driving.driving_clock import Clock, SystemClock
from rig.driving.move_profiles_and_path_check import speed_fraction_of_move, straight_move_segment
from rig.driving.protocols.protocol_interface_and_user_line_protocol import Dialogue, Segment, State, Verdict
from rig.driving.request_and_answer_exchange_with_controller import Link, Port, bytes_as_text
from rig.driving.serial_and_epics_ports_and_checksummed_frames import open_controller_port
from rig.errors import ControllerFault, LinkLost, MotionError, NoAnswer, PositionLost, RigError, Stalled, Unreachable
from rig.model import mechanisms
from rig.model.design import Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import has_struts, require_axes

T = TypeVar("T")
PATIENCE, SHORT_PATIENCE = 30.0, 3.0  # s of trying to connect anew; in order to stop
POLL = 0.01  # s between looks at a moving rig
STILL = 1.0  # s without coming nearer: standing
PROGRESS = 1e-7  # m; less is noise of the read-back
STANDING = 1e-6  # m by which a rig that stands may seem to come nearer from one look to the next
TRIES = 3  # times that a move is sent which the read-back shows was never begun


class Driver:
    """A rig's axes, struts or joints and slides: what is called lengths, in m, is in rad of joints that turn.

    `with Driver(design) as driver: driver.home(); driver.move(lengths)`.

    design : with a controller; clock : SystemClock by default; opener : makes the port, by default what [controller]
        port names
    trace : takes every byte with its time; notify : takes a line of text when something was noticed or recovered
    """

    def __init__(
        self,
        design: Design,
        clock: Clock | None = None,
        opener: Callable[[], Port] | None = None,
        trace: TextIO | None = None,
        notify: Callable[[str], None] | None = None,
    ) -> None:
        c = design.driver()
        if opener is None and not (c.port or c.usb):
            raise RigError("[controller] names no port")
        self.design, self.controller, self.mechanism = design, c, require_axes(design.mechanism)
        self._axes = axes_word(self.mechanism)
        self.clock = clock or SystemClock()
        self._protocol = protocols.protocol_of_controller(c, self.mechanism)
        self.link = Link(
            self._protocol,
            opener or (lambda: open_controller_port(c.port, c.usb, c.baudrate, self.clock)),
            self.clock,
            c.timeout,
            trace,
        )
        self._notify = notify or (lambda text: None)
        self._busy = threading.RLock()
        self._known = False  # whether the lengths can be believed
        self._homed: bool | None = None  # what the controller said of that
        self._left: Floats | None = None  # (n,) m or rad where the axes were left

    def __enter__(self) -> "Driver":
        self.open()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def open(self, stopping: bool = False) -> ControllerStatus:
        """Connect, and read controller identity and strut positions. Raises LinkLost, NoAnswer, ControllerFault.

        stopping : the struts are stopped before anything is asked: a controller that homes may answer nothing
        """
        self.link.connect(0.0)
        if stopping:
            self._require_stop_accepted(self.link.run(self._protocol.stop(), stoppable=False))
        self._notify(self.link.greeting())
        state = self._state()
        self._left, self._homed = self._lengths(state), state.homed
        within = not mechanisms.kinematics_of(self.mechanism).signed_limit_excess(self._left, self.mechanism).any()
        homed = bool(state.homed)
        self._known = homed if self.controller.homing else within and (homed or state.activity != "alarm")
        return self._status(state)

    def close(self) -> None:
        """Let go of the port."""
        self.link.close()

    def status(self) -> ControllerStatus:
        """Status reported by the controller. Raises LinkLost, NoAnswer."""
        return self._status(self._state())

    @property
    def position_known(self) -> bool:
        """Whether the lengths read back can be believed, by all that was seen since it was opened."""
        return self._known

    @property
    def started_anew(self) -> bool:
        """Whether the controller has started since its position was last homed or confirmed, and does not say itself
        that it is homed.
        """
        return self._protocol.started_anew and not self._homed

    def lengths(self) -> Floats:
        """(n,) m or rad, as read back now."""
        return self._lengths(self._state())

    def limits(self) -> ControllerLimits | None:
        """Limits that the controller itself has, in m and rad, None where nobody says. Raises LinkLost, NoAnswer,
        FileError.
        """
        if self.controller.ini:
            return limits_of_linuxcnc_ini(Path(self.controller.ini), mechanisms.axis_units(self.mechanism))
        return self._query(self._protocol.limits)

    def limit_warnings(self) -> list[str]:
        """Lines where the controller's own limits are tighter than the rig.toml's; raises what `limits` does."""
        own = self.limits()
        return [] if own is None else tighter_controller_limit_warnings(own, self.controller, self.mechanism)

    def trust(self) -> None:
        """The operator confirms that lengths read back are true, after a start without homing or PositionLost. Raises
        Unreachable beyond ranges.
        """
        self._query(self._protocol.hello)
        try:
            self._left = move_profiles_and_path_check.require_axis_values_in_range(self.lengths(), self.mechanism)
        except Unreachable as error:
            raise Unreachable(
                "what the controller reports cannot be trusted",
                error.index,
                [str(error), OUT_OF_RANGE if has_struts(self.mechanism) else OUT_OF_JOINT_RANGE],
            ) from None
        self.link.run(self._protocol.confirm())
        self._known, self._homed = True, None

    def unlock(self) -> ControllerStatus:
        """Clear the controller's alarm, because the operator says so."""
        self._query(self._protocol.hello)
        self._accepted(self.link.run(self._protocol.unlock()), "unlocking")
        return self.status()

    def home(self) -> ControllerStatus:
        """Home every axis and wait. Raises ControllerFault with the controller's reason, MotionError where it is not at
        home then.
        """
        if not self.controller.homing:
            raise ControllerFault(CANNOT_HOME)
        with self._busy, self._guarded():
            self._query(self._protocol.hello)
            self._known = False
            self._accepted(self.link.run(self._protocol.home(self.controller.home_timeout)), "homing")
            state = self._state()
            if state.activity != "idle" or state.fault or state.homed is False:
                raise ControllerFault(
                    f"not at home: {state.controller_text}" + (f": {state.fault}" if state.fault else "")
                )
            lengths, home = self._lengths(state), self.controller.home
            if home is not None and np.abs(lengths - home).max() > self.controller.tolerance:
                raise PositionLost(
                    f"after homing the {self._axes} read {self._text(lengths)}, [controller] home states "
                    f"{self._text(home)}"
                )
            self._known, self._homed, self._left = True, state.homed, lengths
            return self._status(state)

    def check(self, lengths: Floats, start: Floats) -> Floats:
        """Lengths (n,) m that may be gone to from start (n,) m: ranges, step, workspace, singularities. Raises
        Unreachable.
        """
        lengths = move_profiles_and_path_check.require_axis_values_in_range(lengths, self.mechanism)
        move_profiles_and_path_check.require_safe_path(
            start, lengths, self.mechanism, self.controller.margin, self.controller.max_step, self.controller.zero
        )
        return lengths

    def move(
        self,
        lengths: Floats,
        share: float = 1.0,
        speed: float | None = None,
        report: Callable[[PositionReport], None] | None = None,
        permit: Callable[[], None] | None = None,
    ) -> FinishedMove:
        """Move all struts to lengths (n,) m, together, at a share of their greatest speeds, and wait until the
        read-back agrees.

        speed : m/s of the strut that moves most, in place of a share; report : takes every read-back on the way
        permit : called just before the move begins, when a `stop` that follows ends the move; raises what forbids it
        Raises ValueError for a speed that a strut may not have, Unreachable before anything moves; PositionLost,
        ControllerFault, Stalled, LinkLost, NoAnswer, Stopped with the struts stopped. Nothing is clipped.
        """
        if not 0 < share <= 1:
            raise ValueError(f"share must be above 0 and at most 1, got {share}")
        target = move_profiles_and_path_check.require_axis_values_in_range(lengths, self.mechanism)
        with self._busy:
            start = self._ready()
            self.check(target, start)
            if speed is not None:
                share = speed_fraction_of_move(start, target, speed, self.controller, self.mechanism)
            if permit is not None:
                permit()
            begun = self.clock.now()
            with self._guarded():
                note = self._go(
                    straight_move_segment(start, target, share, self.controller, self.mechanism), start, target, report
                )
                self._left = arrived = self.lengths()
            return FinishedMove(arrived, begun, self.clock.now(), note)

    def stop(self) -> ControllerStatus:
        """Stop every strut, from any thread; a move under way elsewhere ends with Stopped."""
        with suppress(LinkLost):  # then connecting anew is tried below
            self.link.interrupt()
        with self._busy:
            self.link.resume()
            self._halt()
            return self.status()

    def _ready(self) -> Floats:
        """(n,) m or rad from which a move may start. Raises PositionLost, ControllerFault."""
        same, state = self._query(self._protocol.fence), self._state()
        self._known = self._known and same and not (self._homed and state.homed is False)
        if (
            state.activity != "idle" or state.fault
        ):  # what keeps it from homing, too, is said before what homing would mend
            raise ControllerFault(f"not ready to move: {self._trouble(state)}")
        if not same:
            raise PositionLost(ANEW)
        if not self._known:
            raise PositionLost(f"the position of the {self._axes} is not known; {TRUST}")
        lengths = self._lengths(state)
        if self._left is not None and np.abs(lengths - self._left).max() > self.controller.tolerance:
            self._known = False
            raise PositionLost(
                f"the {self._axes} read {self._text(lengths)}, they were left at {self._text(self._left)}; {TRUST}"
            )
        return lengths

    def _go(
        self, segment: Segment, start: Floats, target: Floats, report: Callable[[PositionReport], None] | None
    ) -> str:
        """Send a move and watch it; a move that the read-back shows was never begun is sent again. Returns a note."""
        note = ""
        for _ in range(TRIES):
            try:
                verdict = self.link.run(self._protocol.move(segment))
            except LinkLost as error:
                verdict = Verdict(None, str(error))
            if self._watch(start, target, verdict, report):
                return note or ("" if verdict.accepted else f"reply lost, move completed: {verdict.reason}")
            note = f"resent, as nothing had moved: {verdict.reason}"
            self._notify(note)
        raise Stalled(f"sent {TRIES} times, and nothing moved: {verdict.reason}")

    def _watch(
        self, start: Floats, target: Floats, verdict: Verdict, report: Callable[[PositionReport], None] | None
    ) -> bool:
        """True when the struts have arrived, False when they never began and no answer came."""
        if verdict.accepted is False:
            raise ControllerFault(f"the move was refused: {verdict.reason}; sent: {bytes_as_text(self.link.sent)}")
        begun = since = self.clock.now()
        closest = before = np.inf
        while True:
            requested = self.clock.now()
            state = self._state()
            lengths = self._lengths(state)
            if report is not None:
                report(PositionReport(requested, self.clock.now(), lengths))
            off = np.abs(lengths - target).max()
            if any(t >= begun and text == "restarted" for t, text in list(self.link.events)):
                self._same()
            if state.fault or state.activity in ("alarm", "off", "held", "homing"):
                raise ControllerFault(f"while moving: {self._trouble(state)}{self._lately(begun)}")
            if self._homed and state.homed is False:
                self._known = False
                raise PositionLost(f"while moving: it is no longer homed ({state.controller_text}); {TRUST}")
            if (
                state.activity == "idle"
                and off <= self.controller.tolerance
                and (off <= STANDING or before - off <= STANDING)
            ):
                return True
            before = off
            if off < closest - PROGRESS:
                closest, since = off, self.clock.now()
            elif self.clock.now() - since > STILL:
                self._same()  # what was sent has been dealt with, and what is read now is no older answer
                state = self._state()
                lengths = self._lengths(state)
                if np.abs(lengths - target).max() < closest - PROGRESS:
                    continue
                if (
                    state.activity == "idle"
                    and verdict.accepted is None
                    and np.abs(lengths - start).max() < self.controller.tolerance
                ):
                    return False
                raise Stalled(
                    f"the {self._axes} stand at {self._text(lengths)}, "
                    f"{greatest_distance_text(lengths - target, self.mechanism)} from where they were commanded to go "
                    f"({state.controller_text}){self._lately(begun)}"
                )
            self.clock.sleep(POLL)

    def _same(self) -> None:
        """Have all that was sent dealt with. Raises PositionLost where the controller has started anew."""
        if not self._query(self._protocol.fence):
            self._known = False
            raise PositionLost(ANEW)

    def _query(self, question: Callable[[], Dialogue[T]], stoppable: bool = True, patience: float = PATIENCE) -> T:
        """Result of a dialogue that moves nothing, reconnecting where the connection is lost."""
        try:
            return self.link.run(question(), stoppable)
        except LinkLost as error:
            self._notify(f"{error}; connecting anew")
        self.link.connect(patience)
        if not stoppable:  # a stop comes before all else; it is asked for once more below
            try:
                self.link.run(self._protocol.stop(), stoppable)
            except (NoAnswer, ControllerFault) as error:
                self._notify(f"{error}; the stop is repeated")
        same = self.link.run(self._protocol.fence(), stoppable)
        self._notify(f"connected anew: {self.link.run(self._protocol.hello(), stoppable)}")
        if not same:
            self._known = False
            raise PositionLost(f"the connection was lost and the controller has restarted; {TRUST}")
        return self.link.run(question(), stoppable)

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        """Stops the struts when anything is raised within, an interrupt from the keyboard too."""
        try:
            yield
        except BaseException as error:
            try:
                self._halt()
            except MotionError as failed:
                self._left = None
                error.add_note(f"the {self._axes} could not be stopped: {failed}")
                self._notify(error.__notes__[-1])
                if isinstance(error, LinkLost) and isinstance(failed, PositionLost):  # why, and what to do
                    raise PositionLost(f"{error}; {failed}") from error
            raise

    def _halt(self) -> None:
        """Stop the struts, and record their position."""
        self._require_stop_accepted(self._query(self._protocol.stop, stoppable=False, patience=SHORT_PATIENCE))
        state = self._state(stoppable=False)
        self._left = self._lengths(state)
        if state.activity == "alarm":
            self._known = False

    def _require_stop_accepted(self, verdict: Verdict) -> None:
        if verdict.accepted is None:
            raise ControllerFault(f"the {self._axes} may still move: {verdict.reason}")

    def _accepted(self, verdict: Verdict, what: str) -> None:
        if not verdict.accepted:
            raise ControllerFault(f"{what} failed: {verdict.reason}")

    def _state(self, stoppable: bool = True) -> State:
        return self._query(self._protocol.state, stoppable)

    def _lengths(self, state: State) -> Floats:
        return cast(Floats, state.positions) + self.controller.zero

    def _status(self, state: State) -> ControllerStatus:
        return ControllerStatus(
            state.activity, self._lengths(state), self._known, state.fault, state.controller_text, state.homing_required
        )

    def _trouble(self, state: State) -> str:
        advice = operator_advice(state.activity, self.controller.homing, state.homing_required)
        return f"{state.fault or state.activity} ({state.controller_text}){advice}"

    def _text(self, values: Floats) -> str:
        return axis_values_text(values, self.mechanism)

    def _lately(self, since: float) -> str:
        return "".join(f"; {text}" for t, text in self.link.events if t >= since)
