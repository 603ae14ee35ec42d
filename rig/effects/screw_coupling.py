"""A nut that turns with the platform's cardan drives its screw: twist of the joints becomes length."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.effects.base import Effect, Parameter
from rig.effects.kinetics import cardan_twist
from rig.errors import RigError


@dataclass(frozen=True, slots=True)
class ScrewCoupling(Effect):
    """Deviation gain * lead / 2 pi * twist of the platform-side cardan against the base-side one, less the twist at home."""

    place: str
    gain: float = 0.0
    name: ClassVar = "screw_coupling"
    stage: ClassVar = "struts"
    places: ClassVar = ("rig", "strut")
    parameters: ClassVar = (Parameter("gain", "", (-1, 1), (0.1, 1)),)
    experiment: ClassVar = "turn the platform about its axis and tilt it, far out: the pose alone tells it"
    on_pose: ClassVar = True

    def deviation(self, motion):
        if motion.actuator.screw_lead is None or motion.actuator.joints is None:
            raise RigError("screw_coupling needs [actuator] screw_lead and joints in rig.toml")
        if motion.actuator.joints != "cardan-cardan":  # a ball turns freely: it cannot turn the nut
            return np.zeros(motion.lengths.shape)
        twist = cardan_twist(motion.T, motion.mechanism) - cardan_twist(motion.mechanism.home, motion.mechanism)
        return self.struts() * self.gain * motion.actuator.screw_lead / (2 * np.pi) * twist
