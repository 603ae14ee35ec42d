"""Many things done at the same time, by processes that end with the one that began them, however it ends."""

import ctypes
import gc
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from itertools import accumulate
from typing import Any

from rig.errors import RigError

# processes that may be ended from outside, one after the other with nothing done between, before nothing more is begun
ENDED = 3
SHARES = 4  # parts of what is left for each worker, so that none is waited for long
MOST = 4  # things of a part: what is lost with a worker, and by which progress goes on
PR_SET_PDEATHSIG = 1  # of prctl(2): the signal that comes when the parent is gone

_waited_for: set[subprocess.Popen] = set()  # children of `run_child_process`
_asked: int | None = None  # workers that the user asked for


class WorkerEnded(RigError):
    """A process at work that was ended from outside; says what that may have been."""


@contextmanager
def limit_workers(count: int | None) -> Iterator[None]:
    """Within it so many processes work at a time, whatever the machine has; None leaves it at that."""
    global _asked
    before, _asked = _asked, _asked if count is None else count
    try:
        yield
    finally:
        _asked = before


def worker_count() -> int:
    """How many processes may work at a time: as many as `limit_workers` says, else the cores that this process may use,
    OMP_NUM_THREADS at most.
    """
    if _asked is not None:
        return _asked
    limit = os.environ.get("OMP_NUM_THREADS", "")
    here = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(here, int(limit)) if limit.isdigit() and int(limit) else here


def executor_map(
    pool: Executor,
    function: Callable,
    things: Iterable,
    progress: Callable | None = None,
    futures: list[Future] | None = None,
) -> list:
    """[function(thing)] by an executor, in the things' order; of what they raise the first in that order is raised, and
    the rest is not begun.

    progress : called with (done, of), or None; futures : gets the things' Futures, or None
    """
    futures, out = [] if futures is None else futures, []
    with (
        _interrupts_wait()
    ):  # what is started here is deaf to Ctrl-C, which reaches all of a terminal's processes: this one ends the others
        for thing in things:
            futures.append(pool.submit(function, thing))
    try:
        for future in futures:
            out.append(future.result())
            if progress:
                progress(len(out), len(futures))
    finally:
        for future in futures:
            future.cancel()
    return out


def work_parts(things: Sequence, count: int) -> list[Sequence]:
    """The things in their order, in parts that `count` workers take in turn: large ones at first, as each costs a
    message to and fro, and single ones at the end, where workers would wait for each other (factoring, Hummel,
    Schonberg and Flynn 1992)."""
    out, at = [], 0
    while at < len(things):
        size = min(MOST, -(-(len(things) - at) // (SHARES * count)))
        out.append(things[at : at + size])
        at += size
    return out


def process_map(
    count: int,
    method: str,
    function: Callable,
    things: Iterable,
    progress: Callable | None = None,
    start: Callable | None = None,
    given: tuple = (),
) -> list:
    """`executor_map` by a pool as `process_pool` makes it; what a process was at when it was ended from outside,
    another does once more.

    Raises WorkerEnded where ENDED pools in turn came to an end with nothing done
    """
    left = list(enumerate(things))
    total, futile = len(left), 0
    out: dict[int, Any] = {}

    while left:
        futures: list[Future] = []
        shares = work_parts(left, count)
        ends = list(accumulate(map(len, shares), initial=len(out)))

        def told(done: int, _: int, ends: list[int] = ends) -> None:
            if progress:
                progress(ends[done], total)

        try:
            with process_pool(count, method, start, given) as pool:
                executor_map(
                    pool, partial(_each, function), [[thing for _, thing in share] for share in shares], told, futures
                )
        except WorkerEnded:
            futile += 1
        kept = [
            (k, result)
            for share, future in zip(shares, futures)
            if future.done() and not future.cancelled() and not future.exception()
            for (k, _), result in zip(share, future.result())
        ]
        out.update(kept)
        futile = 0 if kept else futile
        if futile == ENDED:
            raise WorkerEnded(
                f"{ENDED} processes at work were ended from outside, one after the other, as a system does "
                "that is short of memory; "
                "nothing of it is kept"
            )
        left = [(k, thing) for k, thing in left if k not in out]
    return [out[k] for k in range(total)]


@contextmanager
def process_pool(
    count: int, method: str, start: Callable | None = None, given: tuple = ()
) -> Iterator[ProcessPoolExecutor]:
    """A pool of processes that ends at once where this process is interrupted, and with it where it is killed.

    method : "fork" or "spawn"; start : called with `given` in each process at its beginning, or None
    Raises WorkerEnded where a process of it is ended from outside, which a system short of memory does
    """
    before = multiprocessing.active_children()
    pool = ProcessPoolExecutor(
        count, multiprocessing.get_context(method), _begin, (os.getpid(), pickle.dumps((start, given)))
    )
    try:
        yield pool
    except BaseException as error:
        for process in multiprocessing.active_children():
            if process not in before:
                process.kill()
        pool.shutdown(cancel_futures=True)
        if isinstance(error, BrokenProcessPool):
            raise WorkerEnded(
                "a process at work was ended from outside, as a system does that is short of memory; nothing "
                "of it is kept"
            ) from None
        raise
    pool.shutdown()


def run_child_process(command: list, env: dict[str, str]) -> subprocess.CompletedProcess:
    """A child process, once it has ended: what it printed as text. `end_child_processes` ends those that threads are
    waiting for here.

    The child itself is to call `end_with_parent` with this process's id, so that it does not outlive it
    """
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env) as child:
        _waited_for.add(child)
        try:
            out, error = child.communicate()
        except BaseException:
            child.kill()
            raise
        finally:
            _waited_for.discard(child)
    return subprocess.CompletedProcess(command, child.returncode, out, error)


def end_child_processes() -> None:
    """End the children that other threads of this process wait for."""
    for child in tuple(_waited_for):
        child.kill()


def end_with_parent(parent: int) -> None:
    """Have this process end when its parent, of this id, does, be that killed; Linux sees to it. Raises OSError where
    it will not.
    """
    if sys.platform == "linux" and ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    if os.getppid() != parent:  # it was gone before that
        os._exit(1)


def _each(function: Callable, things: Sequence) -> list:
    return [function(thing) for thing in things]


def _begin(parent: int, rest: bytes) -> None:
    """rest : (start, given) as `process_pool` has them; opened last, as what it takes to do that may have to be
    imported, which lasts.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who interrupts the run ends its processes as well
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    end_with_parent(parent)
    gc.freeze()  # what was inherited is not gone through again, which would copy it
    start, given = pickle.loads(rest)
    if start is not None:
        start(*given)


@contextmanager
def _interrupts_wait() -> Iterator[None]:
    """Within it SIGINT is put off; what is started within inherits that for good."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
