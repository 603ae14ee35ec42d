"""Timed sequence of commands (Route), and map of pose errors over pose space.

A Route times a sequence of commands; the map in pose space gives the pose to request.

Source: configuration-space patent, [0035] (error maps and compensation in the configuration space, the workspace or
    both)
"""

from dataclasses import dataclass
from typing import NamedTuple, cast

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import Field
from rig.array_and_json_types import Booleans, Floats
from rig.errors import NotConverged, Unreachable
from rig.model.pose import exp, log
from rig.recording.recording_folder import Commands

ITERATIONS = 50
TOLERANCE = 1e-13  # m and rad, of the error's last change
NAMES = ("x", "y", "z", "rx", "ry", "rz")


class PoseSpace(NamedTuple):
    """home : T_base_platform whose turn rotations are counted from; coordinates : of NAMES, indices of those that poses
    differ in."""

    home: RigidTransform
    coordinates: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class PoseMap:
    """home : T_base_platform whose turn rotations are counted from; coordinates : of NAMES, indices of those that poses
    differ in
    field : Field over these, position in the base frame (m) and rotation vector from home (rad), whose values are the
    tangent on the right (m, rad) from where a pose is asked for to where the machine stands then, in the same
    coordinates, or in all six."""

    home: RigidTransform
    coordinates: tuple[int, ...]
    field: Field

    def at(self, T: RigidTransform) -> Floats:
        """(..., k) coordinates of poses (...)."""
        return pose_coordinates(T, self.home)[..., list(self.coordinates)]

    def error(self, T: RigidTransform) -> Floats:
        """(..., 6) m and rad, standard error of what the map adds to poses (...)."""
        return self._whole(self.field.error(self.at(T)))

    def applied(self, T: RigidTransform) -> RigidTransform:
        """Where the machine stands (...) when it is taken to stand at poses (...)."""
        return T * exp(self._whole(self.field.value(self.at(T))))

    def compensated(self, T: RigidTransform) -> RigidTransform:
        """The poses (...) at which the machine is to be taken to stand for it to stand at T (...): the fixed point of
        T' = T exp(-error(T')).

        Raises NotConverged with index, poses and residual (m, rad) where it is not found
        """
        found, before = T, np.zeros((*T.shape, 6))
        for _ in range(ITERATIONS):
            now = self._whole(self.field.value(self.at(found)))
            found, change, before = T * exp(-now), np.abs(now - before).max(axis=-1), now
            if change.max(initial=0) < TOLERANCE:
                return found
        failed = np.flatnonzero(~(np.ravel(change) < TOLERANCE))
        raise NotConverged(
            f"the commanded pose for {len(failed)} poses was not found by a map in pose space",
            failed,
            pose_coordinates(T, self.home).reshape(-1, 6)[failed],
            np.ravel(change)[failed],
        )

    def _whole(self, values: Floats) -> Floats:
        if values.shape[-1] == len(NAMES):
            return values
        out = np.zeros((*values.shape[:-1], 6))
        out[..., list(self.coordinates)] = values
        return out


def pose_coordinates(T: RigidTransform, home: RigidTransform) -> Floats:
    """Pose coordinates (..., 6) of poses (...).

    Position (m) and rotation vector (rad) from home's orientation.
    """
    return np.concatenate([T.translation, (home.rotation.inv() * T.rotation).as_rotvec()], axis=-1)


def pose_error_tangents(T_expected: RigidTransform, T_measured: RigidTransform) -> Floats:
    """Tangents (n, 6) of pose errors, m and rad.

    They are on the right, from the expected to the measured pose.
    """
    return log(T_expected.inv() * T_measured)


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
    """Route through commands (n, axes) timed by a Pace.

    It says when the axes leave, arrive and wait.
    start : (axes,); approach_offsets : (n, axes) of approaches, zero for none. Raises Unreachable, listing the poses
        that come too soon
    """
    approach_offsets, t = np.zeros_like(commands) if approach_offsets is None else approach_offsets, pace.t
    out, back = (
        np.abs(commands + approach_offsets - np.vstack([start, commands[:-1]])).max(axis=1),
        np.abs(approach_offsets).max(axis=1),
    )
    distance = out + back
    begin = t[0] - SETTLE - distance[0] / pace.speed if pace.begin is None or pace.begin >= t[0] else pace.begin
    gap = t - np.r_[begin, t[:-1]]
    leave = t - gap + np.r_[0.0, np.minimum(HOLD, HELD * gap[1:])]
    least = np.minimum(distance / pace.speed, t - leave)
    hurried = np.zeros(len(t), bool) if pace.fastest is None else distance > pace.fastest * least * (1 + 1e-9)
    late = np.flatnonzero((gap < 10 * BRIEF) | hurried)
    if len(late):
        lines = [
            f"pose {i}: {distance[i]:.6g} of travel in {gap[i]:.4g} s"
            + (f", at most {pace.fastest:.4g} /s" if pace.fastest else "")
            for i in late.tolist()
        ]
        raise Unreachable(f"{len(late)} of {len(t)} wanted poses follow the previous one too soon:", late, lines)
    arrive = leave + np.maximum(least, BRIEF)
    turn = leave + np.where(back > 0, out / np.maximum(distance, 1e-300), 1.0) * (arrive - leave)
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
    """Route through commands (n, axes) without times.

    They are in order from start (axes,), each held until at rest.
    """
    return timed_route(
        Pace(cast(Floats, AT_REST * np.arange(1, len(commands) + 1)), 0.0, np.abs(commands - start).max() + 1.0, None),
        commands,
        start,
    )
