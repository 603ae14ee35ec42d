"""Whitened columns of an arm's freedoms and terms, stored as joint directions times pose weights.

A term of hundreds of numbers at one joint moves each pose along one direction, so that products of two such terms are
sums over poses of their weights times one number; no column is ever written out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse.linalg import LinearOperator

from rig.array_and_json_types import Booleans, Floats


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Columns (q) side by side. joint : whose direction they follow, values (n, q); None where values (n, k, q) are the
    columns themselves.
    """

    joint: int | None
    values: Floats

    @property
    def count(self) -> int:
        """How many columns."""
        return self.values.shape[-1]


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """directions : (n, k, joints) by which a joint's turn changes what is measured; parts : the columns, in order."""

    directions: Floats
    parts: tuple[Part, ...]

    @property
    def count(self) -> int:
        """How many columns there are."""
        return sum(part.count for part in self.parts)

    def take(self, rows: Booleans) -> "Columns":
        """Of some of the poses, an index or mask (n,)."""
        return Columns(self.directions[rows], tuple(replace(part, values=part.values[rows]) for part in self.parts))

    def whitened(self, W: Floats) -> "Columns":
        """The same with every pose's numbers weighed by W (n, k, k)."""
        return Columns(
            W @ self.directions, tuple(replace(p, values=W @ p.values) if p.joint is None else p for p in self.parts)
        )

    def with_parts(self, parts: Sequence[Part]) -> "Columns":
        """With more columns at the end."""
        return replace(self, parts=(*self.parts, *parts))

    def without_parts(self, numbers: Sequence[int]) -> "Columns":
        """Without some parts."""
        return replace(self, parts=tuple(part for i, part in enumerate(self.parts) if i not in numbers))

    def at(self, sizes: Floats) -> Floats:
        """(n, k, r) what sizes (p, r) come to."""
        n, k, joints = self.directions.shape
        out, turns, start = np.zeros((n, k, sizes.shape[1])), np.zeros((n, joints, sizes.shape[1])), 0
        for part in self.parts:
            moved = part.values @ sizes[start : start + part.count]
            if part.joint is None:
                out += moved
            else:
                turns[:, part.joint] += moved
            start += part.count
        return out + self.directions @ turns

    def along(self, moved: Floats) -> Floats:
        """(n, a, p) products of directions (n, k, a) with the columns, pose by pose."""
        turned = np.swapaxes(moved, 1, 2)
        turns = turned @ self.directions
        out, start = np.empty((len(moved), moved.shape[2], self.count)), 0
        for part in self.parts:
            here = out[..., start : start + part.count]
            if part.joint is None:
                np.matmul(turned, part.values, out=here)
            else:
                np.multiply(turns[..., part.joint, None], part.values[:, None, :], out=here)
            start += part.count
        return out

    def onto(self, moved: Floats) -> Floats:
        """(p, r) products of the columns with what moves (n, k, r), summed over poses."""
        turns = np.swapaxes(self.directions, 1, 2) @ moved
        flat = moved.reshape(-1, moved.shape[2])
        return np.concatenate(
            [
                part.values.reshape(-1, part.count).T @ flat
                if part.joint is None
                else part.values.T @ turns[:, part.joint]
                for part in self.parts
            ]
        )

    def cross(self, other: "Columns") -> Floats:
        """(p, p') products with other columns along the same directions, summed over poses."""
        gram = np.swapaxes(self.directions, 1, 2) @ self.directions
        return np.block([[_product(a, b, self.directions, gram) for b in other.parts] for a in self.parts])

    def gram(self) -> Floats:
        """(p, p) products with each other, summed over poses."""
        gram = np.swapaxes(self.directions, 1, 2) @ self.directions
        count = len(self.parts)
        blocks = {
            (i, j): _product(self.parts[i], self.parts[j], self.directions, gram)
            for i in range(count)
            for j in range(i, count)
        }
        return np.block([[blocks[i, j] if i <= j else blocks[j, i].T for j in range(count)] for i in range(count)])

    def operator(self) -> LinearOperator:
        """The columns (n k, p) as an operator."""
        n, k, _ = self.directions.shape

        def matmat(sizes: Floats) -> Floats:
            return self.at(sizes).reshape(n * k, -1)

        def rmatmat(moved: Floats) -> Floats:
            return self.onto(moved.reshape(n, k, -1))

        return LinearOperator(
            (n * k, self.count),
            matvec=lambda x: matmat(x.reshape(-1, 1))[:, 0],
            rmatvec=lambda y: rmatmat(y.reshape(-1, 1))[:, 0],
            matmat=matmat,
            rmatmat=rmatmat,
            dtype=np.dtype(float),
        )


def _product(a: Part, b: Part, directions: Floats, gram: Floats) -> Floats:
    """(p, q) of two parts. directions : (n, k, joints); gram : (n, joints, joints) of these"""
    if a.joint is None and b.joint is None:
        return a.values.reshape(-1, a.count).T @ b.values.reshape(-1, b.count)
    if a.joint is None:
        along = (directions[:, None, :, b.joint] @ a.values)[:, 0]
        return along.T @ b.values
    if b.joint is None:
        return _product(b, a, directions, gram).T
    return a.values.T @ (gram[:, a.joint, b.joint, None] * b.values)
