"""Joints and limits of an arm out of a table of outside data: rows of figures, those of slides told by a word."""

import numpy as np

from rig.entries import LARGEST_RIG, Entries, slip
from rig.outside import shown

KINDS = {"revolute": False, "prismatic": True}


def joints(table: Entries) -> tuple[np.ndarray, np.ndarray]:
    """((n, 4 or 5) rows of theta (rad), d (m), a (m), alpha (rad), beta (rad); (n,) bool, which joints slide) of the key "joints".

    A row may begin with "revolute", the default, or "prismatic". Raises FileError for anything else, no rows, or lengths beyond any rig
    """
    rows = table.get("joints")
    if not isinstance(rows, list) or not all(isinstance(row, list) for row in rows):
        table.fail(f"{table.name('joints')} must be a list of rows [theta, d, a, alpha], those of slides [\"prismatic\", theta, d, a, alpha]",
                   "joints")
    if not rows:
        table.fail(f"{table.name('joints')} is empty", "joints")
    slides = np.array([_slides(table, i, row) for i, row in enumerate(rows)])
    told = [isinstance(row[0], str) if row else False for row in rows]
    columns = len(rows[0]) - told[0]
    columns = columns if columns in (4, 5) else 4
    for i, (row, word) in enumerate(zip(rows, told)):
        if len(row) - word != columns:
            table.fail(f"{table.name('joints')}[{i + 1}] must have {columns} numbers, theta, d, a, alpha{', beta' if columns == 5 else ''}, "
                       f"got {len(row) - word} entries", "joints", i)
        for j in range(columns):
            table.numbers(row[j + word], (), "joints", (i, j + word), LARGEST_RIG if j in (1, 2) else None)
    return np.array([row[word:] for row, word in zip(rows, told)], float), slides


def _slides(table: Entries, i: int, row: list) -> bool:
    """Whether a row is of a slide."""
    word = row[0] if row else None
    if not isinstance(word, str):
        return False
    if word not in KINDS:
        near = slip(word, KINDS)
        table.fail(f"{table.name('joints')}[{i + 1}] is of a joint {shown(word)}{f'; is {near!r} meant?' if near else ''}; there are "
                   f"{', '.join(map(repr, KINDS))}", "joints", i, 0, value=word)
    return KINDS[word]


def limits(table: Entries, slides: np.ndarray) -> np.ndarray:
    """(n, 2) rad, of slides m, of the key "limits". slides : (n,) bool. Raises FileError where they do not run from small to large, or
    a slide's are beyond any rig."""
    found = table.array("limits", (len(slides), 2))
    for i, (low, high) in enumerate(found):
        if not low < high:
            table.fail(f"{table.name('limits')}[{i + 1}] must run from small to large, not {low:g} .. {high:g}", "limits", i)
        if slides[i]:
            for j in range(2):
                table.numbers(float(found[i, j]), (), "limits", (i, j), LARGEST_RIG)
    return found
