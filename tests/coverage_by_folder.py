"""Which share of its statements the tests ran, by package and folder: python -m tests.coverage_by_folder
out/coverage.json.
"""

import json
import sys
from collections import Counter
from pathlib import Path, PurePath
from typing import Any

DEPTH = 2  # parts of a path that name a line: rig/effects, but not rig/effects/catalogue


def shares(report: dict[str, Any]) -> dict[str, tuple[int, int]]:
    """{folder: (statements run, statements)} of a report of coverage.py as JSON: packages, and their folders by
    name.
    """
    run, total = Counter[str](), Counter[str]()
    for name, file in report["files"].items():
        folders = PurePath(name).parent.parts[:DEPTH]
        for count in range(1, len(folders) + 1):
            folder = "/".join(folders[:count])
            run[folder] += file["summary"]["covered_lines"]
            total[folder] += file["summary"]["num_statements"]
    return {folder: (run[folder], total[folder]) for folder in sorted(total)}


def table(found: dict[str, tuple[int, int]]) -> str:
    """A line a folder: its share in percent, statements run, statements; folders of a package are indented below it."""
    packages = [pair for folder, pair in found.items() if "/" not in folder]
    rows = [*found.items(), ("all", (sum(run for run, _ in packages), sum(total for _, total in packages)))]
    return "\n".join(
        f"{'  ' * folder.count('/') + folder:30} {_percent(*pair):>7} {pair[0]:>7} of {pair[1]:>6}"
        for folder, pair in rows
    )


def _percent(run: int, total: int) -> str:
    return f"{100 * run / total:.1f} %" if total else "none"


def main() -> None:
    """Print the table of the report named."""
    print(table(shares(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")))))


if __name__ == "__main__":
    main()
