"""Struts grow with their temperature, which is logged."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.effects.base import REFERENCE_TEMPERATURE, Effect, Parameter


@dataclass(frozen=True, slots=True)
class ThermalExpansion(Effect):
    """Deviation coefficient * length * (T - 20 C), T the strut's own channel."""

    place: str
    coefficient: float = 0.0
    name: ClassVar = "thermal_expansion"
    stage: ClassVar = "struts"
    places: ClassVar = ("strut", "rig")
    parameters: ClassVar = (Parameter("coefficient", "1/K", (-1e-4, 1e-4), (9e-6, 2.4e-5)),)
    experiment: ClassVar = "heat the struts, or log their temperatures: without a log it is a warm-up"

    def deviation(self, motion):
        mask = self.struts()
        out = np.zeros(motion.lengths.shape)
        for i in np.flatnonzero(mask):
            warmer = motion.channel(f"strut{i + 1}_temperature_C") - REFERENCE_TEMPERATURE
            out[:, i] = self.coefficient * motion.lengths[:, i] * warmer
        return out
