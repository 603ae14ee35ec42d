"""Parallel map of a function over items: by forked processes, threads, or the workers of a cluster.
the workers of a cluster.

Threads within the products of matrices as small as here cost more than they bring; who calls limits them to one.
"""

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar, cast

from rig.compute import dask_cluster
from rig.compute.worker_processes import Progress, process_map, worker_count

FEW = 4  # things for each process, below which it is not worth starting any

T = TypeVar("T")
R = TypeVar("R")

_inherited: tuple[Callable[..., object], Sequence[object]] | None = None  # what the processes forked next are to call


def parallel_map(
    function: Callable[[T], R],
    items: Sequence[T],
    progress: Progress | None = None,
    items_per_process: int = FEW,
    on_cluster: bool = False,
) -> list[R]:
    """Results of a function mapped over items in parallel, in the items' order; exceptions are raised here.

    It takes one process where the system cannot fork or OMP_NUM_THREADS, which limits the processes as it does threads,
    is 1, and within a process that another call of it forked. A process that is ended from outside costs what it was
    at, which another does again.
    progress : called with (done, of), or None; items_per_process : things for each process, below which it is not worth
        starting any
    on_cluster : whether a thing takes so long that it is worth sending it to a cluster, where one is at work
    """
    global _inherited
    nested = _inherited is not None or dask_cluster.is_cluster_worker()
    there = dask_cluster.current_cluster() if on_cluster and not nested and len(items) >= items_per_process else None
    if there is not None:
        return there.map(function, items, progress)
    count = min(worker_count(), len(items) // items_per_process)
    if count < 2 or nested or "fork" not in multiprocessing.get_all_start_methods():
        out = []
        for thing in items:
            out.append(function(thing))
            if progress:
                progress(len(out), len(items))
        return out
    _inherited = function, items
    try:
        return process_map(count, "fork", cast(Callable[[int], R], _call), range(len(items)), progress)
    finally:
        _inherited = None


def thread_map(function: Callable[[T], R], items: Sequence[T]) -> list[R]:
    """Results of a function mapped over items in threads, in the items' order."""
    count = min(worker_count(), len(items))
    if count < 2 or _inherited is not None or dask_cluster.is_cluster_worker():
        return [function(thing) for thing in items]
    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(function, items))


def _call(i: int) -> object:
    if _inherited is None:
        raise RuntimeError("this process was not forked by parallel_map")
    function, things = _inherited
    return function(things[i])
