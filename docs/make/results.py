"""The page of results: every measured figure that the documents state, from the files in docs/results, by version of
rig.
"""

import json
from pathlib import Path
from typing import Any

SCHEMA = "results/2"
FOLDER = Path(__file__).parents[1] / "results"
PAGE = FOLDER.parent / "results.md"
HEAD = """# Results

Each table is what one benchmark printed. It is stored in `docs/results/VERSION/` with the commit, machine, date and \
command that gave it. A file
is never changed after its version is released. A "+" behind a commit means that the tree differed from it. A \
benchmark that was not run again for a
version keeps its newest result; where an older version has the same figure, a column shows it. Other pages state no \
measured figure but with a link
to this one, and a test holds their words to these files.
`make results` measures anew: `make results BENCH="corners arms"` for those that are named. Errors are against \
simulated truth unless a row says
otherwise.
Times depend on what else the machine was doing: `load` is how many processes wanted to run when the benchmark began.
"""


def stored() -> list[dict[str, Any]]:
    """All stored results, by version, the newest last, and name. Raises ValueError for a file of another schema or in
    another version's folder.
    """
    paths = sorted(FOLDER.glob("*/*.json"), key=lambda path: (_order(path.parent.name), path.stem))
    return [_record(path) for path in paths]


def newest() -> list[dict[str, Any]]:
    """The newest stored result of each benchmark, by name."""
    found = {record["name"]: record for record in stored()}
    return [found[name] for name in sorted(found)]


def page() -> str:
    """The page as Markdown."""
    return HEAD + "".join(_section(record, _before(record)) for record in newest())


def _record(path: Path) -> dict[str, Any]:
    record = json.loads(path.read_text(encoding="utf-8"))
    where = path.relative_to(FOLDER.parents[1])
    if record["schema"] != SCHEMA:
        raise ValueError(f"{where} has the schema {record['schema']!r}, not {SCHEMA!r}")
    if (record["version"], record["name"]) != (path.parent.name, path.stem):
        raise ValueError(f"{where} says that it is {record['name']!r} of version {record['version']!r}")
    return record


def _order(version: str) -> list[int]:
    return [int(part) for part in version.split(".")]


def _before(record: dict[str, Any]) -> dict[str, Any] | None:
    """The result of the same benchmark for the version before, or None."""
    older = [other for other in stored() if other["name"] == record["name"] and other["version"] != record["version"]]
    return older[-1] if older else None


def _section(record: dict[str, Any], before: dict[str, Any] | None) -> str:
    on = record["machine"]
    versions = ", ".join(f"{name} {number}" for name, number in on["versions"].items())
    made = (
        f"`{record['command']}`, version {record['version']}, commit `{record['commit']}`, "
        f"{record['created'][:10]}, seed {record['seed']}; "
        f"{on['cores']} cores ({on['processor']}), {on['memory_GiB']} GiB, load {on['load']}; {versions}"
    )
    older = {row["figure"]: row["reached"] for row in before["figures"]} if before else {}
    columns = ["figure", "reached", "wanted", *([f"in {before['version']}"] if before else [])]
    rows = [
        [row["figure"], row["reached"], row["wanted"], *([older.get(row["figure"], "")] if before else [])]
        for row in record["figures"]
    ]
    lines = [line(columns), "|" + "---|" * len(columns), *(line(row) for row in rows)]
    return f"\n## {record['name']}\n\n{_cell(record['title'])}\n\n" + "\n".join(lines) + f"\n\n{made}.\n"


def line(cells: list[str]) -> str:
    """A row of a table in Markdown."""
    return "| " + " | ".join(_cell(text) for text in cells) + " |"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;")
