"""Contradictions of two designs of one rig, and its cubes turned by quarters between recordings.

With instructions to the operator for turning them.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.errors import RigError
from rig.model.design import TURN, Camera, Design, Target

SAME = 1e-9  # m, rad, or the figure's own unit; less is how a number was written
STATED = (
    "gravity",
    "tilts",
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
    """Contradictions of two Designs about the machine itself, in words.

    Camera poses may differ.
    """
    found = [
        text
        for name in STATED
        for where, text in _differences(getattr(a, name), getattr(b, name), name)
        if not FREE.fullmatch(where)
    ]
    return [*found, PAYLOAD] if any(text.startswith("platform.mass") for text in found) else found


def is_same_lens_sensor_and_mount(a: Camera, b: Camera) -> bool:
    """Whether two Cameras have the same lens, sensor, shutter, mount and name."""
    return not any(where.partition(".")[0] not in ("pose", "source", "capture") for where, _ in _differences(a, b, ""))


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


QUARTERS = 4
COLUMN = "turned_"  # before a cube's name: column of a plan in time
WORDS = ("as it was", "turned by a quarter turn", "turned by a half turn", "turned by three quarter turns")


def cube_name_or_problem(text: str, targets: Sequence[Target]) -> tuple[str, str | None]:
    """Name of the cube that a text names or numbers among targets, or the problem in words.

    Returns (name, None), or ("", problem in words)
    """
    names = [target.name for target in targets]
    numbered = text.isascii() and text.isdigit() and text not in names and 0 < int(text[:6]) <= len(targets)
    if text not in names and not numbered:
        return (
            "",
            f"there is no cube {text!r}; there are "
            f"{', '.join(t.name for t in targets if t.pose is not None) or 'none'}",
        )
    found = targets[int(text) - 1] if numbered else targets[names.index(text)]
    if found.pose is None:
        return "", f"target {found.name!r} is not a cube, and cannot be turned on a socket"
    if sum(target.body == found.body for target in targets) < 2:
        return (
            "",
            f"cube {found.name!r} is the only target of the {found.body}, and nothing else defines its frame "
            "while it is off",
        )
    return found.name, None


def cube_turn_permission_or_problem(word: str, targets: Sequence[Target]) -> tuple[str, str | None]:
    """Permission to turn a cube, of a word of [experiment] may, or the problem in words.

    Returns (permission with the cube's name, None), or ("", problem in words)
    """
    if not word.startswith(TURN):
        return word, None
    name, problem = cube_name_or_problem(word.removeprefix(TURN), targets)
    return TURN + name if problem is None else "", problem


def design_with_turned_cubes(design: Design, quarter_turns: Mapping[str, int]) -> Design:
    """The Design with cubes turned by quarter_turns {cube: number}.

    Raises RigError for an unknown cube.
    """
    for name in quarter_turns:
        _, problem = cube_name_or_problem(name, design.targets)
        if problem:
            raise RigError(problem)
    return replace(
        design, targets=tuple(replace(t, turned=quarter_turns.get(t.name, t.turned)) for t in design.targets)
    )


def rig_toml_with_turns(text: str, quarter_turns: Mapping[str, int]) -> str:
    """The rig.toml text with the quarter turns of cubes stated.

    All else, comments too, unchanged.
    """
    import tomlkit

    if not quarter_turns:
        return text

    document = tomlkit.parse(text)
    table = tomlkit.table()
    table.update(quarter_turns)
    document["turned"] = table
    return tomlkit.dumps(document)


def turning_instructions(quarter_turns: Mapping[str, int], present_quarter_turns: Mapping[str, int]) -> list[str]:
    """Instructions to the operator for turning cubes to these quarter turns from the present ones, in words."""
    out = []
    for name, quarter in quarter_turns.items():
        if present_quarter_turns.get(name) != quarter:
            out.append(
                f"take cube {name} off its socket and put it back {WORDS[quarter]}"
                + (", counter-clockwise about its own z, from where rig.toml states it" if quarter else "")
            )
    return out
