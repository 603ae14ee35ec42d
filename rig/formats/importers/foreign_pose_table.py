"""Pose table of another program.

Units, rotation vectors, quaternions or Euler angles.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats, Integers
from rig.errors import FileError, NotConverged, RigError
from rig.formats.checked_toml_and_json_entries import LARGEST_RIG, nearest_known_word
from rig.formats.importers.foreign_csv_dialect_detection import read_foreign_table_header_and_cells
from rig.formats.importers.foreign_file_import_recipe import EULER, ForeignTable
from rig.formats.importers.foreign_table_column_search_and_completion import (
    DIRECTION,
    FRAME,
    TIME,
    Cells,
    column_headers_for_import_recipe,
    column_indices_by_headers,
)
from rig.formats.importers.foreign_table_units_and_timestamps import ambiguity_error
from rig.formats.local_and_remote_input_files import short_repr
from rig.formats.numbers_and_units import ANGLES, LENGTHS
from rig.model.arm_hands_effect_places_and_tolerances import hand_names
from rig.model.design import Design
from rig.model.mechanisms import kinematics_of
from rig.model.mechanisms.mechanism_kinds_and_kinematics import has_axes
from rig.model.pose import poses_pointing_along
from rig.recording.corner_and_pose_csv_tables import DISTANCE, directions_of_angles

Headers = dict[str, tuple[str, ...]]
POSITION: Headers = {
    "x": ("x", "tx", "px", "posx", "positionx", "xpos"),
    "y": ("y", "ty", "py", "posy", "positiony", "ypos"),
    "z": ("z", "tz", "pz", "posz", "positionz", "zpos"),
}
VECTOR = {
    "rx": ("rx", "rotx", "rvecx", "rotationx"),
    "ry": ("ry", "roty", "rvecy", "rotationy"),
    "rz": ("rz", "rotz", "rvecz", "rotationz"),
}
EULERS = {"roll": ("roll",), "pitch": ("pitch",), "yaw": ("yaw",)}
QUATERNION = {"qw": ("qw", "quatw", "w"), "qx": ("qx", "quatx"), "qy": ("qy", "quaty"), "qz": ("qz", "quatz")}
NUMBERED = {"q0": ("q0",), "q1": ("q1",), "q2": ("q2",), "q3": ("q3",), "q4": ("q4",)}
WIRE: Headers = {DISTANCE: (DISTANCE, "dist", "range", "wire", "wirelength", "abstand", "distanz", "distancia", "距离")}
HAND = {"hand": ("hand", "tip", "arm", "gripper", "effector", "greifer", "main", "mano")}
REACH = (0.02, 10.0)  # of the rig's size, that positions lie from its origin
UNIT = 1e-2  # that a quaternion's length may differ from one
UNKNOWN_SIZE = 0.5  # m, of a rig of which nobody knows how large it is
BETTER = 0.3  # of the next best disagreement with the commands, that the reading meant leaves
USUAL = ("zyx", "xyz", "ZYX", "XYZ")  # Euler conventions that are asked about; others are stated
IN_DEGREES = "poses.rotation_unit=deg"
LEAST = 4  # poses with a command, from which commands decide
# how rotations can be read: word, unit or None, and what comes of it; and what was read, with the table as read and
# sentences on it
Reading = tuple[str, str | None, Rotation]
ReadPoses = tuple[RigidTransform, ForeignTable, tuple[str, ...]]
ReadRotations = tuple[Rotation | None, ForeignTable, tuple[str, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class ImportedPoses:
    """T : RigidTransform (n,), or positions unrotated where alone is true; frame : (n,) numbers or None; t : n exact s
    or None; hand : (n,) number, from 0, of the hand that each is of, None of arms with one; lines : n lines of the
    file; moments : n times as they are written there, none where t is None
    """

    T: RigidTransform
    alone: bool
    frame: Integers | None
    t: list[Decimal] | None
    table: ForeignTable
    remarks: tuple[str, ...]
    hand: Integers | None
    lines: tuple[int, ...]
    moments: tuple[str, ...]

    def rows(self, at: list[int]) -> "ImportedPoses":
        """Poses of some rows. at : m indices"""
        t = None if self.t is None else [self.t[k] for k in at]
        frame, hand = (None if part is None else part[at] for part in (self.frame, self.hand))
        lines, moments = tuple(self.lines[k] for k in at), tuple(self.moments[k] for k in at if self.moments)
        return replace(self, T=self.T[at], frame=frame, t=t, hand=hand, lines=lines, moments=moments)

    def require_distinct(self, keys: Sequence[object], found: str, remedy: str) -> None:
        """Raise FileError, with the lines, where two rows have one of n keys. found : what such rows are"""
        first: dict[object, int] = {}
        repeated = [(k, first[key]) for k, key in enumerate(keys) if first.setdefault(key, k) != k]
        if not repeated:
            return
        k, before = repeated[0]
        value = f"t {self.moments[k]}" if self.frame is None else f"frame {self.frame[k]:g}"
        message = f"{value} is in line {self.lines[before]} as well; {len(repeated)} of {len(keys)} rows {found}"
        raise FileError(self.table.file, f"{message}. {remedy}", self.lines[k], value=value)


CommandsAt = Callable[[list[Decimal] | None, Floats | None, int], Floats | None]


def read_poses(
    table: ForeignTable,
    design: Design,
    commands_of_rows: CommandsAt,
    are_plausible: Callable[[Floats], bool],
    of_commands: Collection[str] = (),
) -> ImportedPoses:
    """Read the poses of a foreign table.

    commands_of_rows : of n rows' (times, frame numbers, n) what was commanded, (n, 6) m, or None where that is not
        known
    are_plausible : whether times (n,) s from the first can be so; of_commands : headers of columns that are commands
    Raises RigError for what cannot be used, and for positions alone where no instrument measures these
    """
    cells = read_foreign_table_header_and_cells(table, "poses")
    if of_commands:
        keep = [k for k, header in enumerate(cells.header) if header not in of_commands]
        rows = [[row[k] for k in keep] for row in cells.rows]
        cells = replace(cells, header=tuple(cells.header[k] for k in keep), rows=rows)
    hands = hand_names(design.mechanism)
    of_hands = HAND if hands else {}
    kind = "pose" if design.instrument is None else design.instrument.kind
    names, needed = _columns_of_kind(cells, kind)
    found = column_indices_by_headers(cells, "poses", {**TIME, **FRAME, **of_hands, **names}, (*needed, *of_hands))
    table = replace(cells.table, columns=column_headers_for_import_recipe(table, cells, found))
    lines: tuple[str, ...] = ()
    p, t = np.zeros((len(cells.rows), 3)), None
    if kind == "pose":
        p, table, lines = _positions(cells, found, table, design)
    if "t" in found:
        read_times = cells.times(found["t"], "poses", table, are_plausible)
        t, lines, table = (
            read_times.seconds,
            (*lines, *read_times.remarks),
            replace(table, time_unit=read_times.unit, zone=read_times.zone),
        )
    rows_read = tuple(cells.lines), tuple(cells.column(found["t"])) if "t" in found else ()
    frame = np.array(cells.whole_numbers(found["frame"])) if "frame" in found else None
    hand = _hand_numbers(cells, found["hand"], hands) if hands else None
    q = commands_of_rows(t, frame, len(p))
    if q is not None and hand is not None:
        q = np.where((hand == 0)[:, None], q, np.nan)  # turns are compared of one hand
    if kind in ("direction", "distance"):
        T, table, more = (_directions if kind == "direction" else _distances)(cells, found, table)
        return ImportedPoses(T, False, frame, t, table, (*cells.remarks, *lines, *more), hand, *rows_read)
    rotations, table, more = _rotations(cells, found, table, design, q)
    alone = rotations is None
    if alone and (design.instrument is None or kind == "orientation"):
        raise RigError(
            f"{table.file} has no columns of rotations (--set poses.columns.rx=HEADER names one), and rig.toml no "
            "[instrument] that measures positions alone: base, tool and position_sigma, without rotation_sigma"
        )
    T = RigidTransform.from_components(p, Rotation.identity(len(p)) if alone else rotations)
    return ImportedPoses(T, alone, frame, t, table, (*cells.remarks, *lines, *more), hand, *rows_read)


def _columns_of_kind(cells: Cells, kind: str) -> tuple[Headers, tuple[str, ...]]:
    """({our name: accepted headers}, names that are required) of what an instrument of a kind measures."""
    rotations: Headers = {**VECTOR, **EULERS, **QUATERNION, **NUMBERED}
    if kind == "distance":
        return WIRE, tuple(WIRE)
    if kind == "orientation":
        return rotations, ()
    if kind == "direction":
        vector = {*"xyz"} <= set(column_indices_by_headers(cells, "poses", POSITION, ()))
        return (POSITION, ("x", "y", "z")) if vector else (DIRECTION, tuple(DIRECTION))
    return {**POSITION, **rotations}, ("x", "y", "z")


def _directions(cells: Cells, found: dict[str, int], table: ForeignTable) -> ReadPoses:
    """Poses that point along directions, azimuth and elevation or vectors."""
    values = np.array([cells.numbers(found[name]) for name in ("azimuth", "elevation", *"xyz") if name in found]).T
    if values.shape[1] == 3:
        length = np.linalg.norm(values, axis=1, keepdims=True)
        if (np.abs(length - 1) > UNIT).any():
            k = int(np.argmax(np.abs(length - 1)))
            message = f"x, y, z are no direction, a vector of length one, but of length {length[k, 0]:.6g}"
            raise FileError(cells.path, message, cells.lines[k], value=length[k, 0])
        return poses_pointing_along(values / length), table, (f"{table.file.name}: directions are vectors",)
    stated = [table.rotation_unit or cells.known_unit(found[name], IN_DEGREES) for name in DIRECTION]
    for name, own in zip(DIRECTION, stated):
        if own is not None and own not in ANGLES:
            raise RigError(f"{table.file}: {own} is not a unit of {name}; there are {', '.join(ANGLES)}")
    units = [table.rotation_unit or own for own in stated]
    if None in units and len({*units} - {None}) == 1:
        units = [next(own for own in units if own is not None)] * 2
    if None in units:
        fit = [u for u, turn in (("rad", 2 * np.pi), ("deg", 360.0)) if (np.abs(values) <= [turn, turn / 4]).all()]
        if len(fit) != 1:
            raise ambiguity_error(
                f"{table.file}: the unit of azimuth and elevation is not stated, and they do not decide",
                [(u, f"poses.rotation_unit={u}") for u in ("rad", "deg")],
            )
        units = [*fit, *fit]
    angles = values / [ANGLES[unit] for unit in units if unit is not None]
    beyond = (np.abs(angles) > [2 * np.pi * (1 + UNIT), np.pi / 2]).any(axis=1)
    if beyond.any():
        k = int(np.argmax(beyond))
        both, row = " and ".join(map(str, dict.fromkeys(units))), ", ".join(f"{v:.6g}" for v in values[k])
        message = f"an azimuth or elevation is beyond the circle in {both}: {row}"
        raise FileError(cells.path, message, cells.lines[k], value=row)
    guessed = table.rotation_unit is None and not any(stated)
    remarks = (f"{table.file.name}: azimuth and elevation are in {units[0]}",) if guessed else ()
    unit = units[0] if units[0] == units[1] else table.rotation_unit
    return poses_pointing_along(directions_of_angles(angles)), replace(table, rotation_unit=unit), remarks


def _distances(cells: Cells, found: dict[str, int], table: ForeignTable) -> ReadPoses:
    """Poses as far along x as a wire is long."""
    values, unit = np.array(cells.numbers(found[DISTANCE])), table.unit or cells.unit(found[DISTANCE])
    if unit not in LENGTHS:
        raise RigError(f"{table.file}: the unit of its distances is not stated; --set poses.unit=mm states it")
    return RigidTransform.from_translation(np.outer(values / LENGTHS[unit], [1, 0, 0])), replace(table, unit=unit), ()


def _hand_numbers(cells: Cells, at: int, hands: tuple[str, ...]) -> Integers:
    """(n,) number of each row's hand, by its name in a column. Raises FileError at the first that is none."""
    for name, line in zip(cells.column(at), cells.lines):
        if name not in hands:
            near = nearest_known_word(name, hands)
            hint = f"is {near!r} meant?" if near else f"rig.toml has {', '.join(hands)}"
            raise FileError(cells.path, f"{short_repr(name)} is no hand; {hint}", line, at + 1, name)
    return np.array([hands.index(name) for name in cells.column(at)])


def _positions(
    cells: Cells, found: dict[str, int], table: ForeignTable, design: Design
) -> tuple[Floats, ForeignTable, tuple[str, ...]]:
    values = np.array([cells.numbers(found[name]) for name in "xyz"]).T
    stated = [table.unit or cells.known_unit(found[name], "poses.unit=mm") for name in "xyz"]
    unit = stated[0]
    if len({*stated}) > 1 or (unit is not None and unit not in LENGTHS):
        own = ", ".join(f"{name} in {one or 'none stated'}" for name, one in zip("xyz", stated))
        raise RigError(f"{table.file}: {own}; convert them to one unit of {', '.join(LENGTHS)}")
    lines: tuple[str, ...] = ()
    if unit is None:
        size, far = _size(design), float(np.median(np.linalg.norm(values, axis=1)))
        fit = [u for u in ("m", "mm") if REACH[0] * size <= far / LENGTHS[u] <= REACH[1] * size]
        if len(fit) != 1:
            raise ambiguity_error(
                f"{table.file}: the unit of its positions is not stated, and they lie {far:.6g} from the "
                "origin in the middle",
                [(u, f"poses.unit={u}") for u in ("m", "mm")],
            )
        unit, lines = (
            fit[0],
            (f"{table.file.name}: positions are in {fit[0]}, as the rig measures some {size:.2g} m",),
        )
    p = values / LENGTHS[unit]
    if np.abs(p).max() > LARGEST_RIG:
        k = int(np.argmax(np.abs(p).max(axis=1)))
        message = f"a position of {np.abs(p[k]).max():g} m is implausible; correct it, or state another unit: "
        raise FileError(cells.path, f"{message}--set poses.unit=mm", cells.lines[k])
    return p, replace(table, unit=unit), lines


def _size(design: Design) -> float:
    return design.mechanism.reach or UNKNOWN_SIZE


def _rotations(
    cells: Cells, found: dict[str, int], table: ForeignTable, design: Design, q: Floats | None
) -> ReadRotations:
    """(Rotation (n,) or None where there are none, ForeignTable, sentences)."""
    group = next((g for g in (QUATERNION, EULERS, NUMBERED, VECTOR) if len(set(g) & set(found)) >= 3), None)
    if group is None:
        return None, table, (f"{table.file.name} has positions alone, no rotations",)
    names = [name for name in group if name in found]
    values = np.array([cells.numbers(found[name]) for name in names]).T
    if group in (QUATERNION, NUMBERED):
        ways = _quaternions(values, names, group is QUATERNION, table)
    else:
        units = {table.rotation_unit or cells.known_unit(found[name], IN_DEGREES) for name in names}
        ways = _angles(values, names, units, group is EULERS, table)
    if not ways:
        raise RigError(
            f"{table.file}: {', '.join(names)} are not rotations as stated; --set poses.rotation= takes "
            "rotvec, quaternion-wxyz, "
            "quaternion-xyzw, or an order of Euler angles as zyx (fixed axes) or ZYX (moving axes)"
        )
    if len(ways) == 1:
        rotation, unit, R = ways[0]
        remarks = () if table.rotation else (f"{table.file.name}: rotations are {_name(rotation, unit)}",)
        return R, replace(table, rotation=rotation, rotation_unit=unit), remarks
    return _by_commands(ways, table, design, q)


def _name(rotation: str, unit: str | None) -> str:
    if rotation in EULER:
        return f"Euler angles {rotation} about {'fixed' if rotation.islower() else 'moving'} axes in {unit}"
    return f"rotation vectors in {unit}" if rotation == "rotvec" else f"{rotation}s"


def _quaternions(values: Floats, names: list[str], named: bool, table: ForeignTable) -> list[Reading]:
    if values.shape[1] != 4 or (np.abs(np.linalg.norm(values, axis=1) - 1) > UNIT).any():
        raise RigError(f"{table.file}: {', '.join(names)} are not quaternions: four figures whose squares sum to one")
    if named:
        return [("quaternion-wxyz", None, Rotation.from_quat(values[:, [1, 2, 3, 0]]))]
    ways = {"quaternion-wxyz": values[:, [1, 2, 3, 0]], "quaternion-xyzw": values}
    return [
        (notation, None, Rotation.from_quat(v)) for notation, v in ways.items() if table.rotation in (None, notation)
    ]


def _angles(
    values: Floats, names: list[str], stated: set[str | None], euler: bool, table: ForeignTable
) -> list[Reading]:
    """Readings of three figures: vectors or Euler angles, in rad or degrees. Columns of Euler angles: about x, y, z in
    that order.
    """
    unit = table.rotation_unit or next(iter(stated - {None}), None)
    requested = (table.rotation,) if table.rotation else (*(() if euler else ("rotvec",)), *USUAL)
    found: list[Reading] = []
    for u in (unit,) if unit else ("rad", "deg"):
        v = values / ANGLES[u]
        if np.abs(v).max() > (7.0 if unit is None else 1e3):
            continue
        for notation in requested:
            if notation == "rotvec":
                found.append((notation, u, Rotation.from_rotvec(v)))
            elif notation in EULER:
                found.append(
                    (
                        notation,
                        u,
                        Rotation.from_euler(notation, v[:, ["xyz".index(letter) for letter in notation.lower()]]),
                    )
                )
    return found


def _disagreement_with_commands(design: Design, q: Floats | None) -> Callable[[Rotation], tuple[float, str]] | None:
    """How far rotations (n,) are from what was commanded, q (n, axes), and that in words; None where it cannot be
    determined.

    The turns between one pose and the next are compared, but for a tenth, which may be wrong: they depend neither on
    where the instrument stands nor on where its target sits. Rows of which nothing commanded is known, NaN, do
    not count.
    """
    m = design.mechanism
    if q is None or not has_axes(m):
        return None
    known = np.isfinite(q).all(axis=1)
    if known.sum() < LEAST:
        return None
    try:
        turns = _turns_between_rows(kinematics_of(m).forward(q[known], m).rotation)
    except NotConverged:  # of commands that close on no pose, which the check of the recording names
        return None

    def of_turns(R: Rotation) -> tuple[float, str]:
        squares = np.sort((_turns_between_rows(R[known]) - turns) ** 2)
        off = float(np.sqrt(np.mean(squares[: max(len(squares) * 9 // 10, 1)])))
        return off, f"{np.degrees(off):.2g} degrees"

    return of_turns


def _turns_between_rows(R: Rotation) -> Floats:
    """(n - 1,) rad, angle between each of n rotations and the next."""
    return (R[:-1].inv() * R[1:]).magnitude()


def _by_commands(ways: list[Reading], table: ForeignTable, design: Design, q: Floats | None) -> ReadRotations:
    """The reading with which the commands agree; zyx about fixed axes is XYZ about moving ones, and of the same the
    first counts.
    """
    distinct: list[Reading] = []
    for reading in ways:
        if not any((reading[2] * other[2].inv()).magnitude().max() < 1e-9 for other in distinct):
            distinct.append(reading)
    miss = _disagreement_with_commands(design, q)
    if miss is not None:
        ranked = sorted(distinct, key=lambda reading: miss(reading[2])[0])
        if len(ranked) == 1 or miss(ranked[0][2])[0] < BETTER * miss(ranked[1][2])[0]:
            rotation, unit, R = ranked[0]
            return (
                R,
                replace(table, rotation=rotation, rotation_unit=unit),
                (
                    f"{table.file.name}: rotations are {_name(rotation, unit)}, which agree with the "
                    f"commands to {miss(R)[1]}",
                ),
            )
    if len(distinct) == 1:
        rotation, unit, R = distinct[0]
        return (
            R,
            replace(table, rotation=rotation, rotation_unit=unit),
            (f"{table.file.name}: rotations are {_name(rotation, unit)}",),
        )
    units_too = [
        f"' --set 'poses.rotation_unit={reading[1]}" if reading[1] and not table.rotation_unit else ""
        for reading in distinct
    ]
    raise ambiguity_error(
        f"{table.file}: its rotations can be read in {len(distinct)} ways, and nothing here decides (the "
        "first pose turned by)",
        [
            (
                f"{_name(reading[0], reading[1])} ({np.degrees(reading[2][0].magnitude()):.4g} degrees)",
                f"poses.rotation={reading[0]}{unit}",
            )
            for reading, unit in zip(distinct, units_too)
        ],
    )
