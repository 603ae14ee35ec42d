"""Remounting of cubes, turned by quarter turns: permissions, instructions, the design and rig.toml after it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from rig.errors import RigError
from rig.model.design import TURN, Design, Target

QUARTERS = 4
COLUMN = "turned_"  # before a cube's name: column of a plan in time
WORDS = ("as it was", "turned by a quarter turn", "turned by a half turn", "turned by three quarter turns")


def find_cube(text: str, targets: Sequence[Target]) -> tuple[str, str | None]:
    """(name, None) of the cube that a text names or numbers among targets, or ("", problem in words)."""
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
        return "", f"target {found.name!r} is no cube, and cannot be turned on a socket"
    if sum(target.body == found.body for target in targets) < 2:
        return (
            "",
            f"cube {found.name!r} is the only target of the {found.body}, and nothing else holds its frame "
            "while it is off",
        )
    return found.name, None


def parse_cube_turn_permission(word: str, targets: Sequence[Target]) -> tuple[str, str | None]:
    """(permission with the cube's name, None) of a word of [experiment] may, or ("", problem in words)."""
    if not word.startswith(TURN):
        return word, None
    name, problem = find_cube(word.removeprefix(TURN), targets)
    return TURN + name if problem is None else "", problem


def quarter_turns(design: Design) -> dict[str, int]:
    """{cube: quarter turns} of a design's remounted cubes; of several recordings, the last."""
    return {target.name.partition("@")[0]: target.turned for target in design.targets if target.turned is not None}


def design_with_turned_cubes(design: Design, quarters: Mapping[str, int]) -> Design:
    """The Design with cubes turned by quarters {cube: quarter turns}. Raises RigError for an unknown cube."""
    for name in quarters:
        _, problem = find_cube(name, design.targets)
        if problem:
            raise RigError(problem)
    return replace(design, targets=tuple(replace(t, turned=quarters.get(t.name, t.turned)) for t in design.targets))


def rig_toml_with_turns(text: str, quarters: Mapping[str, int]) -> str:
    """The rig.toml text with the cubes' turns (quarters) stated; all else, comments too, unchanged."""
    import tomlkit

    if not quarters:
        return text

    document = tomlkit.parse(text)
    table = tomlkit.table()
    table.update(quarters)
    document["turned"] = table
    return tomlkit.dumps(document)


def turning_instructions(quarters: Mapping[str, int], present_quarters: Mapping[str, int]) -> list[str]:
    """Instructions to the operator for turning cubes to these quarters from the present ones, in words."""
    out = []
    for name, quarter in quarters.items():
        if present_quarters.get(name) != quarter:
            out.append(
                f"take cube {name} off its socket and put it back {WORDS[quarter]}"
                + (", counter-clockwise about its own z, from where rig.toml states it" if quarter else "")
            )
    return out
