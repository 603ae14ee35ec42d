"""Worker options of commands, and the pool.

Options --workers and --scheduler, the pool that works for them, and results as they come.
"""

from __future__ import annotations

import sys
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from typing import TypeVar

from rig.cli.shared.output_display import Progress
from rig.compute import parallel_map_and_dask_cluster
from rig.compute.worker_processes import temporary_worker_limit, terminate_child_processes, worker_count
from rig.errors import RigError
from rig.formats.numbers_and_units import parse_whole_number

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
def worker_pool() -> Iterator[Executor]:
    """Worker pool of a command (context manager).

    A pool of workers, threads that wait for processes, or the cluster.

    Calls not begun are dropped at its end.
    """
    there = parallel_map_and_dask_cluster.current_cluster()
    if there is not None:
        yield there.executor()
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
