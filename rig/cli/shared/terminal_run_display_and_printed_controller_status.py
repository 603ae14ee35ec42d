"""Terminal display of a run, and the printed status of a controller."""

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

import numpy as np

from calib.online.live_learner_limb_watch_run_state_and_display import MeasuredFrame, RunDisplay, RunState
from calib.online.observer_of_run_frames import RunObserver
from calib.online.web_page_of_ongoing_run import RunPage
from rig.cli.shared.escaped_output_progress_error_table_and_refutations import unescaped_stream
from rig.driving.axis_display_units_and_controller_counts import SHOWN
from rig.driving.controller_status_and_limits import ControllerStatus
from rig.formats.numbers_and_units import count_text
from rig.formats.output_files.atomic_file_writing_and_process_locks import escape_unprintable
from rig.model.design import Design
from rig.model.pose import pose_to_vector


def print_controller_status(status: ControllerStatus, design: Design) -> None:
    """Print a ControllerStatus.

    With the pose that its lengths give by the nominal model.
    """
    from rig.driving.axis_display_units_and_controller_counts import axes_word, axis_values_text
    from rig.driving.controller_status_and_limits import operator_advice
    from rig.errors import NotConverged
    from rig.model import mechanisms
    from rig.model.pose import pose_to_vector

    homing = design.driver().homing
    fault = f" ({status.fault})" if status.fault not in ("", status.activity) else ""
    print(f"{status.activity}{fault}{operator_advice(status.activity, homing, status.homing_required)}")
    if not status.known:
        print("position not known: " + ("home it" if homing else "verify it, then use --trust"))
    m = design.mechanism
    print(f"{'lengths' if m.strut_joints is not None else axes_word(m)} {axis_values_text(status.lengths, m)}")
    if (m.plates is not None or m.strut_joints is None) and status.known:
        try:
            v = pose_to_vector(mechanisms.kinematics_of(design.mechanism).forward(status.lengths, design.mechanism))
        except NotConverged:
            print("these lengths close on no pose of the nominal model")
            return
        print(
            f"pose by the nominal model {' '.join(f'{x * 1e3:.4f}' for x in v[:3])} mm, "
            f"{' '.join(f'{x * 1e3:.4f}' for x in v[3:])} mrad"
        )


WIDTH = 30  # of an axis's bar


class PlainLineDisplay:
    """Plain lines, for pipes and logs."""

    def __init__(self, out: TextIO | None = None) -> None:
        self._out, self._phase = out or sys.stdout, ""
        self._seen: MeasuredFrame | None = None
        self._last: tuple[Any, ...] = ()

    def show(self, state: RunState) -> None:
        """A line for a new phase, a new pose, a new alarm."""
        if state.phase != self._phase and not state.phase.startswith(("settling", "exposed")):
            left = f", {_minutes_and_seconds(state.left)} left" if np.isfinite(state.left) and state.left > 0 else ""
            self._print(f"[{state.frame}{f'/{state.frames}' if state.frames else ''}] {state.phase}{left}")
        self._phase = state.phase
        if state.seen is not None and state.seen is not self._seen:
            self._seen = state.seen
            self._print("  " + " | ".join(_pose_lines(state.seen)))
        fresh = [alarm for alarm in state.alarms if alarm not in self._last]
        self._last = state.alarms
        for alarm in fresh:
            self._print(f"  ! {alarm.kind}: {alarm.text}")

    def close(self) -> None:
        """Nothing to take away."""

    def _print(self, text: str) -> None:
        print(text, file=self._out, flush=True)


class TerminalBlockDisplay:
    """A block of lines on a terminal that knows ANSI's movements."""

    def __init__(self, out: TextIO | None = None) -> None:
        self._out, self._height = unescaped_stream(out or sys.stdout), 0

    def show(self, state: RunState) -> None:
        """Draw the block anew over the one before."""
        lines = [escape_unprintable(line).replace("\n", "\\n") for line in run_state_lines(state)]
        up = f"\x1b[{self._height}A" if self._height else ""
        self._out.write(up + "".join(f"\x1b[2K{line}\n" for line in lines) + "\x1b[J")
        self._out.flush()
        self._height = len(lines)

    def close(self) -> None:
        """Leave the block where it is."""


def run_state_lines(state: RunState) -> list[str]:
    """Lines of a RunState for the terminal.

    Progress, bars of the axes, latest pose, alarms.
    """
    left = f", {_minutes_and_seconds(state.left)} left" if np.isfinite(state.left) and state.left > 0 else ""
    frames = (
        f"frame {state.frame} of {state.frames}" if state.frames else f"{count_text(state.frame, 'frame')} in motion"
    )
    lines = [f"{frames}, step {state.step} of {state.steps}{left}", state.phase]
    for (place, unit), length, goal, (low, high) in zip(
        state.places_and_units, state.lengths, state.goal, state.ranges
    ):
        scale, name = SHOWN[unit]
        at, to = (int(np.clip((value - low) / (high - low), 0, 1) * (WIDTH - 1)) for value in (length, goal))
        bar = "".join("#" if k == at else "+" if k == to else "-" for k in range(WIDTH))
        lines.append(
            f"{place} {low * scale:8.1f} |{bar}| {high * scale:8.1f} {name}   "
            f"{length * scale:9.4f} -> {goal * scale:9.4f}"
        )
    if state.seen is not None:
        lines += _pose_lines(state.seen)
    return lines + [f"! {alarm.kind}: {alarm.text}" for alarm in state.alarms[-4:]]


def _pose_lines(seen: MeasuredFrame) -> list[str]:
    """A measured frame in words: its pose, how sure that is, what each camera saw, what was expected."""
    sight = seen.sight
    cameras = ", ".join(
        f"{name} {len(d.marker)}/{len(sight.expected.get(name, d.marker))}"
        + (f" {seen.rms[name]:.3f} px" if name in seen.rms else "")
        for name, d in sight.detections.items()
    )
    if sight.T_base_platform is None:
        return [f"frame {sight.frame}: no pose: {sight.reason}", cameras]
    v = pose_to_vector(sight.T_base_platform)
    position = " ".join(f"{value * 1e3:.3f}" for value in v[:3])
    turn = " ".join(f"{value * 1e3:.3f}" for value in v[3:])
    lines = [f"frame {sight.frame}: {position} mm, {turn} mrad"]
    if sight.covariance is not None:
        sigma = np.sqrt(np.diag(sight.covariance))
        lines.append(f"+- {np.linalg.norm(sigma[:3]) * 1e6:.1f} um, {np.linalg.norm(sigma[3:]) * 1e6:.1f} urad")
    else:
        lines.append("cameras not yet adjusted")
    if seen.learnt is not None:
        error = seen.learnt.error
        lines.append(
            f"off the prediction by {np.linalg.norm(error[:3]) * 1e6:.1f} um, "
            f"{np.linalg.norm(error[3:]) * 1e6:.1f} urad "
            f"({seen.learnt.innovation:.2f} of what the learner expects by now)"
        )
    return [*lines, cameras, f"{seen.delay:.2f} s after its exposure"]


def _minutes_and_seconds(seconds: float) -> str:
    """Minutes and seconds."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


def terminal_run_display(asked: bool = False) -> PlainLineDisplay | TerminalBlockDisplay:
    """Display of a run in the terminal: a block redrawn in place, or plain lines.

    A block redrawn in place, or plain lines where standard output is a pipe, and where an operator types between them:
    asked.
    """
    return TerminalBlockDisplay() if sys.stdout.isatty() and not asked else PlainLineDisplay()


def is_operator_at_terminal() -> bool:
    """Whether somebody at a terminal can answer.

    A process in the background that reads from it is suspended.
    """
    if sys.stdin is None or not sys.stdin.isatty():
        return False
    return not hasattr(os, "tcgetpgrp") or os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()


def _take_answers(observer: RunObserver, alone: bool) -> None:
    """Hand lines that are typed at the terminal to an observer, until it ends. alone : whether nobody else answers

    Not by sys.stdin, whose lock a thread that waits for a line would hold at the end of the process.
    """
    while True:
        try:
            line = os.read(sys.stdin.fileno(), 4096)
        except OSError:  # the terminal is gone
            line = b""
        if not line:
            if alone:
                observer.ask_stop("nobody is left to answer: the terminal's input ended")
            return
        if not observer.answer(line.decode(errors="replace").strip()):
            print("not taken: nothing is asked now", flush=True)


@contextmanager
def open_terminal_and_page_run_displays(
    port: int | None, asked: bool, observer: RunObserver
) -> Iterator[list[RunDisplay]]:
    """Displays of a run, in the terminal and on a page (context manager).

    Terminal, and the page where a port is given, served while the context lasts. asked : whether an operator at them
    is asked
    """
    if asked and is_operator_at_terminal():
        threading.Thread(target=_take_answers, args=(observer, port is None), daemon=True).start()
    if port is None:
        yield [terminal_run_display(asked)]
        return
    with RunPage(observer, port) as page:
        print(f"the run's page, for this computer only: {page.url}", flush=True)
        yield [terminal_run_display(asked), page]
