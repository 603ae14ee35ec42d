"""Run benchmarks and keep what they gave, with what it was made by: python -m tests.bench.results [way forward ...]."""

import json
import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from docs.make import results
from tests.bench.named import ALL, NAMED

ROOT = Path(__file__).parents[2]
PACKAGES = ("numpy", "scipy", "opencv-contrib-python-headless", "numba")


def commit() -> str:
    """The commit that is run, with "+" where the tree, but for the kept results, differs from it."""
    head = _git("rev-parse", "--short=12", "HEAD")
    return head + ("+" if _git("status", "--porcelain", "--untracked-files=no", ":!docs/results", ":!docs/results.md") else "")


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def machine() -> dict[str, object]:
    """What the figures were taken on, and what else ran there: cores, memory (GiB), processor, versions, load over a minute."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    names = [line.split(":", 1)[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
    return {"cores": os.cpu_count(), "memory_GiB": round(memory), "processor": names[0] if names else platform.machine(),
            "load": round(os.getloadavg()[0], 1), "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}}}


def keep(name: str) -> None:
    """Run one benchmark and write docs/results/NAME.json."""
    module, before = NAMED[name], machine()
    rows = [{"figure": figure, "reached": reached, "wanted": wanted} for figure, reached, wanted in module.rows()]
    record = {"schema": results.SCHEMA, "name": name, "title": (module.__doc__ or "").splitlines()[0], "command": f"python -m tests.bench {name}",
              "seed": getattr(module, "SEED", "in the benchmark"), "commit": commit(), "created": datetime.now(UTC).isoformat(timespec="seconds"),
              "machine": before, "figures": rows}
    (results.FOLDER / f"{name}.json").write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def main() -> None:
    """Keep the benchmarks named, all quick ones by default, and draw the page."""
    for name in sys.argv[1:] or ALL:
        if name not in NAMED:
            sys.exit(f"no benchmark {name!r}; there are {', '.join(NAMED)}")
        print(f"{name} ..", flush=True)
        keep(name)
    results.PAGE.write_text(results.page(), encoding="utf-8")
    print(f"written: {results.PAGE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
