"""Options that name input files, and their reading; what commands print: escaped text, and the display of progress."""

from __future__ import annotations

import os
import sys
import threading
import time
from argparse import SUPPRESS, ArgumentParser, Namespace
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TextIO, cast

from rig.errors import RigError
from rig.formats.number_parsing_and_rounding import parse_whole_number
from rig.formats.output_files.atomic_file_and_manifest import escape_unprintable, file_digest

if TYPE_CHECKING:
    from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
    from calib.online.measuring_limb_poses_checked_by_vision import LimbSource
    from rig.effects.catalogue.effect_list import Plugin
    from rig.effects.texts.effect_text_parsing import Kinds
    from rig.recording.recording_folder import Recording
    from rig.report.verdict_and_refutations import Refutation, State


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
def escaped_output() -> Iterator[None]:
    """Context manager: control characters in standard output and error are escaped.

    Either stream may be absent.
    """
    with ExitStack() as stack:
        if sys.stdout is not None:
            stack.enter_context(redirect_stdout(cast(TextIO, EscapedStream(unescaped_stream(sys.stdout)))))
        if sys.stderr is not None:
            stack.enter_context(redirect_stderr(cast(TextIO, EscapedStream(unescaped_stream(sys.stderr)))))
        yield


def unescaped_stream(stream: TextIO) -> TextIO:
    """Unescaped stream beneath an Escaped one, for displays that move the cursor; any other stream itself."""
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
        self.from_then, self.said = self.began + silent, self.began

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
        if now - self.said >= self.every:
            self.said = now
            print(progress_line(label, done, of, now - self.began), file=sys.stderr, flush=True)

    def close(self) -> None:
        """Take the bar away."""
        if self.timer is not None:
            self.timer.cancel()
        if self.bar is not None:
            self.bar.close()
        self.bar, self.label, self.timer = None, None, None


def print_compilation_notice() -> None:
    """Print a notice that code is being compiled, which takes up to a minute after installation.

    On a terminal, or where lines are asked for; in a pipe the first line on the error output stays the command's own
    """
    if Progress.shown == "lines" or Progress.shown == "auto" and sys.stderr.isatty():
        from tqdm import tqdm

        tqdm.write("compiling for this computer, once: up to a minute", file=unescaped_stream(sys.stderr))


def progress_line(label: str, done: int, total: int, elapsed: float) -> str:
    """Line of progress: share done and estimated time left. elapsed : s"""
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


CHECK_EVERY = 5  # poses between two checks by vision


def add_recording_argument(parser: ArgumentParser, text: str | None = None) -> None:
    """Add the recording argument REC, and the options that leave out frames or images. text : help, or None."""
    parser.add_argument("recording", metavar="REC", type=Path, help=text)
    _add_left_out(parser)


def add_recordings_argument(parser: ArgumentParser) -> None:
    """Add the arguments REC.., several recordings of one rig: `recording` is the first, `further` the others."""
    parser.add_argument("recording", metavar="REC", type=Path)
    parser.add_argument(
        "further",
        metavar="REC",
        type=Path,
        nargs="*",
        help="more recordings of the same rig, in the order in which they were "
        "taken: days apart, with other payloads, cameras moved between them or not",
    )
    _add_left_out(parser)


def _add_left_out(parser: ArgumentParser) -> None:
    parser.add_argument("--skip-unreadable", action="store_true", help="exclude, and list, unusable images")
    parser.add_argument(
        "--mask", metavar="FRAMES", help="exclude these frames, for example 3,7-9: those known to be spoilt"
    )


def read_recording(arguments: Namespace, path: Path | None = None) -> Recording:
    """Read a recording, by default that of the arguments; omitted images are named on standard error."""
    import rig

    found = rig.load(path or arguments.recording, arguments.skip_unreadable, arguments.mask)
    for image in found.skipped:
        print(f"excluded, as requested: {image.path}: {image.problem}", file=sys.stderr)
    return found


def add_anyway_option(parser: ArgumentParser) -> None:
    """Add the option --anyway, which continues in spite of mistakes in the recording."""
    parser.add_argument(
        "--anyway",
        action="store_true",
        help="continue although the recording shows a mistake that makes results meaningless",
    )


def read_recordings(arguments: Namespace) -> list[Recording]:
    """The Recordings of the arguments that `add_recordings_argument` adds. Raises RigError for --mask with several"""
    if arguments.further and arguments.mask is not None:
        raise RigError(
            "--mask names frames of one recording; with several, mask them one by one (rig measure REC "
            "--mask FRAMES --out ..)"
        )
    return [read_recording(arguments, path) for path in (arguments.recording, *arguments.further)]


def notice_printer(progress: Progress) -> Callable[[str], None]:
    """Function that prints a notice line of a computation, the progress bar removed first."""

    def notice(line: str) -> None:
        progress.close()
        print(line, flush=True)

    return notice


def add_earlier_option(parser: ArgumentParser, name: str, dest: str, read: Callable[[str], object]) -> None:
    """Add an option under its earlier name, which help does not list. dest : of the option; read : parses its value"""
    parser.add_argument(name, dest=dest, type=read, default=SUPPRESS, help=SUPPRESS)


def add_limb_options(parser: ArgumentParser) -> None:
    """Add the limb options to a parser: --limbs FILE as the source of poses, --check N for vision checks."""
    parser.add_argument(
        "--limbs",
        metavar="FILE",
        type=Path,
        help="poses from measuring limbs that `rig limbs test` accepted and saved here; "
        "vision checks some, and the acceptance is withdrawn where they no longer agree",
    )
    parser.add_argument(
        "--vision-every",
        dest="check",
        type=parse_whole_number,
        metavar="N",
        help=f"with --limbs: vision measures every Nth pose at least (default {CHECK_EVERY})",
    )
    add_earlier_option(parser, "--check", "check", parse_whole_number)


def limb_source(arguments: Namespace) -> LimbSource | None:
    """Source of limb readings (--limbs) that replaces vision, None where the arguments name none. Raises RigError."""
    if arguments.check is not None and (arguments.limbs is None or arguments.check < 1):
        raise RigError("--vision-every takes a number of poses, at least 1, and --limbs")
    if arguments.limbs is None:
        return None
    from calib.online.measuring_limb_poses_checked_by_vision import LimbSource

    return LimbSource(arguments.limbs, arguments.check or CHECK_EVERY)


def add_user_effect_files_option(parser: ArgumentParser) -> None:
    """Add the option --effects FILE.py, a file of the user's own effects."""
    parser.add_argument(
        "--effects",
        metavar="FILE.py",
        type=Path,
        action="append",
        default=[],
        help="a file with user-defined effects, as `rig effects --new` writes one; it is run; may be repeated",
    )


def load_effect_files(arguments: Namespace) -> tuple[Plugin, ...]:
    """Load the effect files that --effects names. Raises FileError, with the line, for an error in one."""
    if not arguments.effects:
        return ()
    from rig.effects.texts.user_effect_file_loading import load_effect_file

    return tuple(load_effect_file(path) for path in arguments.effects)


def known_effects(effect_files: tuple[Plugin, ...]) -> Kinds:
    """Known effects {name: class}: catalogue and effect files. Raises FileError for a name given twice."""
    if not effect_files:
        from rig.effects.catalogue.effect_list import BY_NAME

        return BY_NAME
    from rig.effects.catalogue.effect_list import catalogue_with_files

    return catalogue_with_files(effect_files)


def load_calibration(path: Path, effect_files: tuple[Plugin, ...], several_hands: bool = False) -> Calibration:
    """Load a calibration that may use effects of these files. Raises RigError where such a file has changed since."""
    from calib.files import calibration_file

    found = calibration_file.load(path, known_effects(effect_files), several_hands)
    hashes = found.provenance.get("inputs_sha256", {}).values()
    used = {effect.name for effect in found.physics.effects} if found.physics is not None else set()
    for plugin in effect_files:
        if plugin.sha256 not in hashes and used & {kind.name for kind in plugin.kinds}:
            raise RigError(f"{plugin.path} has changed since {path} was made from it; use that file, or recalibrate")
    return found


def calibration_of_arguments(arguments: Namespace) -> Calibration:
    """Calibration that the argument CALIBRATION names, with the effects of --effects, of one hand or, where the command
    has --hand, several. Raises as `load_calibration`
    """
    return load_calibration(arguments.calibration, load_effect_files(arguments), "hand" in arguments)


def read_and_print_refutations(path: Path) -> tuple[Refutation, ...]:
    """Read the refutations of a calibration file, and print each as a warning.

    Raises FileError for an invalid list.
    """
    from rig.report.verdict_and_refutations import refutations_of_file

    found = refutations_of_file(path)
    print_refutations(path, found)
    return found


def print_refutations(path: Path, refutations: tuple[Refutation, ...]) -> None:
    """Print on the error output what later recordings found against a calibration's file."""
    for one in refutations:
        print(f"warning: {path} was {one.line}", file=sys.stderr)


def write_refutation(
    arguments: Namespace, path: Path, recording: str, finding: str, state: State | None = None
) -> None:
    """Write a refutation of a calibration by a recording's finding into its folder; warns where that fails.

    finding : a sentence without its full stop; state : BAD (None), or CHECK where it leaves something out
    """
    from rig.report.verdict_and_refutations import NAME, Refutation, State, add_refutation

    state = State.BAD if state is None else state

    new = Refutation(
        file_digest(path), path.name, datetime.now(UTC).date().isoformat(), arguments.command, recording, finding, state
    )
    try:
        add_refutation(arguments.outputs.file(path.parent / NAME, own=True), path.parent, new)
    except RigError as error:
        print(f"warning: {path} was {new.line}; that could not be written next to it: {error}", file=sys.stderr)
        return
    print(
        f"{path} is marked as {'refuted' if state == State.BAD else 'doubted'} in {path.parent / NAME}", file=sys.stderr
    )
