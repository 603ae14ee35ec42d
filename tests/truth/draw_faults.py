"""Faults by name and size: for each of the catalogue's names that shows in poses, several laws that are not the
product's.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.truth import days, loads, memories, places
from tests.truth.journey import Journey
from tests.truth.kinematics import Arm, Machine, SixStruts
from tests.truth.laws import Law

LEAD = 0.004  # m/rev, of every screw drawn here


@dataclass(frozen=True)
class FaultRequest:
    """What a fault is drawn from. size : m (of an arm's angles rad), about what it does to an axis; axes : (axes,)
    share of each axis
    machine : as it really is; journey : the recording's Journey; warmth : K, how much temperatures change; mass,
    centre,
        payload : of the platform"""

    size: float
    axes: np.ndarray
    machine: Machine
    journey: Journey
    warmth: float
    mass: float
    centre: np.ndarray
    payload: np.ndarray
    rng: np.random.Generator

    @property
    def half(self) -> float:
        """Half of the mean travel, m or rad."""
        return float(np.ptp(self.machine.ranges, axis=1).mean() / 2)

    @property
    def begun(self) -> np.ndarray:
        """(axes,) -1..1: where a memory stands at first, which nobody knows."""
        return self.rng.uniform(-1, 1, self.machine.width)

    @property
    def span(self) -> float:
        """s, of the recording."""
        return float(self.journey.t[-1])


def _play(a: FaultRequest) -> list[Law]:
    return [
        memories.Stops(a.axes, a.size, a.size, a.begun),
        memories.Stops(a.axes, 1.5 * a.size, 0.5 * a.size, a.begun),
        memories.Bristles(a.axes, np.array([a.size]), np.ones(1), 1.0, a.begun),
    ]


def _hysteresis(a: FaultRequest) -> list[Law]:
    reach = a.half * np.array([0.02, 0.1, 0.3])
    sliders = np.exp(a.rng.normal(0, 0.5, 3))
    sliders *= a.size / (sliders @ reach)
    most = a.half * a.rng.uniform(0.05, 0.2)
    return [
        memories.Bristles(a.axes, np.array([most]), np.array([a.size / most]), a.rng.uniform(0.55, 0.9), a.begun),
        memories.Sliders(a.axes, reach, sliders, a.begun),
        memories.Bristles(a.axes, np.array([most, most / 6]), np.array([0.6, 2.4]) * a.size / most, 1.0, a.begun),
    ]


def _creep(a: FaultRequest) -> list[Law]:
    fraction, dwell = 3 * a.size / a.half, float(np.diff(a.journey.t).max())
    return [
        memories.TwoPaces(
            a.axes, fraction, dwell * a.rng.uniform(0.3, 1), dwell * a.rng.uniform(3, 10), a.rng.uniform(0.3, 0.7)
        ),
        memories.Logarithmic(a.axes, fraction, 0.2 * dwell, 30 * dwell),
    ]


def _heat(a: FaultRequest) -> list[Law]:
    if isinstance(a.machine, Arm):
        return [days.GrownLinks(a.axes, a.size / 0.5 / (0.4 * a.warmth))]
    per_kelvin = a.size / float(np.abs(a.machine.ranges).mean()) / (0.4 * a.warmth)
    return [days.Heated(a.axes, per_kelvin, 0.0), days.Heated(a.axes, per_kelvin, a.span * a.rng.uniform(0.05, 0.15))]


def _warm_up(a: FaultRequest) -> list[Law]:
    first = a.span * a.rng.uniform(0.1, 0.3)
    return [
        days.Warming(a.axes, 3 * a.size, first, 3 * first, 0.5),
        days.Warming(a.axes, 3 * a.size, first, 1.5 * first, 1.0),
    ]


def _pitch(a: FaultRequest) -> list[Law]:
    rng = a.rng
    return [
        places.Waves(
            a.axes,
            a.size * rng.uniform(0.4, 1, 3),
            np.array([1.3, 0.7, 0.4]) * rng.uniform(0.8, 1.2, 3),
            rng.uniform(0, 6.28, 3),
            a.size * rng.normal(),
        ),
        places.Kinked(a.axes, a.size * rng.normal(0, 1.2, 6)),
    ]


def _cyclic(a: FaultRequest) -> list[Law]:
    pitch = LEAD if isinstance(a.machine, SixStruts) else 0.3 * a.half
    return [
        places.Periodic(a.axes, pitch, a.size * np.array([1.3, 0.4]), a.rng.uniform(0, 6.28, 2)),
        places.Sawtooth(a.axes, 1.7 * a.size, pitch, a.rng.uniform()),
    ]


def _scale(a: FaultRequest) -> list[Law]:
    return [
        places.Scaled(a.axes, 2 * a.size / a.half, 0.0),
        places.Scaled(a.axes, 2 * a.size / a.half, 0.5 * a.size / a.half**2),
    ]


def _coupled(a: FaultRequest) -> list[Law]:
    only = np.zeros(a.machine.width)
    only[int(a.rng.integers(a.machine.width))] = 1.0
    other = int(a.rng.choice(np.flatnonzero(only == 0)))
    return [
        places.Coupled(only, other, 2 * a.size / a.half, 0.0),
        places.Coupled(only, other, 2 * a.size / a.half, 0.3 * a.size / a.half**2),
    ]


def _twist(a: FaultRequest) -> list[Law]:
    gain = min(a.size / (LEAD / 6.28 * 0.05), 1.0)
    return [places.Twisted(a.axes, LEAD, gain, 0.0), places.Twisted(a.axes, LEAD, gain, gain)]


def _give(a: FaultRequest) -> list[Law]:
    force = a.mass * 9.8 / 6
    return [
        loads.Springs(a.axes, a.mass, a.centre, a.payload, force / a.size, np.inf),
        loads.Springs(a.axes, a.mass, a.centre, a.payload, force / a.size / 2, force),
    ]


def _loose(a: FaultRequest) -> list[Law]:
    return [
        loads.Loose(a.axes, a.mass, a.centre, a.payload, 2 * a.size, 0.0),
        loads.Loose(a.axes, a.mass, a.centre, a.payload, 2 * a.size, 0.1 * a.mass),
    ]


def _base(a: FaultRequest) -> list[Law]:
    machine = a.machine
    assert isinstance(machine, SixStruts)
    per_kelvin = 2 * a.size / float(np.linalg.norm(machine.base, axis=1).mean()) / (0.4 * a.warmth)
    return [
        days.GrowingBase(a.axes, per_kelvin * np.array([1.0, 1.0, 1.0])),
        days.GrowingBase(a.axes, per_kelvin * np.array([1.3, 0.7, 1.0])),
    ]


def _lost(a: FaultRequest) -> list[Law]:
    when = a.span * np.sort(a.rng.uniform(0.3, 0.7, 2))
    return [days.Lost(a.axes, when[:1], np.array([2 * a.size])), days.Lost(a.axes, when, a.size * np.array([1.2, 0.8]))]


def _shaken(a: FaultRequest) -> list[Law]:
    mode = a.rng.normal(size=6) * np.r_[np.ones(3), np.full(3, 5.0)]
    mode *= 1.4 * a.size / np.linalg.norm(mode[:3])
    rate, other = a.rng.uniform(0.3, 30), 0.3 * mode[::-1] * np.repeat([0.2, 5.0], 3)
    return [
        days.Shaken(a.axes, mode[None], np.array([rate]), a.rng.uniform(0, 6.28, 1)),
        days.Shaken(a.axes, np.stack([mode, other]), np.array([rate, 2.3 * rate]), a.rng.uniform(0, 6.28, 2)),
    ]


def _speed(a: FaultRequest) -> float:
    moving = np.abs(np.diff(a.journey.values, axis=0) / np.diff(a.journey.t)[:, None])
    return float(np.sqrt((moving[moving > 0] ** 2).mean()))


def _clock(a: FaultRequest) -> list[Law]:
    return [days.Clocked(a.axes, -a.size / _speed(a), 0.0)]


def _drifting(a: FaultRequest) -> list[Law]:
    return [days.Clocked(a.axes, 0.0, -2 * a.size / _speed(a) / a.span)]


def _lag(a: FaultRequest) -> list[Law]:
    late = a.size / _speed(a)
    return [memories.Damped(a.axes, 1.0, 1.4 / late, 0.7), memories.TwoPaces(a.axes, 1.0, late, 2 * late, 0.999)]


def _settling(a: FaultRequest) -> list[Law]:
    return [
        memories.LastStep(a.axes, a.size / a.half, 0.0),
        memories.LastStep(a.axes, 0.7 * a.size / a.half, 0.5 / a.half),
    ]


FAULTS: dict[str, Callable[[FaultRequest], list[Law]]] = {
    "scale_error": _scale,
    "cyclic_error": _cyclic,
    "transmission_error": _pitch,
    "backlash": _play,
    "hysteresis": _hysteresis,
    "missed_steps": _lost,
    "servo_lag": _lag,
    "creep": _creep,
    "thermal_expansion": _heat,
    "warm_up": _warm_up,
    "screw_coupling": _twist,
    "compliance": _give,
    "joint_clearance": _loose,
    "base_expansion": _base,
    "vibration": _shaken,
    "time_offset": _clock,
    "clock_drift": _drifting,
    "axis_coupling": _coupled,
    "settling_error": _settling,
}
HURRIED = (
    "servo_lag",
    "time_offset",
    "clock_drift",
    "rolling_shutter",
)  # which show while moving alone: looked at just as it should have arrived
SLOW = ("thermal_expansion", "warm_up", "base_expansion")  # which take the better part of an hour
LOADED = ("compliance", "joint_clearance")  # which depend on what is carried
STRUTS_ALONE = ("screw_coupling", "compliance", "joint_clearance", "base_expansion")


def fits(effect: str, kind: str) -> bool:
    """Whether there is a law of a fault for machines of a kind."""
    return kind == "hexapod" or effect not in STRUTS_ALONE and (kind != "chain" or effect != "thermal_expansion")
