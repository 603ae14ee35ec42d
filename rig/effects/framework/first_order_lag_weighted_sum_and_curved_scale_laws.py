"""Laws that several effects share: first-order lag, weighted sum, scale with curvature.

Real machines show sums of several members of one law, each with a share of the whole size. A scale is proportional to a
travel from home, and its proportion may grow along it.
"""

from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
from scipy.linalg import qr

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.effects.framework.effect_base_class import Candidate, Effect
from rig.effects.framework.machine_motion_and_play import Motion, Path, first_order_lag
from rig.effects.framework.parameters_covariates_and_marker_table import (
    COUNT,
    Context,
    Linear,
    Node,
    Parameter,
    numerical_derivative_step,
    parameter_grid,
)

AFTER = np.array([0.25, 0.5, 1, 2, 4, 8])  # time constants after a change of speed at which the path gets a knot


def lagged_lengths(path: Path, time_constant: float) -> Floats:
    """Lengths (m, axes) m or rad at a path's knots, lagged by a time constant (s)."""
    return path.walked(lambda t, lengths: first_order_lag(t, lengths, time_constant))


def lagged_path(path: Path, time_constant: float, lagging_axes: Booleans) -> Path:
    """Path of which some axes lag by a time constant (s).

    It has knots where a change of the command's speed still shows.
    Of a path that lags already the command's turns count, not the knots that its lag has bent.
    lagging_axes : (axes,) whether an axis lags
    """
    turns = path.turns
    path = replace(path.with_knots((turns[:, None] + AFTER * time_constant).ravel()), turned=turns)
    return replace(path, lengths=np.where(lagging_axes, lagged_lengths(path, time_constant), path.lengths))


FAINT = 5e-3  # m/s^2 m; a link's weight that turns a joint by less bends nothing
RANK = 2e-2  # of the greatest column; what a column has beyond the earlier ones must be more


def independent_load_column_indices(load_table: Floats) -> Floats:
    """Indices of the independent columns of a joint's load table (n, c).

    Of those that vary with the posture.
    """
    if not load_table.shape[1]:
        return np.zeros(0, int)
    _, r, order = qr((load_table - load_table.mean(axis=0)) / np.sqrt(len(load_table)), mode="economic", pivoting=True)
    return np.sort(order[: int((np.abs(np.diag(r)) > max(FAINT, RANK * np.abs(r[0, 0]))).sum())])


ROUNDED = 1e-3  # by which the sum of shares that somebody writes may differ from 1
LEAST = 1e-9  # of the sum of the members' sizes: below, what they are shares of is nothing


class WeightedSum(Effect):
    """Deviation: size * sum(shares * members), the shares' sum being one; without shares those of the standard law.

    whole : name of the parameter that is the size; scale : name of the parameter that the members spread from
    counts : numbers of members with which a search tries the sum
    """

    __slots__ = ()
    whole: ClassVar[str] = ""
    scale: ClassVar[str] = ""
    counts: ClassVar[tuple[int, ...]] = ()
    once: ClassVar[bool] = True
    if TYPE_CHECKING:  # a field of every such effect
        shares: tuple[float, ...]

    def problem(self) -> str | None:
        total = float(np.sum(self.shares))
        if not self.shares or abs(total - 1) <= ROUNDED:
            return None
        return f"shares have the sum of 1, not {total:g}"

    def member(self, motion: Motion, scale: float, number: int, count: int) -> Floats:
        """(n, axes) m or rad that one of so many members does per unit of the size. scale : of the whole law"""
        raise NotImplementedError

    def standard_shares(self) -> tuple[float, ...]:
        """The shares of the standard law."""
        return (1.0,)

    def deviation(self, motion: Motion) -> Floats:
        shares = self.shares or self.standard_shares()
        scale, count = getattr(self, self.scale), len(shares)

        def summed() -> Floats:
            members = [share * self._member_once(motion, scale, k, count) for k, share in enumerate(shares) if share]
            return np.sum(members, axis=0) if members else np.zeros(motion.lengths.shape)

        total = motion.once((self.name, scale, shares), summed)
        return self.axes(motion.places) * getattr(self, self.whole) * total

    def _member_once(self, motion: Motion, scale: float, number: int, count: int) -> Floats:
        return motion.once((self.name, scale, number, count), lambda: self.member(motion, scale, number, count))

    def conserved_sums(self) -> tuple[dict[tuple[str, int | None], float], ...]:
        return ({("shares", k): 1.0 for k in range(len(self.shares))},) if self.shares else ()

    def written(self) -> Self:
        total = float(np.sum(self.shares))
        if not self.shares or abs(total) <= LEAST:
            return self
        size = total * getattr(self, self.whole)
        low, high = next(p.bounds for p in self.parameters_at(self.place) if p.name == self.whole)
        shares = tuple((np.asarray(self.shares) / total).tolist())
        return type(self)(
            self.place, **{**self.values(), self.whole: float(np.clip(size, low, high)), "shares": shares}
        )

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        size, scale = (next(p for p in cls.parameters_at(place) if p.name == name) for name in (cls.whole, cls.scale))
        return super().candidates(place, context) + [
            Candidate(
                cls,
                place,
                [{scale.name: value, COUNT: count} for value in parameter_grid(scale, context.t)],
                [Linear(size.name, k, numerical_derivative_step(size)) for k in range(count)],
                f"{count} members",
                extra=1,
            )
            for count in cls.counts
        ]

    @classmethod
    def linear(cls, place: str) -> list[Linear]:
        return [column for column in super().linear(place) if column.name != "shares"]

    @classmethod
    def composed(cls, candidate: Candidate, node: Node, coefficients: Floats) -> Effect:
        if COUNT not in node:
            return super().composed(candidate, node, coefficients)
        whole = float(np.sum(coefficients))
        empty = abs(whole) <= LEAST * float(np.abs(coefficients).max(initial=0.0))
        even = np.full(len(coefficients), 1 / len(coefficients))
        off = np.zeros(len(even)) if empty else np.asarray(coefficients) / whole - even
        low, high = next(p.bounds for p in cls.parameters if p.name == "shares")
        moved = np.flatnonzero(off)  # not a single member's share, which is 1, its bound
        room = np.where(off > 0, high - even, low - even)
        over = float(np.max(off[moved] / room[moved], initial=0.0))
        # members that cancel have shares beyond any bound; what rounding leaves beyond it is cut off
        shares = np.clip(even + off / max(over, 1.0), low, high)
        return cls(candidate.place, **{cls.whole: whole, cls.scale: node[cls.scale], "shares": tuple(shares.tolist())})

    @classmethod
    def columns(cls, candidate: Candidate, node: Node, motion: Motion) -> Floats:
        if COUNT not in node:
            return super().columns(candidate, node, motion)
        effect, count = cls(candidate.place), node[COUNT]
        members = [effect._member_once(motion, node[cls.scale], k, count) for k in range(count)]
        return effect.axes(motion.places)[:, None] * np.stack(members, axis=-1)


def parameter_of_weighted_sum_member_weights(low: float, high: float) -> Parameter:
    """Parameter of the weights of a WeightedSum's members, each from low to high."""
    return Parameter("shares", "", (low, high), (0.1, 0.5), 0, role="form")


MOST = 0.5  # of the scale by which it may change over half the travel: more is a profile rather than a scale
CURVATURE = Parameter("curvature", "", (-MOST, MOST), (0.05, 0.3), role="form", signed=True)


class ScaleWithCurvature(Effect):
    """Deviation scale * q * (1 + curvature * q / half), q a travel from home, half half of the axis' whole travel."""

    __slots__ = ()
    if TYPE_CHECKING:  # fields of every such effect
        scale: float
        curvature: float

    def source(self, motion: Motion) -> Integers:
        """(axes,) number of the axis, from 0, whose travel each axis' deviation is proportional to."""
        return np.arange(len(motion.places))

    def half_travel(self, motion: Motion) -> Floats:
        """(axes,) m or rad, half of the travel of each axis' source."""
        ranges = motion.kind.travel_ranges(motion.mechanism)
        return np.asarray((ranges[:, 1] - ranges[:, 0]) / 2)[self.source(motion)]

    def deviation(self, motion: Motion) -> Floats:
        q = motion.stroke[:, self.source(motion)]
        grown = 1 + self.curvature * q / self.half_travel(motion) if self.curvature else 1.0
        return self.axes(motion.places) * self.scale * q * grown

    def controller_lines(self, motion: Motion) -> tuple[str, ...]:
        """What a controller computes of it at its axes, in C."""
        half, lines = self.half_travel(motion), []
        for i in np.flatnonzero(self.axes(motion.places)).tolist():
            source = int(self.source(motion)[i])
            travel = f"(c[{source}] - {motion.home[source].item()!r})"
            growth = f" * (1.0 + {self.curvature / half[i].item()!r} * {travel})" if self.curvature else ""
            lines.append(f"d[{i}] += {self.scale!r} * {travel}{growth};")
        return tuple(lines)

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        scale, straight = cls.parameters_at(place)[0], cls.straight_candidates(place, context)
        step = numerical_derivative_step(scale)  # of the scale; what the curvature adds is a share of it
        curved = [Linear(scale.name, 0, step), Linear(scale.name, 1, 0.1 * step)]
        return straight + [
            replace(c, grid=[{**node, COUNT: 2} for node in c.grid], linear=curved, label="curved") for c in straight
        ]

    @classmethod
    def straight_candidates(cls, place: str, context: Context) -> list[Candidate]:
        """The candidates without a curvature."""
        return super().candidates(place, context)

    @classmethod
    def composed(cls, candidate: Candidate, node: Node, coefficients: Floats) -> Effect:
        if COUNT not in node:
            return super().composed(candidate, node, coefficients)
        scale, bent = np.asarray(coefficients, float).tolist()
        curvature = float(np.clip(bent / scale, -MOST, MOST)) if scale else 0.0
        return cls(candidate.place, scale=scale, curvature=curvature, **_values(node))

    @classmethod
    def columns(cls, candidate: Candidate, node: Node, motion: Motion) -> Floats:
        if COUNT not in node:
            return super().columns(candidate, node, motion)
        effect = cls(candidate.place, scale=1.0, **_values(node))
        straight = effect.deviation(motion)
        share = motion.stroke[:, effect.source(motion)] / effect.half_travel(motion)
        return np.stack([straight, straight * share], axis=-1)


def _values(node: Node) -> Node:
    """The parameters among a node's entries."""
    return {name: value for name, value in node.items() if name != COUNT}
