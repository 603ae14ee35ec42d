"""Joints of an arm read from a table: Denavit-Hartenberg rows, or the screw axes of a product of exponentials.

Columns stand in any order.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats
from rig.errors import FileError, RigError
from rig.formats.checked_toml_and_json_entries import LARGEST_RIG, nearest_known_word
from rig.formats.importers.foreign_csv_dialect_detection import read_foreign_table_header_and_cells
from rig.formats.importers.foreign_file_import_recipe import ForeignTable
from rig.formats.importers.foreign_table_column_search_and_completion import Cells
from rig.formats.importers.foreign_table_units_and_timestamps import header_name_and_unit
from rig.formats.importers.urdf_hands_and_dh_rows_of_joint_axes import (
    PlacedRows,
    denavit_hartenberg_rows_of_joint_axes,
    distal_dh_rows_of_modified_dh_rows,
)
from rig.formats.local_and_remote_input_files import short_repr
from rig.formats.numbers_and_units import ANGLES, LENGTHS, SI, parse_length_and_angle_units

FIGURES = ("theta", "d", "a", "alpha")
KNOWN = (*FIGURES, "beta", "joint", "name", "lower", "upper")
DIRECTION, MOMENT = ("wx", "wy", "wz"), ("vx", "vy", "vz")
SCREW = (*DIRECTION, *MOMENT, "name", "lower", "upper")
UNIT_LENGTH = 1e-6  # by which a direction's length may differ from 1
PITCH = 1e-9  # m/rad, of a joint that turns
KINDS = {"revolute": False, "r": False, "prismatic": True, "p": True}
FULL_TURN = 2 * np.pi  # rad, to either side, of a joint whose limits are not stated
MOST_ANGLE = 2 * np.pi + 1e-6  # rad


@dataclass(frozen=True, slots=True, eq=False)
class JointTable:
    """placed : PlacedRows, distal; slides : (n,) bool; limits : (n, 2) rad, of slides m; names : of its joints
    assumed : which of its joints have no limits stated; axis_texts : what was read of each axis, where that is not the
    row itself
    """

    placed: PlacedRows
    slides: Booleans
    limits: Floats
    names: tuple[str, ...]
    assumed: Booleans
    axis_texts: tuple[str, ...] = ()


def load_denavit_hartenberg_table(path: Path, is_modified: bool = False, units: str | None = None) -> JointTable:
    """Load a CSV table of Denavit-Hartenberg rows as a JointTable.

    Its columns: theta, d, a, alpha; optional beta, joint, name, lower, upper.
    is_modified : whether the rows are in Craig's convention (alpha and a of a row before its theta and d), not distal
    units : "mm,deg" and the like, of columns whose header states none; None for m and rad
    Raises FileError for what is missing, unknown or no number, and for figures that are no radians or metres
    """
    length, angle = _units(units)
    cells = read_foreign_table_header_and_cells(ForeignTable(path), "dh")
    at = _columns(cells, KNOWN, FIGURES)
    if is_modified and "beta" in at:
        _fail(cells, "has a column beta, which Craig's convention has none of")
    kinds = [text.strip().lower() for text in cells.column(at["joint"])] if "joint" in at else ["r"] * len(cells.rows)
    for text, line in zip(kinds, cells.lines):
        if text not in KINDS:
            raise FileError(path, f"joint {short_repr(text)} is neither revolute nor prismatic", line, at["joint"] + 1)
    slides = np.array([KINDS[text] for text in kinds])

    def figures(name: str) -> Floats:
        unit = cells.unit(at[name]) or (length if name in ("d", "a") else angle)
        return _figures(cells, at[name], name, unit, np.full(len(slides), name in ("d", "a")), units)

    rows = np.stack([figures(name) if name in at else np.zeros(len(slides)) for name in (*FIGURES, "beta")], axis=1)
    limits, assumed = _limits(cells, at, slides, (length, angle), units)
    placed = distal_dh_rows_of_modified_dh_rows(rows[:, :4]) if is_modified else PlacedRows(rows, *_NOWHERE)
    names = cells.column(at["name"]) if "name" in at else [f"q{i + 1}" for i in range(len(slides))]
    return JointTable(placed, slides, limits, tuple(names), assumed)


_NOWHERE = distal_dh_rows_of_modified_dh_rows(np.zeros((1, 4)))[1:]


def _fail(cells: Cells, message: str) -> NoReturn:
    raise FileError(cells.path, message, max(cells.lines[0] - 1, 1))


def _units(units: str | None) -> tuple[str, str]:
    """(unit of lengths, unit of angles) of columns whose header states none."""
    try:
        found = SI if units is None else parse_length_and_angle_units(units)
    except ValueError as error:
        raise RigError(f"--units takes {error}") from None
    return found.length, found.angle


def _columns(cells: Cells, known: tuple[str, ...], needed: tuple[str, ...]) -> dict[str, int]:
    """{name of known: column}. Raises FileError for one that is unknown, there twice, or needed and missing."""
    found: dict[str, int] = {}
    for k, header in enumerate(cells.header):
        name = header_name_and_unit(header)[0].strip().lower()
        if name not in known:
            near = nearest_known_word(name, known)
            _fail(
                cells,
                f"column {short_repr(header)} is unknown; "
                + (f"is {near!r} meant?" if near else f"there are {', '.join(known)}"),
            )
        if name in found:
            _fail(cells, f"has two columns {name}")
        found[name] = k
    missing = [name for name in needed if name not in found]
    if missing:
        _fail(cells, f"has no column {missing[0]}; its header is {', '.join(cells.header)}")
    return found


def _figures(cells: Cells, at: int, name: str, unit: str, is_length: Booleans, units: str | None) -> Floats:
    """A column's figures in m or rad. is_length : (n,) bool, which of them are lengths"""
    out = []
    for value, line, slide in zip(cells.numbers(at), cells.lines, is_length):
        scale = (LENGTHS if slide else ANGLES).get(unit)
        if scale is None:
            what = "a length" if slide else "an angle"
            raise FileError(cells.path, f"{name} is {what}, and its header states {unit}", line, at + 1, value)
        most, other = (LARGEST_RIG, "mm") if slide else (MOST_ANGLE, "deg")
        if abs(value / scale) > most:
            raise FileError(
                cells.path,
                f"{name} = {value:g} {unit} is implausible; is it in {other}? Head the column {name}_{other}"
                + ("" if units else ", or state --units mm,deg"),
                line,
                at + 1,
                value,
            )
        out.append(value / scale)
    return np.array(out)


def _limits(
    cells: Cells, at: dict[str, int], slides: Booleans, stated: tuple[str, str], units: str | None
) -> tuple[Floats, Booleans]:
    """(limits (n, 2) rad or m, (n,) which are assumed). Raises FileError for a slide without."""
    if ("lower" in at) != ("upper" in at):
        _fail(cells, f"has a column {'lower' if 'lower' in at else 'upper'} without the other one")
    if "lower" not in at:
        if slides.any():
            raise FileError(
                cells.path,
                "a prismatic joint has no limits: columns lower and upper state them",
                cells.lines[int(np.argmax(slides))],
            )
        return np.tile([-FULL_TURN, FULL_TURN], (len(slides), 1)), np.ones(len(slides), bool)
    out = np.zeros((len(slides), 2))
    for k, name in enumerate(("lower", "upper")):
        values, header = cells.numbers(at[name]), cells.unit(at[name])
        for i, slide in enumerate(slides):
            unit = header or stated[0 if slide else 1]
            scale = (LENGTHS if slide else ANGLES).get(unit)
            if scale is None:
                _fail(cells, f"column {name} is in {unit}, but has limits of both kinds of joints: use --units")
            out[i, k] = values[i] / scale
            if abs(out[i, k]) > (LARGEST_RIG if slide else 10 * np.pi):
                raise FileError(
                    cells.path,
                    f"{name} = {values[i]:g} {unit} is implausible; is it in {'mm' if slide else 'deg'}?"
                    + ("" if units else " State --units mm,deg"),
                    cells.lines[i],
                    at[name] + 1,
                )
    for i, (low, high) in enumerate(out):
        if not low < high:
            raise FileError(
                cells.path,
                f"lower is not below upper: {low:g} .. {high:g} {'m' if slides[i] else 'rad'}",
                cells.lines[i],
            )
    return out, np.zeros(len(slides), bool)


def load_product_of_exponentials_table(path: Path, T_home: RigidTransform, units: str | None = None) -> JointTable:
    """Load a CSV table of screw axes (product of exponentials) as a JointTable.

    They are wx, wy, wz, vx, vy, vz of each joint, in the frame of poses.
    T = exp(S_1 q_1) .. exp(S_n q_n) T_home. A joint that turns has w of length 1 and v = -w x (a point of its axis), m;
    one that slides has w = 0 and v of length 1. Optional columns name, lower, upper
    T_home : the hand's pose while all joint values are 0; units : as of `load_denavit_hartenberg_table`
    Raises FileError as there, and for an axis of another length or with a pitch.
    Source: Lynch and Park, Modern Robotics, 2017, ch. 4
    """
    length, angle = _units(units)
    cells = read_foreign_table_header_and_cells(ForeignTable(path), "poe")
    at = _columns(cells, SCREW, (*DIRECTION, *MOMENT))
    w, v = (np.stack([cells.numbers(at[name]) for name in names], axis=1) for names in (DIRECTION, MOMENT))
    slides = np.asarray(~w.any(axis=1))
    points = np.zeros((len(w), 3))
    for i, line in enumerate(cells.lines):
        axis, what = (v[i], "v of a joint that slides (w = 0)") if slides[i] else (w[i], "w")
        if abs(np.linalg.norm(axis) - 1) > UNIT_LENGTH:
            raise FileError(path, f"{what} has length {np.linalg.norm(axis):.6g}, and must have length 1", line)
        if not slides[i]:
            scales = [LENGTHS.get(cells.unit(at[name]) or length, 0.0) for name in MOMENT]
            if not all(scales):
                _fail(cells, "v of a joint that turns is a length, and its header states another unit")
            moment = v[i] / scales
            if np.abs(moment).max() > LARGEST_RIG:
                raise FileError(path, f"v reaches {np.abs(moment).max():g} m; is it in mm? State --units mm,deg", line)
            if abs(w[i] @ moment) > PITCH:
                raise FileError(path, f"w . v = {w[i] @ moment:.3g}, a screw's; v = -w x point gives 0", line)
            points[i] = np.cross(w[i], moment)
    directions = np.where(slides[:, None], v, w)
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    limits, assumed = _limits(cells, at, slides, (length, angle), units)
    placed = denavit_hartenberg_rows_of_joint_axes(points, directions, T_home)
    names = cells.column(at["name"]) if "name" in at else [f"q{i + 1}" for i in range(len(slides))]
    texts = tuple(
        f"along {_figures_text(d)}, " if slide else f"about {_figures_text(d)} through {_figures_text(p * 1e3)} mm, "
        for d, p, slide in zip(directions, points, slides)
    )
    return JointTable(placed, slides, limits, tuple(names), assumed, texts)


def _figures_text(values: Floats) -> str:
    return "(" + ", ".join(f"{value + 0.0:.6g}" for value in values) + ")"
