"""Cubes that are taken off and put back turned: which there are, what a plan asks for, how a rig.toml says it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from rig.errors import RigError
from rig.model.design import TURN, Design, Target

QUARTERS = 4
COLUMN = "turned_"  # before a cube's name: column of a plan in time
WORDS = ("as it was", "turned by a quarter turn", "turned by a half turn", "turned by three quarter turns")


def cube_named(text: str, targets: Sequence[Target]) -> tuple[str, str | None]:
    """(name, None) of the cube that a text names, by its name or, where no target bears that, its number (from 1) among
    the targets; or ("", what is wrong, in words): no such target, one that is no cube, the only one of its body,
    without which nothing holds the body's frame."""
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


def parse_permission(word: str, targets: Sequence[Target]) -> tuple[str, str | None]:
    """(what an owner allows experiments, a cube that may be turned by its name, None), or ("", what is wrong with that
    cube, in words).
    """
    if not word.startswith(TURN):
        return word, None
    name, problem = cube_named(word.removeprefix(TURN), targets)
    return TURN + name if problem is None else "", problem


def quarter_turns(design: Design) -> dict[str, int]:
    """{cube: quarter turns} of the cubes of a design that were taken off and put back; of several recordings together,
    as they stood last.
    """
    return {target.name.partition("@")[0]: target.turned for target in design.targets if target.turned is not None}


def design_with_turned_cubes(design: Design, quarters: Mapping[str, int]) -> Design:
    """The Design with cubes put back turned. Raises RigError for a cube that there is not."""
    for name in quarters:
        _, problem = cube_named(name, design.targets)
        if problem:
            raise RigError(problem)
    return replace(design, targets=tuple(replace(t, turned=quarters.get(t.name, t.turned)) for t in design.targets))


def rig_toml_with_turns(text: str, quarters: Mapping[str, int]) -> str:
    """The rig.toml text saying how cubes stand; all else, comments too, as it was."""
    import tomlkit

    if not quarters:
        return text

    document = tomlkit.parse(text)
    table = tomlkit.table()
    table.update(quarters)
    document["turned"] = table
    return tomlkit.dumps(document)


def turning_instructions(quarters: Mapping[str, int], before: Mapping[str, int]) -> list[str]:
    """What an operator is asked to do so that cubes stand as they are to, in words. before : how they stand now"""
    out = []
    for name, quarter in quarters.items():
        if before.get(name) != quarter:
            out.append(
                f"take cube {name} off its socket and put it back {WORDS[quarter]}"
                + (", counter-clockwise about its own z, from where rig.toml states it" if quarter else "")
            )
    return out
