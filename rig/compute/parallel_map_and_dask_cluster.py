"""Parallel map of a function, and the Dask cluster.

Over items: by forked processes, threads, or the workers of a cluster.

Threads within the products of matrices as small as here cost more than they bring; who calls limits them to one.
"""

import hashlib
import os
import pickle
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast

from rig.compute.worker_processes import Progress, process_map, split_into_decreasing_parts, worker_count
from rig.errors import MissingLibrary, RigError
from rig.formats import local_and_remote_input_files

if TYPE_CHECKING:
    from dask.distributed import Client, Future

T = TypeVar("T")
R = TypeVar("R")

WAIT = 20  # s for a scheduler, and for its first worker
PATIENCE = 3  # such times for another worker, when the last one is gone
LARGE = "1GiB"  # what a function may carry to the workers before Dask warns of it


_here = threading.local()  # of a worker: whether this thread is at work for a cluster, and what it last opened
_at_work: "Cluster | None" = None


class Cluster:
    """Workers behind a scheduler. address : of that scheduler"""

    def __init__(self, client: "Client", address: str) -> None:
        self._client, self.address = client, address

    def map(self, function: Callable[[T], R], things: Sequence[T], progress: Progress | None = None) -> list[R]:
        """[function(thing)] in the things' order; of what they raise the first in that order is raised.

        Raises RigError where the cluster or all its workers are gone, or where workers end again and again at the same
            things
        """
        import cloudpickle

        data = cloudpickle.dumps(function)
        with self._errors_in_one_line():
            carried = self._client.submit(
                bytes, data, pure=False
            )  # a call and no mere data: it is done again where who held it is gone
            digest, shares = (
                hashlib.sha256(data).hexdigest(),
                split_into_decreasing_parts(things, max(self._workers(), 1)),
            )
            futures: list[Future[list[R]]] = [
                self._client.submit(_done, carried, digest, share, pure=False) for share in shares
            ]
        out: list[R] = []
        try:
            for future in futures:
                for result in self._result(future):
                    out.append(result)
                    if progress:
                        progress(len(out), len(things))
        finally:
            with self._errors_in_one_line():
                self._client.cancel([future for future in futures if not future.done()])
        return out

    def _result(self, future: "Future[list[R]]") -> list[R]:
        """Result of a part. What the work raises is raised unchanged, not attributed to the cluster."""
        from dask.distributed import KilledWorker

        with self._errors_in_one_line():
            try:
                return self._waited_for(future)
            except Exception:
                raised = future.exception() if future.status == "error" else None
                if raised is None or isinstance(raised, (KilledWorker, ImportError)):
                    raise
        raise raised

    def _waited_for(self, future: "Future[list[R]]") -> list[R]:
        """What comes of a part. Raises RigError where for long nobody is left to do it"""
        alone = 0
        while alone < PATIENCE:
            try:
                return future.result(timeout=WAIT)
            except TimeoutError:
                if future.status == "error":
                    raise
                alone = 0 if self._workers() else alone + 1
        raise RigError(f"the cluster at {self.address} has had no worker for {PATIENCE * WAIT} s")

    def executor(self) -> Executor:
        """What single calls are submitted to."""
        return self._client.get_executor(pure=False)

    def _workers(self) -> int:
        return sum(self._client.nthreads().values())

    @contextmanager
    def _errors_in_one_line(self) -> Iterator[None]:
        """Context in which errors of Dask about the cluster are reported in one line."""
        from dask import config
        from dask.distributed import CancelledError, KilledWorker

        try:
            with config.set({"distributed.admin.large-graph-warning-threshold": LARGE}):
                yield
        except KilledWorker as error:
            raise RigError(
                f"workers of the cluster at {self.address} ended one after the other at the same work, as a "
                "system does that is short of "
                f"memory: {error}"
            ) from None
        except ImportError as error:
            raise RigError(
                f"a worker of the cluster at {self.address} lacks what this computer has: {error}; install "
                "the same rig there"
            ) from None
        except (OSError, CancelledError) as error:  # those of its connections and waits that are over are OSErrors
            raise RigError(f"the cluster at {self.address} is gone: {error}") from None


@contextmanager
def use_cluster(address: str | None) -> Iterator[Cluster | None]:
    """Use the Dask cluster at an address (context manager).

    The address is that of its scheduler, tcp://HOST:PORT.
    Raises MissingLibrary without Dask, RigError where no scheduler answers or it has no worker
    """
    global _at_work
    if address is None:
        yield _at_work
        return
    try:
        from dask.distributed import Client
    except ImportError:
        raise MissingLibrary("--scheduler needs Dask: pip install 'rig[cluster]'") from None
    try:
        client = Client(address, timeout=WAIT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise RigError(f"no Dask scheduler answers at {address}: {error}") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=WAIT)
        except TimeoutError:
            raise RigError(
                f"the Dask scheduler at {address} has no worker; start some: dask worker {address} --nthreads 1"
            ) from None
        before, _at_work = _at_work, Cluster(client, address)
        try:
            yield _at_work
        finally:
            _at_work = before


def current_cluster() -> Cluster | None:
    """The Cluster current in this process.

    None where there is none.
    """
    return _at_work


def path_seen_by_cluster_workers(path: Path) -> Path:
    """The path of a file as the cluster's workers find it."""
    return path if _at_work is None else local_and_remote_input_files.absolute_path(path)


def is_cluster_worker() -> bool:
    """Whether this thread runs a task of a Dask cluster worker."""
    return getattr(_here, "busy", False)


def _done(data: bytes, digest: str, part: Sequence[T]) -> list[R]:
    """[function(thing)] of a part of the things, in a worker. data : of the function, opened once by each thread"""
    from threadpoolctl import threadpool_limits

    if getattr(_here, "digest", None) != digest:
        _here.function, _here.digest = pickle.loads(data), digest
    _here.busy = True
    try:
        with threadpool_limits(1):  # products are rounded by how many threads share them
            return [_here.function(thing) for thing in part]
    finally:
        _here.busy = False


FEW = 4  # things for each process, below which it is not worth starting any


_inherited: tuple[Callable[..., object], Sequence[object]] | None = None  # what the processes forked next are to call


def parallel_map(
    function: Callable[[T], R],
    items: Sequence[T],
    progress: Progress | None = None,
    items_per_process: int = FEW,
    on_cluster: bool = False,
) -> list[R]:
    """Results of a function mapped over items in parallel, in the items' order.

    Exceptions are raised here.

    It takes one process where the system cannot fork or OMP_NUM_THREADS, which limits the processes as it does threads,
    is 1, and within a process that another call of it forked. A process that is ended from outside costs what it was
    at, which another does again.
    progress : called with (done, of), or None; items_per_process : things for each process, below which it is not worth
        starting any
    on_cluster : whether a thing takes so long that it is worth sending it to a cluster, where one is at work
    """
    global _inherited
    nested = _inherited is not None or is_cluster_worker()
    cluster = current_cluster() if on_cluster and not nested and len(items) >= items_per_process else None
    if cluster is not None:
        return cluster.map(function, items, progress)
    count = min(worker_count(), len(items) // items_per_process)
    if count < 2 or nested or not hasattr(os, "fork"):
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
    if count < 2 or _inherited is not None or is_cluster_worker():
        return [function(thing) for thing in items]
    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(function, items))


def _call(i: int) -> object:
    if _inherited is None:
        raise RuntimeError("this process was not forked by parallel_map")
    function, things = _inherited
    return function(things[i])
