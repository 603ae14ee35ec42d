"""What a rig.toml says of cubes that may be turned, or were: [experiment] and [turned]."""

from dataclasses import replace

from rig.formats.checked_entries import Entries
from rig.model.cube_remounting import cube_named, parse_permission
from rig.model.design import PERMITTED, TURN, Permission, Target


def experiment_permission(table: Entries, targets: tuple[Target, ...]) -> Permission:
    """What an owner allows experiments, cubes by their names. Raises FileError for what is none of it."""
    table.refuse_misspelt(("may",))
    may = table.get("may", [])
    words = (*map(repr, PERMITTED), f"'{TURN}NAME'")
    if not isinstance(may, list) or not all(
        isinstance(word, str) and (word in PERMITTED or word.startswith(TURN)) for word in may
    ):
        table.fail(
            f"{table.name('may')} must list what experiments may do, of {', '.join(words)}, not {may!r}",
            "may",
            value=may,
        )
    out = []
    for i, word in enumerate(may):
        allowed, problem = parse_permission(word, targets)
        if problem:
            table.fail(f"{table.name('may')}[{i + 1}]: {problem}", "may", i, value=word)
        out.append(allowed)
    return Permission(tuple(out))


def turned_targets(table: Entries, targets: tuple[Target, ...]) -> tuple[Target, ...]:
    """The targets, each cube that was taken off and put back with its quarter turns. Raises FileError for one that
    there is not.
    """
    out, places = list(targets), {}
    for key in table.tree:
        name, problem = cube_named(key, targets)
        if problem:
            table.fail(f"turned: {problem}", key, value=key)
        at = places[key] = next(k for k, target in enumerate(targets) if target.name == name)
        out[at] = replace(targets[at], turned=table.whole(key, 0, most=3))
    for key, at in places.items():
        body = targets[at].body
        if all(target.turned is not None for target in out if target.body == body):
            table.fail(
                f"turned: all targets of the {body} were taken off, so that nothing holds its frame", key, value=key
            )
    return tuple(out)
