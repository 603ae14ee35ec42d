"""What can be read in more than one way is refused, all readings shown, each with the setting that decides for it."""

from collections.abc import Iterable

from rig.errors import RigError


def ambiguity_error(what: str, readings: Iterable[tuple[str, str]]) -> RigError:
    """The error about `what`. readings : (what it would mean, "key=value" that decides for it)"""
    return RigError("\n".join([f"{what}:", *(f"  {reading}: --set '{setting}'" for reading, setting in readings)]))
