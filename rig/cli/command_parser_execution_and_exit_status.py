"""Parser and execution of a command line: its command is imported and run, and the exit status returned."""

import argparse
import errno
import importlib
import io
import os
import signal
import sys
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, redirect_stdout, suppress
from pathlib import Path
from shutil import get_terminal_size
from typing import TextIO, TypeVar, cast

from rig.cli.command_names_groups_summaries_and_exit_statuses import (
    COMMANDS,
    EARLIER_NAMES,
    FAMILIES,
    SHARED_FILES,
    STATUSES,
    exit_status_text,
)
from rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion import (
    Parser,
    join_options_with_negative_numbers,
)
from rig.cli.shared.shared_output_controller_hand_and_worker_options import add_common_options
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


def command_name_in_manifests(name: str) -> str:
    """Name of a command in manifests of outputs.

    The earlier one if it has one, so that its earlier outputs are its.
    """
    return next((earlier for earlier, present in EARLIER_NAMES.items() if present == name), name)


def command_module_name(name: str) -> str:
    """Name (not imported) of the module in rig.cli that holds a command."""
    return SHARED_FILES.get(name) or name.replace("-", "_").replace(" ", "_")


def argument_adder_and_runner_of_command(
    name: str,
) -> tuple[Callable[[argparse.ArgumentParser], None], Callable[..., int | None]]:
    """The two functions of a command, imported: the one that adds its arguments to a parser, and the one that runs it.

    They are `arguments` and `run`; in a file of several commands, `arguments_of_WORD` and `run_WORD` by the last word.
    """
    module, last = importlib.import_module(f"rig.cli.{command_module_name(name)}"), name.split()[-1]
    if name not in SHARED_FILES:
        return module.arguments, module.run
    return getattr(module, f"arguments_of_{last}"), getattr(module, f"run_{last}")


def join_command_words_and_find_earlier_name(words: list[str]) -> tuple[list[str], str | None]:
    """Words of a command line with the command's own words joined to one, and its earlier name.

    `new design --radius 0.3` becomes `new design` and the rest, and so does `design --radius 0.3`. The second word is
    the command's where the two together are one: a file of that name is written ./design.

    Returns (words, the earlier name if one was used)
    """
    at = next((i for i, word in enumerate(words) if not word.startswith("-")), None)
    if at is None:
        return words, None
    if words[at] in EARLIER_NAMES:
        return [*words[:at], EARLIER_NAMES[words[at]], *words[at + 1 :]], words[at]
    both = " ".join(words[at : at + 2])
    return ([*words[:at], both, *words[at + 2 :]] if both in COMMANDS else words), None


def run_command_line_words(words: list[str], call: Callable[[list[str]], int], urgent_stop: object) -> int:
    """Run the command that the words of a command line name; see rig.cli.command_line.main.

    call : runs another command, for commands that need others; urgent_stop : as
    rig.cli.urgent_stop_before_slow_imports returns it,
    None for other commands
    """
    from rig.cli.shared.escaped_output_progress_error_table_and_refutations import escape_control_characters_in_output

    with escape_control_characters_in_output():
        return _run_words(join_options_with_negative_numbers(words), call, urgent_stop)


def _run_words(argv: list[str], call: Callable[[list[str]], int], urgent_stop: object) -> int:
    """See `run_command_line_words`."""
    argv, earlier = join_command_words_and_find_earlier_name(argv)
    chosen = next((word for word in argv if not word.startswith("-")), None)
    if earlier is not None and sys.stderr is not None and sys.stderr.isatty():
        print(f"rig {earlier} is now `rig {chosen}`", file=sys.stderr)
    parser = command_line_parser([chosen] if chosen else [], tuple(argv))
    try:
        if chosen in FAMILIES and chosen not in COMMANDS:
            seconds = [name.split()[1] for name in COMMANDS if name.startswith(f"{chosen} ")]
            parser.exit(2, f"rig {chosen}: error: name what to do: {', '.join(seconds)}\n")
        if chosen is not None and chosen not in COMMANDS:
            parser.unknown(chosen, [*COMMANDS, *FAMILIES, *EARLIER_NAMES])
        arguments = parser.parse_args(argv)
        if arguments.command is None:
            parser.print_help()
            return _flushed("rig", 2)
    except SystemExit as end:
        raise SystemExit(_flushed("rig", end.code)) from None
    except OSError as error:
        return _failed(f"rig: standard output: {error.strerror}")
    arguments.argv, arguments.all_commands, arguments.call = argv, shell_completion_parser, call
    arguments.urgent_stop = urgent_stop
    return _run(arguments)


def command_line_parser(expanded_commands: Collection[str], words: tuple[str, ...] = ()) -> Parser:
    """Parser of the command line.

    expanded_commands : those with their own arguments; words : the words to parse
    """
    parser = Parser(
        prog="rig",
        usage="rig [-h] [--version] COMMAND ...",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Vision-measured calibration of robots that move a platform on struts, and of arms.\n\n"
        + ("" if expanded_commands else _grouped_commands()),
        epilog="`rig COMMAND --help` describes one. A recording is a folder with rig.toml, frames.csv,\n"
        "commands.csv and images or corners.csv. Tables and JSON files are in SI units and radians;\n"
        'rig.toml is too, unless it states units = "mm, deg".\n\n'
        + ("" if expanded_commands else exit_status_text(get_terminal_size((80, 24)).columns)),
    )
    parser.words = words
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and end")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", prog="rig", help=argparse.SUPPRESS)
    for name, text in COMMANDS.items():
        sub = commands.add_parser(name, description=text)
        if name in expanded_commands:  # the others' arguments do not matter, so their files stay shut
            sub.set_defaults(run=_add_arguments(sub, name))
            parser.command, sub.words = sub, words
    return parser


def _grouped_commands() -> str:
    """All commands by group, as the help of `rig` lists them."""
    from rig.cli.command_names_groups_summaries_and_exit_statuses import commands_by_group_help_text

    return commands_by_group_help_text(get_terminal_size((80, 24)).columns)


def shell_completion_parser() -> Parser:
    """Parser of all commands for completion.

    Commands of two words are subcommands of the first.
    """
    parser = Parser(prog="rig")
    commands = parser.add_subparsers(dest="command")
    families: dict[str, argparse._SubParsersAction[Parser]] = {}
    for name, text in COMMANDS.items():
        first, _, second = name.partition(" ")
        if not second:
            sub = commands.add_parser(name, help=text, description=text)
            _add_arguments(sub, name)
        else:
            family = commands.choices.get(first) or commands.add_parser(first, help=f"{first} ..")
            if first not in families:
                families[first] = family.add_subparsers(dest="subcommand")
            _add_arguments(families[first].add_parser(second, help=text, description=text), name)
    return parser


def _add_arguments(parser: Parser, name: str) -> object:
    """Add a command's arguments to a parser; returns the function that runs it."""
    add_own_arguments, run = argument_adder_and_runner_of_command(name)
    add_own_arguments(parser)
    if name in STATUSES:
        parser.epilog = "Exit status {} if {}, otherwise 0.".format(*STATUSES[name])
    add_common_options(parser, name)
    return run


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
    for_programs = _for_programs(arguments)
    try:
        if any(getattr(arguments, written, None) for written in WRITTEN):
            _require_utf8([*arguments.argv, os.path.realpath(".")])
        if for_programs and getattr(arguments, "out", None) == STANDARD_OUTPUT:
            raise RigError("--json and --out - both write to the standard output; name a file, or omit --json")
        with (
            _signals(),
            CommandOutputs(
                command_name_in_manifests(arguments.command),
                arguments.argv[1:],
                _read(arguments),
                getattr(arguments, "overwrite", False),
            ) as outputs,
        ):
            arguments.outputs = outputs
            with _reader_may_leave(name, outputs), _words(arguments), _compiling(), _workers(arguments):
                status = arguments.run(arguments) or 0
        if outputs.pages:
            from rig.report.pages.page_templates_and_index_page import refresh_index_pages_above

            refresh_index_pages_above(outputs.pages)
        if for_programs and arguments.result is not None:
            from rig.cli.shared.shared_output_controller_hand_and_worker_options import print_json

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
        return _failed(f"{name}: ended by signal {end.number}{_usual_sender(end.number)}", 128 + end.number)
    except KeyboardInterrupt:
        return _failed(f"{name}: interrupted", 130)


@contextmanager
def _reader_may_leave(name: str, outputs: CommandOutputs) -> Iterator[None]:
    """Within it a command that writes files finishes them though the reader of its standard output is gone, which is
    then reported.
    """
    from rig.cli.shared.escaped_output_progress_error_table_and_refutations import StandardOutput

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
    from rig.cli.shared.escaped_output_progress_error_table_and_refutations import print_compilation_notice
    from rig.compute.numba_compilation_and_kernel_cache_folder import announce_compilation

    return announce_compilation(print_compilation_notice)


def _workers(arguments: argparse.Namespace) -> AbstractContextManager[None]:
    """Within it those work for a command who were asked for."""
    if "workers" not in arguments:
        return nullcontext()
    from rig.cli.shared.shared_output_controller_hand_and_worker_options import use_requested_workers

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
    from rig.cli.shared.escaped_output_progress_error_table_and_refutations import Progress

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

    ends = [signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])]
    numbers = [number for number in ends if signal.getsignal(number) == signal.SIG_DFL]
    for number in numbers:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in numbers:
            signal.signal(number, signal.SIG_DFL)


def _usual_sender(number: int) -> str:
    """Who sends a signal to a command that drives, in words; "" for others."""
    drives = "rig.driving.controller_lock_and_stop_of_its_holder" in sys.modules
    return " (SIGTERM, as rig stop and kill send it)" if drives and number == signal.SIGTERM else ""


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
    from rig.cli.shared.escaped_output_progress_error_table_and_refutations import discard_output

    discard_output(sys.stdout)
    if name and message:
        with suppress(OSError):
            print(message, file=sys.stderr, flush=True)
    return status or 1
