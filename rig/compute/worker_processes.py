"""Worker processes and their pools.

Their number, and mapping over them; they end when their parent process ends.
"""

import ctypes
import gc
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import partial
from itertools import accumulate
from os import PathLike
from queue import Empty, SimpleQueue
from types import FrameType
from typing import TypeVar

from rig.errors import RigError

# processes that may be ended from outside, one after the other with nothing done between, before nothing more is begun
ENDED = 3
SHARES = 4  # parts of what is left for each worker, so that none is waited for long
AWAKE = 0.5  # s, after which a signal that another thread took is seen, which does not end a wait
MOST = 4  # things of a part: what is lost with a worker, and by which progress goes on
LOOK = 0.5  # s between looks at whether the parent is there
SIGKILL = 9  # of Linux
PR_SET_PDEATHSIG = 1  # of prctl(2): the signal that comes when the parent is gone

Progress = Callable[[int, int], object]  # called with (done, of)
T = TypeVar("T")
R = TypeVar("R")

_waited_for: set[subprocess.Popen[str]] = set()  # children of `run_child_process`
_requested: int | None = None  # workers that the user asked for


class WorkerEnded(RigError):
    """A worker process that was killed from outside; states the possible cause."""


@contextmanager
def temporary_worker_limit(count: int | None) -> Iterator[None]:
    """Limit the number of worker processes to `count` (context manager).

    None sets no limit.
    """
    global _requested
    before, _requested = _requested, _requested if count is None else count
    try:
        yield
    finally:
        _requested = before


def worker_count() -> int:
    """Number of worker processes.

    The limit that is set, else the CPU cores, OMP_NUM_THREADS at most.
    """
    if _requested is not None:
        return _requested
    limit = os.environ.get("OMP_NUM_THREADS", "")
    here = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(here, int(limit)) if limit.isdigit() and int(limit) else here


def executor_map(
    executor: Executor,
    function: Callable[[T], R],
    items: Iterable[T],
    progress: Progress | None = None,
    futures: list[Future[R]] | None = None,
) -> list[R]:
    """Results of a function mapped over items by an executor, in the items' order.

    The first exception is raised.
    progress : called with (done, of), or None; futures : gets the things' Futures, or None
    """
    futures, out = [] if futures is None else futures, []
    finished: SimpleQueue[Future[R]] = SimpleQueue()  # its wait ends at an interrupt with no lock held
    with (
        _interrupts_wait()
    ):  # what is started here is deaf to Ctrl-C, which reaches all of a terminal's processes: this one ends the others
        for thing in items:
            futures.append(executor.submit(function, thing))
            futures[-1].add_done_callback(finished.put)
    pending = set(futures)
    try:
        for future in futures:
            while future in pending:
                with suppress(Empty):
                    pending.discard(finished.get(timeout=AWAKE))
            with _interrupts_wait():
                out.append(future.result())
            if progress:
                progress(len(out), len(futures))
    finally:
        for future in futures:
            future.cancel()
    return out


def split_into_decreasing_parts(items: Sequence[T], workers: int) -> list[Sequence[T]]:
    """The items split into parts of decreasing size, for a number of workers.

    Several for each worker, single items last.
    """
    out, at = [], 0
    while at < len(items):
        size = min(MOST, -(-(len(items) - at) // (SHARES * workers)))
        out.append(items[at : at + size])
        at += size
    return out


def process_map(
    count: int,
    start_method: str,
    function: Callable[[T], R],
    items: Iterable[T],
    progress: Progress | None = None,
    initializer: Callable[..., object] | None = None,
    initializer_arguments: tuple[object, ...] = (),
) -> list[R]:
    """Results of a function mapped over items by a process pool.

    Items of killed processes are repeated.
    Raises WorkerEnded where ENDED pools in turn came to an end with nothing done
    """
    left = list(enumerate(items))
    total, futile = len(left), 0
    out: dict[int, R] = {}

    while left:
        futures: list[Future[list[R]]] = []
        shares = split_into_decreasing_parts(left, count)
        ends = list(accumulate(map(len, shares), initial=len(out)))

        def report_done(done: int, _: int, ends: list[int] = ends) -> None:
            if progress:
                progress(ends[done], total)

        try:
            with process_pool(count, start_method, initializer, initializer_arguments) as pool:
                executor_map(
                    pool,
                    partial(_each, function),
                    [[thing for _, thing in share] for share in shares],
                    report_done,
                    futures,
                )
        except WorkerEnded:
            futile += 1
        retained = [
            (k, result)
            for share, future in zip(shares, futures)
            if future.done() and not future.cancelled() and not future.exception()
            for (k, _), result in zip(share, future.result())
        ]
        out.update(retained)
        futile = 0 if retained else futile
        if futile == ENDED:
            raise WorkerEnded(
                f"{ENDED} worker processes were killed from outside, one after the other, as a system does "
                "that is short of memory; "
                "none of its results are retained"
            )
        left = [(k, thing) for k, thing in left if k not in out]
    return [out[k] for k in range(total)]


@contextmanager
def process_pool(
    count: int,
    start_method: str,
    initializer: Callable[..., object] | None = None,
    initializer_arguments: tuple[object, ...] = (),
) -> Iterator[ProcessPoolExecutor]:
    """A process pool (context manager).

    It ends at once when this process is interrupted or killed.

    start_method : "fork" or "spawn"; initializer : called with `initializer_arguments` in each process at its
        beginning, or None
    Raises WorkerEnded where a process of it is ended from outside, which a system short of memory does
    """
    before = multiprocessing.active_children()
    pool = ProcessPoolExecutor(
        count,
        multiprocessing.get_context(start_method),
        _begin,
        (os.getpid(), pickle.dumps((initializer, initializer_arguments))),
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
                "a worker process was killed from outside, as a system does that is short of memory; none "
                "of its results are retained"
            ) from None
        raise
    pool.shutdown()


def run_child_process(command: Sequence[str | PathLike[str]], env: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """Run a child process until it ends.

    The child itself is to call `end_when_parent_ends` with this process's id, so that it does not outlive it

    Returns its exit status and what it printed (CompletedProcess)
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


def terminate_child_processes() -> None:
    """Terminate the child processes of this process.

    Those for which its other threads wait.
    """
    for child in tuple(_waited_for):
        child.kill()


def end_when_parent_ends(parent_pid: int) -> None:
    """Make this process end when its parent process (parent_pid) ends.

    By the system on Linux, elsewhere by a thread.
    Raises OSError where it will not. On Windows that takes a process that multiprocessing started.
    """
    if sys.platform == "linux" and ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, SIGKILL, 0, 0, 0):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    if os.getppid() != parent_pid:  # it was gone before that
        os._exit(1)
    if sys.platform != "linux":
        threading.Thread(target=_end_after_parent, args=(parent_pid,), daemon=True).start()


def _end_after_parent(parent_pid: int) -> None:
    if parent := multiprocessing.parent_process():
        parent.join()
    else:
        while os.getppid() == parent_pid:
            time.sleep(LOOK)
    os._exit(1)


def _each(function: Callable[[T], R], things: Sequence[T]) -> list[R]:
    return [function(thing) for thing in things]


def _begin(parent: int, rest: bytes) -> None:
    """rest : (start, given) as `process_pool` has them; opened last, as what it takes to do that may have to be
    imported, which lasts.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who interrupts the run ends its processes as well
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
    end_when_parent_ends(parent)
    gc.freeze()  # what was inherited is not gone through again, which would copy it
    start, given = pickle.loads(rest)
    if start is not None:
        start(*given)


@contextmanager
def _interrupts_wait() -> Iterator[None]:
    """Within it SIGINT is put off; what is started within inherits that for good.

    A KeyboardInterrupt inside `submit` or `result` can leave a lock of the pool locked, so that the pool never ends
    """
    put_off: list[FrameType | None] = []
    handler = signal.getsignal(signal.SIGINT)
    here = threading.current_thread() is threading.main_thread() and callable(handler)
    masks = hasattr(signal, "pthread_sigmask")  # where not (Windows), SIGINT comes to the main thread alone
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if masks else set()
    if here:  # another thread, whose signals are not blocked, may take it, and this one would handle it
        signal.signal(signal.SIGINT, lambda number, frame: put_off.append(frame))
    try:
        yield
    finally:
        if masks:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if here:
            signal.signal(signal.SIGINT, handler)
    if put_off and callable(handler):
        handler(signal.SIGINT, put_off[0])
