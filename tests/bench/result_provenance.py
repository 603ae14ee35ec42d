"""What a result was made by: the version, the commit and the machine."""

import os
import platform
import subprocess
import tomllib
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("numpy", "scipy", "opencv-contrib-python-headless", "numba")


def release() -> str:
    """The version that pyproject.toml states: the release to which a result belongs."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]


def commit() -> str:
    """The commit that is run, with "+" where the tree, but for the kept results, differs from it."""
    head = _git("rev-parse", "--short=12", "HEAD")
    return head + (
        "+" if _git("status", "--porcelain", "--untracked-files=no", ":!docs/results", ":!docs/results.md") else ""
    )


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def machine() -> dict[str, object]:
    """What the figures were taken on, and what else ran there: cores, memory (GiB), processor, versions, load over a
    minute.
    """
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    names = [
        line.split(":", 1)[1].strip()
        for line in Path("/proc/cpuinfo").read_text().splitlines()
        if line.startswith("model name")
    ]
    return {
        "cores": os.cpu_count(),
        "memory_GiB": round(memory),
        "processor": names[0] if names else platform.machine(),
        "load": round(os.getloadavg()[0], 1),
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
    }
