"""Who works: the same bytes by one process, by two and by a cluster of two workers; what one that is killed was at is
done again.
"""

import os
import pickle
import shutil
import signal
import sys
import threading
import time
from contextlib import contextmanager

import cloudpickle
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from rig.cli.command_line import main
from rig.compute import parallel_map_and_dask_cluster, worker_processes
from rig.compute.parallel_map_and_dask_cluster import parallel_map
from rig.compute.worker_processes import WorkerEnded, process_map, worker_count
from rig.errors import FileError, RigError
from rig.model import pose  # noqa: F401  states how a RigidTransform is pickled
from tests.conftest import BENCH

SAME = ("corners.csv", "poses.csv", "rpy.csv", "rig.toml", "frames.csv", "report.html")  # of what rig measure writes


def killed_once(item):
    """The item's double, by a process that is killed at number 7 the first time."""
    number, marker = item
    if number == 7 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def test_what_a_process_was_at_when_it_was_killed_is_done_again(tmp_path):
    progress = []
    things = [(k, tmp_path / "killed") for k in range(20)]
    assert process_map(2, "fork", killed_once, things, lambda done, of: progress.append((done, of))) == [
        2 * k for k in range(20)
    ]
    assert (tmp_path / "killed").exists() and progress[-1] == (20, 20)


def test_processes_that_end_at_the_same_thing_every_time_are_given_up(monkeypatch):
    begun = []
    monkeypatch.setattr(
        worker_processes, "executor_map", lambda *a, real=worker_processes.executor_map: begun.append(1) or real(*a)
    )
    with pytest.raises(WorkerEnded, match="3 worker processes were killed from outside"):
        process_map(1, "fork", os._exit, [9, 9])
    assert len(begun) == 3


def test_workers_are_as_many_as_asked(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    with worker_processes.temporary_worker_limit(3), worker_processes.temporary_worker_limit(None):
        assert worker_count() == 3
        assert (
            len(
                {
                    pid
                    for pid, _ in parallel_map(
                        lambda k: (os.getpid(), time.sleep(0.01)), range(12), items_per_process=1
                    )
                }
            )
            > 1
        )
    assert worker_count() == 1
    for words in (["--workers", "0"], ["--jobs", "2000"]):
        assert main(["measure", str(tmp_path), "--out", str(tmp_path / "o"), *words]) == 1
        assert "--workers takes 1 to 1024" in capsys.readouterr().err


def test_a_cluster_that_is_not_there_is_said(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(parallel_map_and_dask_cluster, "WAIT", 0.2)
    words = ["measure", str(tmp_path), "--out", str(tmp_path / "o"), "--scheduler"]
    assert (
        main([*words, "tcp://127.0.0.1:9"]) == 1
        and "no Dask scheduler answers at tcp://127.0.0.1:9" in capsys.readouterr().err
    )
    assert main([*words, "tpc://x:1"]) == 1 and "no Dask scheduler answers at tpc://x:1" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "dask.distributed", None)
    assert main([*words, "tcp://127.0.0.1:9"]) == 1 and "pip install 'rig[cluster]'" in capsys.readouterr().err


@pytest.mark.parametrize("dumps", [pickle.dumps, cloudpickle.dumps])
def test_a_pose_comes_to_another_process_unrounded(dumps):
    rng = np.random.default_rng(0)
    T = RigidTransform.from_components(rng.normal(size=(100, 3)), Rotation.random(100, rng=rng))
    received, one = pickle.loads(dumps(T)), pickle.loads(dumps(T[3]))
    assert (received.as_matrix() == T.as_matrix()).all() and one.single and (one.as_matrix() == T[3].as_matrix()).all()


@contextmanager
def two_workers():
    """(Address of a scheduler, {worker's address: its process}) of a cluster of two workers on loopback."""
    from dask.distributed import Client, LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=":0") as here:
        with Client(here, set_as_default=False) as client:
            pids = client.run(os.getpid)
        yield here, pids


@contextmanager
def one_killed(here, pids):
    """Within it the first worker that is at work is killed; what is yielded names it then."""
    found, ended = [], threading.Event()

    def watch():
        while not ended.wait(0.005):
            busy = [
                address
                for address, state in list(here.scheduler.workers.items())
                if state.processing and address in pids
            ]
            if busy:
                os.kill(pids[busy[0]], signal.SIGKILL)
                found.append(busy[0])
                return

    watching = threading.Thread(target=watch)
    watching.start()
    try:
        yield found
    finally:
        ended.set()
        watching.join()


def alike(first, other, names):
    for name in names:
        assert (first / name).read_bytes() == (other / name).read_bytes(), name


@pytest.mark.parametrize("kind", [TimeoutError, ConnectionResetError, ValueError])
def test_what_the_work_raises_is_not_said_of_the_cluster(kind):
    from dask.distributed import LocalCluster

    def fail(k):
        raise kind(f"corners.csv of {k} is far away")

    with (
        LocalCluster(n_workers=1, processes=False, dashboard_address=None) as here,
        parallel_map_and_dask_cluster.use_cluster(here.scheduler_address) as cluster,
        pytest.raises(kind, match="corners.csv of 0 is far away"),
    ):
        cluster.map(fail, range(3))


@pytest.mark.slow
def test_a_cluster_does_calls_in_order_and_raises_what_they_raise(tmp_path):
    def fail(k):
        if k >= 5:
            raise FileError("x.csv", f"is wrong {k}", 3)
        return k

    with two_workers() as (here, _), parallel_map_and_dask_cluster.use_cluster(here.scheduler_address) as cluster:
        progress = []
        things = [(k, tmp_path / "killed") for k in range(40)]
        assert cluster.map(killed_once, things, lambda done, of: progress.append((done, of))) == [
            2 * k for k in range(40)
        ]
        assert progress == [(k, 40) for k in range(1, 41)] and (tmp_path / "killed").exists()
        with pytest.raises(FileError, match="x.csv:3: is wrong 5"):
            parallel_map(fail, range(40), on_cluster=True)
        nested = parallel_map(
            lambda k: (os.getpid(), {pid for pid in parallel_map(lambda _: os.getpid(), range(40))}),
            range(4),
            items_per_process=1,
            on_cluster=True,
        )
        assert all(inner == {pid} and pid != os.getpid() for pid, inner in nested)
    with (
        pytest.raises(RigError, match="has no worker"),
        _no_workers() as address,
        parallel_map_and_dask_cluster.use_cluster(address),
    ):
        pass


@pytest.mark.slow
def test_work_at_which_workers_end_is_given_up():
    from dask import config

    once = config.set({"distributed.scheduler.allowed-failures": 0})
    with (
        once,
        two_workers() as (here, _),
        parallel_map_and_dask_cluster.use_cluster(here.scheduler_address),
        pytest.raises(RigError, match="ended one after the other"),
    ):
        parallel_map(lambda k: os._exit(9), range(4), items_per_process=1, on_cluster=True)


@contextmanager
def _no_workers():
    from dask.distributed import LocalCluster

    with (
        LocalCluster(n_workers=0, host="127.0.0.1", dashboard_address=":0") as here,
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setattr(parallel_map_and_dask_cluster, "WAIT", 0.5)
        yield here.scheduler_address


@pytest.fixture(scope="module")
def drawn(opengl, tmp_path_factory):
    """A folder with rig.toml and 16 frames of three cameras: more than teach, so that some are shared out."""
    at = tmp_path_factory.mktemp("drawn")
    assert main(["design", "--radius", "0.3", "--size", "640x512", "--out", str(at / "rig.toml")]) == 0
    assert main([*simulating(at), "--out", str(at / "rec"), "--workers", "1"]) == 0
    return at


def simulating(at):
    return [
        "simulate",
        str(at / "rig.toml"),
        "--plan",
        "sobol:16",
        "--seed",
        "3",
        "--images",
        "--blur",
        "0.5",
        "--read-noise",
        "1",
        "--quiet",
    ]


@pytest.mark.slow
def test_measuring_is_the_same_by_one_by_two_and_by_a_cluster_of_which_one_is_killed(drawn, tmp_path, monkeypatch):
    monkeypatch.chdir(drawn)  # workers stand elsewhere than who names a folder here
    words = ["measure", "rec", "--quiet", "--out"]
    assert main([*words, str(tmp_path / "1"), "--workers", "1"]) == 0
    assert main([*words, str(tmp_path / "2"), "--workers", "2"]) == 0
    alike(tmp_path / "1", tmp_path / "2", SAME)
    with two_workers() as (here, pids):
        assert main([*words, str(tmp_path / "c"), "--scheduler", here.scheduler_address]) == 0
        alike(tmp_path / "1", tmp_path / "c", SAME)
        with one_killed(here, pids) as found:
            assert main([*words, str(tmp_path / "k"), "--scheduler", here.scheduler_address]) == 0
        assert found
    alike(tmp_path / "1", tmp_path / "k", SAME)


@pytest.mark.slow
def test_drawing_is_the_same_by_one_by_two_and_by_a_cluster_of_which_one_is_killed(drawn, tmp_path):
    images = [path.relative_to(drawn / "rec") for path in sorted((drawn / "rec" / "images").rglob("*.png"))]
    assert len(images) == 48
    assert main([*simulating(drawn), "--out", str(tmp_path / "2"), "--workers", "2"]) == 0
    alike(drawn / "rec", tmp_path / "2", images)
    with two_workers() as (here, pids), one_killed(here, pids) as found:
        assert main([*simulating(drawn), "--out", str(tmp_path / "c"), "--scheduler", here.scheduler_address]) == 0
        assert found
    alike(drawn / "rec", tmp_path / "c", images)


@pytest.mark.slow
def test_diagnosing_two_recordings_is_the_same_on_a_cluster(design, rig_text, tmp_path):
    from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
    from tests.conftest import make_recording

    for name, seed in (("a", 1), ("b", 2)):
        make_recording(
            tmp_path / name, design, rig_text, seed, count=24, effects=(parse_effect("backlash:strut2:gap=8e-5"),)
        )
    words = ["diagnose", str(tmp_path / "a"), "--only", "backlash", "--only", "scale_error", "--quiet", "--out"]
    assert main([*words, str(tmp_path / "1"), "--workers", "1"]) == 0
    with two_workers() as (here, pids), one_killed(here, pids) as found:
        assert main([*words, str(tmp_path / "c"), "--scheduler", here.scheduler_address]) == 0
        assert found
    alike(tmp_path / "1", tmp_path / "c", ["diagnosis.json"])


@pytest.mark.slow
def test_a_campaign_is_the_same_on_a_cluster_of_which_one_is_killed(tmp_path):
    words = ["blind", "--season", "2", "--frames", "40", "--hide", "one", "--effects", "backlash", "--quiet", "--out"]
    assert main([*words, str(tmp_path / "1"), "--jobs", "1"]) == 0
    with two_workers() as (here, pids), one_killed(here, pids) as found:
        assert main([*words, str(tmp_path / "c"), "--scheduler", here.scheduler_address]) == 0
        assert found
    alike(
        tmp_path / "1",
        tmp_path / "c",
        [
            f"{folder}/000{k}{rest}"
            for k in (1, 2)
            for folder, rest in (("hashes", ".sha256"), ("truth", ".json"), ("recordings", "/corners.csv"))
        ],
    )
    assert not list((tmp_path / "c").rglob(".rig-*.part"))


@pytest.mark.slow
def test_a_process_here_that_is_killed_costs_no_result(tmp_path, monkeypatch):
    from vision.reading import corner_reading_from_recording_images

    monkeypatch.setattr(
        corner_reading_from_recording_images, "LEARN_FROM", 4
    )  # so that images are left to be shared out
    words = ["measure", str(BENCH / "check"), "--quiet", "--workers", "2", "--out"]
    assert main([*words, str(tmp_path / "1")]) == 0
    seen, killed, here = corner_reading_from_recording_images.detect_markers, tmp_path / "killed", os.getpid()

    def once(*a, **k):
        if not killed.exists() and os.getpid() != here:
            killed.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return seen(*a, **k)

    monkeypatch.setattr(corner_reading_from_recording_images, "detect_markers", once)
    assert main([*words, str(tmp_path / "2")]) == 0 and killed.exists()
    alike(tmp_path / "1", tmp_path / "2", SAME)
    shutil.rmtree(tmp_path)
