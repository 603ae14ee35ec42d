"""Mistake of a user in a recording or rig.toml: what is wrong, what to do; and the order of several."""

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Mistake:
    """what : a sentence that names it, with the file; do : what to do about it; spoils : whether results mean nothing
    until it is mended;
    proof : 0..1, how much of what is wrong it explains, 1 where nothing else can be the cause."""

    what: str
    do: str
    spoils: bool = True
    proof: float = 0.5

    def __str__(self) -> str:
        return f"{self.what}. {self.do}"


def sort_mistakes(mistakes: Iterable[Mistake]) -> tuple[Mistake, ...]:
    """Mistakes sorted, each once: those that spoil results first, of these the likeliest first."""
    return tuple(sorted(dict.fromkeys(mistakes), key=lambda one: (not one.spoils, -one.proof)))
