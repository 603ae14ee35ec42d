"""Columns that are a table times a small matrix, the product never written out."""

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import DTypeLike

from rig.array_and_json_types import Floats, Integers


@dataclass(frozen=True, slots=True, eq=False)
class FactoredColumns:
    """Columns (m, r), a table (m, p) times turn (p, r).

    A basis of thousands of rows costs as much to write out as all that is asked of it, and p may be well below r.
    """

    table: Floats
    turn: Floats
    __array_ufunc__ = None  # an array times this is asked of this

    @property
    def shape(self) -> tuple[int, int]:
        """(m, r)."""
        return len(self.table), self.turn.shape[1]

    @property
    def T(self) -> "_Transposed":
        """Transposed, to multiply by."""
        return _Transposed(self)

    def __len__(self) -> int:
        return len(self.table)

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> Floats:
        return cast(Floats, np.asarray(self.table @ self.turn, dtype=dtype))

    def __getitem__(self, rows: slice | Integers) -> "FactoredColumns":
        """Some of the rows, as an array is indexed."""
        return FactoredColumns(self.table[rows], self.turn)

    def __matmul__(self, sizes: Floats) -> Floats:
        return self.table @ (self.turn @ sizes)

    def __rmatmul__(self, left: Floats) -> Floats:
        return (left @ self.table) @ self.turn

    def beside(self, part: Floats, lost: Floats, half: Floats) -> "FactoredColumns":
        """These columns and part (m, k) @ half (k, h) - these @ lost (r, h)."""
        (p, r), (k, h) = self.turn.shape, half.shape
        turn = np.zeros((p + k, r + h))
        turn[:p, :r], turn[:p, r:], turn[p:, r:] = self.turn, -self.turn @ lost, half
        return FactoredColumns(np.concatenate([self.table, part], axis=1), turn)


@dataclass(frozen=True, slots=True, eq=False)
class _Transposed:
    """Of FactoredColumns."""

    of: FactoredColumns
    __array_ufunc__ = None

    def __matmul__(self, other: "Floats | FactoredColumns") -> Floats:
        of = self.of
        if isinstance(other, FactoredColumns):
            return (of.turn.T @ (of.table.T @ other.table)) @ other.turn
        return of.turn.T @ (of.table.T @ other)
