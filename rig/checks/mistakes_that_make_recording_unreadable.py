"""Mistakes that make a recording unreadable.

They are reported in place of the bare reading error.
"""

import tomllib
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

import numpy as np

from rig.array_and_json_types import Floats, Json
from rig.checks import design_value_camera_and_image_mistakes_and_all_file_checks, mistake_dataclass_and_clock_mistakes
from rig.checks.mistake_dataclass_and_clock_mistakes import Mistake, sort_mistakes
from rig.errors import FileError, RigError
from rig.formats import csv_and_parquet_tables_and_time_origin, local_and_remote_input_files
from rig.formats.local_and_remote_input_files import read_text
from rig.formats.numbers_and_units import SI, stated_units
from rig.formats.rig_toml import design_from_rig_toml

SPREAD = {
    "arm": 0.4,
    "hexapod": 0.08,
    "planar2": 0.3,
}  # of the rig's size, that poses of a recording have about their middle, RMS
FILES = ("commands.csv", "frames.csv", "sensors.csv")


def unreadable_recording_mistakes(folder: Path, error: FileError) -> tuple[Mistake, ...]:
    """Mistakes that make a recording unreadable.

    From the FileError that its folder raised, in order.
    May be none.
    """
    found: list[Mistake] = []
    for look in (_figures, _times, _numbers, _order, _poses):
        try:
            found += look(Path(folder), str(error))
        except (RigError, OSError, ValueError, KeyError, TypeError, AttributeError):
            continue  # what cannot be read here either is what the complaint itself is about
    return sort_mistakes(found)


def _figures(folder: Path, complaint: str) -> Iterator[Mistake]:
    """rig.toml: figures that contradict each other."""
    if "rig.toml" not in complaint:
        return
    tree = tomllib.loads(read_text(folder / "rig.toml"))
    if stated_units(tree) != SI:
        return  # the owner states the units, and the complaint is in them
    yield from design_value_camera_and_image_mistakes_and_all_file_checks.overlong_rotation_vector_mistakes(tree)
    for target in tree.get("target", []):
        if (
            isinstance(target.get("marker"), float)
            and target["marker"] > target.get("edge", np.inf)
            and target["marker"] < 5
        ):
            yield Mistake(
                f"rig.toml: edge and marker are exchanged in target {target.get('name')}: a marker of "
                f"{target['marker']:g} m is no part of "
                f"a cube of {target['edge']:g} m",
                "edge is the cube's, marker the outer side of its black border",
                True,
                0.9,
            )
            break
    m = tree.get("mechanism", {})
    if "home" in complaint and m.get("kind") == "hexapod":
        yield from _home(m)


def _poses(folder: Path, complaint: str) -> Iterator[Mistake]:
    """poses.csv: positions that spread as the rig's size would in another unit."""
    if "poses.csv" not in complaint or "implausible" not in complaint:
        return
    m = design_from_rig_toml.load_design(folder / "rig.toml").mechanism
    size = m.reach
    if size is None:
        return
    p = csv_and_parquet_tables_and_time_origin.read_csv_table(folder / "poses.csv", ("x", "y", "z")).matrix(
        ("x", "y", "z")
    )
    spread = float(np.sqrt(((p - p.mean(axis=0)) ** 2).sum(axis=1).mean())) / (SPREAD[m.kind] * size)
    unit, per = min(
        (("centimetres", 1e2), ("millimetres", 1e3), ("micrometres", 1e6)), key=lambda one: abs(np.log(spread / one[1]))
    )
    yield Mistake(
        f"poses.csv: positions are in {unit}: they spread by {spread * SPREAD[m.kind] * size:.3g}, and the "
        f"rig measures {size:.3g} m",
        f"Divide them by {per:g}: poses are in metres",
        True,
        0.9,
    )


def _home(m: Json) -> Iterator[Mistake]:
    """What home, joints and strut_range contradict each other in: of all that would bring home into the range, what
    brings it nearest the middle.
    """
    base, platform, ranges = (np.array(m[name], float) for name in ("base_joints", "platform_joints", "strut_range"))
    at, metres = np.array(m["home"]["position"], float), "rig.toml is in metres"
    tried = []
    for unit, factor in (("millimetres", 1e-3), ("centimetres", 1e-2), ("inches", 0.0254)):
        do = f"Multiply by {factor:g}: {metres}"
        tried += [
            (f"base_joints and platform_joints are in {unit}", do, (at, base * factor, platform * factor, ranges)),
            (f"base_joints are in {unit}", do, (at, base * factor, platform, ranges)),
            (f"platform_joints are in {unit}", do, (at, base, platform * factor, ranges)),
            (f"strut_range is in {unit}", do, (at, base, platform, ranges * factor)),
            (f"the position of home is in {unit}", do, (at * factor, base, platform, ranges)),
        ]
    number = "Number both as the struts"
    tried += [
        (
            f"base_joints are numbered from another joint, by {k} on, than platform_joints",
            number,
            (at, np.roll(base, k, axis=0), platform, ranges),
        )
        for k in range(1, len(base))
    ]
    tried += [
        (
            "base_joints are numbered the other way round than platform_joints",
            number,
            (at, np.roll(base[::-1], k, axis=0), platform, ranges),
        )
        for k in range(len(base))
    ]
    for i, k in combinations(range(len(base)), 2):
        order = np.arange(len(base))
        order[[i, k]] = k, i
        tried += [
            (
                f"base_joints {i + 1} and {k + 1} are exchanged (or platform_joints)",
                number,
                (at, base[order], platform, ranges),
            )
        ]
    fits = [(_away(*parts), what, do) for what, do, parts in tried]
    away, what, do = min(fits, key=lambda one: one[0])
    if away <= 1:
        lengths = np.linalg.norm(at + platform - base, axis=1)
        yield Mistake(
            f"rig.toml: {what}: as stated the struts are {lengths.min():.4g} to {lengths.max():.4g} m at "
            "home, and strut_range is "
            f"{ranges.min():.4g} to {ranges.max():.4g} m",
            do,
            True,
            0.8,
        )


def _away(at: Floats, base: Floats, platform: Floats, ranges: Floats) -> float:
    """How far the struts' lengths at home lie from the middle of their ranges (6, 2), in half ranges; the largest of
    six.
    """
    lengths = np.linalg.norm(at + platform - base, axis=1)
    return float((np.abs(lengths - ranges.mean(axis=1)) / (np.diff(ranges)[:, 0] / 2)).max())


def _times(folder: Path, complaint: str) -> Iterator[Mistake]:
    """Files whose times cannot be of one clock."""
    if " t = " not in complaint and "command" not in complaint:
        return
    times = {}
    for name in FILES:
        if local_and_remote_input_files.exists(folder / name):
            times[name] = csv_and_parquet_tables_and_time_origin.read_csv_table(folder / name, ("t",)).numbers("t")
    yield from mistake_dataclass_and_clock_mistakes.time_unit_and_clock_origin_mistakes(times)


def _numbers(folder: Path, complaint: str) -> Iterator[Mistake]:
    """corners.csv: identities or corners that count from another number."""
    if "corners.csv" not in complaint:
        return
    rows = csv_and_parquet_tables_and_time_origin.read_csv_table(
        folder / "corners.csv", ("frame", "camera", "marker", "corner")
    )
    marker, corner = rows.numbers("marker"), rows.numbers("corner")
    if corner.min() == 1 and corner.max() == 4:
        yield Mistake(
            "corners.csv: corners are counted from 1 to 4, not from 0 to 3",
            "Subtract 1 from the column corner",
            True,
            0.95,
        )
    tree = tomllib.loads(read_text(folder / "rig.toml"))
    known = set()
    for target in tree.get("target", []):
        known |= set(target.get("faces", {}).values()) if "faces" in target else {m["id"] for m in target["marker"]}
    ids = {int(number) for number in marker}
    stray = sorted(ids - known)
    if not stray:
        return
    for by in (1, -1):
        if {number + by for number in ids} <= known:
            yield Mistake(
                f"corners.csv: marker ids are off by one: they run from {min(ids)} to {max(ids)}, rig.toml's "
                f"from {min(known)} to "
                f"{max(known)}",
                f"{'Add' if by > 0 else 'Subtract'} 1, or state the ids that are printed",
                True,
                0.9,
            )
            return
    yield Mistake(
        f"corners.csv: {len(stray)} of {len(ids)} marker ids are none of rig.toml's: {', '.join(map(str, stray[:8]))}",
        "State these markers in rig.toml, or leave their rows out",
        True,
        0.6,
    )


def _order(folder: Path, complaint: str) -> Iterator[Mistake]:
    """frames.csv: rows that are in another order than time or frame number."""
    if "frames must come in order" in complaint or ("time runs backwards" in complaint and "frames.csv" in complaint):
        frames = csv_and_parquet_tables_and_time_origin.read_csv_table(folder / "frames.csv", ("frame", "t"))
        number, t = frames.numbers("frame"), frames.numbers("t")
        back = int((np.diff(number) < 0).sum() + (np.diff(t) < 0).sum())
        yield Mistake(
            f"frames.csv: its rows are in another order than time: at {back} places frame or t runs "
            "backwards (shuffled, sorted by name, "
            "or two recordings in one)",
            "Sort the rows by frame, so that t grows with it",
            True,
            0.7,
        )
