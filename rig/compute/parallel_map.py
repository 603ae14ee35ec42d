"""One function of many things on all cores: in processes, which inherit what it reads by forking and send back what it
found, in threads, or by the workers of a cluster.

Threads within the products of matrices as small as here cost more than they bring; who calls limits them to one.
"""

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from rig.compute import dask_cluster
from rig.compute.worker_processes import process_map, worker_count

FEW = 4  # things for each process, below which it is not worth starting any

Progress = Callable[[int, int], None]  # called with (done, of)
T = TypeVar("T")
R = TypeVar("R")

_inherited: tuple[Callable, Sequence] | None = None  # what the processes forked next are to call


def parallel_map(
    function: Callable[[Any], Any],
    things: Sequence,
    progress: Progress | None = None,
    few: int = FEW,
    far: bool = False,
) -> list:
    """[function(thing)] in the things' order; what it changes elsewhere is lost, what it raises is raised here.

    It takes one process where the system cannot fork or OMP_NUM_THREADS, which limits the processes as it does threads,
    is 1, and within a process that another call of it forked. A process that is ended from outside costs what it was
    at, which another does again.
    progress : called with (done, of), or None; few : things for each process, below which it is not worth starting any
    far : whether a thing takes so long that it is worth sending it to a cluster, where one is at work
    """
    global _inherited
    nested = _inherited is not None or dask_cluster.is_worker()
    there = dask_cluster.current_cluster() if far and not nested and len(things) >= few else None
    if there is not None:
        return there.map(function, things, progress)
    count = min(worker_count(), len(things) // few)
    if count < 2 or nested or "fork" not in multiprocessing.get_all_start_methods():
        out = []
        for thing in things:
            out.append(function(thing))
            if progress:
                progress(len(out), len(things))
        return out
    _inherited = function, things
    try:
        return process_map(count, "fork", _call, range(len(things)), progress)
    finally:
        _inherited = None


def thread_map(function: Callable[[T], R], things: Sequence[T]) -> list[R]:
    """[function(thing)] in the things' order, side by side in threads: for a few large things whose work lets go of the
    interpreter's lock.
    """
    count = min(worker_count(), len(things))
    if count < 2 or _inherited is not None or dask_cluster.is_worker():
        return [function(thing) for thing in things]
    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(function, things))


def _call(i: int) -> Any:
    if _inherited is None:
        raise RuntimeError("this process was not forked by parallel_map")
    function, things = _inherited
    return function(things[i])
