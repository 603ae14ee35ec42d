"""Columns of poses.csv that say of which frame a row is, and of which hand of an arm with several."""

from dataclasses import replace
from typing import Any, NoReturn

import numpy as np

from rig.array_and_json_types import Integers
from rig.formats.checked_entries import nearest_known_word
from rig.formats.csv_and_parquet_tables_and_time_origin import Table

HAND = "hand"


def frame_column(rows: Table, known_frames: set[int] | None) -> Integers:
    """(n,) frame of each row. Raises FileError for one that is not known, and for one that is listed twice."""
    return frame_and_hand_columns(rows, known_frames, ())[0]


def frame_and_hand_columns(
    rows: Table, known_frames: set[int] | None, hands: tuple[str, ...]
) -> tuple[Integers, Integers | None]:
    """(frame (n,), number (n,) of the hand) of each row; no numbers where there are no names of hands.

    Raises FileError for a frame or hand that is not known, and for one that is listed twice
    """
    frame, seen = rows.whole("frame"), dict[Any, int]()
    names = rows.text(HAND) if hands else [""] * len(frame)
    for i, (number, name) in enumerate(zip(frame.tolist(), names)):
        if known_frames is not None and number not in known_frames:
            rows.fail(f"frame {number} is not in frames.csv", i, "frame", number)
        if hands and name not in hands:
            _fail_unknown_hand(rows, i, name, hands)
        if (number, name) in seen:
            of = f" of hand {name!r}" if hands else ""
            first = rows.lines[seen[number, name]]
            rows.fail(f"frame {number}{of} is listed twice, first in line {first}", i, "frame", number)
        seen[number, name] = i
    return frame, np.array([hands.index(name) for name in names]) if hands else None


def rows_of_hand(rows: Table, hands: tuple[str, ...], hand: str) -> Table:
    """The rows of a table whose column `hand` names one of several hands; all where there is no such column.

    Raises FileError for a name that no hand has, and for a table without a row of this hand
    """
    if HAND not in rows.columns:
        return rows
    names = rows.text(HAND)
    for i, name in enumerate(names):
        if name not in hands:
            _fail_unknown_hand(rows, i, name, hands)
    own = np.flatnonzero(np.array(names) == hand)
    if not len(own):
        rows.fail(f"no row is of hand {hand!r}, only of {', '.join(sorted(set(names)))}", 0, HAND, names[0])
    return replace(rows, rows=[rows.rows[i] for i in own], lines=rows.lines[own])


def _fail_unknown_hand(rows: Table, row: int, name: str, hands: tuple[str, ...]) -> NoReturn:
    """Raise FileError for a name in the column `hand` that no hand has."""
    near = nearest_known_word(name, hands)
    hint = f"; is {near!r} meant?" if near else f"; rig.toml has {', '.join(hands)}"
    rows.fail(f"{name!r} is no hand{hint}", row, HAND, name)
