"""Many images: measuring and drawing by one process, by two and by a cluster of two workers on loopback: times, bytes,
memory of each worker.

IMAGES_MEASURED says how many (120 by default; 1000 are what the figures are asked for); in a folder that SCALE names
drawings are kept, for next time.
"""

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

CAMERAS = 3
COUNT = int(os.environ.get("IMAGES_MEASURED", "120")) // CAMERAS * CAMERAS
REPEATS = 2  # of each way, one after the other in turn; the quickest counts
FEW = 4  # times fewer images, to hold memory against
FILES = ("poses.csv", "corners.csv", "rig.toml", "rpy.csv", "frames.csv")
RUN = """import resource, sys
from rig.cli.command_line import main
status = main(sys.argv[1:])
print("peak", *(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)), \
file=sys.stderr)
sys.exit(status)"""


@dataclass(frozen=True, slots=True)
class Ran:
    """A command that was run. seconds : from its start to its end; own, worker : MiB at the most, of itself and of its
    largest process at work
    """

    seconds: float
    own: float
    worker: float


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    with tempfile.TemporaryDirectory() as here:
        at = Path(os.environ.get("SCALE", here))
        drawing = drawn(at, COUNT)
        if drawing is not None:
            yield (
                f"{COUNT} images drawn by two processes",
                f"{drawing.seconds:.0f} s, {COUNT / drawing.seconds:.1f} a second",
                "",
            )
            yield "the same: memory of a process that draws", f"{drawing.worker:.0f} MiB", "<= 1024 MiB"
        few = part(at / f"rec{COUNT}", at / f"rec{COUNT}-few", COUNT // FEW)
        yield from _measured(at / f"rec{COUNT}", few, Path(here))


def _measured(recording, few, out):
    ways = {"one": ["--workers", "1"], "two": ["--workers", "2"]}
    with two_workers() as (address, peaks):
        ways["cluster"] = ["--workers", "2", "--scheduler", address]
        small = {
            mode: rig("measure", few, "--out", out / f"few-{mode}", "--force", *words) for mode, words in ways.items()
        }  # which also warms
        before = peaks()
        ran = {mode: [] for mode in ways}
        for _ in range(REPEATS):
            for mode, words in ways.items():
                ran[mode].append(rig("measure", recording, "--out", out / mode, "--force", *words))
        after = peaks()
    best = {mode: min(tried, key=lambda one: one.seconds) for mode, tried in ran.items()}
    for mode, name in (
        ("one", "one process"),
        ("two", "two processes"),
        ("cluster", "a cluster of two workers on loopback"),
    ):
        yield (
            f"{COUNT} images measured by {name}",
            f"{best[mode].seconds:.1f} s, {COUNT / best[mode].seconds:.1f} a second",
            "",
        )
    for mode, wanted in (("two", ">= 1.8"), ("cluster", ">= 1.7")):
        yield f"the same: one process's time over {mode}'s", f"{best['one'].seconds / best[mode].seconds:.2f}", wanted
    same = [name for name in FILES if len({(out / mode / name).read_bytes() for mode in ways}) == 1]
    yield f"files that are the same to the last byte by all three, of {len(FILES)}", str(len(same)), str(len(FILES))
    counts, wanted = f"{COUNT // FEW} and {COUNT} images", "<= 1024 MiB, flat"
    yield f"memory of a process at work, {counts}", f"{small['two'].worker:.0f}, {best['two'].worker:.0f} MiB", wanted
    yield f"memory of a cluster's worker, {counts}", f"{max(before):.0f}, {max(after):.0f} MiB", wanted
    yield f"memory of rig itself, {counts}", f"{small['one'].own:.0f}, {best['one'].own:.0f} MiB", ""


def drawn(at: Path, count: int) -> Ran | None:
    """Draw a recording of so many images as `at`/recN; None where it is there."""
    folder = at / f"rec{count}"
    if (folder / "frames.csv").exists():
        return None
    at.mkdir(parents=True, exist_ok=True)
    rig("design", "--radius", "0.3", "--cameras", str(CAMERAS), "--out", at / "rig.toml", "--force")
    return rig(
        "simulate",
        at / "rig.toml",
        "--plan",
        f"sobol:{count // CAMERAS}",
        "--seed",
        "7",
        "--images",
        "--blur",
        "0.5",
        "--read-noise",
        "1",
        "--workers",
        "2",
        "--out",
        folder,
    )


def part(recording: Path, folder: Path, count: int) -> Path:
    """A folder with the first images of a recording, as links."""
    lines = (recording / "frames.csv").read_text().splitlines()
    for line in lines[1 : count + 1]:
        name = line.split(",")[3]
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if not (folder / name).exists():
            os.link(recording / name, folder / name)
    (folder / "frames.csv").write_text("\n".join(lines[: count + 1]) + "\n")
    for name in ("rig.toml", "commands.csv", "sensors.csv"):
        (folder / name).write_bytes((recording / name).read_bytes())
    return folder


def rig(*words: object) -> Ran:
    """Run a command by itself. Raises RuntimeError where it fails."""
    start = time.monotonic()
    done = subprocess.run([sys.executable, "-c", RUN, *map(str, words), "--quiet"], capture_output=True, text=True)
    seconds = time.monotonic() - start
    peak = re.search(r"peak (\d+) (\d+)", done.stderr)
    if done.returncode or peak is None:
        raise RuntimeError(f"rig {' '.join(map(str, words))}: {done.stderr}")
    return Ran(seconds, int(peak[1]) / 1024, int(peak[2]) / 1024)


@contextmanager
def two_workers():
    """(Address of a scheduler on loopback, a function that gives what each of its two workers took at most so far,
    MiB).
    """
    from dask.distributed import Client, LocalCluster

    here = LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=":0")
    with here, Client(here, set_as_default=False) as client:
        yield here.scheduler_address, lambda: list(client.run(_peak).values())


def _peak():
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
