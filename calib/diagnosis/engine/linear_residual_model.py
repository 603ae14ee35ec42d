"""Linear model of residuals.

Residuals are whitened.

In blocks, frame by frame, with nuisance directions projected out.

Every residual r is whitened; P = I - Q Q^T takes out the span of the nuisances, Q orthonormal. Each block (corners,
closures, poses) is a kind of measurement; its rows stand frame by frame, then what was known beforehand.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np
from numpy.typing import DTypeLike
from scipy.sparse.linalg import LinearOperator

from rig.array_and_json_types import Floats, Integers
from rig.report.verdict_refutations_and_result_display import FieldSummaryRepr

RANK = 1e-11  # of the greatest eigenvalue; nuisances below are none


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

    def with_columns(self, part: Floats, lost: Floats, half: Floats) -> "FactoredColumns":
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


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """name; unit : of the residual before whitening; residual : (m,) whitened, nuisances taken out
    edges : (F + 1,) rows edges[f] : edges[f + 1] belong to frame f, those after the last to what was known
        beforehand"""

    name: str
    unit: str
    residual: Floats
    edges: Integers

    @property
    def frames_rows(self) -> slice:
        """The rows that belong to frames."""
        return slice(0, int(self.edges[-1]))

    @property
    def known_rows(self) -> slice:
        """The rows of what was known beforehand."""
        return slice(int(self.edges[-1]), None)

    def rows_of(self, some: Floats) -> list[slice]:
        """The rows of some frames (F,) bool, those of frames that follow each other in one."""
        ends = np.flatnonzero(np.diff(np.r_[False, some, False]))
        return [slice(int(self.edges[a]), int(self.edges[b])) for a, b in ends.reshape(-1, 2)]


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """k directions in all blocks. parts : one (m, k) for each block, an array or what multiplies as one does; None for
    nothing
    inner : (F, L, k) coordinates in each frame's own freedoms, None for nothing"""

    parts: tuple[Floats | LinearOperator | None, ...]
    inner: Floats | None = None

    def __matmul__(self, sizes: Floats) -> "Column":
        """The directions (k, r) combined by sizes (k, r)."""
        return Column(
            tuple(None if part is None else part @ sizes for part in self.parts),
            None if self.inner is None else self.inner @ sizes,
        )

    def __add__(self, other: "Column") -> "Column":
        """Column of what two do together."""
        parts = tuple(b if a is None else a if b is None else a + b for a, b in zip(self.parts, other.parts))
        inner = other.inner if self.inner is None else self.inner if other.inner is None else self.inner + other.inner
        return Column(parts, inner)

    def take(self, index: list[int] | slice) -> "Column":
        """The directions of an index, without inner coordinates."""
        return Column(tuple(None if part is None else part[:, index] for part in self.parts))

    @property
    def whole(self) -> tuple[Floats, ...]:
        """The parts, arrays or what multiplies as one does. Raises ValueError where a block has none"""
        parts = tuple(part for part in self.parts if part is not None)
        if len(parts) < len(self.parts):
            raise ValueError("a basis says of every block what it is there, zeros where it is nothing")
        return parts

    @property
    def count(self) -> int:
        """How many directions there are."""
        return next(part.shape[1] for part in self.parts if part is not None)


@dataclass(frozen=True, slots=True, eq=False)
class Projection:
    """Of a Column on a LinearModel: onto : (r, k) on the nuisances' basis; right : (k,) with the residual; gram : (k,
    k), nuisances out.
    """

    onto: Floats
    right: Floats
    gram: Floats


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LinearModel(FieldSummaryRepr):
    """Residuals in blocks with the span of the nuisances taken out.

    blocks : (Block, ..); columns : Column (p) that spans the nuisances; half : (p, r), columns @ half orthonormal; None
        where they are so already
    size : independent numbers that the residuals hold, nuisances taken off
    """

    blocks: tuple[Block, ...]
    columns: Column
    half: Floats | None
    size: int
    _frame_products: dict[int, tuple[Floats, Floats]] = field(init=False, default_factory=dict)
    _last_projection: list[tuple[Column, Projection]] = field(init=False, default_factory=list)

    @property
    def frames(self) -> int:
        """How many frames there are."""
        return len(self.blocks[0].edges) - 1

    def frame_products(self, number: int) -> tuple[Floats, Floats]:
        """Products of a block's table, of which the basis' part is combined: ((F, p) of each frame's rows with their
        residuals, (F, p, p) with themselves), made once.
        """
        if number not in self._frame_products:
            block, (table, _) = self.blocks[number], self.factors(number)
            rho, gram = np.zeros((self.frames, table.shape[1])), np.zeros((self.frames, *table.shape[1:] * 2))
            for f, (a, b) in enumerate(zip(block.edges[:-1], block.edges[1:])):
                rho[f] = table[a:b].T @ block.residual[a:b]
                gram[f] = table[a:b].T @ table[a:b]
            self._frame_products[number] = rho, gram
        return self._frame_products[number]

    def factors(self, number: int) -> tuple[Floats, Floats | None]:
        """(table (m, p), (p, r) by which it is combined to a block's part of the basis, None for as it is)."""
        part: object = self.columns.whole[number]
        if isinstance(part, FactoredColumns):
            return part.table, part.turn
        return self.columns.whole[number], self.half

    def gram(self, some: Floats) -> Floats:
        """(p, p) of an explicit basis' rows of some frames (F,) bool on themselves."""
        out = np.zeros((self.columns.count, self.columns.count))
        for block, part in zip(self.blocks, self.columns.whole):
            for rows in block.rows_of(some):
                out += part[rows].T @ part[rows]
        return out

    def right(self, some: Floats, residuals: Sequence[Floats]) -> Floats:
        """(p,) products of an explicit basis with residuals (one (m,) for each block) of some frames (F,) bool."""
        out = np.zeros(self.columns.count)
        for block, part, y in zip(self.blocks, self.columns.whole, residuals):
            for rows in block.rows_of(some):
                out += part[rows].T @ y[rows]
        return out

    def onto(self, products: Floats) -> Floats:
        """Inner products with the columns (.., p) -> with the orthonormal basis (.., r)."""
        return products if self.half is None else products @ self.half

    def project(self, column: Column) -> Projection:
        """Projection of a Column (k), made once of the same Column asked for again and again."""
        if not self._last_projection or self._last_projection[0][0] is not column:
            self._last_projection[:] = [(column, self._projected(column))]
        return self._last_projection[0][1]

    def _projected(self, column: Column) -> Projection:
        K, b, G = (
            np.zeros(shape)
            for shape in ((self.columns.count, column.count), column.count, (column.count, column.count))
        )
        for block, basis, part in reversed(list(zip(self.blocks, self.columns.whole, column.parts))):
            if part is not None:
                K, b, G = K + basis.T @ part, b + part.T @ block.residual, G + part.T @ part
        K = K if self.half is None else self.half.T @ K
        return Projection(K, b, G - K.T @ K)

    def marginalise(self, column: Column) -> "LinearModel":
        """The model with the directions of a Column (k) among the nuisances; its basis orthonormal and explicit.

        Raises ValueError for a model whose basis is not explicit.
        """
        if self.half is not None:
            raise ValueError("only a model whose nuisances' basis is explicit can take in more")
        found = self.project(column)
        own = np.diag(found.gram)
        seen = own > RANK * (own + (found.onto**2).sum(axis=0))  # of the others rounding alone is left
        half: Floats = np.zeros((len(own), 0))
        if seen.any():
            visible = orthonormal_combinations(found.gram[np.ix_(seen, seen)])
            half = np.zeros((len(own), visible.shape[1]))
            half[seen] = visible
        lost, z = found.onto @ half, half.T @ found.right
        bases: list[Floats | LinearOperator] = []
        residuals = []
        for basis, part, block in zip(self.columns.whole, column.parts, self.blocks):
            factored: object = basis
            moved = np.zeros(len(basis)) if part is None else part @ (half @ z)
            residuals.append(block.residual - (moved - basis @ (lost @ z)))
            if isinstance(factored, FactoredColumns):
                nothing = np.zeros((len(basis), 0)), lost, half[:0]
                bases.append(
                    factored.with_columns(*nothing) if part is None else factored.with_columns(part, lost, half)
                )
            else:
                bases.append(np.column_stack([basis, (0 if part is None else part @ half) - basis @ lost]))
        blocks = tuple(replace(block, residual=residual) for block, residual in zip(self.blocks, residuals))
        return LinearModel(blocks, Column(tuple(bases)), None, self.size - half.shape[1])

    def _few(self, number: int) -> bool:
        """Whether the products of frames' rows, which are explicit, are fewer numbers than a block's rows."""
        return self.half is None and self.factors(number)[0].shape[1] * self.frames <= self.blocks[number].edges[-1]

    def leakage_and_carried(self, reach: Floats, onto: Floats) -> tuple[Floats, Floats]:
        """((F, q): per frame, the product of Q onto^T with the residual plus Q reach; (F, q, q): with itself).

        reach : (r,); onto : (q, r)
        """
        q = len(onto)
        out = np.zeros((self.frames, q, q + 1))
        for number, block in enumerate(self.blocks):
            table, turn = self.factors(number)
            both = np.column_stack([onto.T, reach])
            both = both if turn is None else turn @ both
            if self._few(number):
                projections, grams = self.frame_products(number)
                moved = grams @ both
                moved[..., q] += projections
                out += both[:, :q].T @ moved
                continue
            moved = (table @ both)[block.frames_rows]
            moved[:, q] += block.residual[block.frames_rows]
            each = np.unique(np.diff(block.edges))
            if len(each) == 1:
                moved = moved.reshape(self.frames, int(each[0]), q + 1)
                out += np.swapaxes(moved[..., :q], 1, 2) @ moved
                continue
            for f, (a, b) in enumerate(zip(block.edges[:-1], block.edges[1:])):
                out[f] += moved[a:b, :q].T @ moved[a:b]
        return out[..., q], out[..., :q]

    def cost(self) -> float:
        """Sum of squares of all blocks."""
        return float(sum(block.residual @ block.residual for block in reversed(self.blocks)))


def orthonormal_combinations(gram: Floats) -> Floats:
    """Orthonormal combinations (p, r) of columns with a Gram matrix (p, p).

    They span what the columns do; what is null is left out.
    """
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / scale[:, None] / scale)
    retained = values > RANK * values[-1]
    return vectors[:, retained] / np.sqrt(values[retained]) / scale[:, None]


def join_columns(columns: list[Column]) -> Column:
    """Several Columns over the same blocks joined into one.

    What is nothing in one is zero in the joined one. Raises ValueError for none
    """
    if not columns:
        raise ValueError("there is nothing to join")
    parts: list[Floats | None] = []
    for n in range(len(columns[0].parts)):
        own = [c.parts[n] for c in columns]
        rows = next((part.shape[0] for part in own if part is not None), None)
        parts.append(
            None
            if rows is None
            else np.column_stack([np.zeros((rows, c.count)) if part is None else part for c, part in zip(columns, own)])
        )
    shape = next((c.inner.shape[:2] for c in columns if c.inner is not None), None)
    if shape is None:
        return Column(tuple(parts))
    inner = np.concatenate([c.inner if c.inner is not None else np.zeros((*shape, c.count)) for c in columns], axis=2)
    return Column(tuple(parts), inner)


def column_cosine(model: LinearModel, a: Column, b: Column) -> float:
    """Cosine of the angle between two columns, nuisances projected out."""
    one, other = model.project(a), model.project(b)
    inner = -float((one.onto.T @ other.onto)[0, 0])
    inner += sum(float((x.T @ y)[0, 0]) for x, y in zip(a.parts, b.parts) if x is not None and y is not None)
    return inner / np.sqrt(max(float(one.gram[0, 0]) * float(other.gram[0, 0]), 1e-300))
