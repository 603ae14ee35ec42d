"""Calls at the same time: by threads that wait for processes here, or on a Dask cluster; with progress."""

import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from typing import Any

from rig.commands.output import Progress
from rig.errors import MissingLibrary, RigError
from rig.processes import end_waiting


@contextmanager
def pool(scheduler: str | None, jobs: int) -> Iterator[Any]:
    """What runs calls at the same time: threads that wait for processes here, or a Dask cluster. At its end what has not begun is dropped.

    Raises MissingLibrary without Dask, RigError where no scheduler answers.
    """
    if scheduler is None:
        workers = ThreadPoolExecutor(jobs)
        try:
            yield workers
        except BaseException:
            workers.shutdown(wait=False, cancel_futures=True)
            end_waiting()
            raise
        finally:
            workers.shutdown(wait=False, cancel_futures=True)
        return
    try:
        from dask.distributed import Client
    except ImportError:
        raise MissingLibrary("--scheduler needs Dask: pip install distributed") from None
    try:
        client = Client(scheduler, timeout=20)
    except (OSError, ValueError) as error:
        raise RigError(f"no Dask scheduler answers at {scheduler}: {error}") from None
    with client:
        yield client.get_executor(pure=False)


def each(workers: Any, function: Callable, calls: list, label: str) -> Iterator[Any]:
    """Results of calls of a function as they come, with progress on standard error. Raises what a call raises."""
    progress, start = Progress(), time.monotonic()
    waiting = [workers.submit(function, *call) for call in calls]
    for count, future in enumerate(as_completed(waiting), 1):
        result = future.result()
        if sys.stderr.isatty():
            progress(label, count, len(calls))
        else:
            print(f"{label}: {count} of {len(calls)}, {time.monotonic() - start:.0f} s", file=sys.stderr, flush=True)
        yield result
