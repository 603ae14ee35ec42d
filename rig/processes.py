"""Many things done at the same time, by processes that end with the one that began them, however it ends."""

import ctypes
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

from rig.errors import RigError

PR_SET_PDEATHSIG = 1  # of prctl(2): the signal that comes when the parent is gone

_waited_for: set[subprocess.Popen] = set()  # children of `finished`


def cores() -> int:
    """How many processes may run at a time: the cores that this process may use, OMP_NUM_THREADS at most."""
    limit = os.environ.get("OMP_NUM_THREADS", "")
    here = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(here, int(limit)) if limit.isdigit() and int(limit) else here


def gathered(pool: Executor, function: Callable, things: Iterable, progress: Callable | None = None) -> list:
    """[function(thing)] by an executor, in the things' order; of what they raise the first in that order is raised, and the rest is not begun.

    progress : called with (done, of), or None
    """
    with _interrupts_wait():  # what is started here is deaf to Ctrl-C, which reaches all of a terminal's processes: this one ends the others
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


@contextmanager
def pool_of(count: int, method: str, start: Callable | None = None, given: tuple = ()) -> Iterator[ProcessPoolExecutor]:
    """A pool of processes that ends at once where this process is interrupted, and with it where it is killed.

    method : "fork" or "spawn"; start : called with `given` in each process at its beginning, or None
    Raises RigError where a process of it is ended from outside, which a system short of memory does
    """
    before = multiprocessing.active_children()
    pool = ProcessPoolExecutor(count, multiprocessing.get_context(method), _begin, (os.getpid(), pickle.dumps((start, given))))
    try:
        yield pool
    except BaseException as error:
        for process in multiprocessing.active_children():
            if process not in before:
                process.kill()
        pool.shutdown(cancel_futures=True)
        if isinstance(error, BrokenProcessPool):
            raise RigError("a process at work was ended from outside, as a system does that is short of memory; nothing of it is kept") from None
        raise
    pool.shutdown()


def finished(command: list, env: dict[str, str]) -> subprocess.CompletedProcess:
    """A child process, once it has ended: what it printed as text. `end_waiting` ends those that threads are waiting for here.

    The child itself is to call `end_with` with this process's id, so that it does not outlive it
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


def end_waiting() -> None:
    """End the children that other threads of this process wait for."""
    for child in tuple(_waited_for):
        child.kill()


def end_with(parent: int) -> None:
    """Have this process end when its parent, of this id, does, be that killed; Linux sees to it. Raises OSError where it will not."""
    if sys.platform == "linux" and ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    if os.getppid() != parent:  # it was gone before that
        os._exit(1)


def _begin(parent: int, rest: bytes) -> None:
    """rest : (start, given) as `pool_of` has them; opened last, as what it takes to do that may have to be imported, which lasts."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who interrupts the run ends its processes as well
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    end_with(parent)
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
