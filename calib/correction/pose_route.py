"""Route through wanted poses in time: when the axes leave, arrive and wait, and from which side."""

from dataclasses import dataclass
from typing import cast

import numpy as np

from rig.arrays import Booleans, Floats
from rig.errors import Unreachable
from rig.recording.recording_folder import Commands

HOLD, HELD = (
    1.0,
    0.1,
)  # s for which a pose is held beyond its time, and share of the time to the next that this takes at the most
SETTLE = 2.0  # s at rest before the first pose's time, where nobody says when the axes set out
BRIEF = 1e-3  # s; rows of commands lie no closer together
AT_REST = 1e9  # s, as good as for ever: between poses that have no times
WAITING, TURNING, ARRIVED, HOLDING = range(4)  # what a row of commands does


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """Rows of commands, in order of time. t : (m,) s; pose : (m,) number of the pose whose values a row takes, -1 for
    the start
    doing : (m,) WAITING at a place before the axes leave it, TURNING beyond a pose to come to it from there, ARRIVED at
        it, HOLDING it at its time
    reach : (m, axes) m or rad by which a row lies beyond its pose; start : (axes,) m or rad, where the axes stand at
        first."""

    t: Floats
    pose: Floats
    doing: Floats
    reach: Floats
    start: Floats

    def values(self, held: Floats) -> Floats:
        """(m, axes) what the rows command where the poses take values (n, axes)."""
        return np.where(self.pose[:, None] < 0, self.start, held[self.pose]) + self.reach

    def commands(self, held: Floats) -> Commands:
        """Commands of values (n, axes) at the poses."""
        return Commands(self.t, self.values(held))

    @property
    def times(self) -> Floats:
        """(n,) s at which the poses are held."""
        return self.t[self.doing == HOLDING]

    @property
    def approached(self) -> Booleans:
        """(n,) bool, whether a pose is come to from beyond it."""
        return np.isin(np.arange((self.doing == HOLDING).sum()), self.pose[self.doing == TURNING])


@dataclass(frozen=True, slots=True, eq=False)
class Pace:
    """t : (n,) s, when poses are held; begin : s, from when the axes stand at the start, None for just in time;
    speed : m/s or rad/s at which the axes go where there is time; fastest : what they must not exceed, or None."""

    t: Floats
    begin: float | None
    speed: float
    fastest: float | None


def timed_route(pace: Pace, commands: Floats, start: Floats, approach_offsets: Floats | None = None) -> Route:
    """Route through commands (n, axes) timed by a Pace: when the axes leave, arrive and wait.

    start : (axes,); approach_offsets : (n, axes) of approaches, zero for none. Raises Unreachable, listing the poses
        that come too soon
    """
    approach_offsets, t = np.zeros_like(commands) if approach_offsets is None else approach_offsets, pace.t
    out, back = (
        np.abs(commands + approach_offsets - np.vstack([start, commands[:-1]])).max(axis=1),
        np.abs(approach_offsets).max(axis=1),
    )
    way = out + back
    begin = t[0] - SETTLE - way[0] / pace.speed if pace.begin is None or pace.begin >= t[0] else pace.begin
    gap = t - np.r_[begin, t[:-1]]
    leave = t - gap + np.r_[0.0, np.minimum(HOLD, HELD * gap[1:])]
    least = np.minimum(way / pace.speed, t - leave)
    hurried = np.zeros(len(t), bool) if pace.fastest is None else way > pace.fastest * least * (1 + 1e-9)
    late = np.flatnonzero((gap < 10 * BRIEF) | hurried)
    if len(late):
        lines = [
            f"pose {i}: {way[i]:.6g} of travel in {gap[i]:.4g} s"
            + (f", at most {pace.fastest:.4g} /s" if pace.fastest else "")
            for i in late.tolist()
        ]
        raise Unreachable(f"{len(late)} of {len(t)} wanted poses come too soon after the one before:", late, lines)
    arrive = leave + np.maximum(least, BRIEF)
    turn = leave + np.where(back > 0, out / np.maximum(way, 1e-300), 1.0) * (arrive - leave)
    n, numbers = len(t), np.arange(len(t))
    parts = [
        (np.array([begin]), np.array([-1]), WAITING, np.ones(1, bool)),
        (leave, numbers - 1, WAITING, numbers > 0),
        (turn, numbers, TURNING, back > 0),
        (arrive, numbers, ARRIVED, arrive < t - BRIEF),
        (t, numbers, HOLDING, np.ones(n, bool)),
        (t[-1:] + HOLD, numbers[-1:], WAITING, np.ones(1, bool)),
    ]
    when, pose, doing = (np.concatenate(x) for x in zip(*((t[k], p[k], np.full(k.sum(), d)) for t, p, d, k in parts)))
    order = np.lexsort((doing, when))
    when, pose, doing = when[order], pose[order], doing[order]
    return Route(when, pose, doing, np.where((doing == TURNING)[:, None], approach_offsets[pose], 0.0), start)


def untimed_route(commands: Floats, start: Floats) -> Route:
    """Route through commands (n, axes) without times: in order from start (axes,), each held until at rest."""
    return timed_route(
        Pace(cast(Floats, AT_REST * np.arange(1, len(commands) + 1)), 0.0, np.abs(commands - start).max() + 1.0, None),
        commands,
        start,
    )
