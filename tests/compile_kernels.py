"""Compile the kernels that most tests call once, on two cores, before each of the tests' processes would: python -m
tests.compile_kernels.
"""

import subprocess
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.cli import RIG

BENCH = Path(__file__).parent / "data" / "bench"


def ways(folder: Path) -> tuple[list[list[str]], ...]:
    """Commands that follow each other, of two ways that can be gone side by side, writing into a folder: from images,
    and from corners on.
    """
    rec, arm, on_arm = folder / "rec", folder / "arm.toml", folder / "on-arm"
    images = [["measure", BENCH / "check", "--out", folder / "measured"]]
    corners = [
        ["simulate", BENCH / "fit" / "rig.toml", "--plan", "sobol:40", "--seed", "1", "--out", rec],
        ["calibrate", rec, "--out", folder / "calibration.json"],
        ["diagnose", rec, "--out", folder / "diagnosed", "--only", "backlash", "--only", "edge_bias"],
        ["design", "--arm", "ur10", "--out", arm],
        ["simulate", arm, "--plan", "sobol:60", "--seed", "1", "--out", on_arm],
        ["calibrate", on_arm, "--out", folder / "arm.json"],
    ]
    return tuple([[str(word) for word in command] for command in commands] for commands in (images, corners))


def go(commands: list[list[str]]) -> None:
    """Run commands one after another. Raises CalledProcessError with what the command printed to the error output
    shown.
    """
    for command in commands:
        subprocess.run([*RIG, *command], check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made, ThreadPoolExecutor() as pool:
        list(pool.map(go, ways(Path(made))))
