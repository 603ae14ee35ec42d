"""How a mistake is told: Case, the list of them, and changes that many of them make."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.calib.checks.files import column, columns, rig

LENGTHS = tuple(f"l{i}" for i in range(1, 7))
ANGLES = tuple(f"q{i}" for i in range(1, 7))
POSE = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True)
class Case:
    """kind : "corners", "images", "poses" (of a platform) or "arm"; says : regular expression for the first line."""

    name: str
    kind: str
    spoil: Callable[[Path], None]
    says: str


CASES: list[Case] = []


def case(name: str, kind: str, says: str) -> Callable:
    def keep(function: Callable[[Path], None]) -> Callable[[Path], None]:
        CASES.append(Case(name, kind, function, says))
        return function

    return keep


def simple(name: str, kind: str, says: str, spoil: Callable[[Path], None]) -> None:
    CASES.append(Case(name, kind, spoil, says))


def each(tree: dict, what: str, key: str, change: Callable) -> None:
    for entry in tree[what]:
        entry[key] = change(entry[key])


def lengths(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    return lambda f: columns(f / "commands.csv", LENGTHS, change)


def time(name: str, factor: float = 1.0, by: float = 0.0) -> Callable[[Path], None]:
    return lambda f: column(f / name, "t", lambda t: t * factor + by)


def all_times(factor: float) -> Callable[[Path], None]:
    def spoil(f: Path) -> None:
        for name in ("commands.csv", "frames.csv", "sensors.csv"):
            column(f / name, "t", lambda t: t * factor)

    return spoil


def uv(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    return lambda f: columns(f / "corners.csv", ("u", "v"), change)


def cameras(change: Callable[[dict], None]) -> Callable[[Path], None]:
    def spoil(f: Path) -> None:
        rig(f, lambda tree: [change(camera) for camera in tree["camera"]] and None)

    return spoil


def matrix(order: Callable[[float, float, float, float], tuple]) -> Callable[[dict], None]:
    def change(camera: dict) -> None:
        (fx, _, cx), (_, fy, cy), _ = camera["matrix"]
        fx, fy, cx, cy = order(fx, fy, cx, cy)
        camera["matrix"] = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]

    return change


def size(f: Path) -> tuple[int, int]:
    import tomllib

    camera = tomllib.loads((f / "rig.toml").read_text())["camera"][0]
    return camera["width"], camera["height"]
