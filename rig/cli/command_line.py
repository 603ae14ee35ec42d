"""Command line `rig`: lists the commands, imports the chosen one, runs it, returns its exit status."""

import argparse
import errno
import importlib
import io
import os
import signal
import sys
import threading
from collections.abc import Collection, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, redirect_stdout, suppress
from pathlib import Path
from typing import NoReturn, TextIO, TypeVar, cast

from rig.cli.shared.argument_parser_and_common_options import Parser, add_common_options, join_negative_numbers
from rig.errors import RigError
from rig.formats.output_files import STANDARD_OUTPUT, CommandOutputs

UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
WRITTEN = (
    "next",
    "out",
    "page",
    "truth",
    "state",
    "history",
    "draw",
    "stl",
    "rerun",
)  # arguments that name what is written; all else is read

S = TypeVar("S", bound=int | str | None)  # an exit status
COMMANDS = {
    "new": "A rig.toml from four questions, or from options when not interactive.",
    "check": "All errors and implausible values of a recording, at once, with remedies.",
    "import": "A recording from existing files: folders of images, tables in any dialect, units and clocks; and a "
    "recipe of it.",
    "measure": "Images or corners of a recording -> platform poses with covariance, cameras adjusted.",
    "calibrate": "A recording -> calibration.json: geometry and corrections, with held-out figures.",
    "diagnose": "A recording -> its unmodelled effects: where, which, how large, and the evidence.",
    "blind": "Blind cases of the diagnosis on simulated rigs, and their score.",
    "correct": "Wanted poses -> the strut lengths to command for them.",
    "kinematics": "An arm's poses of joint values, or all joint values of poses, step by step in one global frame.",
    "posture": "A redundant arm's posture for sensing or exerting force, with the hand fixed.",
    "wrench": "The wrench on an arm's hand, from its joints' torques or motor currents: force and moment with "
    "covariance.",
    "verify": "A calibration verified by a recording not used for it: error before and after.",
    "investigate": "Automatic investigation: plan, diagnosis, the most informative experiment, repeated, up to a "
    "certificate.",
    "watch": "Small visits compared with a calibration day by day: whether it still holds, what changed, what to "
    "remeasure.",
    "certify": "What a calibration promises of all poses in a volume, from recordings held out: a certificate.",
    "workspace": "What a calibration does to the workspace: lost, gained, room to limits, singularities, error bounds.",
    "lens": "Photographs of a board -> one camera's lens: models compared, a [[camera]] block.",
    "simulate": "A simulated rig under a plan -> a recording, and its truth separately.",
    "emulate": "An emulated controller, at a pseudo-terminal or over TCP, with faults on request.",
    "run": "A plan executed on the real machine: moved, settled, grabbed, journalled, measured during the run.",
    "go": "The platform sent to one pose through a calibration: corrected lengths, checked.",
    "jog": "Struts moved a little, checked as any move.",
    "home": "All struts homed.",
    "stop": "The struts stopped now, and any process that moves them.",
    "status": "The status of the controller; nothing moves.",
    "plan": "Which configurations to visit so that the parameters are observable.",
    "online": "A recording's poses learnt one at a time: the current estimate of the machine, and sudden changes.",
    "insitu": "Measuring limbs tested against vision; once they pass, saved to replace it.",
    "closure": "More lengths than six: which six give the pose, and closure errors of the others.",
    "export": "A calibrated geometry for other programs: genhexkins, URDF, JSON, CSV.",
    "view": "One frame of a recording with markers, axes and residuals drawn in; or all of it in three dimensions, "
    "as a page or for Rerun.",
    "index": "One page of all pages below a folder, each with its verdict.",
    "design": "A sensible rig.toml from a radius: cubes and cameras placed.",
    "print": "The cubes of a rig.toml as nets to print, true to scale.",
    "check-print": "A photograph of a printed sheet -> the true side of its markers.",
    "effects": "The known unmodelled effects: place, parameters, experiment that exposes them, remedy.",
    "catalogue": "The known unmodelled effects, as a document: model, parameters, experiment and remedy of each.",
    "doctor": "Requirements of rig on this computer: packages, OpenGL, cameras, ports, space, threads.",
    "completion": "The script that makes bash, zsh or fish complete rig's commands and options.",
}


def main(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit status: 0 done, 1 refused, 2 wrong usage, 130 interrupted.

    Raises SystemExit where help was asked for or the usage is wrong
    """
    from rig.cli.shared.input_options_and_output_display import escaped_output

    with escaped_output():
        return _main(join_negative_numbers(sys.argv[1:] if argv is None else argv))


def _main(argv: list[str]) -> int:
    """See `main`."""
    chosen = next((word for word in argv if not word.startswith("-")), None)
    parser = command_line_parser([chosen] if chosen else [], tuple(argv))
    try:
        if chosen is not None and chosen not in COMMANDS:
            parser.unknown(chosen, COMMANDS)
        arguments = parser.parse_args(argv)
        if arguments.command is None:
            parser.print_help()
            return _flushed("rig", 2)
    except SystemExit as end:
        raise SystemExit(_flushed("rig", end.code)) from None
    except OSError as error:
        return _failed(f"rig: standard output: {error.strerror}")
    arguments.argv, arguments.all_commands, arguments.call = argv, lambda: command_line_parser(COMMANDS), main
    return _run(arguments)


def command_line_parser(expanded_commands: Collection[str], words: tuple[str, ...] = ()) -> Parser:
    """Parser of the command line. expanded_commands : those with their own arguments; words : the words to parse"""
    parser = Parser(
        prog="rig",
        description="Vision-measured calibration of robots that move a platform on struts, and of arms.",
        epilog="A recording is a folder with rig.toml, frames.csv, commands.csv and images or corners.csv; "
        "SI units and radians throughout.",
    )
    parser.words = words
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and end")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    for name, text in COMMANDS.items():
        sub = commands.add_parser(name, help=text, description=text)
        if name in expanded_commands:  # the others' arguments do not matter, so their files stay shut
            module = importlib.import_module(f"rig.cli.{name.replace('-', '_')}")
            module.arguments(sub)
            add_common_options(sub, name)
            sub.set_defaults(run=module.run)
            parser.command, sub.words = sub, words
    return parser


def run_script() -> NoReturn:
    """Entry point of the `rig` script: run `main` and end the process with its exit status.

    Products of matrices take one thread unless the environment says otherwise: several wait for each other, for cores
    that other processes use, ten times as long as they save.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    status = main()
    if status > 128:
        os._exit(status)
    sys.exit(status)


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        """Print the version, which is read only when requested, and end."""
        from importlib.metadata import version

        print(f"rig {version('rig')}")
        parser.exit()


class Ended(KeyboardInterrupt):
    """This process was requested to end; number : of the signal."""

    def __init__(self, number: int) -> None:
        self.number = number


def _run(arguments: argparse.Namespace) -> int:
    """The exit status of a command; what it has written is in its place before this returns."""
    name = f"rig {arguments.command}"
    asked = _for_programs(arguments)
    try:
        if any(getattr(arguments, written, None) for written in WRITTEN):
            _require_utf8([*arguments.argv, os.path.realpath(".")])
        if asked and getattr(arguments, "out", None) == STANDARD_OUTPUT:
            raise RigError("--json and --out - both write to the standard output; name a file, or omit --json")
        with (
            _signals(),
            CommandOutputs(
                arguments.command, arguments.argv[1:], _read(arguments), getattr(arguments, "overwrite", False)
            ) as outputs,
        ):
            arguments.outputs = outputs
            with _reader_may_leave(name, outputs), _words(arguments), _compiling(), _workers(arguments):
                status = arguments.run(arguments) or 0
        if outputs.pages:
            from rig.report.pages.page_templates_and_elements import refresh_indices

            refresh_indices(outputs.pages)
        if asked and arguments.result is not None:
            from rig.cli.shared.argument_parser_and_common_options import print_json

            print_json(arguments.result)
        return _flushed(name, status)
    except RigError as error:
        return _failed(f"{name}: {error}")
    except BrokenPipeError:
        _flushed("", 1)
        return 1
    except MemoryError:
        return _failed(f"{name}: there is not enough memory for this")
    except OSError as error:
        if _flushed(name, 0):
            return 1
        where = error.filename or (
            "standard output" if error.errno in UNWRITABLE else ""
        )  # files are written where a FileError names them
        return _failed(f"{name}: {f'{where}: ' if where else ''}{error.strerror or error}")
    except Ended as end:
        return _failed(f"{name}: ended by signal {end.number}", 128 + end.number)
    except KeyboardInterrupt:
        return _failed(f"{name}: interrupted", 130)


@contextmanager
def _reader_may_leave(name: str, outputs: CommandOutputs) -> Iterator[None]:
    """Within it a command that writes files finishes them though the reader of its standard output is gone, which is
    then reported.
    """
    from rig.cli.shared.input_options_and_output_display import StandardOutput

    out = StandardOutput(sys.stdout or io.StringIO(), lambda: outputs.in_use)
    with redirect_stdout(cast(TextIO, out)):
        yield
        out.flush()
    if out.closed_by_reader:
        with suppress(OSError):
            print(
                f"{name}: standard output was closed before all was printed; the files that this command "
                "writes are complete",
                file=sys.stderr,
            )


def _compiling() -> AbstractContextManager[None]:
    """Context in which compilation, which takes time, is announced once."""
    from rig.cli.shared.input_options_and_output_display import print_compilation_notice
    from rig.compute.numba_kernels_and_lazy_exports import announce_compilation

    return announce_compilation(print_compilation_notice)


def _workers(arguments: argparse.Namespace) -> AbstractContextManager[None]:
    """Within it those work for a command who were asked for."""
    if "workers" not in arguments:
        return nullcontext()
    from rig.cli.shared.argument_parser_and_common_options import use_requested_workers

    return use_requested_workers(arguments)


def _require_utf8(words: list[str]) -> None:
    """Raise RigError for a name of a file that is no UTF-8: what is written names what it was made from, and is
    UTF-8.
    """
    for word in words:
        try:
            word.encode("utf-8")
        except UnicodeEncodeError:
            raise RigError(f"{word}: this name is not UTF-8; rename that file or folder") from None


def _for_programs(arguments: argparse.Namespace) -> bool:
    """Whether a command that leaves its result in `arguments.result` is to print it as JSON."""
    return getattr(arguments, "json", False) and "result" in vars(arguments)


@contextmanager
def _words(arguments: argparse.Namespace) -> Iterator[None]:
    """Within it what a command prints goes where its user wants words: nowhere with --quiet, unless it is the result
    that was asked for; to the error output where the result is printed as JSON once the command is done."""
    from rig.cli.shared.input_options_and_output_display import Progress

    out, quiet = getattr(arguments, "out", ""), getattr(arguments, "quiet", False)
    aside = _for_programs(arguments)
    before, Progress.shown = (
        Progress.shown,
        "none" if quiet or Progress.shown == "none" else getattr(arguments, "progress", "auto"),
    )
    try:
        if quiet and (
            aside or out is not None and not getattr(arguments, "json", False)
        ):  # without --out the result itself is printed
            with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere):
                yield
        else:
            with redirect_stdout(sys.stderr) if aside or out == STANDARD_OUTPUT else nullcontext():
                yield
    finally:
        Progress.shown = before


def _read(arguments: argparse.Namespace) -> list[Path]:
    """The paths that a command reads."""
    named = [value for name, value in vars(arguments).items() if name not in WRITTEN]
    return [
        path for value in named for path in (value if isinstance(value, list) else [value]) if isinstance(path, Path)
    ]


@contextmanager
def _signals() -> Iterator[None]:
    """Within it a signal to end is an exception, so that what was begun is cleared away; threads but the first cannot
    ask for that.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, _: object) -> None:
        raise Ended(number)

    numbers = [number for number in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(number) == signal.SIG_DFL]
    for number in numbers:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in numbers:
            signal.signal(number, signal.SIG_DFL)


def _failed(message: str, status: int = 1) -> int:
    with suppress(OSError):  # where the error output is full as well, the status alone can tell
        print(message, file=sys.stderr, flush=True)
    _flushed("", status)
    return status


def _flushed(name: str, status: S) -> S | int:
    """The status, once all output is flushed; 1 where it cannot be printed, which is reported on the error output."""
    if sys.stdout is None:
        return status
    try:
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        message = ""
    except OSError as error:
        message = f"{name}: standard output cannot be written: {error.strerror}"
    from rig.cli.shared.input_options_and_output_display import discard_output

    discard_output(sys.stdout)
    if name and message:
        with suppress(OSError):
            print(message, file=sys.stderr, flush=True)
    return status or 1
