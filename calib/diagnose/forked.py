"""One function of many things on all cores: what it reads is inherited by forking, only what it found is sent back."""

import multiprocessing
import os
import signal
from concurrent.futures import ProcessPoolExecutor, as_completed

from threadpoolctl import threadpool_limits

FEW = 4  # things for each process, below which it is not worth starting any

_function = None  # what the processes forked next are to call


def each(function, things, progress=None):
    """[function(thing)] in the things' order; what it changes elsewhere is lost, what it raises is raised here.

    It takes one process where the system cannot fork or OMP_NUM_THREADS, which limits the processes as it does threads, is 1.
    progress : called with (done, of), or None
    """
    global _function
    count = min(cores(), len(things) // FEW)
    if count < 2 or "fork" not in multiprocessing.get_all_start_methods():
        out = []
        for thing in things:
            out.append(function(thing))
            if progress:
                progress(len(out), len(things))
        return out
    _function, before = (function, things), _function
    try:
        with ProcessPoolExecutor(count, multiprocessing.get_context("fork"), _start) as pool:
            futures = [pool.submit(_call, i) for i in range(len(things))]
            try:
                for done, future in enumerate(as_completed(futures), 1):
                    future.result()
                    if progress:
                        progress(done, len(things))
            finally:
                for future in futures:
                    future.cancel()
    finally:
        _function = before
    return [future.result() for future in futures]


def cores():
    """How many processes may run at a time: the cores that this process may use, OMP_NUM_THREADS at most."""
    limit = os.environ.get("OMP_NUM_THREADS", "")
    here = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(here, int(limit)) if limit.isdigit() and int(limit) else here


def _start():
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who interrupts the run ends its processes as well
    threadpool_limits(1)


def _call(i):
    function, things = _function
    return function(things[i])
