"""Balanced visiting order and approach side.

Neither time nor direction correlates with position.

A correction fitted to place absorbs whatever goes with place. A Sobol sequence in its own order comes to the upper half
of a stroke from below and to the lower half from above, so that play looks like a map; a grid in serpentine order goes
with time, so that drift does.
Source: Box, Hunter and Hunter, Statistics for Experimenters, 2nd ed., ch. 4 and 5 (randomise what cannot be blocked,
    balance what can)
"""

from collections.abc import Sequence

import numpy as np

from rig.array_and_json_types import Floats, Integers

TRIED = 64  # exchanges of two configurations that are compared at once
REACHES = (0.02, 0.2)  # of the stroke, shortest and longest last move
ROOM = 0.95  # of what is left to the stroke's end, that a last move takes at most
WORST = 6.0  # weight of the axis whose direction goes with place the most
ROUNDS = 600  # of exchanges, and of turned sides, at most
MIDDLE = 3.0  # weight of as many sides above as below, beside correlations
BESIDE = 0.5  # weight of time, load and the sides of other axes, beside place
RIDGE = 0.05  # variance added to each, so that few configurations are balanced as far as they go
SMALL = 1e-9  # of a sum of squared correlations, below which an exchange gains nothing


def time_balanced_order(configurations: Floats, rng: np.random.Generator, start: Floats | None = None) -> Integers:
    """Order (n,) of configurations in which time is balanced against position.

    Shuffled, then exchanged in pairs.
    start : (axes,) from which the first is reached, where the axes go straight from one to the next: then direction of
    approach goes with place the least as well; None where sides are chosen apart (see `balanced_approach_lengths`). The
    least: the sum of squared correlations over all axes
    """
    n = len(configurations)
    order = rng.permutation(n)
    if n < 4:
        return order
    place, own = _place(configurations)
    smooth = _apart(place[:, : 2 * configurations.shape[1]])  # a drift goes with time, and is no matter of halves
    time = _standard(np.column_stack([np.linspace(-1, 1, n), np.linspace(-1, 1, n) ** 2]))
    for _ in range(ROUNDS):
        a, b = rng.integers(n, size=(2, TRIED))
        apart = np.abs(a - b) > 1
        a, b = a[apart], b[apart]
        if not len(a):
            continue
        now = smooth[order]
        sums = time.T @ now + np.einsum("kt,kp->ktp", time[a] - time[b], now[b] - now[a])
        costs = (sums**2).sum(axis=(1, 2))
        base = float(((time.T @ now) ** 2).sum())
        if start is not None:
            along, change = _directions(configurations[order], place[order], start, a, b)
            costs = costs + _worst_first((((along + change) ** 2) * own).sum(axis=2))
            base += float(_worst_first((along**2 * own).sum(axis=1)))
        best = int(np.argmin(costs))
        if costs[best] < base * (1 - SMALL):
            order[[a[best], b[best]]] = order[[b[best], a[best]]]
    return order


def balanced_approach_lengths(
    configurations: Floats, rng: np.random.Generator, strokes: Floats, other_variables: Sequence[Floats] = ()
) -> Floats:
    """Approach lengths (n, axes) m or rad to configurations, sides balanced.

    Positive from below.

    Sides are those of `_balanced_sides`; lengths are drawn from REACHES of the strokes (axes, 2), evenly on a
    logarithmic scale, so that what follows the size of a move differs from what follows its direction, and end before
    the stroke does. other_variables : as there
    """
    extent = np.ptp(strokes, axis=1)
    sides = _balanced_sides(configurations, rng, REACHES[0] * extent, strokes, other_variables)
    drawn = extent * REACHES[0] * (REACHES[1] / REACHES[0]) ** rng.random(configurations.shape)
    return np.asarray(
        sides
        * np.minimum(drawn, ROOM * np.where(sides > 0, configurations - strokes[:, 0], strokes[:, 1] - configurations))
    )


def _balanced_sides(
    values: Floats, rng: np.random.Generator, reach: Floats, strokes: Floats, others: Sequence[Floats] = ()
) -> Floats:
    """(n, axes) sides from which each axis comes to configurations values (n, axes), m or rad, in their order: 1 from
    below, -1 from above.

    At random, then turned one by one until place, time, others (n,) and the sides of other axes together explain the
    least of the side, axis by axis.
    reach : (axes,) m or rad, by which an axis moves last at least; strokes : (axes, 2), which it does not leave: at an
    end an axis comes from within
    """
    n, axes = values.shape
    place, own = _place(values)
    time = np.linspace(-1, 1, max(n, 2))[:n]
    sides = np.zeros((n, axes))
    for i in range(axes):
        fixed = 1 * (values[:, i] + reach[i] > strokes[i, 1]) - 1 * (values[:, i] - reach[i] < strokes[i, 0])
        causes = np.column_stack([_standard(np.column_stack([time, time**2, *others])), sides[:, :i]])
        columns = np.column_stack([np.full(n, MIDDLE), _apart(place[:, own[i] > 0]), BESIDE * causes])
        side = np.where(fixed, fixed, rng.permutation(np.where(np.arange(n) % 2, 1.0, -1.0)))
        sides[:, i] = _turned(side, columns, fixed == 0)
    return sides


def _turned(side: Floats, columns: Floats, free: Floats) -> Floats:
    """Sides (n,) of which the free ones are turned, one or two at a time, while the squared sums with columns (n, p)
    become less.
    """
    own = (columns**2).sum(axis=1)
    if not free.any():
        return side
    sums = columns.T @ side
    for _ in range(ROUNDS):
        change = np.where(
            free, 4 * own - 4 * side * (columns @ sums), np.inf
        )  # |sums - 2 side_k columns_k|^2 - |sums|^2
        best = int(np.argmin(change))
        if change[best] >= -SMALL:  # none gains alone: two at once
            pair = (
                change[:, None] + change + 8 * np.outer(side, side) * (columns @ columns.T)
                if len(side) <= TRIED
                else np.full((1, 1), np.inf)
            )
            np.fill_diagonal(pair, np.inf)
            if not pair.min() < -SMALL:
                break
            turned = [int(k) for k in np.unravel_index(int(np.argmin(pair)), pair.shape)]
        else:
            turned = [best]
        sums = sums - 2 * side[turned] @ columns[turned]
        side[turned] *= -1
    return side


def _place(values: Floats) -> tuple[Floats, Floats]:
    """(functions of place (n, 3 axes), standardised: every axis, its square and the half of its stroke; (axes, 3 axes)
    bool which count for the direction of an axis: all axes' places, and of its own the square and the half)."""
    axes = values.shape[1]
    span = np.ptp(values, axis=0)
    unit = 2 * (values - values.min(axis=0)) / np.where(span > 0, span, 1.0) - 1
    own = np.concatenate([np.ones((axes, axes)), np.eye(axes), np.eye(axes)], axis=1)
    return _standard(np.concatenate([unit, unit**2, np.sign(np.round(unit, 9))], axis=1)), own


def _standard(columns: Floats) -> Floats:
    """Columns (n, p) of mean 0 and mean square 1; of 0 where they are constant."""
    centred = columns - columns.mean(axis=0)
    size = np.sqrt((centred**2).mean(axis=0))
    return np.asarray(centred / np.where(size > SMALL, size, np.inf))


def _worst_first(shares: Floats) -> Floats:
    """(...) what the axes' (..., axes) squared sums with directions cost: those of all, and most of all the worst
    axis'.
    """
    return np.asarray(shares.sum(axis=-1) + WORST * shares.max(axis=-1))


def _apart(columns: Floats) -> Floats:
    """Columns (n, p) made nearly uncorrelated: of a side their squared sums over n^2 are the share that all together
    explain.
    """
    size, vectors = np.linalg.eigh(columns.T @ columns / len(columns))
    return np.asarray(columns @ vectors / np.sqrt(size + RIDGE))


def _directions(visited: Floats, place: Floats, start: Floats, a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """(sums (axes, p) of directions times functions of place (n, p) in an order, (k, axes, p) by which exchanging a
    (k,) and b (k,) changes them).

    visited : (n, axes) configurations in their order; no a is next to its b
    """
    before = np.concatenate([start[None], visited[:-1]])
    way = np.sign(visited - before)
    change = np.zeros((len(a), visited.shape[1], place.shape[1]))
    for at, other in ((a, b), (b, a)):
        new = np.sign(visited[other] - before[at])
        change += np.einsum("ka,kp->kap", new, place[other]) - np.einsum("ka,kp->kap", way[at], place[at])
        behind = at + 1 < len(visited)
        after = np.minimum(at + 1, len(visited) - 1)
        moved = (np.sign(visited[after] - visited[other]) - way[after]) * behind[:, None]
        change += np.einsum("ka,kp->kap", moved, place[after])
    return way.T @ place, change
