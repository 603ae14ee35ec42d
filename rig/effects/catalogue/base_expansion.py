"""Base expansion with temperature.

The base plate grows with the room's temperature, its joints move outward.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import REFERENCE_TEMPERATURE, Candidate, Effect
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import (
    Context,
    ControllerTerm,
    Covariate,
    Linear,
    Parameter,
    c_channel_expression,
    temperature_covariate,
)
from rig.errors import RigError

AMBIENT = "ambient_temperature_C"
STEP = 1e-8  # 1/K, so small that lengths are linear in it


@dataclass(frozen=True, slots=True)
class BaseExpansion(Effect):
    """Base joints times 1 + coefficient * (T_ambient - 20 C), as what each strut's length seems to lack at the pose.

    uneven : (2,) what the base grows by along x beyond that, and along y less; and the same along the diagonals
    """

    place: str
    coefficient: float = 0.0
    uneven: tuple[float, ...] = (0.0, 0.0)
    name: ClassVar = "base_expansion"
    stage: ClassVar = "structure"
    places: ClassVar = ("rig",)
    parameters: ClassVar = (
        Parameter("coefficient", "1/K", (-1e-3, 1e-3), (1e-5, 1e-4)),
        Parameter("uneven", "1/K", (-1e-3, 1e-3), (1e-6, 5e-5), 2, role="form"),
    )
    experiment: ClassVar = "the same poses in a cold and a warm room"
    action: ClassVar = "Keep the room's temperature, or correct the base joints by it."
    on_pose: ClassVar = True

    def needs(self, motion: Motion) -> str | None:
        if motion.kind.AXIS != "strut":
            return "takes struts on a base plate"
        return motion.no_channel(AMBIENT)

    def deviation(self, motion: Motion) -> Floats:
        warm = motion.channel(AMBIENT) - REFERENCE_TEMPERATURE
        ends = motion.kind.strut_ends(motion.poses(), motion.mechanism)
        if ends is None:
            raise RigError(f"{self.name} takes struts on a base plate")
        base, tips = ends
        moved = np.linalg.norm(tips - base - warm[:, None, None] * (base @ self.growth), axis=2)
        return np.linalg.norm(tips - base, axis=2) - moved

    @property
    def growth(self) -> Floats:
        """(3, 3) 1/K, symmetric: displacement of a base joint over its place."""
        along, across = self.uneven
        return self.coefficient * np.eye(3) + np.array([[along, across, 0.0], [across, -along, 0.0], [0.0, 0.0, 0.0]])

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        plain = cls.linear(place)
        own = [Linear("coefficient", None, STEP), *(Linear("uneven", k, STEP) for k in range(2))]
        return [Candidate(cls, place, [{}], plain), Candidate(cls, place, [{}], own, "uneven")]

    def in_controller(self, motion: Motion) -> ControllerTerm:
        rows = ", ".join("{" + ", ".join(map(repr, row)) + "}" for row in self.growth.tolist())
        return ControllerTerm(
            (
                "for (int i = 0; i < 6; i++) {",
                f"    static const double GROWTH[3][3] = {{{rows}}};",
                f"    const double warm = {c_channel_expression(AMBIENT)} - {REFERENCE_TEMPERATURE!r};",
                "    double before = 0.0, after = 0.0;",
                "    for (int k = 0; k < 3; k++) {",
                "        const double leg = tip[i][k] - BASE[i][k];",
                "        double grown = 0.0;",
                "        for (int j = 0; j < 3; j++) grown += GROWTH[k][j] * BASE[i][j];",
                "        before += leg * leg;",
                "        after += (leg - warm * grown) * (leg - warm * grown);",
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
