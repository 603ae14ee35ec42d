"""Friction and springs in a strut: nested loops that do not saturate at one gap."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.effects.base import Effect, Parameter
from rig.effects.play import play

PLAYS = 8  # operators that stand for the continuum


@dataclass(frozen=True, slots=True)
class Hysteresis(Effect):
    """Prandtl-Ishlinskii: weight times the mean lag of plays whose half widths are spread evenly up to range."""

    place: str
    range: float = 5e-3
    weight: float = 0.0
    name: ClassVar = "hysteresis"
    stage: ClassVar = "struts"
    places: ClassVar = ("strut",)
    parameters: ClassVar = (Parameter("range", "m", (1e-5, 0.1), (1e-3, 2e-2), role="log"), Parameter("weight", "", (0, 1), (1e-3, 1e-2)))
    experiment: ClassVar = "reversals of growing amplitude: a backlash saturates at its gap, nested loops keep widening"

    def deviation(self, motion):
        path = motion.path.lengths
        halves = self.range * (np.arange(PLAYS) + 0.5) / PLAYS
        lag = np.mean([play(path, half) - path for half in halves], axis=0)
        return self.struts() * self.weight * lag[motion.path.at]
