"""The same recording gives the same results, to the last byte, for any number of threads and processes at work, and
whether kernels are compiled or loaded.
"""

import os
import re
import subprocess

import numpy as np
import pytest

from tests.calib.secret_arms import secret, tracked, write
from tests.cli import RIG
from tests.conftest import BENCH, ROOT, make_recording
from tests.rig.arms import UR10

WHEN = re.compile(rb'"created": "[^"]*"')
COUNTS = ("1", "2")


def calibration(recording, threads, *words):
    """The bytes of a calibration made by a process that so many threads are given to, but for when it was made."""
    env = {**os.environ, "PYTHONHASHSEED": threads}
    env |= {
        name: threads for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    }
    done = subprocess.run(
        [*RIG, "calibrate", str(recording), *words, "--out", "-"], capture_output=True, env=env, timeout=900
    )
    assert done.returncode == 0, done.stderr.decode()
    assert len(WHEN.findall(done.stdout)) == 1
    return WHEN.sub(b"", done.stdout)


def same_for_all(recording, *words):
    """Assert that a calibration is one whatever number of threads works at it."""
    first, *others = (calibration(recording, threads, *words) for threads in COUNTS)
    assert first.startswith(b"{") and all(other == first for other in others)


@pytest.fixture(scope="module")
def hexapod(tmp_path_factory, design, rig_text):
    """A recording of corners whose products are large enough for libraries to share them among threads."""
    folder = tmp_path_factory.mktemp("threads") / "rec"
    make_recording(folder, design, rig_text, 7, count=40)
    return folder


@pytest.mark.slow
def test_a_hexapods_calibration_is_the_same_to_the_last_byte(hexapod):
    same_for_all(hexapod)


@pytest.mark.slow
@pytest.mark.parametrize("words", [("--extend", "auto"), ("--joint",), ("--find",)])
def test_so_is_one_that_extends_joins_or_diagnoses(hexapod, words):
    same_for_all(hexapod, *words)


@pytest.mark.slow
def test_so_is_one_from_images():
    same_for_all(BENCH / "fit")


@pytest.mark.slow
def test_so_is_an_arms(tmp_path):
    rng = np.random.default_rng(3)
    nominal = UR10
    write(tmp_path / "arm", nominal, tracked(secret(nominal, rng), nominal, 150, rng))
    same_for_all(tmp_path / "arm")


@pytest.mark.slow
def test_corners_do_not_depend_on_the_cache_of_kernels(tmp_path):
    """Kernels from the cache may not round differently from those just compiled."""
    found = []
    for run, workers in enumerate(("2", "2", "1")):  # the first one compiles
        done = subprocess.run(
            [*RIG, "measure", str(BENCH / "fit"), "--out", str(tmp_path / str(run)), "--workers", workers],
            capture_output=True,
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")},
            timeout=900,
        )
        assert done.returncode == 0, done.stderr.decode()
        found.append([(tmp_path / str(run) / name).read_bytes() for name in ("corners.csv", "poses.csv")])
    assert found[1] == found[0] and found[2] == found[0]


def test_no_kernel_may_reorder_arithmetic():
    """Else every caller's copy of a kernel rounds differently, and the cache decides which of them is linked."""
    sources = [path for package in ("rig", "vision", "calib", "synthetic") for path in (ROOT / package).rglob("*.py")]
    assert len(sources) > 100
    for path in sources:
        assert not re.search(r"fastmath\"?\s*[=:]", path.read_text()), path
