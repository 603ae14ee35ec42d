"""Escaped output of commands, progress, a table of errors, and refutations.

Escaped text, progress, held-out errors as a table, and refutations, which are written too.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TextIO, cast

from rig.errors import RigError
from rig.formats.output_files.atomic_file_writing_and_process_locks import escape_unprintable
from rig.formats.output_files.staged_folder_and_manifest import file_sha256_or_empty
from rig.report.axis_places_with_joint_names import text_with_joint_names

if TYPE_CHECKING:
    from calib.certification.held_out_pose_error_statistics import HeldOut
    from rig.report.verdict_refutations_and_result_display import Refutation, State
    from vision.recording_adjustment_with_hand_and_stages import Measurement


class EscapedStream:
    """A stream to which control characters are written as escapes, and what its encoding lacks too.

    stream : where it goes; controls : the same for those of the project's own displays that move a terminal's cursor
    """

    def __init__(self, stream: TextIO) -> None:
        self.controls = stream

    def write(self, text: str) -> int:
        """Print a text, escaped; its length."""
        shown = escape_unprintable(text)
        encoding = getattr(self.controls, "encoding", None) or "utf-8"
        self.controls.write(shown.encode(encoding, "backslashreplace").decode(encoding))
        return len(text)

    def __getattr__(self, name: str) -> object:
        return getattr(self.controls, name)


@contextmanager
def escape_control_characters_in_output() -> Iterator[None]:
    """Escape control characters in standard output and error (context manager).

    Either stream may be absent.
    """
    with ExitStack() as stack:
        if sys.stdout is not None:
            stack.enter_context(redirect_stdout(cast(TextIO, EscapedStream(unescaped_stream(sys.stdout)))))
        if sys.stderr is not None:
            stack.enter_context(redirect_stderr(cast(TextIO, EscapedStream(unescaped_stream(sys.stderr)))))
        yield


def unescaped_stream(stream: TextIO) -> TextIO:
    """Unescaped stream beneath an Escaped one.

    For displays that move the cursor.
    Any other stream itself.
    """
    beneath: TextIO = getattr(stream, "controls", stream)
    return beneath


class StandardOutput:
    """A stream that stands for standard output while a command runs.

    stream : what it prints to; writes_files : whether the command writes files by now. Once the reader has closed the
    pipe, printing is discarded where it does (`closed` is true from then on); where it does not, BrokenPipeError is
    raised, since nobody is left to work for.
    """

    def __init__(self, stream: TextIO, writes_files: Callable[[], bool]) -> None:
        self.stream, self.writes_files, self.closed_by_reader = stream, writes_files, False

    def write(self, text: str) -> int:
        """Print a text; its length."""
        self._attempt(lambda: self.stream.write(text))
        return len(text)

    def flush(self) -> None:
        """Print what waits in the buffer."""
        self._attempt(self.stream.flush)

    def _attempt(self, action: Callable[[], object]) -> None:
        try:
            action()
        except BrokenPipeError:
            if not self.writes_files():
                raise
            discard_output(self.stream)
            self.closed_by_reader = True

    def __getattr__(self, name: str) -> object:
        return getattr(self.stream, name)


def discard_output(stream: TextIO) -> None:
    """Discard the output of a stream from now on, its buffer included."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


EVERY = 5.0  # s between two lines, and before the first


class Progress:
    """Bars on a terminal, nothing in a pipe and nothing in the first second: called with (label, done, of).

    shown : for all commands of this process: "auto"; "lines", one every 5 s, into pipes as well; or "none"
    """

    shown: ClassVar[str] = "auto"

    def __init__(self, silent: float = 1.0, every: float = EVERY) -> None:
        """silent : s, from now, in which no bar is shown: who is quick needs none; every : s, between lines and before
        the first
        """
        self.bar: Any = None
        self.label: str | None = None
        self.timer: threading.Timer | None = None
        self.every, self.began = every, time.monotonic()
        self.from_then, self.last_line_at = self.began + silent, self.began

    def __call__(self, label: str, done: int, of: int) -> None:
        if self.shown == "none":
            return
        if self.shown == "lines":
            self._line(label, done, of)
            return
        from tqdm import tqdm

        if label != self.label:
            self.close()
            wait = max(self.from_then - time.monotonic(), 0.0)
            self.bar, self.label = (
                tqdm(total=of, desc=label, disable=None, leave=False, file=unescaped_stream(sys.stderr), delay=wait),
                label,
            )
            if wait and not self.bar.disable:  # a bar of its own accord shows only once something is done
                self.timer = threading.Timer(wait, _show, (self.bar,))
                self.timer.daemon = True
                self.timer.start()
        self.bar.update(done - self.bar.n)
        if done >= of:
            self.close()

    def _line(self, label: str, done: int, of: int) -> None:
        now = time.monotonic()
        if label != self.label:
            self.label, self.began = label, now
        if now - self.last_line_at >= self.every:
            self.last_line_at = now
            print(progress_line(label, done, of, now - self.began), file=sys.stderr, flush=True)

    def close(self) -> None:
        """Take the bar away."""
        if self.timer is not None:
            self.timer.cancel()
        if self.bar is not None:
            self.bar.close()
        self.bar, self.label, self.timer = None, None, None


def print_compilation_notice() -> None:
    """Print a notice that code is being compiled.

    That takes up to a minute after installation. It is printed on a terminal, or where lines are asked for; in a pipe
    the first line on the error output stays the command's own
    """
    if Progress.shown == "lines" or Progress.shown == "auto" and sys.stderr.isatty():
        from tqdm import tqdm

        tqdm.write("compiling for this computer, once: up to a minute", file=unescaped_stream(sys.stderr))


def progress_line(label: str, done: int, total: int, elapsed: float) -> str:
    """Line of progress.

    Share done and estimated time left.
    elapsed : s
    """
    share = f"{label}: {done} of {total}, {100 * done // max(total, 1)} %"
    if not 0 < done < total or elapsed <= 0:
        return share
    left = elapsed * (total - done) / done
    return f"{share}, about {left / 60:.0f} min left" if left >= 120 else f"{share}, about {left:.0f} s left"


class ProgressBar(Protocol):
    """What is asked of a bar of tqdm, which has no types. delay : s before it is shown; n : how far it is"""

    delay: float
    disable: bool
    n: int

    def refresh(self) -> object:
        """Draw it again."""

    def update(self, n: int) -> object:
        """Move it on by n."""

    def close(self) -> object:
        """End it."""


def _show(bar: ProgressBar) -> None:
    bar.delay = 0  # shown from here on, so there is something to clear
    bar.refresh()


def print_held_out_errors(held_out: HeldOut, title: str) -> None:
    """Print held-out errors before and after correction as a table in mm and mrad."""
    from calib.certification.calibration_dataclass_and_claim_sentences import ratio_interval_text

    names = ("mean", "RMS", "95 %", "max")
    print(f"{title}, N = {held_out.after.n}, {held_out.configurations} distinct configurations:")
    print(f"{'':14}{'position, mm':>40}{'rotation, mrad':>43}")
    print(f"{'':14}" + "".join(f"{name:>10}" for name in names) + "   " + "".join(f"{name:>10}" for name in names))
    for name, figures in (("nominal model", held_out.before), ("corrected", held_out.after)):
        position, rotation = (figures.mean[0], *figures.position), (figures.mean[1], *figures.rotation)
        print(f"{name:14}" + "".join(map(_cell, position)) + "   " + "".join(map(_cell, rotation)))
    turned = "; rotations were not measured"
    if held_out.floor[1] < 1:
        turned = f" and {held_out.floor[1] * 1e3:.4f} mrad" if held_out.floor[1] else "; it does not turn"
    placed = f"{held_out.floor[0] * 1e3:.4f} mm" if held_out.floor[0] < 1 else ""
    words = f"{placed}{turned}" if placed else f"{turned.removeprefix(' and ')}; positions were not measured"
    print(
        f"on these poses {ratio_interval_text(held_out.ratio)}; the measured poses themselves are uncertain by {words}"
    )


def _cell(value: float) -> str:
    return f"{value * 1e3:10.4f}" if value == value else f"{'-':>10}"


def printer_with_joint_names(joint_names: Sequence[str]) -> Callable[[str], None]:
    """Function that prints a line with an arm's joint names, () for none, behind their numbers."""
    return lambda line: print(text_with_joint_names(line, joint_names))


def print_frames_without_pose(measurement: Measurement | None) -> None:
    """Print the frames without a pose of a Measurement, with their reasons."""
    if measurement is None or not measurement.unsolved:
        return
    count = len(measurement.unsolved)
    print(f"{count} frame{'s' * (count != 1)} without a pose:")
    for frame, reason in sorted(measurement.unsolved.items())[:20]:
        print(f"  frame {frame}: {reason}")
    if len(measurement.unsolved) > 20:
        print(f"  and {len(measurement.unsolved) - 20} more")


def read_and_print_refutations(path: Path) -> tuple[Refutation, ...]:
    """Read the refutations of a calibration file, and print each as a warning.

    Raises FileError for an invalid list.
    """
    from rig.report.verdict_refutations_and_result_display import refutations_of_file

    found = refutations_of_file(path)
    print_refutations(path, found)
    return found


def print_refutations(path: Path, refutations: tuple[Refutation, ...]) -> None:
    """Print the refutations of a calibration's file.

    What later recordings found against it, on the error output.
    """
    for one in refutations:
        print(f"warning: {path} was {one.line}", file=sys.stderr)


def write_refutation(
    arguments: Namespace, path: Path, recording: str, finding: str, state: State | None = None
) -> None:
    """Write a refutation of a calibration by a recording's finding into its folder.

    Warns where that fails.

    finding : a sentence without its full stop; state : BAD (None), or CHECK where it leaves something out
    """
    from rig.report.verdict_refutations_and_result_display import NAME, Refutation, State, add_refutation

    state = State.BAD if state is None else state

    new = Refutation(
        file_sha256_or_empty(path),
        path.name,
        datetime.now(UTC).date().isoformat(),
        arguments.command,
        recording,
        finding,
        state,
    )
    try:
        add_refutation(arguments.outputs.file(path.parent / NAME, own=True), path.parent, new)
    except RigError as error:
        print(f"warning: {path} was {new.line}; that could not be written next to it: {error}", file=sys.stderr)
        return
    print(
        f"{path} is marked as {'refuted' if state == State.BAD else 'doubted'} in {path.parent / NAME}", file=sys.stderr
    )
