"""Options of output, controller, hand and workers that several commands share.

Outputs, controller, hand, workers with their pool; what they need of matplotlib, results printed as JSON, and results
of workers as they come.
"""

from __future__ import annotations

import sys
import time
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from rig.cli.shared.escaped_output_progress_error_table_and_refutations import Progress
from rig.compute import parallel_map_and_dask_cluster
from rig.compute.worker_processes import temporary_worker_limit, terminate_child_processes, worker_count
from rig.errors import MissingLibrary, RigError
from rig.formats.numbers_and_units import parse_number, parse_whole_number
from rig.formats.output_files import STANDARD_OUTPUT

if TYPE_CHECKING:
    from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
    from rig.formats.numbers_and_units import LengthAndAngleUnits
    from rig.recording.recording_folder import Recording
    from rig.report.pages.page_templates_and_index_page import Link


PROGRESS = ("auto", "lines", "none")
PRINTED = (
    "doctor completion",
    "doctor",
    "effects",
    "status",
)  # what they print is all they are for, so they cannot be quiet

SHARED = (
    "calibrate",
    "calibrate online",
    "certify",
    "diagnose",
    "investigate",
    "limbs test",
    "measure",
    "simulate",
    "simulate blind",
    "verify",
    "watch",
    "why",
)  # work for many


def add_common_options(parser: ArgumentParser, command: str) -> None:
    """Add the common options of all commands.

    They are --quiet and --progress, and worker options where the command uses them.
    """
    if command in SHARED:
        add_worker_options(parser)
    if command in PRINTED:
        return
    parser.add_argument(
        "--quiet", action="store_true", help="print only errors, and results requested on the standard output"
    )
    parser.add_argument(
        "--progress",
        choices=PROGRESS,
        default="auto",
        metavar="|".join(PROGRESS),
        help="progress of a command and the "
        "time left: bars on a terminal (auto), lines on the error output, pipes too, or none",
    )


SEED = 0  # of the bootstrap; results are the same from run to run


def file_or_stdout(text: str) -> Path:
    """Output file path, or standard output.

    `-` is standard output.
    """
    return STANDARD_OUTPUT if text == "-" else Path(text)


def add_overwrite_option(parser: ArgumentParser, name: str = "--force") -> None:
    """Add the option to overwrite files that the command did not make.

    name : of the option
    """
    parser.add_argument(
        name,
        dest="overwrite",
        action="store_true",
        help="overwrite files that this command did not make; it never overwrites its inputs",
    )


def add_units_option(parser: ArgumentParser, quantities_text: str) -> None:
    """Add the option --units of lengths and angles.

    quantities_text : has them, in words
    """
    parser.add_argument(
        "--units",
        metavar="mm,deg",
        type=_parse_units,
        help=f"units of lengths (m, mm, cm, um, in) and angles (rad, deg, mrad) {quantities_text} (default m,rad)",
    )


def _parse_units(text: str) -> LengthAndAngleUnits:
    from rig.formats.numbers_and_units import parse_length_and_angle_units

    try:
        return parse_length_and_angle_units(text)
    except ValueError as error:
        raise ArgumentTypeError(f"expected {error}") from None


def add_page_option(parser: ArgumentParser) -> None:
    """Add the option --page FILE."""
    parser.add_argument(
        "--page", metavar="FILE", type=Path, help="a page of it, written here: one file that needs no network"
    )


def page_path(arguments: Namespace) -> Path | None:
    """Path of the page to write, None where none is requested.

    Raises RigError where it cannot be written.
    """
    return None if arguments.page is None else arguments.outputs.file(arguments.page)


def page_links(arguments: Namespace, page_file: Path) -> list[Link]:
    """Links of a command's page.

    To the index above it and to the pages of the command's inputs.
    """
    from rig.report.pages.page_templates_and_index_page import index_and_source_links as links

    return links(page_file, arguments.outputs.inputs)


def add_json_option(parser: ArgumentParser) -> None:
    """Add the option --json."""
    parser.add_argument("--json", action="store_true", help="print the result as JSON (SI units, rad) instead of text")


def add_json_result_option(parser: ArgumentParser) -> None:
    """Add the option --json for a command that leaves its result in `arguments.result`.

    Printed at its end.
    """
    parser.add_argument(
        "--json",
        action="store_true",
        help="print the result as JSON (SI units, rad) when all is done; text goes to the error output",
    )
    parser.set_defaults(result=None)


def print_json(tree: object) -> None:
    """Print a result as JSON.

    NaN becomes null.
    """
    import json

    from rig.formats.json_toml_and_yaml_loading import nan_to_null

    print(json.dumps(nan_to_null(tree), indent=1))


def add_rig_toml_port_and_trace_arguments(parser: ArgumentParser) -> None:
    """Add the arguments RIG.toml, --port and --trace of commands that talk to the controller."""
    parser.add_argument("design", metavar="RIG.toml", type=Path)
    add_port_and_trace_options(parser)


def add_port_and_trace_options(parser: ArgumentParser) -> None:
    """Add the options --port of the controller, and --trace FILE of the bytes exchanged."""
    parser.add_argument(
        "--port", help="controller address, instead of the one in [controller]: a device, socket://.., rfc2217://.."
    )
    parser.add_argument("--trace", metavar="FILE", type=Path, help="write every byte there, with its time")


def add_speed_option(parser: ArgumentParser, usual: float) -> None:
    """Add the option --speed.

    A share of the struts' greatest speed.
    """
    parser.add_argument(
        "--speed",
        type=parse_number,
        default=usual,
        metavar="SHARE",
        help=f"of the struts' greatest speed (default {usual:g})",
    )


def add_trust_option(parser: ArgumentParser) -> None:
    """Add the option --trust, to trust the position that the controller reports.

    Though it was not homed.
    """
    parser.add_argument(
        "--trust", action="store_true", help="trust the position that the controller reports, though it was not homed"
    )


def require_matplotlib(drawings: str) -> None:
    """Require matplotlib: raise MissingLibrary where it is not installed.

    drawings : what is to be drawn, in the plural
    """
    problem = missing_matplotlib_reason()
    if problem:
        raise MissingLibrary(f"{drawings} {problem}")


def missing_matplotlib_reason() -> str | None:
    """Reason that drawings lack matplotlib, to be printed where it is missing.

    None where it is installed.
    """
    from importlib.util import find_spec

    return None if find_spec("matplotlib") else "are drawn by matplotlib: pip install 'rig[print]'"


def add_hand_option(parser: ArgumentParser) -> None:
    """Add the option --hand to a parser."""
    parser.add_argument("--hand", metavar="NAME", help="of an arm with several hands: which of them")


def recording_of_chosen_hand(arguments: Namespace, recording: Recording) -> Recording:
    """The Recording of the hand that is chosen; as it is where none is. Raises RigError for a hand that there is not"""
    from rig.recording.frame_selection_and_content_hashes import select_hand

    return recording if arguments.hand is None else select_hand(recording, arguments.hand)


def calibration_of_chosen_hand(arguments: Namespace, calibration: Calibration) -> Calibration:
    """The Calibration of the hand that is chosen. Raises RigError where there are several hands and none is chosen."""
    from rig.model.arm_hands_effect_places_and_tolerances import hand_names

    names = hand_names(calibration.correction.nominal)
    if names and arguments.hand is None:
        raise RigError(f"{arguments.calibration} is of several hands; choose one with --hand: {', '.join(names)}")
    return calibration if arguments.hand is None else calibration.of_hand(arguments.hand)


MOST = 1024  # processes
R = TypeVar("R")


def add_worker_options(parser: ArgumentParser) -> None:
    """Add the worker options --workers and --scheduler."""
    group = parser.add_argument_group("worker processes; results are identical to the last byte")
    group.add_argument(
        "--workers",
        "--jobs",
        dest="workers",
        type=parse_whole_number,
        metavar="N",
        help="processes at a time on this computer (all cores)",
    )
    group.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="of a Dask cluster (tcp://HOST:PORT) whose workers have rig and see the same "
        "folders: they read images, draw and diagnose; needs the extra rig[cluster]",
    )


@contextmanager
def use_requested_workers(arguments: Namespace) -> Iterator[None]:
    """Use the requested number of workers (context manager).

    BLAS takes one thread, so that their number does not change how sums are rounded.
    Raises RigError for a number of workers that cannot be, and what `use_cluster` raises
    """
    if arguments.workers is not None and not 1 <= arguments.workers <= MOST:
        raise RigError(f"--workers takes 1 to {MOST}, not {arguments.workers}")

    import scipy.linalg  # noqa: F401  libraries are limited once they are loaded
    from threadpoolctl import threadpool_limits

    with (
        temporary_worker_limit(arguments.workers),
        parallel_map_and_dask_cluster.use_cluster(arguments.scheduler),
        threadpool_limits(1),
    ):
        yield


@contextmanager
def open_worker_pool() -> Iterator[Executor]:
    """Worker pool of a command (context manager).

    A pool of workers, threads that wait for processes, or the cluster.

    Calls not begun are dropped at its end.
    """
    cluster = parallel_map_and_dask_cluster.current_cluster()
    if cluster is not None:
        yield cluster.executor()
        return
    threads = ThreadPoolExecutor(worker_count())
    try:
        yield threads
    except BaseException:
        threads.shutdown(wait=False, cancel_futures=True)
        terminate_child_processes()
        raise
    else:
        threads.shutdown(wait=False, cancel_futures=True)


def results_with_progress(
    pool: Executor, function: Callable[..., R], calls: Sequence[tuple[object, ...]], label: str
) -> Iterator[R]:
    """Results of calls as they complete, with progress on standard error.

    Raises what a call raises.
    """
    progress, start = Progress(), time.monotonic()
    waiting = [pool.submit(function, *call) for call in calls]
    for count, future in enumerate(as_completed(waiting), 1):
        result = future.result()
        if sys.stderr.isatty() or progress.shown != "auto":
            progress(label, count, len(calls))
        else:
            print(f"{label}: {count} of {len(calls)}, {time.monotonic() - start:.0f} s", file=sys.stderr, flush=True)
        yield result
