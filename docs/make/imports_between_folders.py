"""Which folder of the packages imports which, and how often: counted by grimp, and ordered into layers."""

from collections import Counter
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import grimp

ROOT = Path(__file__).parents[2]
PACKAGES = ("rig", "vision", "calib", "synthetic")
COMMANDS = "rig/cli"  # sees all packages, so that it stands for itself among them

Counts = dict[tuple[str, str], int]  # {(importing, imported): imports}


@cache
def module_imports() -> tuple[tuple[str, str], ...]:
    """(importing module, imported module) of every import within the packages, those inside functions too."""
    graph = grimp.build_graph(*PACKAGES)
    return tuple(
        sorted((module, other) for module in graph.modules for other in graph.find_modules_directly_imported_by(module))
    )


def package_of(module: str) -> str:
    """The package of a module; of the commands their folder."""
    return COMMANDS if folder_of(module) == COMMANDS else module.split(".")[0]


def folder_of(module: str) -> str:
    """The folder, one level below its package, in which a module lies; the package itself for a file at its top."""
    parts = module.split(".")[:2]
    return "/".join(parts) if ROOT.joinpath(*parts).is_dir() else parts[0]


def package_counts() -> Counts:
    """Imports between packages."""
    return _counted((package_of(a), package_of(b)) for a, b in module_imports())


def folder_counts(package: str) -> Counts:
    """Imports between the folders of one package."""
    return _counted(
        (folder_of(a), folder_of(b)) for a, b in module_imports() if a.split(".")[0] == b.split(".")[0] == package
    )


def _counted(pairs: Iterable[tuple[str, str]]) -> Counts:
    return dict(sorted(Counter((a, b) for a, b in pairs if a != b).items()))


def names(counts: Counts) -> list[str]:
    """All folders that import or are imported, by name."""
    return sorted({name for pair in counts for name in pair})


def order(counts: Counts) -> list[str]:
    """The folders from those that import to those that are imported, so that few imports run against it: each is moved
    to where fewest do, until no move helps."""

    def against(row: list[str]) -> int:
        place = {name: k for k, name in enumerate(row)}
        return sum(n for (a, b), n in counts.items() if place[a] > place[b])

    def balance(name: str) -> int:
        return sum(n for (a, _), n in counts.items() if a == name) - sum(n for (_, b), n in counts.items() if b == name)

    row = sorted(names(counts), key=lambda name: (-balance(name), name))
    while True:
        moves = [
            [*rest[:k], name, *rest[k:]]
            for name in row
            for rest in [[other for other in row if other != name]]
            for k in range(len(row))
        ]
        best = min(moves, key=against, default=row)
        if against(best) >= against(row):
            return row
        row = best


def downward(counts: Counts) -> Counts:
    """The imports that run along the order; all others run against it."""
    place = {name: k for k, name in enumerate(order(counts))}
    return {(a, b): n for (a, b), n in counts.items() if place[a] < place[b]}


def layers(counts: Counts) -> dict[str, int]:
    """{folder: layer}, 0 at the bottom: one above the highest that it imports along the order."""
    found: dict[str, int] = {}
    along = downward(counts)
    for name in reversed(order(counts)):
        found[name] = max((found[b] + 1 for a, b in along if a == name), default=0)
    return found


def unimplied(counts: Counts) -> Counts:
    """Downward imports without those that a longer chain of them implies."""
    along = downward(counts)
    below = {name: {b for a, b in along if a == name} for name in names(counts)}

    def reached(name: str) -> set[str]:
        return below[name].union(*(reached(other) for other in below[name]))

    return {(a, b): n for (a, b), n in along.items() if not any(b in reached(other) for other in below[a] - {b})}
