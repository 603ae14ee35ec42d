"""Parameters and covariates of effects, and the table of markers that effects change.

Also the context of a recording, and linear columns. Of markers: identities, poses on bodies, sides.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol, TypeVar, cast

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.effects.framework.machine_motion_and_play import Motion
from rig.errors import RigError
from rig.formats.numbers_and_units import quantity_text
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.design import Camera, Design
from rig.recording.recording_folder import Sensors


def replace_axis_placeholder_in_text(text: str) -> str:
    """Text with its placeholder {axis} replaced by the word axis.

    For axes of any kind.
    """
    return text.replace("{axis}s", "axes").format(axis="axis")


MOST_SHOWN = 3  # numbers of several

TURNED = {"m": "rad", "N/m": "N m/rad"}  # units of a strut's and of a joint's axis

FAR = 10.0  # times what rigs show, from which a size is said to be unusual

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ControllerTerm:
    """An effect as a machine's controller computes it, in C99.

    statements : add m or rad to d[i], of commands c[axes] (m or rad), of a hexapod's joints BASE[6][3] and tip[6][3]
        (m, base frame) and sensor channels, each named by `c_channel_expression`
    gaps : (axes,) m or rad, the play of each axis, () for none; channels : names of the sensor channels; lag : s, by
        which what counts follows them, 0 for at once
    """

    statements: tuple[str, ...] = ()
    gaps: tuple[float, ...] = ()
    channels: tuple[str, ...] = ()
    lag: float = 0.0


def c_channel_expression(name: str) -> str:
    """C expression of a controller's sensor channel."""
    return f"channels[RIG_{name.upper()}]"


@dataclass(frozen=True, slots=True)
class Parameter:
    """name; unit; bounds : (low, high) that make sense, beyond any value that nature prefers; usual : (low, high) that
    rigs show
    size : numbers it has, 0 for any; signed : whether minus what is usual is as usual
    joint : (bounds, usual) at a joint, whose travel is rad, where these are not those of a strut

    role : how the effect depends on it, for those who search: "linear", "inverse" (its reciprocal enters linearly),
    "size" (nothing at zero, but not linear), "phase" (of a sinusoid that a linear parameter scales), "log" or "even" (a
    node's parameter, to be searched over `usual` on a scale of that kind), "moment" (a time, s from the recording's
    start), "frequency", "direction" (of which only the direction counts), "form" (which member of a law's
    family it is; its default is the standard law, of which it is not fitted), "choice" (given or chosen, never fitted)
    tried : values that a search tries in place of those of the role; () for these
    """

    name: str
    unit: str
    bounds: Range
    usual: Range
    size: int = 1
    role: str = "linear"
    signed: bool = False
    joint: tuple[Range, Range] | None = None
    tried: tuple[float, ...] = ()

    def unusual(self, value: object) -> str | None:
        """Whether a value is far beyond what rigs show, in a sentence; None where it is not, or is no number."""
        if self.role not in ("linear", "size", "inverse") or not isinstance(value, (int, float)):
            return None
        inverse = self.role == "inverse"
        most = self.usual[0] if inverse else self.usual[1]
        if not (abs(value) * FAR < most if inverse else abs(value) > FAR * most):
            return None
        end = "least" if inverse else "most"
        return (
            f"{self.name.replace('_', ' ')} {quantity_text(value, self.unit)} is far beyond what rigs show, "
            f"{quantity_text(most, self.unit)} at the "
            f"{end}: "
            "something else may hide behind it"
        )

    def at(self, place: str) -> "Parameter":
        """The same as it is at a place: in rad in place of m at a joint."""
        if self.joint is None or Place.parse(place).kind != "joint":
            return self
        return replace(
            self, unit=TURNED.get(self.unit, self.unit), bounds=self.joint[0], usual=self.joint[1], joint=None
        )

    def value_text(self, value: float | tuple[float, ...]) -> str:
        """Its name and a value, in a unit that people read."""
        numbers = value if isinstance(value, tuple) else (value,)
        more = f", the first {MOST_SHOWN} of {len(numbers)}" if len(numbers) > MOST_SHOWN else ""
        return f"{self.name.replace('_', ' ')} {quantity_text(numbers[:MOST_SHOWN], self.unit)}{more}"


SEARCHED = ("size", "log", "even", "moment")  # roles of parameters of which a grid of values is tried
LOG_STEPS, EVEN_STEP = 14, 0.01  # values of a "log" parameter over its usual range; steps of an "even" one
SIZES = 16  # values of a "size" parameter over its usual range
SMALLER = 4  # values of one below that range, as far from each other
EDGE = 4  # frames at either end that a moment leaves


def parameter_grid(parameter: Parameter, t: Floats) -> list[float]:
    """Grid of values of a parameter to try.

    By its role and usual size.
    t : (n,) s, the exposures
    """
    low, high = parameter.usual
    if parameter.tried:
        return list(parameter.tried)
    if parameter.role in ("size", "log"):
        return _sizes(low, high) if parameter.role == "size" else np.geomspace(low, high, LOG_STEPS).tolist()
    if parameter.role == "even":
        return np.arange(max(low * 0.3, parameter.bounds[0]), min(high * 2.5, parameter.bounds[1]), EVEN_STEP).tolist()
    return ((t[EDGE - 1 : -EDGE] + t[EDGE : len(t) - EDGE + 1]) / 2).tolist()


Node = dict[str, Any]  # {parameter: value} of the nonlinear ones: a number each, or several


def grid_nodes_of_both_signs(parameters: Sequence[Parameter], name: str) -> list[Node]:
    """Grid nodes {parameter: value} with both signs of a parameter's usual sizes."""
    usual = next(p.usual for p in parameters if p.name == name)
    return [{name: sign * size} for sign in (-1, 1) for size in _sizes(*usual)]


def _sizes(low: float, high: float) -> list[float]:
    """Sizes over a usual range, and below it as far as `SMALLER`: what is not linear cannot be seen from far above."""
    usual = np.geomspace(low, high, SIZES)
    return [*(low / (usual[1] / low) ** np.arange(SMALLER, 0, -1)).tolist(), *usual.tolist()]


def numerical_derivative_step(parameter: Parameter) -> float:
    """Step of a parameter for its numerical derivative."""
    size = (
        np.sqrt(parameter.usual[0] * parameter.usual[1])
        if parameter.usual[0] > 0
        else 1e-2 * max(map(abs, parameter.usual))
    )
    return 1 / size if parameter.role == "inverse" else 0.1 * size


EARLY, LATE = 0.1, 0.9  # shares of the exposures between which moments are drawn


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """design : Design; t : (n,) s, the exposures; motion : Motion of its commands, everything logged that can be
    displaced : (how a camera is to be looked through : Effect -> px RMS by which corners all over its image move), see
        synthetic.random_blind_platform_cases_with_truth
    """

    design: Design
    t: Floats
    motion: Motion
    displaced: Callable[[Any, Camera], float]


def draw_log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Log-uniform random number between low and high.

    Every order of magnitude as likely.
    """
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def draw_parameter(parameter: Parameter, drawing: Drawing, rng: np.random.Generator) -> float | tuple[float, ...]:
    """Value of a parameter drawn at random over its usual range."""
    low, high = parameter.usual
    if parameter.role == "moment":
        return float(rng.uniform(*np.quantile(drawing.t, [EARLY, LATE])))
    if parameter.role in ("phase", "even"):
        return float(rng.uniform(low, high))
    size = draw_log_uniform(rng, low, high)
    if parameter.size == 1:
        return float(rng.choice([-1, 1]) * size) if parameter.signed else size
    return tuple((size / np.sqrt(parameter.size) * rng.normal(size=parameter.size)).tolist())


def draw_scalar_parameter(parameter: Parameter, drawing: Drawing, rng: np.random.Generator) -> float:
    """Number of a scalar parameter drawn at random over its usual range.

    Raises ValueError for a vector.
    """
    drawn = draw_parameter(parameter, drawing, rng)
    if isinstance(drawn, tuple):
        raise ValueError(f"{parameter.name} has {len(drawn)} numbers")
    return float(drawn)


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """design : Design as its owner states it; t : (n,) s, the exposures; sensors : Sensors or None
    motion : Motion at the measured poses, no effects; None where nothing was commanded
    cameras : names of those that saw something; moving : of those on a mount that moves; markers : ids seen;
        targets : names seen
    """

    design: Design
    t: Floats
    sensors: Sensors | None
    motion: Motion | None
    cameras: tuple[str, ...] = ()
    moving: tuple[str, ...] = ()
    markers: tuple[int, ...] = ()
    targets: tuple[str, ...] = ()

    def moved(self) -> Motion:
        """The Motion. Raises RigError where nothing was commanded."""
        if self.motion is None:
            raise RigError("nothing was commanded")
        return self.motion

    def places_of_kind(self, kind: str) -> tuple[str, ...]:
        """The places of a kind of place that an effect can sit at."""
        if kind == "axis":
            return self.moved().places
        if kind == "cameras" and len(self.design.cameras) < 2:
            return ()
        several = {"camera": self.cameras, "marker": self.markers, "target": self.targets}
        return tuple(str(Place(kind, str(name))) for name in several[kind]) if kind in several else (kind,)

    def logged(self, *names: str) -> bool:
        """Whether any of these sensor channels was logged."""
        return self.sensors is not None and bool(set(names) & set(self.sensors.channels))


PLOT_UNITS = {"m": (1e3, "mm"), "rad": (180 / np.pi, "degrees")}  # of an axis' travel


@dataclass(frozen=True, slots=True, eq=False)
class Covariate:
    """values : (n,) or (n, axes) in the unit in which they are drawn; label : in words, with that unit."""

    values: Floats
    label: str


def travel_covariate(values: Floats, motion: Motion, label: str, unit_suffix: str = "") -> Covariate:
    """Covariate of travel values (n, axes) in the unit of each axis (m or rad), with a label."""
    scale = np.array([PLOT_UNITS[unit][0] for unit in motion.units])
    words = " or ".join(dict.fromkeys(PLOT_UNITS[unit][1] for unit in motion.units))
    return Covariate(values * scale, f"{label}, {words}{unit_suffix}")


def load_covariate(values: Floats, motion: Motion, label: str) -> Covariate:
    """Covariate of load: values (n, axes) N or N m that the axes carry, with a label."""
    kind = motion.kind
    per = {"m": ("force", "N"), "rad": ("torque", "N m")}
    names, units = (dict.fromkeys(per[unit][k] for unit in motion.units) for k in (0, 1))
    return Covariate(values, f"{' or '.join(names)}, {label.format(unit=' or '.join(units), axis=kind.AXIS)}")


def time_covariate(motion: Motion) -> Covariate:
    """Covariate of time.

    Minutes since the first exposure.
    """
    return Covariate((motion.t - motion.t[0]) / 60, "time, min")


def temperature_covariate(values: Floats, part: str) -> Covariate:
    """Covariate of temperature: values (n,) or (n, axes) of a part in degrees Celsius."""
    return Covariate(values, f"temperature of {part}, °C")


QUADRATURE = "_quadrature"  # the cosine beside the sine of a sinusoid: stands for its phase
COUNT = "_count"  # in a node: how many numbers a vector of any length has


class Linear(NamedTuple):
    """A column of the model: a parameter's name (or QUADRATURE), which number of a vector or None, and a small step of
    it.
    """

    name: str
    entry: int | None
    step: float


def parameter_values(
    linear: Sequence[Linear], node: Node, coefficients: Floats, parameters: Sequence[Parameter]
) -> dict[str, object]:
    """Values {parameter: value} of an effect's parameters from a fit.

    From a grid node and coefficients (q,) of its linear columns.
    """
    values, by = dict(node), {p.name: p for p in parameters}
    vectors = {name: np.zeros(by[name].size or node[COUNT]) for name, index, _ in linear if index is not None}
    for (name, index, _), c in zip(linear, coefficients):
        if name == QUADRATURE:
            amplitude = next(p.name for p in parameters if p.role == "linear")
            phase = next(p.name for p in parameters if p.role == "phase")
            values[amplitude], values[phase] = (
                float(np.hypot(values[amplitude], c)),
                float(np.arctan2(c, values[amplitude])),
            )
        elif index is not None:
            vectors[name][index] = c
        elif by[name].role == "inverse":
            values[name] = 1 / c if c else np.inf
        else:
            values[name] = float(c)
    values.pop(COUNT, None)
    return {**values, **{name: tuple(v.tolist()) for name, v in vectors.items()}}


def sine_and_cosine_columns_of_travel(
    travel: Floats, affected_axes: Booleans, rates: Sequence[float], phases: Sequence[float]
) -> Floats:
    """Quadrature columns (k, n, axes, 2): sine and cosine of rate * travel + phase.

    travel : (n, axes) m or rad; affected_axes : (axes,) of which; rates : (k,) rad per m or rad; phases : (k,) rad
    """
    angle = np.array(rates)[:, None, None] * travel[:, affected_axes] + np.array(phases)[:, None, None]
    out = np.zeros((len(rates), *travel.shape, 2))
    out[:, :, affected_axes, 0], out[:, :, affected_axes, 1] = np.sin(angle), np.cos(angle)
    return out


class MarkerTable(Protocol):
    """A dataclass of markers, a row each, as vision.marker_corner_prediction has it.

    id : (m,); on_platform : (m,) bool; T_body_marker : RigidTransform (m,); side : (m,) m; heights : (m, 4) m
        or (1, 4) for all alike; target : m names; stage : (m,) number
    """

    @property
    def id(self) -> Integers:
        """Identities as printed, (m,)."""

    @property
    def on_platform(self) -> Booleans:
        """Whether each moves, (m,) bool."""

    @property
    def T_body_marker(self) -> RigidTransform:
        """Poses on their bodies, (m,)."""

    @property
    def side(self) -> Floats:
        """Sides, (m,) m."""

    @property
    def heights(self) -> Floats:
        """How far their corners stand off their planes, (m, 4) m, or (1, 4) for all alike."""

    @property
    def target(self) -> list[str]:
        """Names of their targets, m."""

    @property
    def stage(self) -> Floats:
        """Numbers of their stages, (m,)."""


Markers = TypeVar("Markers", bound=MarkerTable)


def markers_with_replaced_columns(markers: Markers, **columns: object) -> Markers:
    """Copy of a marker table (Markers) with some of its columns replaced."""
    return cast(Markers, replace(cast(Any, markers), **columns))  # a Protocol cannot say that it is a dataclass
