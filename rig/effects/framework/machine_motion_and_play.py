"""Motion of the machine as effects see it, and play along it."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, Integers
from rig.compute.numba_compilation_and_kernel_cache_folder import njit
from rig.errors import RigError
from rig.model import mechanisms
from rig.model.base_and_link_tilt_sensors import gravity_at_exposures
from rig.model.design import Actuator, Platform
from rig.model.mechanisms.arm_dynamics_and_step_by_step_kinematics import (
    UNSTATED,
    are_hand_masses_and_centres_stated,
    loads_by_weight_of_hands,
    weight_wrench,
)
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Commanded, MechanismKinematics, has_links
from rig.recording.recording_folder import PAYLOAD, Sensors

SOON = 1e-6  # s; knots that lie closer together are one
STEADY = 1e-6  # of the greatest speed, by which two speeds are the same


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Commanded values through time, linear between knots: t (m,) s, lengths (m, axes) m or rad; at : (n,) the knots of
    the exposures
    starts : (k,) s, knots at which history begins anew: another recording of the same machine
    turned : (j,) s at which the command's speed changes where the path lags behind it, else None"""

    t: Floats
    lengths: Floats
    at: Integers
    starts: Floats = field(default_factory=lambda: np.zeros(0))
    turned: Floats | None = None

    @property
    def turns(self) -> Floats:
        """(j,) s at which the command's speed changes."""
        if self.turned is not None:
            return self.turned
        speeds = self.speeds
        return self.t[:-1][np.abs(np.diff(speeds, axis=0)).max(axis=1) > STEADY * np.abs(speeds).max()]

    def with_knots(self, times: Floats) -> "Path":
        """The same path with knots added at times (k,) s."""
        t = np.union1d(self.t, times)
        lengths = np.stack([np.interp(t, self.t, column) for column in self.lengths.T], axis=1)
        return replace(self, t=t, lengths=lengths, at=np.searchsorted(t, self.t[self.at]))

    @property
    def firsts(self) -> Floats:
        """(k + 1,) the knots at which history begins."""
        return np.r_[0, np.searchsorted(self.t, self.starts)]

    def walked(self, walk: Callable[[Floats, Floats], Floats]) -> Floats:
        """(m, axes) of walk(t (r,), lengths (r, axes)) -> (r, axes), which remembers, along each stretch from where
        history begins.
        """
        if not len(self.starts):
            return walk(self.t, self.lengths)
        edges = [*self.firsts.tolist(), len(self.t)]
        return np.concatenate([walk(self.t[a:b], self.lengths[a:b]) for a, b in zip(edges[:-1], edges[1:])])

    @property
    def began(self) -> Floats:
        """(n,) s at which the history of each exposure began."""
        return self.t[self.firsts[np.searchsorted(self.starts, self.t[self.at], side="right")]]

    @property
    def _steps(self) -> Floats:
        """(m, axes) m or rad from the knot before to each; 0 where history begins."""
        step = np.diff(self.lengths, axis=0, prepend=self.lengths[:1])
        step[self.firsts] = 0
        return step

    @property
    def speeds(self) -> Floats:
        """(m, axes) m/s or rad/s at which the axes come to the knots."""
        return self._steps / np.maximum(np.diff(self.t, prepend=self.t[0] - 1), SOON)[:, None]

    @property
    def speed(self) -> Floats:
        """(n, axes) m/s or rad/s at which the axes come to the exposures."""
        return self.speeds[self.at]

    @property
    def direction(self) -> Floats:
        """(n, axes) -1 or 1, which way each axis last moved before the exposures; 0 where it never did."""
        return np.sign(self.since_reversal)

    @property
    def way(self) -> Floats:
        """(n, axes) m or rad that the axes have travelled by the exposures, whichever way."""
        return np.abs(self._steps).cumsum(axis=0)[self.at]

    @property
    def last_step(self) -> Floats:
        """(n, axes) m or rad of the last straight move that led to each exposure: knots on its way and rests after it
        do not count.
        """
        speeds, ends = self.speeds, self._ends
        moving = np.flatnonzero(speeds.any(axis=1))
        starts = np.arange(len(self.t))  # the knot at which the move that ends at a knot began
        limit = STEADY * np.abs(speeds).max(initial=0.0)
        if len(moving):
            turned = np.abs(np.diff(speeds[moving], axis=0)).max(axis=1) > limit
            fresh = np.r_[True, turned | (np.diff(moving) > 1)]
            starts[moving] = (moving - 1)[fresh][np.cumsum(fresh) - 1]
        step = self.lengths[ends] - self.lengths[starts[ends]]
        return step[self.at]

    @property
    def _ends(self) -> Floats:
        """(m,) the last knot that a move led to, by each knot."""
        ends = np.where(self.speeds.any(axis=1), np.arange(len(self.t)), 0)
        ends[self.firsts] = self.firsts
        return np.maximum.accumulate(ends)

    @property
    def dwell(self) -> Floats:
        """(n,) s that nothing has moved for at the exposures; from the start on where nothing ever did."""
        return self.t[self.at] - self.t[self._ends[self.at]]

    @property
    def from_motion(self) -> Floats:
        """(n,) s between each exposure and the nearest motion; 0 in motion, infinite where there is none."""
        ends = np.flatnonzero(self.speeds.any(axis=1))  # motion lasts from the knot before to each of these
        if not len(ends):
            return np.full(len(self.at), np.inf)
        t, after = self.t[self.at], np.searchsorted(ends, self.at)
        before = np.where(after > 0, t - self.t[ends[after - 1]], np.inf)
        start = np.append(self.t[ends - 1], np.inf)[after]
        return np.maximum(np.minimum(before, start - t), 0.0)

    @property
    def since_reversal(self) -> Floats:
        """(n, axes) m or rad each axis has moved since it last turned round, signed by the direction."""
        step = self._steps
        out, fresh = np.zeros_like(step), set(self.firsts.tolist())
        for j in range(1, len(step)):
            out[j] = (
                0
                if j in fresh
                else np.where(step[j] == 0, out[j - 1], np.where(step[j] * out[j - 1] >= 0, out[j - 1], 0) + step[j])
            )
        return out[self.at]


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """All that an effect of the axes or the structure may look at, at the n exposures.

    mechanism : Hexapod, Planar2 or Arm as it really is; platform : Platform; actuator : Actuator; gravity : (3,) m/s^2,
        frame of poses
    t : (n,) s from the recording's start, on the commands' clock; path : Path of the commands, clock and lags applied
    sensors : Sensors or None; home : (axes,) m or rad, commanded values from which strokes count
    T : T_base_platform (n,), the present estimate, for effects that depend on the pose
    cached : what several effects (or an effect again and again) ask for, worked out once
    """

    mechanism: Commanded
    platform: Platform
    actuator: Actuator
    gravity: Floats
    t: Floats
    path: Path
    sensors: Sensors | None
    home: Floats
    T: RigidTransform | None
    cached: dict[tuple[object, ...], Floats] = field(default_factory=dict, init=False, repr=False)

    @property
    def kind(self) -> MechanismKinematics[Commanded]:
        """The module of rig.model.mechanisms that moves the mechanism."""
        return mechanisms.kinematics_of(self.mechanism)

    @property
    def places(self) -> tuple[str, ...]:
        """The axes' places: "strut 1" .. or "joint 1" .., of an arm's slides "slide 1" .."""
        return mechanisms.axis_place_texts(self.mechanism)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each axis' travel, "m" or "rad"."""
        return mechanisms.axis_units(self.mechanism)

    @property
    def lengths(self) -> Floats:
        """(n, axes) commanded values at the exposures, m or rad."""
        return self.path.lengths[self.path.at]

    @property
    def stroke(self) -> Floats:
        """(n, axes) m or rad from home."""
        return self.lengths - self.home

    @property
    def displaced(self) -> Floats:
        """(n, 6) m and rad of the platform, or the hand, from home: translation and rotation vector in the frame of
        poses.
        """
        home = self.kind.forward(self.home[None], self.mechanism)
        T = self.poses()
        return np.concatenate(
            [T.translation - home.translation, (T.rotation * home.rotation.inv()).as_rotvec()], axis=1
        )

    def tangents(self, moved: Floats) -> Floats:
        """(n, 6) tangents, on the right, of what moves by (n, 6) m and rad along the axes of the frame of poses and, at
        its origin, about them.
        """
        back = np.swapaxes(self.poses().rotation.as_matrix(), 1, 2)
        return (back[:, None] @ moved.reshape(-1, 2, 3, 1)).reshape(-1, 6)

    def once(self, key: tuple[object, ...], make: Callable[[], Floats]) -> Floats:
        """What `make` makes, kept under a key for as long as this Motion lasts."""
        if key not in self.cached:
            self.cached[key] = make()
        return self.cached[key]

    def recent_travel(self, time_constant: float) -> Floats:
        """(n, axes) m or rad of travel, whichever way, that is remembered for a time constant, s, at the exposures."""

        def walked() -> Floats:
            return self.path.walked(lambda t, x: exponentially_fading_travel(t, x, time_constant))[self.path.at]

        return self.once(("recent travel", time_constant), walked)

    def turn(self) -> Floats:
        """(axes,) m or rad of travel for one turn of what drives an axis: the screw's lead, a joint's own turn; NaN
        where no lead is stated.
        """
        lead = np.nan if self.actuator.screw_lead is None else self.actuator.screw_lead
        return np.array([lead if unit == "m" else 2 * np.pi for unit in self.units])

    def no_turn(self, sits: Floats) -> str | None:
        """Why the travel of one turn is not known of the axes that something sits at (axes,), or None."""
        return "needs [actuator] screw_lead in rig.toml" if np.isnan(self.turn()[sits > 0]).any() else None

    def no_cardans(self, wanted: tuple[str, ...]) -> str | None:
        """Why the struts do not end in joints of one of these kinds ([actuator] joints), or None."""
        if self.mechanism.plates is None:
            return "takes a hexapod, whose struts end in cardans"
        if self.actuator.joints is None:
            return "needs [actuator] joints in rig.toml"
        return None if self.actuator.joints in wanted else f"takes {' or '.join(wanted)} joints: a ball turns freely"

    def channel(self, *names: str) -> Floats:
        """(n,) the first of these sensor channels that there is, at the exposures. Raises RigError where the recording
        lacks them all.
        """
        reason = self.no_channel(*names)
        if reason or self.sensors is None:
            raise RigError(f"the model {reason}")
        return self.sensors.at(self.t, *names)

    def lagged_channel(self, lag: float, *names: str) -> Floats:
        """(n,) `channel` at the exposures, followed by a first-order lag (s, 0 for none) from where its log begins."""
        now = self.channel(*names)
        if lag <= 0 or self.sensors is None:
            return now
        log, t = next(self.sensors.channels[name] for name in names if name in self.sensors.channels), self.sensors.t
        edges = [0, *np.searchsorted(t, self.sensors.starts).tolist(), len(t)]
        part, out = np.searchsorted(self.sensors.starts, self.t, side="right"), now.copy()
        for k, (a, b) in enumerate(zip(edges[:-1], edges[1:])):
            own = np.flatnonzero(part == k)
            knots = np.union1d(t[a:b], self.t[own])
            late = first_order_lag(knots, np.interp(knots, t[a:b], log[a:b])[:, None], lag)[:, 0]
            out[own] = late[np.searchsorted(knots, self.t[own])]
        return out

    def no_channel(self, *names: str) -> str | None:
        """Why none of these sensor channels can be had, or None."""
        wanted = f"needs a sensor channel {' or '.join(map(repr, names))}"
        if self.sensors is None:
            return f"{wanted}, and the recording has no sensors.csv"
        return None if set(names) & set(self.sensors.channels) else f"{wanted}, which the recording does not have"

    def payload(self) -> Floats:
        """(n,) kg on the platform; 0 where nobody logged any."""
        logged = self.sensors is not None and PAYLOAD in self.sensors.channels
        return self.channel(PAYLOAD) if logged else np.zeros(len(self.t))

    def poses(self) -> RigidTransform:
        """T, the poses (n,). Raises ValueError for a Motion that has none."""
        if self.T is None:
            raise ValueError("this requires a motion with its poses")
        return self.T

    def gravity_in_base(self) -> Floats:
        """(n, 3) m/s^2 of gravity in the frame of poses: as logged where the base tilts, else as stated."""
        known = () if self.sensors is None else self.sensors.channels
        return gravity_at_exposures(self.gravity, known, self.channel, len(self.t))

    def loads(self) -> Floats:
        """(n, axes) N or N m with which the axes hold the platform and its payload at the poses T, worked out once.

        Raises RigError where the platform's mass or centre is not stated
        """
        reason = self.no_loads()
        if reason:
            raise RigError(f"the model {reason}")
        m = self.mechanism
        if has_links(m) and m.hands:
            return self.once(("loads",), lambda: loads_by_weight_of_hands(self.lengths, m, self.gravity_in_base()))
        return self.once(
            ("loads",), lambda: self.kind.axis_forces_and_torques(self.T, self.lengths, m, self.platform_wrench())
        )

    def no_loads(self) -> str | None:
        """Why the loads of the axes are not known, or None."""
        if has_links(self.mechanism) and self.mechanism.hands:
            if not are_hand_masses_and_centres_stated(self.mechanism):
                return UNSTATED
            return "takes no payload with several hands" if self.payload().any() else None
        if self.platform.mass is None or self.platform.centre_of_mass is None:
            return "needs [platform] mass and centre_of_mass in rig.toml"
        if self.payload().any() and self.platform.payload_centre_of_mass is None:
            return "needs [platform] payload_centre_of_mass in rig.toml, since a payload was logged"
        return None

    def platform_wrench(self) -> Floats:
        """(n, 6) N and N m of the weight of the platform and its payload, in the platform's frame."""
        platform, payload, gravity = self.platform, self.payload(), self.gravity_in_base()
        wrench = weight_wrench(self.poses(), gravity, platform.mass or 0.0, platform.centre_of_mass)
        if payload.any():
            wrench += weight_wrench(self.poses(), gravity, payload, platform.payload_centre_of_mass)
        return wrench

    def links(self) -> Floats:
        """(n, axes, c) load of the axes per kg and kg m of the machine's own members, worked out once."""
        return self.once(
            ("links",),
            lambda: self.kind.link_weight_loads(self.T, self.lengths, self.mechanism, self.gravity_in_base()),
        )


def play_operator(lengths: Floats, half_width: float) -> Floats:
    """Play operator (backlash): output (m, axes) of a play of a half width along lengths (m, axes), m or rad.

    The output starts in the middle of the gap and is dragged along at its ends. Between knots the input is monotonic,
    so the knots are all that matters. Source: Brokate and Sprekels, Hysteresis and Phase Transitions, 1996, ch. 2
    """
    return _walk(np.ascontiguousarray(lengths, dtype=float), float(half_width))


def play_deviation(motion: Motion, half_width: float) -> Floats:
    """Deviation (n, axes) m or rad from the command at the exposures by a play of a half width."""
    path = motion.path
    return motion.once(
        ("behind", half_width),
        lambda: path.walked(lambda _, lengths: play_operator(lengths, half_width))[path.at] - path.lengths[path.at],
    )


@njit(cache=True)
def _walk(lengths: Floats, half: float) -> Floats:
    out = np.empty_like(lengths)
    at = lengths[0].copy()
    for k in range(len(lengths)):
        for i in range(lengths.shape[1]):
            at[i] = min(max(at[i], lengths[k, i] - half), lengths[k, i] + half)
            out[k, i] = at[i]
    return out


def first_order_lag(t: Floats, x: Floats, time_constant: float) -> Floats:
    """First-order lag (m, axes) of x (m, axes), linear between knots t (m,), from rest, y = x."""
    return _lag(np.ascontiguousarray(t, dtype=float), np.ascontiguousarray(x, dtype=float), float(time_constant))


@njit(cache=True)
def _lag(t: Floats, x: Floats, time_constant: float) -> Floats:
    out = np.empty_like(x)
    out[0] = x[0]
    for k in range(1, len(t)):
        dt = t[k] - t[k - 1]
        fade = np.exp(-dt / time_constant)
        for i in range(x.shape[1]):
            behind = (x[k, i] - x[k - 1, i]) / dt * time_constant if dt > 0 else 0.0
            out[k, i] = x[k, i] - behind + (out[k - 1, i] - x[k - 1, i] + behind) * fade
    return out


def exponentially_fading_travel(t: Floats, lengths: Floats, time_constant: float) -> Floats:
    """Travel (m, axes) along lengths (m, axes) m or rad that fades exponentially with a time constant.

    Lengths are linear between knots t (m,) s.
    Exact: at a steady speed v it nears v * time_constant exponentially. It starts from none.
    """
    return _fade(np.ascontiguousarray(t, dtype=float), np.ascontiguousarray(lengths, dtype=float), float(time_constant))


@njit(cache=True)
def _fade(t: Floats, lengths: Floats, time_constant: float) -> Floats:
    out = np.zeros_like(lengths)
    for k in range(1, len(t)):
        dt = t[k] - t[k - 1]
        fade = np.exp(-dt / time_constant)
        gain = -np.expm1(-dt / time_constant) * time_constant / dt if dt > 0 else 1.0
        for i in range(lengths.shape[1]):
            out[k, i] = out[k - 1, i] * fade + abs(lengths[k, i] - lengths[k - 1, i]) * gain
    return out
