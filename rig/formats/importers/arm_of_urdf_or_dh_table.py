"""Arm read from a URDF or a Denavit-Hartenberg table.

Columns of the table stand in any order; also the rig.toml text of the arm.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats
from rig.errors import FileError, RigError
from rig.formats.checked_entries import LARGEST_RIG, nearest_known_word
from rig.formats.importers.csv_dialect import read_foreign_table_header_and_cells
from rig.formats.importers.foreign_table_columns import Cells
from rig.formats.importers.import_recipe import ForeignTable
from rig.formats.importers.units_and_timestamps import split_header
from rig.formats.importers.urdf_hands_and_dh_rows_of_joint_axes import (
    PlacedRows,
    denavit_hartenberg_rows_of_joint_axes,
    distal_rows_of_modified_rows,
    urdf_arm_with_several_hands,
)
from rig.formats.importers.urdf_joint_chain import MOVING, limits_text, load_joint_chain
from rig.formats.local_and_remote_input_files import short_repr
from rig.formats.numbers_and_units import ANGLES, LENGTHS, SI, parse_length_and_angle_units
from rig.model.mechanism_geometry_classes import Arm

FIGURES = ("theta", "d", "a", "alpha")
KNOWN = (*FIGURES, "beta", "joint", "name", "lower", "upper")
KINDS = {"revolute": False, "r": False, "prismatic": True, "p": True}
FULL_TURN = 2 * np.pi  # rad, to either side, of a joint whose limits are not stated
MOST_ANGLE = 2 * np.pi + 1e-6  # rad


@dataclass(frozen=True, slots=True, eq=False)
class DenavitHartenbergTable:
    """placed : PlacedRows, distal; slides : (n,) bool; limits : (n, 2) rad, of slides m; names : of its joints
    assumed : which of its joints have no limits stated
    """

    placed: PlacedRows
    slides: Booleans
    limits: Floats
    names: tuple[str, ...]
    assumed: Booleans


def load_denavit_hartenberg_table(
    path: Path, is_modified: bool = False, units: str | None = None
) -> DenavitHartenbergTable:
    """DenavitHartenbergTable of a CSV with a header.

    Its columns: theta, d, a, alpha; optional beta, joint, name, lower, upper.
    is_modified : whether the rows are in Craig's convention (alpha and a of a row before its theta and d), not distal
    units : "mm,deg" and the like, of columns whose header states none; None for m and rad
    Raises FileError for what is missing, unknown or no number, and for figures that are no radians or metres
    """
    length, angle = _units(units)
    cells = read_foreign_table_header_and_cells(ForeignTable(path), "dh")
    at = _columns(cells)
    missing = [name for name in FIGURES if name not in at]
    if missing:
        _fail(cells, f"has no column {missing[0]}; its header is {', '.join(cells.header)}")
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
    placed = distal_rows_of_modified_rows(rows[:, :4]) if is_modified else PlacedRows(rows, *_NOWHERE)
    names = cells.column(at["name"]) if "name" in at else [f"q{i + 1}" for i in range(len(slides))]
    return DenavitHartenbergTable(placed, slides, limits, tuple(names), assumed)


_NOWHERE = distal_rows_of_modified_rows(np.zeros((1, 4)))[1:]


def _fail(cells: Cells, message: str) -> NoReturn:
    raise FileError(cells.path, message, max(cells.lines[0] - 1, 1))


def _units(units: str | None) -> tuple[str, str]:
    """(unit of lengths, unit of angles) of columns whose header states none."""
    try:
        found = SI if units is None else parse_length_and_angle_units(units)
    except ValueError as error:
        raise RigError(f"--units takes {error}") from None
    return found.length, found.angle


def _columns(cells: Cells) -> dict[str, int]:
    """{name of KNOWN: column}. Raises FileError for one that is unknown or there twice."""
    found: dict[str, int] = {}
    for k, header in enumerate(cells.header):
        name = split_header(header)[0].strip().lower()
        if name not in KNOWN:
            near = nearest_known_word(name, KNOWN)
            _fail(
                cells,
                f"column {short_repr(header)} is unknown; "
                + (f"is {near!r} meant?" if near else f"there are {', '.join(KNOWN)}"),
            )
        if name in found:
            _fail(cells, f"has two columns {name}")
        found[name] = k
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


@dataclass(frozen=True, slots=True, eq=False)
class ReadArm:
    """An Arm read from a file. name : of the machine; joint_names : as the file has them; source : where it comes from
    lines : what was read of each joint, and what does not count
    """

    arm: Arm
    name: str
    joint_names: tuple[str, ...]
    source: str
    lines: tuple[str, ...]

    def rig_toml(self, name: str | None = None) -> str:
        """rig.toml text of it, with its joints' names as comments. name : of the machine, None for the file's"""
        arm, lines = self.arm, [f"# {_comment(line)}" for line in self.lines]
        columns = 5 if arm.rows[:, 4].any() else 4
        joints = [
            f"  {json.dumps([*(['prismatic'] if slide else []), *row[:columns]])},  # {axis}: {_comment(name)}"
            for row, slide, axis, name in zip(arm.rows.tolist(), arm.slides, arm.axes, self.joint_names)
        ]
        limits = [f"  [{low!r}, {high!r}]," for low, high in arm.limits.tolist()]
        stands = [
            f"{key} = {_pose(T)}   # {text}"
            for key, T, text in (
                ("base", arm.base, "frame 0 of the rows, in the frame of poses"),
                ("tool", arm.tool, "what is measured, in the last frame of the rows"),
            )
            if not _is_identity(T) and not (key == "tool" and arm.hands)
        ]
        return "\n".join(
            [
                'schema = "rig/1"',
                f"name = {json.dumps(name or self.name)}",
                f"# from {_comment(self.source)}",
                *lines,
                "",
                "[mechanism]",
                'kind = "arm"',
                "# Denavit-Hartenberg, distal: theta (rad), d (m), a (m), alpha (rad)"
                + (", Hayati's beta (rad)" if columns == 5 else ""),
                "joints = [",
                *joints,
                "]",
                "limits = [",
                *limits,
                "]",
                *stands,
                *_branch_and_hand_tables(arm),
                "",
            ]
        )


def _branch_and_hand_tables(arm: Arm) -> list[str]:
    """Lines of the tables of an arm's branches and hands; none of an arm with one hand."""
    out: list[str] = []
    for branch in arm.branches:
        out += ["", "[[mechanism.branch]]", f"joint = {branch.joint + 1}", f"parent = {branch.parent + 1}"]
        out += [] if _is_identity(branch.mount) else [f"mount = {_pose(branch.mount)}"]
    for hand in arm.hands:
        out += ["", "[[mechanism.hand]]", f"name = {json.dumps(hand.name)}", f"joint = {hand.joint + 1}"]
        out += [] if _is_identity(hand.tool) else [f"tool = {_pose(hand.tool)}"]
    return out


def _pose(T: RigidTransform) -> str:
    return f"{{ position = {T.translation.tolist()}, rotvec = {T.rotation.as_rotvec().tolist()} }}"


def _comment(text: str) -> str:
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def _is_identity(T: RigidTransform) -> bool:
    return not T.translation.any() and T.rotation.magnitude() == 0


@dataclass(frozen=True, slots=True)
class ArmFileOptions:
    """The file that states an arm. urdf : with tips and root, links of it, none for its only end and its first; several
    tips are the hands of one arm
    dh : table of Denavit-Hartenberg rows, with modified, whether in Craig's convention, and units, as "mm,deg"
    Raises RigError for options that do not belong to each other
    """

    urdf: Path | None = None
    tips: tuple[str, ...] = ()
    root: str | None = None
    dh: Path | None = None
    modified: bool = False
    units: str | None = None

    def __post_init__(self) -> None:
        if self.urdf is not None and self.dh is not None:
            raise RigError("--urdf and --dh both state the arm; give only one")
        if (self.tips or self.root is not None) and self.urdf is None:
            raise RigError("--tip and --root name links of a URDF; give --urdf FILE.urdf")
        if (self.modified or self.units is not None) and self.dh is None:
            raise RigError("--modified and --units apply to a table of Denavit-Hartenberg rows; give --dh FILE.csv")

    @property
    def file(self) -> Path | None:
        """The file, None where none is named."""
        return self.urdf if self.dh is None else self.dh


def read_arm_file(options: ArmFileOptions) -> ReadArm | None:
    """ReadArm of the file that is named, None where none is.

    Raises FileError as rig.formats.importers.urdf_joint_chain.load_joint_chain, and load_denavit_hartenberg_table of
        rig.formats.importers.arm_of_urdf_or_dh_table
    """
    if options.urdf is not None:
        return read_urdf_arm(options.urdf, options.tips, options.root)
    return None if options.dh is None else read_dh_table_arm(options.dh, options.modified, options.units)


def read_urdf_arm(path: Path, tips: tuple[str, ...] = (), root: str | None = None) -> ReadArm:
    """ReadArm of a URDF's joints from a root link to a tip, or to several, whose forward kinematics is the URDF's.

    Raises FileError as rig.formats.importers.urdf_joint_chain.load_joint_chain
    """
    if len(tips) > 1:
        return _read_urdf_arm_with_several_hands(path, tips, root)
    chain = load_joint_chain(path, tips[0] if tips else None, root)
    placed = denavit_hartenberg_rows_of_joint_axes(*chain.axes_at_zero())
    moving = chain.moving
    arm = Arm(
        placed.rows,
        np.array([joint.limits for joint in moving]),
        placed.base,
        placed.tool,
        np.array([joint.kind == "prismatic" for joint in moving]),
    )
    source = f"{path.name}, link {chain.root} to link {chain.tip}"
    lines = (*(joint.line_of_text for joint in chain.joints), *chain.remarks)
    return ReadArm(arm, chain.name, tuple(joint.name for joint in moving), source, lines)


def _read_urdf_arm_with_several_hands(path: Path, tips: tuple[str, ...], root: str | None) -> ReadArm:
    """The same of an arm whose hands are several tips."""
    arm, chains = urdf_arm_with_several_hands(path, tips, root)
    joints = {joint.name: joint for chain in chains for joint in chain.joints}
    names = [joint.name for joint in joints.values() if joint.kind in MOVING]
    shared = [name for name in names if all(name in [joint.name for joint in chain.moving] for chain in chains)]
    lines = [joint.line_of_text for joint in joints.values()]
    lines.append(f"joints that all hands share: {', '.join(shared) or 'none'}")
    remarks = dict.fromkeys(line for chain in chains for line in chain.remarks if not _names_any(line, names))
    source = f"{path.name}, link {chains[0].root} to links {', '.join(tips)}"
    return ReadArm(arm, chains[0].name, tuple(names), source, (*lines, *remarks))


def _names_any(remark: str, names: list[str]) -> bool:
    """Whether a remark on a joint that is left out names one that another hand has."""
    return any(remark.startswith(f"ignored joint {name}:") for name in names)


def read_dh_table_arm(path: Path, is_modified: bool = False, units: str | None = None) -> ReadArm:
    """ReadArm of a table of Denavit-Hartenberg rows.

    Raises FileError as rig.formats.importers.arm_of_urdf_or_dh_table.load_denavit_hartenberg_table
    """
    table = load_denavit_hartenberg_table(path, is_modified, units)
    arm = Arm(table.placed.rows, table.limits, table.placed.base, table.placed.tool, table.slides)
    lines = [
        f"read joint {name}: {MOVING[2] if slide else MOVING[0]}, limits{' assumed' if assumed else ''} "
        f"{limits_text(limits, slide)}"
        for name, slide, assumed, limits in zip(table.names, table.slides, table.assumed, table.limits)
    ]
    convention = "modified (Craig) rows, converted to distal ones" if is_modified else "distal rows"
    return ReadArm(arm, path.stem, table.names, f"{path.name}, {convention}", tuple(lines))
