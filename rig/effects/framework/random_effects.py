"""Effects of a plausible size drawn at random: what a simulator has to know of the rig and its recording."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from rig.effects.framework.machine_motion import Motion
from rig.effects.framework.parameter import Parameter
from rig.model.design import Camera, Design

EARLY, LATE = 0.1, 0.9  # shares of the exposures between which moments are drawn


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """design : Design; t : (n,) s, the exposures; motion : Motion of its commands, everything logged that can be
    displaced : (how a camera is to be looked through : Effect -> px RMS by which corners all over its image move), see
        synthetic.blind_cases
    """

    design: Design
    t: np.ndarray
    motion: Motion
    displaced: Callable[[Any, Camera], float]


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number as likely at every order of magnitude between two."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def draw_parameter(p: Parameter, drawing: Drawing, rng: np.random.Generator) -> float | tuple[float, ...]:
    """A parameter drawn over what rigs show."""
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
    """A parameter of one number drawn over what rigs show. Raises ValueError for one of several"""
    drawn = draw_parameter(p, drawing, rng)
    if isinstance(drawn, tuple):
        raise ValueError(f"{p.name} has {len(drawn)} numbers")
    return float(drawn)
