"""Run benchmarks and keep what they gave, with what it was made by: python -m tests.bench.results [way forward ...]."""

import json
import sys
from datetime import UTC, datetime

from docs.make import results, validation
from tests.bench.benchmark_list import ALL, NAMED
from tests.bench.result_provenance import ROOT, commit, machine, release


def keep(name: str) -> None:
    """Run one benchmark and write docs/results/VERSION/NAME.json."""
    module, before = NAMED[name], machine()
    rows = [{"figure": figure, "reached": reached, "wanted": wanted} for figure, reached, wanted in module.rows()]
    record = {
        "schema": results.SCHEMA,
        "name": name,
        "title": (module.__doc__ or "").splitlines()[0],
        "command": f"python -m tests.bench {name}",
        "seed": getattr(module, "SEED", "in the benchmark"),
        "version": release(),
        "commit": commit(),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": before,
        "figures": rows,
    }
    path = results.FOLDER / record["version"] / f"{name}.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def main() -> None:
    """Keep the benchmarks named, all quick ones by default, and draw the page."""
    for name in sys.argv[1:] or ALL:
        if name not in NAMED:
            sys.exit(f"no benchmark {name!r}; there are {', '.join(NAMED)}")
        print(f"{name} ..", flush=True)
        keep(name)
    results.PAGE.write_text(results.page(), encoding="utf-8")
    validation.PAGE.write_text(validation.page(), encoding="utf-8")
    print(f"written: {results.PAGE.relative_to(ROOT)} and {validation.PAGE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
