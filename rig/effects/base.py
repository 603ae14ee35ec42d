"""What an effect is: a name, a place, parameters with units and bounds, and a hook at the stage where it acts.

Stages, in the order in which a command becomes a corner: `command` (what the struts are told, and when), `struts` (what their
lengths do beyond that), `structure` (what the frame and platform do), `targets` (where markers sit), `view` (what a camera
makes of it). Every hook of the base class changes nothing; an effect overrides the ones that it needs.
"""

import re
from dataclasses import dataclass, fields

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.errors import RigError

SOON = 1e-6  # s; knots that lie closer together are one
REFERENCE_TEMPERATURE = 20.0  # degrees Celsius, at which dimensions are as stated


@dataclass(frozen=True, slots=True)
class Parameter:
    """name; unit; bounds : (low, high) that make sense; usual : (low, high) that rigs show; size : numbers it has, 0 for any
    signed : whether minus what is usual is as usual.

    role : how the effect depends on it, for those who search: "linear", "inverse" (its reciprocal enters linearly), "size"
    (nothing at zero, but not linear), "phase" (of a sinusoid that a linear parameter scales), "log" or "even" (a shape's
    parameter, to be searched over `usual` on a scale of that kind), "moment" (a time, s from the recording's start), "frequency", "choice"
    (a whole number)
    """

    name: str
    unit: str
    bounds: tuple[float, float]
    usual: tuple[float, float]
    size: int = 1
    role: str = "linear"
    signed: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Commanded lengths through time, linear between knots: t (m,) s, lengths (m, axes); at : (n,) the knots of the exposures."""

    t: np.ndarray
    lengths: np.ndarray
    at: np.ndarray

    def with_knots(self, times):
        """The same path with knots added at times (k,) s."""
        t = np.union1d(self.t, times)
        lengths = np.stack([np.interp(t, self.t, column) for column in self.lengths.T], axis=1)
        return Path(t, lengths, np.searchsorted(t, self.t[self.at]))

    @property
    def speed(self):
        """(n, axes) m/s at which the struts come to the exposures."""
        step = np.diff(self.lengths, axis=0, prepend=self.lengths[:1])
        return (step / np.maximum(np.diff(self.t, prepend=self.t[0] - 1), SOON)[:, None])[self.at]

    @property
    def way(self):
        """(n, axes) m that the struts have travelled by the exposures, whichever way."""
        return np.abs(np.diff(self.lengths, axis=0, prepend=self.lengths[:1])).cumsum(axis=0)[self.at]


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """All that a strut or structure effect may look at, at the n exposures.

    mechanism : Hexapod as it really is; platform : Platform; actuator : Actuator; gravity : (3,) m/s^2, base frame
    t : (n,) s from the recording's start, on the commands' clock; path : Path of the commands, clock and lags applied
    sensors : Sensors or None; home : (axes,) m, commanded lengths at home
    T : T_base_platform (n,), the present estimate, for effects that depend on the pose
    """

    mechanism: object
    platform: object
    actuator: object
    gravity: np.ndarray
    t: np.ndarray
    path: Path
    sensors: object
    home: np.ndarray
    T: RigidTransform | None

    @property
    def lengths(self):
        """(n, axes) commanded lengths at the exposures, m."""
        return self.path.lengths[self.path.at]

    def channel(self, name):
        """(n,) a sensor's channel at the exposures. Raises RigError where the recording lacks it."""
        if self.sensors is None:
            raise RigError(f"the model needs a sensor channel {name!r}, and the recording has no sensors.csv")
        return self.sensors.at(self.t, name)

    def payload(self):
        """(n,) kg on the platform; 0 where nobody logged any."""
        return self.channel("payload_mass_kg") if self.sensors is not None and "payload_mass_kg" in self.sensors.channels else np.zeros(len(self.t))


class Effect:
    """Base of all effects. name, stage, places (kinds of place it can sit at), parameters, experiment : what would expose it."""

    __slots__ = ()
    name = ""
    stage = ""
    places: tuple[str, ...] = ()
    parameters: tuple[Parameter, ...] = ()
    experiment = ""
    on_pose = False  # whether its deviation depends on the pose
    sudden = False  # whether it happens at one time, and may be over soon

    def times(self, t):
        """(n,) s on the commands' clock at which exposures logged at t (n,) really happened."""
        return t

    def follow(self, path):
        """Path that the struts follow when told to follow a path."""
        return path

    def deviation(self, motion):
        """(n, axes) m that the struts are longer than commanded, by this effect."""
        return np.zeros(motion.lengths.shape)

    def sway(self, motion):
        """(n, 6) tangent by which the platform is displaced, on the right (m, rad)."""
        return np.zeros((len(motion.t), 6))

    def attach(self, markers):
        """Markers (id (m,), T_body_marker (m,), side (m,), target names) as they really sit: a `Sheet`."""
        return markers

    def camera(self, camera):
        """The Camera that really looks."""
        return camera

    def mount(self, camera, t, channel):
        """(n, 6) tangent by which a camera's mount has moved at t (n,) s, on the right; channel(name) -> (n,) sensor values."""
        return np.zeros((len(t), 6))

    def focal(self, camera, t, channel):
        """(n,) factor on a camera's focal length."""
        return np.ones(len(t))

    def bend(self, camera, points):
        """Points (..., 3) m of a camera's frame where they appear to be."""
        return points

    def late(self, camera, v):
        """(...,) s by which image row v (...,) is exposed after the middle row."""
        return np.zeros(np.shape(v))

    def print_(self, camera, quads):
        """Marker corners (..., 4, 2) px as they appear, given where their edges are."""
        return quads

    def values(self):
        """{parameter name: number or tuple} of this effect."""
        return {field.name: getattr(self, field.name) for field in fields(self) if field.name != "place"}

    def at(self, kind):
        """Whether this effect sits at a place "kind name"; "rig", "cameras" and "markers" take in all of their kind."""
        whole = {"strut": "rig", "camera": "cameras", "marker": "markers"}
        return self.place == kind or self.place == whole.get(kind.split(" ")[0])

    def struts(self, count=6):
        """(count,) 1.0 for the struts where it sits, else 0.0."""
        return np.array([float(self.at(f"strut {i + 1}")) for i in range(count)])


def check(effect):
    """The effect itself. Raises ValueError for a place it cannot sit at or a parameter out of bounds."""
    kind = effect.place.split(" ")[0]
    if kind not in effect.places:
        raise ValueError(f"{effect.name} cannot sit at {effect.place!r}; it takes {', '.join(effect.places)}")
    if kind in ("strut", "camera", "marker", "target") and not re.fullmatch(rf"{kind} \S+", effect.place):
        raise ValueError(f"{effect.name}: which {kind}? write for example '{kind} {'1' if kind in ('strut', 'marker') else 'name'}'")
    for parameter in effect.parameters:
        value = np.atleast_1d(np.asarray(getattr(effect, parameter.name), float))
        if parameter.size and len(value) != parameter.size:
            raise ValueError(f"{effect.name}: {parameter.name} has {parameter.size} numbers, got {len(value)}")
        low, high = parameter.bounds
        if not ((value >= low).all() and (value <= high).all()):  # false for what is not a number, too
            raise ValueError(f"{effect.name}: {parameter.name} must lie in {low:g} .. {high:g} {parameter.unit}, got {value.tolist()}")
    return effect
