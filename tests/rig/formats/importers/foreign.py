"""A good recording written the way other people write theirs: five dialects of tables, clocks, units and rotations."""

import csv
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from decimal import Decimal
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from rig.model.mechanisms import hexapod

EPOCH = Decimal("1763800000")  # s, a day in November 2025
STEPS = 12800  # per mm


@dataclass(frozen=True)
class Dialect:
    """How a table is written: time : exact s -> text; length : m -> number; rotation : Rotation -> columns of
    figures.
    """

    name: str
    separator: str
    decimal: str
    time: Callable[[Decimal], str]
    length: Callable[[np.ndarray], np.ndarray]
    rotation: Callable[[Rotation], np.ndarray]
    headers: tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]  # of commands, poses and sensors
    settings: tuple[str, ...] = ()
    position: float = 1e3  # per m
    temperature: Callable[[np.ndarray], np.ndarray] = lambda T: T
    encoding: str = "utf-8"
    before: str = ""
    from_home: bool = False


def iso(t: Decimal) -> str:
    whole = int(t)
    return (datetime(2026, 1, 31, 12, tzinfo=timezone(timedelta(hours=1))) + timedelta(seconds=whole)).strftime(
        "%Y-%m-%dT%H:%M:%S"
    ) + (f"{t - whole:.9f}"[1:] + "+01:00")


def limbs(word: str) -> tuple[str, ...]:
    return tuple(word.format(i) for i in range(1, 7))


DIALECTS = (
    Dialect(
        "German spreadsheet",
        ";",
        ",",
        lambda t: f"{(t + EPOCH) * 1000:f}",
        lambda q: q * 1e3,
        lambda R: R.as_quat()[:, [3, 0, 1, 2]],
        (
            ("Zeit [ms]", *limbs("Bein {} [mm]")),
            ("Bild", "Zeit [ms]", "X [mm]", "Y [mm]", "Z [mm]", "qw", "qx", "qy", "qz"),
            ("Zeit [ms]", "Ambient temp [°C]"),
        ),
        encoding="utf-8-sig",
        before="# Messung 7\n# alles gut\n",
    ),
    Dialect(
        "numpy",
        " ",
        ".",
        lambda t: f"{t:f}",
        lambda q: q,
        lambda R: R.as_rotvec(),
        (("# t", *limbs("l{}")), ("# frame", "t", "x", "y", "z", "rx", "ry", "rz"), ("# t", "ambient_temperature_C")),
        position=1.0,
        settings=("poses.rotation=rotvec",),
    ),
    Dialect(
        "ISO times, from home",
        "\t",
        ".",
        iso,
        lambda q: q * 1e3,
        lambda R: R.as_euler("xyz", degrees=True),
        (
            ("timestamp", *limbs("strut_{}")),
            ("frame", "timestamp", "x", "y", "z", "roll [deg]", "pitch [deg]", "yaw [deg]"),
            ("timestamp", "ambient_temp_K"),
        ),
        temperature=lambda T: T + 273.15,
        from_home=True,
    ),
    Dialect(
        "steps and microseconds",
        ",",
        ".",
        lambda t: f"{(t + EPOCH) * 10**6:.3f}",
        lambda q: q * 1e3 * STEPS,
        lambda R: R.as_quat(),
        (
            ("time_us", *limbs("axis{} [steps]")),
            ("index", "time_us", "x_cm", "y_cm", "z_cm", "q0", "q1", "q2", "q3"),
            ("time_us", "ambient temperature (F)"),
        ),
        position=1e2,
        temperature=lambda T: T * 1.8 + 32,
        settings=(f"commands.steps_per_mm={STEPS}", "poses.rotation=quaternion-xyzw"),
    ),
    Dialect(
        "UTF-16 and nanoseconds",
        "\t",
        ",",
        lambda t: f"{(t + EPOCH) * 10**9:.0f}",
        lambda q: q * 1e6,
        lambda R: R.as_euler("ZYX")[:, ::-1],
        (
            ("t", *limbs("L{} (µm)")),
            ("frame", "t", "x (m)", "y (m)", "z (m)", "roll (rad)", "pitch (rad)", "yaw (rad)"),
            ("t", "Ambient temp (°C)"),
        ),
        position=1.0,
        encoding="utf-16",
    ),
)


def columns(path: Path) -> dict[str, list[str]]:
    """{name: cells} of a CSV file."""
    with open(path, newline="") as file:
        header, *rows = list(csv.reader(file))
    return dict(zip(header, map(list, zip(*rows))))


def export(folder: Path, out: Path, dialect: Dialect, design) -> dict[str, Path]:
    """Write a recording's commands, poses and sensors in a dialect; {which: its file}."""
    out.mkdir()
    frames, c, p, s = (columns(folder / f"{name}.csv") for name in ("frames", "commands", "poses", "sensors"))
    at = dict(zip(frames["frame"], frames["t"]))
    q = np.array([c[name] for name in design.mechanism.axes], float).T
    if dialect.from_home:
        q = q - hexapod.inverse(design.mechanism.home, design.mechanism)
    v = np.array([p[name] for name in ("x", "y", "z", "rx", "ry", "rz")], float).T
    turns = dialect.rotation(Rotation.from_rotvec(v[:, 3:]))
    tables = {
        "commands": [[_time(t, dialect), *_figures(row, dialect)] for t, row in zip(c["t"], dialect.length(q))],
        "poses": [
            [frame, _time(at[frame], dialect), *_figures(row, dialect)]
            for frame, row in zip(p["frame"], np.column_stack([v[:, :3] * dialect.position, turns]))
        ],
        "sensors": [
            [_time(t, dialect), *_figures([T], dialect)]
            for t, T in zip(s["t"], dialect.temperature(np.array(s["ambient_temperature_C"], float)))
        ],
    }
    files = {}
    for (name, rows), header in zip(tables.items(), dialect.headers):
        files[name] = out / f"{name}.txt"
        lines = [dialect.separator.join(header), *(dialect.separator.join(row) for row in rows)]
        files[name].write_text(dialect.before + "\n".join(lines) + "\n", encoding=dialect.encoding)
    return files


def _figures(values, dialect: Dialect) -> list[str]:
    return [np.format_float_positional(value, trim="0").replace(".", dialect.decimal) for value in values]


def _time(t: str, dialect: Dialect) -> str:
    return dialect.time(Decimal(t)).replace(".", dialect.decimal)
