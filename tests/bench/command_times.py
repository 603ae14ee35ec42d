"""Times of everyday commands, each in a process of its own: medians of several runs.

QUICK_SHARE=0.02 takes that share of frames and images and runs each command once: a trial that the rows work.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from tests.bench.scale import part

SHARE = float(os.environ.get("QUICK_SHARE", "1"))
REPEATS = 5 if SHARE == 1 else 1
CAMERAS, SEED = 3, 7
RUN = "from rig.cli.command_line import run_script; run_script()"  # as the installed command
CHECKED, MEASURED, FRAMES = 150, 1000, 380  # images, images, frames of corners


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    with tempfile.TemporaryDirectory() as folder:
        at = Path(folder)
        yield "rig --help", f"{_median('--help'):.2f} s", ""
        frames = max(round(SHARE * FRAMES), 30)
        _seconds("design", "--radius", "0.3", "--cameras", CAMERAS, "--size", "640x480", "--out", at / "rig.toml")
        _simulate(at, frames, "rec", "--corners")
        seconds = _median("calibrate", at / "rec", "--out", at / "calibration.json", "--force")
        yield f"rig calibrate of corners, {frames} frames of {CAMERAS} cameras", f"{seconds:.2f} s", "<= 4 s"
        images = max(round(SHARE * MEASURED) // CAMERAS, 6) * CAMERAS
        _simulate(at, images // CAMERAS, "images", "--images")
        few = max(round(SHARE * CHECKED) // CAMERAS, 5) * CAMERAS
        small = part(at / "images", at / "few", few)
        yield from _kernel_rows(at, small, few)
        yield f"rig check of {few} images of 640 x 480 px", f"{_median('check', small):.2f} s", ""
        yield from _worker_rows(at, images)


def _kernel_rows(at: Path, small: Path, few: int) -> Iterator[tuple[str, str, str]]:
    """Measuring without and with compiled kernels, in a cache of its own for each repeat."""
    words, first, second = ("measure", small, "--out", at / "measured", "--force"), [], []
    before = os.environ.get("NUMBA_CACHE_DIR")
    try:
        for k in range(min(REPEATS, 3)):
            os.environ["NUMBA_CACHE_DIR"] = str(at / f"kernels{k}")
            first.append(_seconds(*words))
            second.append(_seconds(*words))
    finally:
        if before is None:
            del os.environ["NUMBA_CACHE_DIR"]
        else:
            os.environ["NUMBA_CACHE_DIR"] = before
    for name, seconds in (("first rig measure after an installation", first), ("the second one", second)):
        yield f"{name}, {few} images", f"{statistics.median(seconds):.2f} s", ""


def _worker_rows(at: Path, images: int) -> Iterator[tuple[str, str, str]]:
    """Measuring by one process and by two, in turn."""
    seconds: dict[int, list[float]] = {1: [], 2: []}
    for _ in range(min(REPEATS, 3)):
        for workers, times in seconds.items():
            out = ("--out", at / f"by{workers}", "--force", "--workers", workers)
            times.append(_seconds("measure", at / "images", *out))
    one, two = (statistics.median(times) for times in seconds.values())
    yield f"rig measure of {images} images by one process", f"{one:.2f} s", ""
    yield "the same: one process's time over that of two", f"{one / two:.2f}", ">= 1.8"


def _simulate(at: Path, frames: int, name: str, *words: str) -> None:
    plan = ("--plan", f"sobol:{frames}", "--seed", SEED)
    _seconds("simulate", at / "rig.toml", *plan, *words, "--out", at / name)


def _median(*words: object) -> float:
    """Median time (s) of a command's runs."""
    return statistics.median(_seconds(*words) for _ in range(REPEATS))


def _seconds(*words: object) -> float:
    """Time (s) of a command. Raises RuntimeError where it fails"""
    start = time.monotonic()
    done = subprocess.run([sys.executable, "-c", RUN, *map(str, words)], capture_output=True, text=True)
    seconds = time.monotonic() - start
    if done.returncode:
        raise RuntimeError(f"rig {' '.join(map(str, words))}: {done.stderr}")
    return seconds
