"""A repeatable profile of a strut's own position: lead of the screw, gear, encoder."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.interpolate import CubicSpline

from rig.effects.base import Effect, Parameter


@dataclass(frozen=True, slots=True)
class TransmissionError(Effect):
    """Deviation: a natural cubic spline through profile (m), evenly spaced over the strut's range. rms tells its size."""

    place: str
    profile: tuple[float, ...] = (0.0, 0.0)
    name: ClassVar = "transmission_error"
    stage: ClassVar = "struts"
    places: ClassVar = ("strut",)
    parameters: ClassVar = (Parameter("profile", "m", (-1e-3, 1e-3), (5e-6, 5e-5), 0),)
    experiment: ClassVar = "the whole stroke of that strut in small steps, from both sides"

    @property
    def rms(self):
        """m, root mean square of the profile."""
        return float(np.sqrt(np.mean(np.square(self.profile))))

    def deviation(self, motion):
        out = np.zeros(motion.lengths.shape)
        for i in np.flatnonzero(self.struts()):
            low, high = motion.mechanism.strut_range[i]
            spline = CubicSpline(np.linspace(low, high, len(self.profile)), self.profile, bc_type="natural")
            out[:, i] = spline(np.clip(motion.lengths[:, i], low, high))  # beyond its ends a profile stays what it was there
        return out
