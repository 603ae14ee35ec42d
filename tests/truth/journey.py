"""Plans and their course in time: which configurations are visited, how fast, how long the machine stands there, when
it is looked at.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

MIDDLE = 0.8  # share of every stroke that is visited and driven to
LOOK = 0.25  # s before a dwell ends, when it is looked at
PLANS = ("sobol", "shuffled", "ladders", "revisits")
ARRIVED = 1e-3  # s after it has arrived, when a hurried machine is looked at


@dataclass(frozen=True)
class Journey:
    """t, values : (k,) s and (k, axes), commands between which every axis moves linearly; looked : (n,) s"""

    t: np.ndarray
    values: np.ndarray
    looked: np.ndarray

    def at(self, t: np.ndarray) -> np.ndarray:
        """(n, axes) commanded at t (n,) s."""
        return np.stack([np.interp(t, self.t, column) for column in self.values.T], axis=1)


def middle(ranges: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """(n, axes) values in the middle of ranges (axes, 2) at points (n, axes) of the unit cube."""
    centre, half = ranges.mean(axis=1), np.ptp(ranges, axis=1) / 2
    return centre + MIDDLE * half * (2 * unit - 1)


def spread(axes: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, axes) scrambled Sobol points of the unit cube, in the sequence's own order."""
    return qmc.Sobol(axes, rng=rng).random_base2(int(np.ceil(np.log2(max(count, 2)))))[:count]


def visits(plan: str, ranges: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """(n, axes) configurations of a plan in order.

    sobol : count in the order of the sequence; shuffled : the same in random order; ladders : count scattered ones,
    then two axes alone, out and back in growing steps; revisits : count, then a third of them once more
    """
    axes = len(ranges)
    places = middle(ranges, spread(axes, count, rng))
    if plan == "sobol":
        return places
    places = rng.permutation(places)
    if plan == "revisits":
        return np.vstack([places, rng.permutation(places)[: count // 3]])
    if plan == "ladders":
        rungs, centre = [places], ranges.mean(axis=1)
        for axis in rng.choice(axes, 2, replace=False):
            for share in (0.02, 0.08, 0.3, 1.0):
                for side in (share, 0.0, -share, 0.0):
                    rung = centre.copy()
                    rung[axis] += side * MIDDLE * np.ptp(ranges[axis]) / 2
                    rungs.append(rung[None])
        return np.vstack(rungs)
    if plan not in PLANS:
        raise ValueError(f"no plan {plan!r}; there are {', '.join(PLANS)}")
    return places


def journey(places: np.ndarray, start: np.ndarray, speeds: np.ndarray, dwell: float, hurried: bool = False) -> Journey:
    """Journey from start (axes,) to each of places (n, axes) in turn, all axes setting out and arriving at once.

    speeds : (axes,) top speeds, of which 0.6 is used; dwell : s at each place, looked at LOOK before its end
    hurried : looked at as soon as it should have arrived
    """
    t, values, looked = [0.0, 1.0], [start, start], []
    for place in places:
        takes = max(float((np.abs(place - values[-1]) / (0.6 * speeds)).max()), 0.1)
        t += [t[-1] + takes, t[-1] + takes + dwell]
        values += [place, place]
        looked.append(t[-1] - dwell + ARRIVED if hurried else t[-1] - LOOK)
    return Journey(np.array(t), np.array(values), np.array(looked))
