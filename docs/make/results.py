"""The page of results: every measured figure that the documents state, from the kept files in docs/results."""

import json
from pathlib import Path
from typing import Any

SCHEMA = "results/1"
FOLDER = Path(__file__).parents[1] / "results"
PAGE = FOLDER.parent / "results.md"
HEAD = """# Results

Each table is what one benchmark printed, kept in `docs/results/` with the commit, machine and command that gave it. A "+" behind a commit means that
the tree differed from it. Other pages state no measured figure but with a link to this one, and a test holds their words to these files.
`make results` measures anew: `make results BENCH="corners arms"` for those that are named. Errors are against simulated truth unless a row says
otherwise.
Times depend on what else the machine was doing: `load` is how many processes wanted to run when the benchmark began.
"""


def kept() -> list[dict[str, Any]]:
    """The kept results, by name. Raises ValueError for a file of another schema."""
    found = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(FOLDER.glob("*.json"))]
    for record in found:
        if record["schema"] != SCHEMA:
            raise ValueError(f"docs/results/{record.get('name')}.json has the schema {record['schema']!r}, not {SCHEMA!r}")
    return found


def page() -> str:
    """The page as Markdown."""
    return HEAD + "".join(_section(record) for record in kept())


def _section(record: dict[str, Any]) -> str:
    on = record["machine"]
    versions = ", ".join(f"{name} {number}" for name, number in on["versions"].items())
    made = (f"`{record['command']}`, commit `{record['commit']}`, {record['created'][:10]}, seed {record['seed']}; "
            f"{on['cores']} cores ({on['processor']}), {on['memory_GiB']} GiB, load {on['load']}; {versions}")
    rows = "".join(f"| {_cell(row['figure'])} | {_cell(row['reached'])} | {_cell(row['wanted'])} |\n" for row in record["figures"])
    return f"\n## {record['name']}\n\n{_cell(record['title'])}\n\n| figure | reached | wanted |\n|---|---|---|\n{rows}\n{made}.\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;")
