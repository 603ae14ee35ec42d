"""Library of a formula search: products of a few quantities and sinusoids of one, as columns of the model.

A quantity is whatever a recording says of every frame (a stroke, a temperature, a time); an atom is one product or one
sinusoid.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from rig.array_types import Floats, Integers

MOST_POWER = 3
FINE = 0.25  # of a turn over a quantity's range, between frequencies that are tried
SLOWEST = 0.75  # turns over its range: less is a power


@dataclass(frozen=True, slots=True, eq=False)
class Quantity:
    """name; values : (F, a) of each frame in each direction that it can be moved in, or (F, 1) the same in all; in its
    own unit, from its own zero
    powers : the greatest; turns : the most over its range that frames resolve, 0 for what has no sinusoid"""

    name: str
    values: Floats
    powers: int = MOST_POWER
    turns: float = 0.0

    @property
    def scale(self) -> float:
        """The greatest of its values, its own unit."""
        return float(max(np.abs(self.values).max(initial=0.0), 1e-300))

    @property
    def range(self) -> float:
        """Between its smallest and its greatest value, its own unit."""
        return float(np.ptp(self.values))

    @property
    def frequencies(self) -> Floats:
        """(k,) rad per unit, to be tried."""
        turns = np.arange(SLOWEST, self.turns, FINE)
        return 2 * np.pi * turns / max(self.range, 1e-300)


class Wave(NamedTuple):
    """A sinusoid. quantity : index; frequency : rad per unit."""

    quantity: int
    frequency: float


class Atom(NamedTuple):
    """powers : ((index of a quantity, power), ..) whose product it is; wave : Wave that it is multiplied with, sine and
    cosine, or None
    direction : index of the one that it moves frames in, None for all of them alike"""

    powers: tuple[tuple[int, int], ...] = ()
    wave: Wave | None = None
    direction: int | None = None

    @property
    def quantities(self) -> frozenset[int]:
        """Those that it looks at."""
        own = {i for i, _ in self.powers}
        return frozenset(own if self.wave is None else own | {self.wave.quantity})


@dataclass(frozen=True, eq=False)
class Library:
    """quantities : (Quantity, ..); directions : how many a frame can be moved in
    apart : whether an atom moves frames in one of these directions, else in all of them alike"""

    quantities: tuple[Quantity, ...]
    directions: int = 1
    apart: bool = False

    @cached_property
    def products(self) -> list[Atom]:
        """Atoms without sinusoids, no direction said: powers of one quantity, products of two."""
        own = [Atom(((i, n),)) for i, q in enumerate(self.quantities) for n in range(1, q.powers + 1)]
        count = len(self.quantities)
        return own + [Atom(((i, 1), (j, 1))) for i in range(count) for j in range(i + 1, count)]

    @cached_property
    def waves(self) -> list[Atom]:
        """Sinusoids at the frequencies that are tried, no direction said."""
        return [Atom((), Wave(i, float(w))) for i, q in enumerate(self.quantities) if q.turns for w in q.frequencies]

    def modulated(self, atoms: list[Atom]) -> list[Atom]:
        """The sinusoids of some atoms, times each quantity; those themselves as well."""
        waves = dict.fromkeys(a.wave for a in atoms if a.wave is not None)
        return [Atom(powers, w) for w in waves for powers in [(), *(((i, 1),) for i in range(len(self.quantities)))]]

    def column(self, atom: Atom, rows: Integers) -> Floats:
        """(f, a or 1, q) values of an atom at frames rows (f,), in units of its quantities' scales; q = 2 for a
        sinusoid, else 1.
        """
        out = np.ones((len(rows), 1))
        for i, power in atom.powers:
            q = self.quantities[i]
            out = out * (q.values[rows] / q.scale) ** power
        if atom.wave is None:
            return out[..., None]
        angle = atom.wave.frequency * self.quantities[atom.wave.quantity].values[rows]
        return np.stack([out * np.sin(angle), out * np.cos(angle)], axis=-1)

    def scale(self, atom: Atom) -> float:
        """What a coefficient of an atom's column is divided by for the quantities in their own units."""
        return float(np.prod([self.quantities[i].scale ** power for i, power in atom.powers]))

    def weights(self, atom: Atom, rows: Integers) -> Floats:
        """(f, a, q) by which an atom moves frames rows (f,) in all directions."""
        column = self.column(atom, rows)
        if atom.direction is None:
            return np.broadcast_to(column, (len(rows), self.directions, column.shape[2]))
        out = np.zeros((len(rows), self.directions, column.shape[2]))
        out[:, atom.direction] = column[:, 0]
        return out
