"""A strut's scale is off: s times the stroke from home."""

from dataclasses import dataclass
from typing import ClassVar

from rig.effects.base import Effect, Parameter


@dataclass(frozen=True, slots=True)
class ScaleError(Effect):
    """Deviation scale * q, q the length less the home length."""

    place: str
    scale: float = 0.0
    name: ClassVar = "scale_error"
    stage: ClassVar = "struts"
    places: ClassVar = ("strut",)
    parameters: ClassVar = (Parameter("scale", "", (-5e-3, 5e-3), (5e-5, 1e-3), signed=True),)
    experiment: ClassVar = "a certified length along the strut, or a target of certified size: all six scales equal look like a print scale"

    def deviation(self, motion):
        return self.struts() * self.scale * (motion.lengths - motion.home)
