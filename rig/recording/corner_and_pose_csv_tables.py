"""CSV tables of corners and poses.

They are loaded with checks, and written. Directions are azimuth and elevation, or unit vectors.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.errors import FileError
from rig.formats import csv_and_parquet_tables_and_time_origin, local_and_remote_input_files
from rig.formats.checked_toml_and_json_entries import LARGEST_RIG, nearest_known_word
from rig.formats.csv_and_parquet_tables_and_time_origin import PLAIN, Table, TableFormat, read_csv_table
from rig.formats.output_files import write_text
from rig.formats.pandas_tables_of_poses_and_errors import DataFrame, pandas_table_of_poses
from rig.model.arm_hands_effect_places_and_tolerances import hand_names
from rig.model.design import Design, Instrument
from rig.model.pose import TRIANGLE, covariance_from_triangle, pose, pose_to_vector, poses_pointing_along
from rig.recording.exposures_and_image_files import Exposures

HAND = "hand"


def frame_numbers_of_rows(rows: Table, known_frames: set[int] | None) -> Integers:
    """Frame numbers (n,) of a table's rows. Raises FileError for one unknown, and for one listed twice."""
    return frame_and_hand_numbers_of_rows(rows, known_frames, ())[0]


def frame_and_hand_numbers_of_rows(
    rows: Table, known_frames: set[int] | None, hands: tuple[str, ...]
) -> tuple[Integers, Integers | None]:
    """Frame numbers (n,) of a table's rows, and hand numbers (n,) where hands have names.

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
    """The rows of a table that belong to a hand; all where it has no column `hand`.

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


ANGLES = ("azimuth", "elevation")  # columns, rad
VECTOR = ("x", "y", "z")
UNIT_LENGTH = 1e-6  # that a direction's length may differ from one


def read_direction_table_and_unit_vectors(path: str | Path, form: TableFormat = PLAIN) -> tuple[Table, Floats]:
    """Read a poses.csv of directions: its Table, and unit vectors.

    form : of the file
    Returns (Table, unit vectors (n, 3)) of columns azimuth and elevation (rad), or x, y and z
    Raises FileError with line and column for a missing column, angles that no circle has and vectors that are not of
    length one
    """
    angles = any(name in read_csv_table(path, ("frame",), form=form).columns for name in ANGLES)
    rows = read_csv_table(path, ("frame", *(ANGLES if angles else VECTOR)), form=form)
    if not angles:
        values = rows.matrix(VECTOR)
        length = np.linalg.norm(values, axis=1)
        bad = np.flatnonzero(np.abs(length - 1) > UNIT_LENGTH)
        if len(bad):
            rows.fail(f"a direction has length 1, not {length[bad[0]]:.9g}", bad[0], "x", values[bad[0], 0])
        return rows, values / length[:, None]
    values = form.units.si(rows.matrix(ANGLES), ("rad", "rad"))
    for k, most in enumerate((2 * np.pi, np.pi / 2)):
        bad = np.flatnonzero(np.abs(values[:, k]) > most)
        if len(bad):
            rows.fail(
                f"{ANGLES[k]} = {form.units.shown(values[bad[0], k], 'rad')} is implausible"
                + (" (degrees?)" if form.units.angle == "rad" else ""),
                bad[0],
                ANGLES[k],
                values[bad[0], k],
            )
    return rows, directions_of_angles(values)


def directions_of_angles(angles: Floats) -> Floats:
    """Directions (..., 3) of azimuth and elevation (..., 2) rad; x is north, y east and z down."""
    azimuth, elevation = np.moveaxis(np.asarray(angles, float), -1, 0)
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), -np.sin(elevation)], axis=-1)


POSE_COLUMNS = ("x", "y", "z", "rx", "ry", "rz")
POSE_UNITS = ("m", "m", "m", "rad", "rad", "rad")
DISTANCE = "distance"  # column of a drawn wire's length, m
COVARIANCE_COLUMNS = tuple(f"c{i}{j}" for i, j in zip(*TRIANGLE))
CORNER_COLUMNS = ("frame", "camera", "marker", "corner", "u", "v")
CORNER_COVARIANCE = ("cuu", "cuv", "cvv")


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """Marker corners in images. frame, marker, corner : (n,) int; camera : n names; uv : (n, 2) px;
    covariance : (n, 2, 2) px^2, or None where the recording states none."""

    frame: Integers
    camera: list[str]
    marker: Integers
    corner: Integers
    uv: Floats
    covariance: Floats | None

    def take(self, rows: Booleans) -> "Corners":
        """The corners of a mask (n,)."""
        camera = list(compress(self.camera, rows))
        covariance = None if self.covariance is None else self.covariance[rows]
        own = (self.marker[rows], self.corner[rows], self.uv[rows])
        return Corners(self.frame[rows], camera, *own, covariance)


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Platform in base. frame : (n,) int; T_base_platform : RigidTransform (n,); covariance : (n, 6, 6) m, rad, on the
    right, order x y z rx ry rz, or None; common : (n, 6, k) m, rad, factor of errors that poses share beyond it, or
    None: of several recordings, where the instrument stood in each; hand : (n,) number, from 0, of its hand, or None"""

    frame: Integers
    T_base_platform: RigidTransform
    covariance: Floats | None
    common: Floats | None = None
    hand: Integers | None = None

    def take(self, index: Booleans | Integers) -> "Poses":
        """The poses of an index or mask (n,)."""
        covariance, common = (None if part is None else part[index] for part in (self.covariance, self.common))
        own = (self.frame[index], self.T_base_platform[index], covariance, common)
        return Poses(*own, None if self.hand is None else self.hand[index])

    def to_pandas(self) -> DataFrame:
        """DataFrame of `pandas_table_of_poses`, a row for each pose. Raises MissingLibrary without pandas."""
        return pandas_table_of_poses(self.frame, self.T_base_platform, self.covariance)


def load_corners(path: Path, design: Design, exposures: Exposures) -> Corners | None:
    """Load the Corners of a corners.csv, None where there is none. Raises FileError with line and column."""
    if not local_and_remote_input_files.exists(path):
        return None
    rows = csv_and_parquet_tables_and_time_origin.read_csv_table(path, CORNER_COLUMNS, ("sigma", *CORNER_COVARIANCE))
    frame, marker, corner, camera = rows.whole("frame"), rows.whole("marker"), rows.whole("corner"), rows.text("camera")
    uv = rows.matrix(("u", "v"))
    cameras = {c.name for c in design.cameras}
    markers = {number for target in design.targets for number in target.ids}
    exposed = set(zip(exposures.frame.tolist(), exposures.camera))
    keys = list(zip(frame.tolist(), camera, marker.tolist(), corner.tolist()))
    sound = (
        len(set(keys)) == len(keys)
        and set(camera) <= cameras
        and set(marker.tolist()) <= markers
        and set(zip(frame.tolist(), camera)) <= exposed
    )
    if not sound or corner.max() > 3:
        _refuse(rows, keys, cameras, markers, exposed)
    return Corners(frame, camera, marker, corner, uv, _corner_covariance(rows))


def _refuse(
    rows: Table,
    keys: list[tuple[int, str, int, int]],
    cameras: set[str],
    markers: set[int],
    exposed: set[tuple[int, str]],
) -> NoReturn:
    """Raise FileError at the first corner, by (frame, camera, marker, corner), that cannot be or occurs twice."""
    seen: dict[Any, Any] = {}
    for i, key in enumerate(keys):
        if key[1] not in cameras:
            rows.fail(
                f"unknown camera {key[1]!r}; rig.toml has {', '.join(sorted(cameras)) or 'none'}", i, "camera", key[1]
            )
        if key[2] not in markers:
            rows.fail(f"unknown marker {key[2]}: no target of rig.toml has it", i, "marker", key[2])
        if key[3] > 3:
            rows.fail(f"a marker has corners 0..3, not {key[3]}", i, "corner", key[3])
        if key[:2] not in exposed:
            rows.fail(f"frame {key[0]} of camera {key[1]!r} is not in frames.csv", i, "frame", key[0])
        if key in seen:
            rows.fail(
                f"corner {key[3]} of marker {key[2]} is listed twice in frame {key[0]}, camera {key[1]!r}, "
                "first in line "
                f"{rows.lines[seen[key]]}",
                i,
                "marker",
                key[2],
            )
        seen[key] = i
    raise AssertionError("unreachable: bad corners without a bad one")


def _corner_covariance(rows: Table) -> Floats | None:
    if all(name in rows.columns for name in CORNER_COVARIANCE):
        cuu, cuv, cvv = rows.matrix(CORNER_COVARIANCE).T
        bad = np.flatnonzero((cuu <= 0) | (cuu * cvv <= cuv**2))
        if len(bad):
            rows.fail("cuu, cuv, cvv are not a covariance: not positive definite", bad[0], "cuu")
        return np.stack([np.stack([cuu, cuv], -1), np.stack([cuv, cvv], -1)], -2)
    if "sigma" not in rows.columns:
        return None
    sigma = rows.numbers("sigma")
    bad = np.flatnonzero(sigma <= 0)
    if len(bad):
        rows.fail(f"sigma must be positive px, not {sigma[bad[0]]:g}", bad[0], "sigma", sigma[bad[0]])
    return sigma[:, None, None] ** 2 * np.eye(2)


def load_poses(
    path: str | Path,
    known_frames: set[int] | None = None,
    positions_only: bool = False,
    are_commands: bool = False,
    form: TableFormat = PLAIN,
    hands: tuple[str, ...] = (),
    hand: str | None = None,
) -> Poses:
    """Load the Poses of a poses.csv.

    known_frames : set of frame numbers that there are, or None; positions_only : rotations and covariances, if there
    are any, mean nothing: the poses are unrotated; are_commands : a covariance may be 0 in directions in which the
    machine has no freedom; form : of the file; hands : names in its column `hand`, where there are several;
    hand : whose rows alone are taken, the column may then be absent
    Raises FileError with line and column.
    """
    needed = [HAND] if hands and hand is None else []
    optional = (*COVARIANCE_COLUMNS, *[HAND][: len(hands)])
    rows = csv_and_parquet_tables_and_time_origin.read_csv_table(
        path, ("frame", *needed, *POSE_COLUMNS[: 3 if positions_only else 6]), optional, form
    )
    if hand is not None:
        rows, hands = rows_of_hand(rows, hands, hand), ()
    frame, number = frame_and_hand_numbers_of_rows(rows, known_frames, hands)
    values, k = np.zeros((len(rows), 6)), 3 if positions_only else 6
    values[:, :k] = form.units.si(rows.matrix(POSE_COLUMNS[:k]), POSE_UNITS[:k])
    _plausible(rows, values[:, :3], POSE_COLUMNS[:3])
    covariance = None if positions_only else _pose_covariance(rows, are_commands)
    found = Poses(frame, pose(values[:, :3], values[:, 3:]), covariance, hand=number)
    return found if number is None else found.take(np.lexsort((number, frame)))


def load_instrument_poses(
    path: str | Path,
    known_frames: set[int] | None,
    instrument: Instrument | None,
    form: TableFormat = PLAIN,
    hands: tuple[str, ...] = (),
) -> Poses:
    """Load the Poses of a poses.csv as its instrument measures them.

    form : of the file, where it holds poses or directions; hands : as there. Raises FileError with line and column
    """
    kind = "pose" if instrument is None else instrument.kind
    if kind == "pose":
        alone = instrument is not None and instrument.rotation_sigma is None
        return load_poses(path, known_frames, alone, form=form, hands=hands)
    if kind == "direction":
        rows, directions = read_direction_table_and_unit_vectors(path, form)
        return Poses(frame_numbers_of_rows(rows, known_frames), poses_pointing_along(directions), None)
    columns = POSE_COLUMNS[3:] if kind == "orientation" else (DISTANCE,)
    rows = csv_and_parquet_tables_and_time_origin.read_csv_table(path, ("frame", *columns))
    frame, values, nothing = frame_numbers_of_rows(rows, known_frames), rows.matrix(columns), np.zeros((len(rows), 3))
    if kind == "orientation":
        return Poses(frame, pose(nothing, values), None)
    _plausible(rows, values, columns)
    short = np.flatnonzero(values[:, 0] <= 0)
    if len(short):
        length = values[short[0], 0]
        rows.fail(f"a wire's length must be positive, not {length:g} m", short[0], DISTANCE, length)
    return Poses(frame, pose(np.pad(values, ((0, 0), (0, 2))), nothing), None)


def _plausible(rows: Table, values: Floats, columns: tuple[str, ...]) -> None:
    """Raise FileError at the first length (n, k) that no rig has."""
    far = np.argwhere(np.abs(values) > LARGEST_RIG)
    if len(far):
        i, j = far[0]
        hint = "metres (millimetres?)" if rows.form.units.length == "m" else f"{rows.form.units}, as stated"
        size = rows.form.units.shown(values[i, j], "m")
        rows.fail(f"{columns[j]} = {size} is implausible: poses are in {hint}", i, columns[j], values[i, j])


def _pose_covariance(rows: Table, commanded: bool) -> Floats | None:
    given = [name for name in COVARIANCE_COLUMNS if name in rows.columns]
    if not given:
        return None
    if len(given) < len(COVARIANCE_COLUMNS):
        missing = next(name for name in COVARIANCE_COLUMNS if name not in given)
        raise FileError(
            rows.path, f"column {missing!r} is missing: a covariance has all of {','.join(COVARIANCE_COLUMNS)}", 1
        )
    per = rows.form.units.si(np.ones(6), POSE_UNITS)
    covariance = covariance_from_triangle(rows.matrix(COVARIANCE_COLUMNS)) * np.outer(per, per)
    scale = np.sqrt(np.abs(np.einsum("nii->ni", covariance)))
    whitened = covariance / np.maximum(scale[:, :, None] * scale[:, None, :], 1e-300)
    if commanded:
        whitened = whitened + np.eye(6) * (scale == 0)[:, None]
    bad = np.flatnonzero(np.linalg.eigvalsh(whitened)[:, 0] <= 0)
    if len(bad):
        rows.fail("c00 .. c55 are not a covariance: not positive definite", bad[0], "c00")
    return covariance


def write_table(path: Path, header: Iterable[str], rows: Iterable[str]) -> None:
    """Write a CSV table of a header (names) and rows (lines of text)."""
    write_text(path, "\n".join([",".join(header), *rows]) + "\n")


def write_configurations(
    path: Path, axis_names: Iterable[str], configurations: Floats, reached_from: Floats | None = None
) -> None:
    """Write a CSV of configurations (k, axes) m or rad, numbered from 0.

    reached_from : (k, axes) m or rad from which each is approached, written as rows without a frame before it; or None
    """
    rows: list[tuple[object, ...]] = []
    for k, values in enumerate(configurations):
        rows += [] if reached_from is None else [("", *reached_from[k])]
        rows.append((k, *values))
    lines = [f"{frame}," + ",".join(f"{value:.7f}" for value in row) for frame, *row in rows]
    write_table(path, ("frame", *axis_names), lines)


def write_poses(path: Path, poses: Poses, hands: tuple[str, ...] = ()) -> None:
    """Write a poses.csv, with the poses' covariance where there is one; resolution 1e-10 m and rad.

    hands : names of the hands by number, of an arm with several
    """
    of_hand = [] if poses.hand is None else [hands[number] for number in poses.hand]
    header = ["frame", *[HAND][: len(of_hand)], *POSE_COLUMNS]
    lines = [",".join([*header, *(COVARIANCE_COLUMNS if poses.covariance is not None else ())])]
    for i, (frame, values) in enumerate(zip(poses.frame, pose_to_vector(poses.T_base_platform))):
        cells = [str(frame), *of_hand[i : i + 1], *(f"{value:.10f}" for value in values)]
        if poses.covariance is not None:
            cells += [f"{value:.9e}" for value in poses.covariance[i][TRIANGLE]]
        lines.append(",".join(cells))
    write_text(path, "\n".join(lines) + "\n")


def write_instrument_poses(path: Path, poses: Poses, design: Design, positions_only: bool = False) -> None:
    """Write a poses.csv as the instrument of a design measures. positions_only : whether positions without rotations"""
    kind = "pose" if design.instrument is None else design.instrument.kind
    if kind == "pose" and not positions_only:
        write_poses(path, poses, hand_names(design.mechanism))
        return
    T = poses.T_base_platform
    columns, values = {
        "pose": (POSE_COLUMNS[:3], T.translation),
        "orientation": (POSE_COLUMNS[3:], T.rotation.as_rotvec()),
        "direction": (VECTOR, T.rotation.as_matrix()[:, :, 2]),
        "distance": ((DISTANCE,), T.translation[:, :1]),
    }[kind]
    named = [] if poses.hand is None else [hand_names(design.mechanism)[number] for number in poses.hand]
    write_table(
        path,
        ("frame", *[HAND][: len(named)], *columns),
        (
            ",".join([str(frame), *named[i : i + 1], *(f"{v:.10f}" for v in row)])
            for i, (frame, row) in enumerate(zip(poses.frame, values))
        ),
    )


def write_corners(path: Path, corners: Corners) -> None:
    """Write a corners.csv with sigma and the covariance of each corner."""
    c = corners
    header, form = [*CORNER_COLUMNS], "%d,%s,%d,%d,%.5f,%.5f"
    columns = [c.frame.tolist(), c.camera, c.marker.tolist(), c.corner.tolist(), *c.uv.T.tolist()]
    if c.covariance is not None:
        header, form = [*header, "sigma", *CORNER_COVARIANCE], form + ",%.5f,%.4e,%.4e,%.4e"
        (uu, uv), (_, vv) = np.moveaxis(c.covariance, 0, -1)
        columns += [column.tolist() for column in (np.sqrt((uu + vv) / 2), uu, uv, vv)]
    write_table(path, header, (form % row for row in zip(*columns)))
