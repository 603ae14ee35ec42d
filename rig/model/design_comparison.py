"""Comparison of two designs of one rig: contradictions between them, and whether lenses are the same."""

import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.model.design import Camera, Design

SAME = 1e-9  # m, rad, or the figure's own unit; less is how a number was written
STATED = (
    "gravity",
    "mechanism",
    "instrument",
    "actuator",
    "platform",
    "targets",
    "insitu",
)  # what one machine has once
FREE = re.compile(r"actuator\.max_speed|targets \d+\.turned")  # what an owner may set otherwise from day to day
PAYLOAD = "a payload is no part of the platform: log it as payload_mass_kg in sensors.csv"


def design_contradictions(a: Design, b: Design) -> list[str]:
    """Contradictions of two Designs about the machine itself, in words; camera poses may differ."""
    found = [
        text
        for name in STATED
        for where, text in _differences(getattr(a, name), getattr(b, name), name)
        if not FREE.fullmatch(where)
    ]
    return [*found, PAYLOAD] if any(text.startswith("platform.mass") for text in found) else found


def same_lens(a: Camera, b: Camera) -> bool:
    """Whether two Cameras have the same lens, sensor, shutter and mount, wherever they stand."""
    return not any(where not in ("pose", "source") for where, _ in _differences(a, b, ""))


def _differences(a: object, b: object, where: str) -> Iterator[tuple[str, str]]:
    """(name, what differs in words) of two values of one kind."""
    if type(a) is not type(b):
        yield where, f"{where}: {_shown(a)} and {_shown(b)}"
    elif isinstance(a, RigidTransform) and isinstance(b, RigidTransform):
        yield from _differences(a.as_matrix(), b.as_matrix(), where)
    elif isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        if a.shape != b.shape:
            yield where, f"{where}: {a.shape} and {b.shape} numbers"
        elif a.size and not np.allclose(a, b, rtol=0, atol=SAME, equal_nan=True):
            yield where, f"{where}: up to {np.nanmax(np.abs(a - b)):.3g} apart"
    elif is_dataclass(a):
        for field in fields(a):
            yield from _differences(
                getattr(a, field.name), getattr(b, field.name), f"{where}.{field.name}".removeprefix(".")
            )
    elif isinstance(a, tuple) and isinstance(b, tuple):
        if len(a) != len(b):
            yield where, f"{where}: {len(a)} and {len(b)}"
        for k, (one, other) in enumerate(zip(a, b)):
            yield from _differences(one, other, f"{where} {k + 1}")
    elif a != b:
        yield where, f"{where}: {_shown(a)} and {_shown(b)}"


def _shown(value: object) -> str:
    if value is None:
        return "nothing"
    return type(value).__name__ if is_dataclass(value) or isinstance(value, np.ndarray) else repr(value)
