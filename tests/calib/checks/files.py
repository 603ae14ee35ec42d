"""A recording's files as plain text and tables, for spoiling them: nothing here knows how mistakes are recognised."""

import csv
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import tomlkit


def rows(path: Path) -> tuple[list[str], list[list[str]]]:
    """(header, rows) of a CSV file."""
    with open(path, newline="") as file:
        header, *body = list(csv.reader(file))
    return header, body


def write(path: Path, header: list[str], body: list[list[str]]) -> None:
    """Write a CSV file."""
    with open(path, "w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *body])


def column(
    path: Path, name: str, change: Callable[[np.ndarray], np.ndarray], rows_of: Callable[[dict], bool] | None = None
) -> None:
    """Change the numbers of a column, in the rows that rows_of (of {column: text}) says, or in all."""
    header, body = rows(path)
    at = header.index(name)
    which = [i for i, row in enumerate(body) if rows_of is None or rows_of(dict(zip(header, row)))]
    for i, value in zip(which, change(np.array([float(body[i][at]) for i in which]))):
        body[i][at] = (
            repr(float(value))
            if float(value) != int(value) or name not in ("marker", "corner", "frame")
            else str(int(value))
        )
    write(path, header, body)


def columns(path: Path, names: tuple[str, ...], change: Callable[[np.ndarray], np.ndarray]) -> None:
    """Change the numbers of several columns together: (n, k) -> (n, k)."""
    header, body = rows(path)
    at = [header.index(name) for name in names]
    for row, values in zip(body, change(np.array([[float(row[k]) for k in at] for row in body]))):
        for k, value in zip(at, values):
            row[k] = repr(float(value))
    write(path, header, body)


def rename(path: Path, change: Callable[[list[str]], list[str]]) -> None:
    """Change the header of a CSV file."""
    header, body = rows(path)
    write(path, change(header), body)


def rig(folder: Path, change: Callable[[dict], None]) -> None:
    """Change rig.toml as a tree, in place."""
    path = folder / "rig.toml"
    document = tomlkit.parse(path.read_text()).unwrap()
    change(document)
    path.write_text(tomlkit.dumps(document))
    tomllib.loads(path.read_text())
