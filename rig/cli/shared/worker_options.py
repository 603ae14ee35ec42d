"""Who does the work of a command: so many processes here, or a Dask cluster; one group of options and what they
mean.
"""

import sys
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from typing import Any

from rig.cli.shared.output_options import Progress
from rig.compute import dask_cluster
from rig.compute.worker_processes import end_child_processes, limit_workers, worker_count
from rig.errors import RigError
from rig.formats.number_parsing import parse_whole_number

MOST = 1024  # processes


def add_workers(parser: ArgumentParser) -> None:
    """Let a command be told who works for it."""
    group = parser.add_argument_group("who does the work; results are the same to the last byte")
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
def workers_at_work(arguments: Namespace) -> Iterator[None]:
    """Within it those work whom `add_workers` was told of; products of matrices take one thread, so that who works does
    not change how they are rounded. Raises RigError for a number of workers that cannot be, and what `cluster` raises
    """
    if arguments.workers is not None and not 1 <= arguments.workers <= MOST:
        raise RigError(f"--workers takes 1 to {MOST}, not {arguments.workers}")

    import scipy.linalg  # noqa: F401  libraries are limited once they are loaded
    from threadpoolctl import threadpool_limits

    with limit_workers(arguments.workers), dask_cluster.use_cluster(arguments.scheduler), threadpool_limits(1):
        yield


@contextmanager
def worker_pool() -> Iterator[Any]:
    """What runs calls at the same time: threads that wait for processes here, or the cluster. At its end what has not
    begun is dropped.
    """
    there = dask_cluster.current_cluster()
    if there is not None:
        yield there.executor()
        return
    threads = ThreadPoolExecutor(worker_count())
    try:
        yield threads
    except BaseException:
        threads.shutdown(wait=False, cancel_futures=True)
        end_child_processes()
        raise
    else:
        threads.shutdown(wait=False, cancel_futures=True)


def results_with_progress(threads: Any, function: Callable, calls: list, label: str) -> Iterator[Any]:
    """Results of calls of a function as they come, with progress on standard error. Raises what a call raises."""
    progress, start = Progress(), time.monotonic()
    waiting = [threads.submit(function, *call) for call in calls]
    for count, future in enumerate(as_completed(waiting), 1):
        result = future.result()
        if sys.stderr.isatty() or progress.shown != "auto":
            progress(label, count, len(calls))
        else:
            print(f"{label}: {count} of {len(calls)}, {time.monotonic() - start:.0f} s", file=sys.stderr, flush=True)
        yield result
