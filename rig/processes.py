"""Many things done at the same time."""

import os


def cores():
    """How many processes may run at a time: the cores that this process may use, OMP_NUM_THREADS at most."""
    limit = os.environ.get("OMP_NUM_THREADS", "")
    here = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(here, int(limit)) if limit.isdigit() and int(limit) else here


def gathered(pool, function, things, progress=None):
    """[function(thing)] by an executor, in the things' order; of what they raise the first in that order is raised, and the rest is not begun.

    progress : called with (done, of), or None
    """
    futures, out = [pool.submit(function, thing) for thing in things], []
    try:
        for future in futures:
            out.append(future.result())
            if progress:
                progress(len(out), len(futures))
    finally:
        for future in futures:
            future.cancel()
    return out
