"""Processes: how many there may be, and that none outlives the one that began it."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from rig.compute.worker_processes import executor_map, process_pool, run_child_process, worker_count
from rig.errors import FileError, NotConverged, RigError
from tests.conftest import ROOT

POOL = """
import multiprocessing, os, signal, sys, time
from rig.compute.worker_processes import executor_map as gathered, process_pool as pool_of
if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell's background job is begun deaf to
    with pool_of(2, sys.argv[1]) as pool:
        busy = [pool.submit(time.sleep, 60) for _ in range(2)]
        print(*(child.pid for child in multiprocessing.active_children()), flush=True)
        gathered(pool, time.sleep, [60, 60])
"""
CHILD = """
import os, sys
from rig.compute.worker_processes import run_child_process as finished
finished([sys.executable, "-c", "import sys, time; from rig.compute.worker_processes import end_when_parent_ends as \
end_with; end_with(int(sys.argv[1]));"
          "time.sleep(60)", str(os.getpid())], dict(os.environ))
"""


def gone(pid):
    """Whether a process has ended, be it waited for or not."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] == "Z"
    except FileNotFoundError:
        return True


def all_gone(pids, within=10.0):
    end = time.monotonic() + within
    while not all(gone(pid) for pid in pids):
        if time.monotonic() > end:
            return False
        time.sleep(0.005)
    return True


def started(code, *arguments):
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


def test_cores_are_limited_as_threads_are(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert worker_count() == 1
    monkeypatch.setenv("OMP_NUM_THREADS", "4,2")  # of nested threads, which there are none of here
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(3)), raising=False)
    assert worker_count() == 3


@pytest.mark.parametrize("method", ["fork", "spawn"])
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_no_worker_outlives_the_one_that_began_it(method, number):
    with started(POOL, method) as process:
        pids = [int(pid) for pid in process.stdout.readline().split()]
        assert len(pids) == 2
        process.send_signal(number)
        process.communicate(timeout=20)
        assert process.returncode == -number and all_gone(pids)


def test_an_interrupt_that_another_thread_takes_does_not_break_into_a_submission():
    """Raised inside `submit` it could leave a lock of the pool locked, and the pool would never end."""
    accepted = []
    other = ThreadPoolExecutor(1)  # its thread begins now, while signals are not blocked
    other.submit(int).result()

    class Interrupted(ThreadPoolExecutor):
        def submit(self, function, *arguments):
            other.submit(signal.raise_signal, signal.SIGINT).result()
            accepted.append(arguments)
            return super().submit(function, *arguments)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), Interrupted(1) as pool:
            executor_map(pool, abs, [-1, -2])
    finally:
        signal.signal(signal.SIGINT, before)
        other.shutdown()
    assert accepted == [(-1,), (-2,)]


def test_no_child_that_is_waited_for_outlives_this_process():
    with started(CHILD) as process:
        deadline = time.monotonic() + 20
        children = []
        while not children and time.monotonic() < deadline:
            with open(f"/proc/{process.pid}/task/{process.pid}/children") as file:
                children = file.read().split()
            time.sleep(0.005)
        process.kill()
        process.wait()
        assert children and all_gone(map(int, children))


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_a_worker_that_is_ended_is_said_in_a_line(method):
    with pytest.raises(RigError, match="short of memory"), process_pool(1, method) as pool:
        pool.submit(os._exit, 9).result()


def fail(kind):
    raise {"file": FileError("x.csv", "is wrong", 3, 4, "value"), "pose": NotConverged("no pose", [1], [[2.0]], [3.0])}[
        kind
    ]


def test_what_a_worker_raises_is_raised_with_all_it_says():
    with pytest.raises(FileError, match="x.csv:3:4: is wrong") as raised, process_pool(1, "fork") as pool:
        pool.submit(fail, "file").result()
    assert (raised.value.path, raised.value.line, raised.value.column, raised.value.value) == ("x.csv", 3, 4, "value")
    with pytest.raises(NotConverged, match="no pose") as raised, process_pool(1, "fork") as pool:
        pool.submit(fail, "pose").result()
    assert raised.value.residual == [3.0]


def test_a_finished_child_gives_its_output_and_status():
    done = run_child_process(
        [sys.executable, "-c", "import sys; print('out'); print('err', file=sys.stderr); sys.exit(3)"], dict(os.environ)
    )
    assert (done.returncode, done.stdout, done.stderr) == (3, "out\n", "err\n")
