"""Interface between effects and a diagnosis: recording context, search candidates, covariates of residuals."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rig.arrays import Floats
from rig.effects.framework.machine_motion import Motion
from rig.effects.framework.parameter import Parameter
from rig.effects.framework.place import Place
from rig.errors import RigError
from rig.model.design import Design
from rig.recording.recording_folder import Sensors


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


def travel_covariate(values: Floats, motion: Motion, label: str, per: str = "") -> Covariate:
    """Covariate of travel values (n, axes) in the unit of each axis (m or rad), with a label."""
    scale = np.array([PLOT_UNITS[unit][0] for unit in motion.units])
    words = " or ".join(dict.fromkeys(PLOT_UNITS[unit][1] for unit in motion.units))
    return Covariate(values * scale, f"{label}, {words}{per}")


def load_covariate(values: Floats, motion: Motion, label: str) -> Covariate:
    """Covariate of load: values (n, axes) N or N m that the axes carry, with a label."""
    kind = motion.kind
    per = {"m": ("force", "N"), "rad": ("torque", "N m")}
    names, units = (dict.fromkeys(per[unit][k] for unit in motion.units) for k in (0, 1))
    return Covariate(values, f"{' or '.join(names)}, {label.format(unit=' or '.join(units), axis=kind.AXIS)}")


def time_covariate(motion: Motion) -> Covariate:
    """Covariate of time: minutes since the first exposure."""
    return Covariate((motion.t - motion.t[0]) / 60, "time, min")


def temperature_covariate(values: Floats, part: str) -> Covariate:
    """Covariate of temperature: values (n,) or (n, axes) of a part in degrees Celsius."""
    return Covariate(values, f"temperature of {part}, °C")


QUADRATURE = "_quadrature"  # the cosine beside the sine of a sinusoid: stands for its phase
Node = dict[str, Any]  # {parameter: value} of the nonlinear ones: a number each, or several
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
    """{parameter: value} of an effect, from a grid node and coefficients (q,) of its linear columns."""
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
