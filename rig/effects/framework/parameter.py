"""Parameter of an effect: unit, bounds, usual size and role; its grid of values to search; random draws."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rig.arrays import Floats
from rig.effects.framework.machine_motion import Motion
from rig.effects.framework.place import Place
from rig.formats.number_parsing_and_rounding import quantity_text
from rig.model.design import Camera, Design

MOST_SHOWN = 3  # numbers of several

TURNED = {"m": "rad", "N/m": "N m/rad"}  # units of a strut's and of a joint's axis

FAR = 10.0  # times what rigs show, from which a size is said to be unusual

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Parameter:
    """name; unit; bounds : (low, high) that make sense, beyond any value that nature prefers; usual : (low, high) that
    rigs show
    size : numbers it has, 0 for any; signed : whether minus what is usual is as usual
    joint : (bounds, usual) at a joint, whose travel is rad, where these are not those of a strut

    role : how the effect depends on it, for those who search: "linear", "inverse" (its reciprocal enters linearly),
    "size" (nothing at zero, but not linear), "phase" (of a sinusoid that a linear parameter scales), "log" or "even" (a
    node's parameter, to be searched over `usual` on a scale of that kind), "moment" (a time, s from the recording's
    start), "frequency", "direction" (of which only the direction counts), "choice" (given or chosen, never fitted)
    """

    name: str
    unit: str
    bounds: Range
    usual: Range
    size: int = 1
    role: str = "linear"
    signed: bool = False
    joint: tuple[Range, Range] | None = None

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

    def said(self, value: float | tuple[float, ...]) -> str:
        """Its name and a value, in a unit that people read."""
        numbers = value if isinstance(value, tuple) else (value,)
        more = f", the first {MOST_SHOWN} of {len(numbers)}" if len(numbers) > MOST_SHOWN else ""
        return f"{self.name.replace('_', ' ')} {quantity_text(numbers[:MOST_SHOWN], self.unit)}{more}"


LOG_STEPS, EVEN_STEP = 14, 0.01  # values of a "log" parameter over its usual range; steps of an "even" one
SIZES = 16  # values of a "size" parameter over its usual range
EDGE = 4  # frames at either end that a moment leaves


def parameter_grid(p: Parameter, t: Floats) -> list[float]:
    """Grid of values of a parameter to be tried, by its role and usual size; t : (n,) s, the exposures."""
    low, high = p.usual
    if p.role in ("size", "log"):
        return np.geomspace(low, high, SIZES if p.role == "size" else LOG_STEPS).tolist()
    if p.role == "even":
        return np.arange(max(low * 0.3, p.bounds[0]), min(high * 2.5, p.bounds[1]), EVEN_STEP).tolist()
    return ((t[EDGE - 1 : -EDGE] + t[EDGE : len(t) - EDGE + 1]) / 2).tolist()


def derivative_step(p: Parameter) -> float:
    """Step of a parameter for its numerical derivative."""
    size = np.sqrt(p.usual[0] * p.usual[1]) if p.usual[0] > 0 else 1e-2 * max(map(abs, p.usual))
    return 1 / size if p.role == "inverse" else 0.1 * size


EARLY, LATE = 0.1, 0.9  # shares of the exposures between which moments are drawn


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """design : Design; t : (n,) s, the exposures; motion : Motion of its commands, everything logged that can be
    displaced : (how a camera is to be looked through : Effect -> px RMS by which corners all over its image move), see
        synthetic.blind_cases
    """

    design: Design
    t: Floats
    motion: Motion
    displaced: Callable[[Any, Camera], float]


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Log-uniform random number between low and high: every order of magnitude as likely."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def draw_parameter(p: Parameter, drawing: Drawing, rng: np.random.Generator) -> float | tuple[float, ...]:
    """Value of a parameter drawn at random over its usual range."""
    low, high = p.usual
    if p.role == "moment":
        return float(rng.uniform(*np.quantile(drawing.t, [EARLY, LATE])))
    if p.role in ("phase", "even"):
        return float(rng.uniform(low, high))
    size = log_uniform(rng, low, high)
    if p.size == 1:
        return float(rng.choice([-1, 1]) * size) if p.signed else size
    return tuple((size / np.sqrt(p.size) * rng.normal(size=p.size)).tolist())


def draw_number(p: Parameter, drawing: Drawing, rng: np.random.Generator) -> float:
    """Number of a scalar parameter drawn at random over its usual range. Raises ValueError for a vector."""
    drawn = draw_parameter(p, drawing, rng)
    if isinstance(drawn, tuple):
        raise ValueError(f"{p.name} has {len(drawn)} numbers")
    return float(drawn)
