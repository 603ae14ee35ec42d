"""Base expansion: the base plate grows with the room's temperature, its joints move outward."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect import REFERENCE_TEMPERATURE, Effect
from rig.effects.framework.effect_parameters_and_covariates import (
    Context,
    ControllerTerm,
    Covariate,
    Parameter,
    controller_channel,
    temperature_covariate,
)
from rig.effects.framework.machine_motion_and_play import Motion
from rig.errors import RigError

AMBIENT = "ambient_temperature_C"


@dataclass(frozen=True, slots=True)
class BaseExpansion(Effect):
    """Base joints times 1 + coefficient * (T_ambient - 20 C), as what each strut's length seems to lack at the pose."""

    place: str
    coefficient: float = 0.0
    name: ClassVar = "base_expansion"
    stage: ClassVar = "structure"
    places: ClassVar = ("rig",)
    parameters: ClassVar = (Parameter("coefficient", "1/K", (-1e-3, 1e-3), (1e-5, 1e-4)),)
    experiment: ClassVar = "the same poses in a cold and a warm room"
    action: ClassVar = "Keep the room's temperature, or correct the base joints by it."
    on_pose: ClassVar = True

    def needs(self, motion: Motion) -> str | None:
        if motion.kind.AXIS != "strut":
            return "takes struts on a base plate"
        return motion.no_channel(AMBIENT)

    def deviation(self, motion: Motion) -> Floats:
        scale = 1 + self.coefficient * (motion.channel(AMBIENT) - REFERENCE_TEMPERATURE)
        ends = motion.kind.strut_ends(motion.posed(), motion.mechanism)
        if ends is None:
            raise RigError(f"{self.name} takes struts on a base plate")
        base, tips = ends
        moved = np.linalg.norm(tips - scale[:, None, None] * base, axis=2)
        return np.linalg.norm(tips - base, axis=2) - moved

    def in_controller(self, motion: Motion) -> ControllerTerm:
        return ControllerTerm(
            (
                "for (int i = 0; i < 6; i++) {",
                f"    const double scale = 1.0 + {self.coefficient!r} * ({controller_channel(AMBIENT)} - "
                f"{REFERENCE_TEMPERATURE!r});",
                "    double before = 0.0, after = 0.0;",
                "    for (int k = 0; k < 3; k++) {",
                "        before += (tip[i][k] - BASE[i][k]) * (tip[i][k] - BASE[i][k]);",
                "        after += (tip[i][k] - scale * BASE[i][k]) * (tip[i][k] - scale * BASE[i][k]);",
                "    }",
                "    d[i] += sqrt(before) - sqrt(after);",
                "}",
            ),
            channels=(AMBIENT,),
        )

    def covariate(self, motion: Motion) -> Covariate:
        return temperature_covariate(motion.channel(AMBIENT), "the room")

    @classmethod
    def follows(cls, place: str, context: Context) -> tuple[tuple[str, ...], ...]:
        return ((AMBIENT,),)
