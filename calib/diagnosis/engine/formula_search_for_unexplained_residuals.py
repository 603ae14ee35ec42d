"""Search of a formula for residuals that nothing explains.

Over a library of functions of covariates.

A quantity is whatever a recording says of every frame (a stroke, a temperature, a time); an atom is one product or one
sinusoid.

Description length: minus twice the log likelihood with scatter at its best (never below the noise that is known),
Schwarz's logarithm of the size for each number, and twice the logarithm of how many there were to choose from for each
quantity, kind of atom, direction and frequency (Chen and Chen, Biometrika 95, 2008, 759-771, gamma = 1): what looks at
few quantities is shorter.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy

from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import Reduced, Stack
from rig.array_and_json_types import Floats, Integers

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


MOST = 4  # atoms
CLASSES = 5  # of atoms: a quantity, a higher power, a product, a sinusoid, one that another quantity swells
WORTH = 10.0  # of the description length that an atom must bring: "very strong" (Kass and Raftery 1995)
SWEEPS = 8  # of exchanges, at most
CLOSER = 1e-6  # of a frequency, to which it is refined


@dataclass(frozen=True, slots=True, eq=False)
class Formula:
    """atoms; coefficients : (q,) in turn, of quantities in their own units, a sinusoid's sine and cosine; length : by
    which the description is shorter than without; cost : what its numbers and their choice take of the description"""

    atoms: tuple[Atom, ...]
    coefficients: Floats
    length: float
    cost: float

    @property
    def quantities(self) -> frozenset[int]:
        """Those that it looks at."""
        return frozenset().union(*(atom.quantities for atom in self.atoms))


@dataclass(eq=False)
class Search:
    """Of a formula for a Reduced residual. floor : what a whitened square is by the noise that is known alone, at most
    1
    """

    library: Library
    data: Reduced
    floor: float = 1.0
    _known: dict[tuple[object, ...], tuple[list[Atom], Stack]] = field(default_factory=dict, init=False)

    def best(self) -> Formula | None:
        """The Formula of the shortest description; None where none is worth it."""
        atoms: tuple[Atom, ...] = ()
        while len(atoms) < MOST:
            more = self._exchanged(self._with_one(atoms))
            if more is None or self.length(more) > self.length(atoms) - WORTH:
                break
            atoms = more
        atoms = self._without_needless(atoms)
        if not atoms:
            return None
        columns = self._columns(atoms)
        scales = np.concatenate([np.full(1 if a.wave is None else 2, self.library.scale(a)) for a in atoms])
        return Formula(
            atoms, self.data.coefficients(columns) / scales, self.length(()) - self.length(atoms), self.cost(atoms)
        )

    def length(self, atoms: tuple[Atom, ...] | None) -> float:
        """Description length of the residual by some atoms; infinite where they swallow one another."""
        if atoms is None:
            return np.inf
        left = self.data if not atoms else self.data.with_nuisances(self._columns(atoms))
        if left is None:
            return np.inf
        mean = float(left.y @ left.y) / self.data.size
        scatter = max(mean, self.floor)
        return self.data.size * (np.log(scatter) + mean / scatter) + self.cost(atoms)

    def cost(self, atoms: tuple[Atom, ...]) -> float:
        """What the numbers of atoms, and the choice of atoms, cost."""
        size, library = np.log(self.data.size), self.library
        quantities = frozenset().union(*(atom.quantities for atom in atoms))
        waves = {atom.wave for atom in atoms if atom.wave is not None}
        each = sum(
            (1 if atom.wave is None else 2) * size + 2 * np.log(CLASSES * (library.directions if library.apart else 1))
            for atom in atoms
        )
        turned = sum(size + 2 * np.log(max(library.quantities[wave.quantity].turns, 1.0)) for wave in waves)
        return float(each + turned + 2 * np.log(len(library.quantities)) * len(quantities))

    def _costs(self, atoms: tuple[Atom, ...], group: list[Atom]) -> Floats:
        """(k,) costs of atoms with each of a group besides: those that look at the same and are of one kind cost the
        same.
        """
        known: dict[tuple[object, ...], float] = {}
        out = []
        for atom in group:
            key = (
                atom.quantities,
                atom.wave if any(atom.wave == a.wave for a in atoms) else atom.wave and atom.wave.quantity,
            )
            if key not in known:
                known[key] = self.cost((*atoms, atom))
            out.append(known[key])
        return np.array(out)

    def _with_one(self, atoms: tuple[Atom, ...]) -> tuple[Atom, ...] | None:
        """Atoms and one more, the one that shortens the description most; None where there is none."""
        left = self.data if not atoms else self.data.with_nuisances(self._columns(atoms))
        if left is None:
            return None
        total, found = float(left.y @ left.y), []
        for group, stack in self._groups(atoms):
            drops = left.drops(stack)
            mean = np.maximum(total - drops, 0.0) / self.data.size
            scatter = np.maximum(mean, self.floor)
            lengths = self.data.size * (np.log(scatter) + mean / scatter) + self._costs(atoms, group)
            k = int(np.argmin(lengths))
            found.append((float(lengths[k]), group[k]))
        _, best = min(found, key=lambda pair: pair[0])
        return None if best in atoms else self._refined((*atoms, best))

    def _groups(self, atoms: tuple[Atom, ...]) -> Iterator[tuple[list[Atom], Stack]]:
        """(atoms of one kind, Stack of their whitened columns) of all that may be admitted beside some."""
        directions = range(self.library.directions) if self.library.apart else (None,)
        for direction in directions:
            for kind, members in (("products", self.library.products), ("waves", self.library.waves)):
                if members:
                    if (kind, direction) not in self._known:
                        own = [atom._replace(direction=direction) for atom in members]
                        self._known[kind, direction] = own, self._stacked(own)
                    yield self._known[kind, direction]
            swelling = [atom._replace(direction=direction) for atom in self.library.modulated(list(atoms))]
            if swelling:
                yield swelling, self._stacked(swelling)

    def _stacked(self, atoms: list[Atom]) -> Stack:
        return self.data.stack(
            np.stack([self.data.whitened(self.library.weights(atom, self.data.rows)) for atom in atoms], axis=1)
        )

    def _columns(self, atoms: tuple[Atom, ...]) -> Floats:
        return np.concatenate(
            [self.data.whitened(self.library.weights(atom, self.data.rows)) for atom in atoms], axis=1
        )

    def _refined(self, atoms: tuple[Atom, ...]) -> tuple[Atom, ...]:
        """Atoms with the frequency of each wave at its best between those that were tried."""
        for wave in dict.fromkeys(a.wave for a in atoms if a.wave is not None):
            step = 2 * np.pi * FINE / max(self.library.quantities[wave.quantity].range, 1e-300)

            def at(frequency: float, wave: Wave = wave, now: tuple[Atom, ...] = atoms) -> tuple[Atom, ...]:
                return tuple(
                    a._replace(wave=Wave(wave.quantity, float(frequency))) if a.wave == wave else a for a in now
                )

            low, high = max(wave.frequency - step, step / 2), wave.frequency + step
            found = scipy.optimize.minimize_scalar(
                lambda w, at=at: min(self.length(at(w)), 1e300),
                bounds=(low, high),
                method="bounded",
                options={"xatol": CLOSER * wave.frequency},
            )
            atoms = min(atoms, at(found.x), key=self.length)
        return atoms

    def _exchanged(self, atoms: tuple[Atom, ...] | None) -> tuple[Atom, ...] | None:
        """Atoms with each exchanged for another as long as that shortens the description, or left out."""
        if atoms is None:
            return None
        for _ in range(SWEEPS):
            before = self.length(atoms)
            for k in range(len(atoms)):
                rest = (*atoms[:k], *atoms[k + 1 :])
                atoms = min((t for t in (atoms, self._with_one(rest)) if t is not None), key=self.length)
            if self.length(atoms) > before - 1e-6:
                break
        return atoms

    def _without_needless(self, atoms: tuple[Atom, ...]) -> tuple[Atom, ...]:
        """Atoms without those that bring less than they must."""
        while atoms:
            shorter = [(*atoms[:k], *atoms[k + 1 :]) for k in range(len(atoms))]
            best = min(shorter, key=self.length)
            if self.length(best) > self.length(atoms) + WORTH:
                break
            atoms = best
        return atoms
