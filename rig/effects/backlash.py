"""Lost motion: the strut follows its command only once the gap is taken up."""

from dataclasses import dataclass
from typing import ClassVar

from rig.effects.base import Effect, Parameter
from rig.effects.play import play


@dataclass(frozen=True, slots=True)
class Backlash(Effect):
    """Play operator of width gap on the length, over the whole path. Positive: a strut driven outward stays half a gap short."""

    place: str
    gap: float = 0.0
    name: ClassVar = "backlash"
    stage: ClassVar = "struts"
    places: ClassVar = ("strut",)
    parameters: ClassVar = (Parameter("gap", "m", (0, 1e-3), (5e-6, 2e-4), role="size"),)
    experiment: ClassVar = "a ladder of reversal amplitudes: every length approached from both sides"

    def deviation(self, motion):
        return self.struts() * (play(motion.path.lengths, self.gap / 2) - motion.path.lengths)[motion.path.at]
