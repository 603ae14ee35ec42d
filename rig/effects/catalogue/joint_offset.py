"""Joint offset of a cardan joint, between its two axes.

They do not meet: the strut's end moves as the joint turns; this is no zero offset.
"""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Candidate, Effect
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import (
    Context,
    Covariate,
    Drawing,
    Linear,
    Parameter,
    draw_scalar_parameter,
)
from rig.errors import RigError
from rig.model.mechanisms.hexapod import cardan_plate_axes
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_hexapod_or_redundant_hexapod

BALL = "cardan-ball"
CARDANS = {"cardan-cardan": (0.0, 1.0), BALL: (0.0,)}  # ends that have one, by [actuator] joints
STEP = 1e-7  # m, of the derivative: so small that the offset's square does not count


@dataclass(frozen=True, slots=True)
class JointOffset(Effect):
    """Deviation L - sqrt(a^2 + (p - offset)^2), less that at home: L the distance of the joints, a and p its parts
    along the cardan's first axis, which lies in the plate, and across it. The second axis stands off by offset along
    the strut and turns about the first alone. end : 0 at the base, 1 at the platform. By Pythagoras' theorem."""

    place: str
    offset: float = 0.0
    end: float = 0.0
    name: ClassVar = "joint_offset"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis",)
    parameters: ClassVar = (
        Parameter("offset", "m", (-5e-2, 5e-2), (1e-4, 1.5e-2), signed=True),
        Parameter("end", "", (0, 1), (0, 1), role="choice"),
    )
    experiment: ClassVar = "tilt and turn the platform far out: the strut's cardan must swing about its second axis"
    action: ClassVar = "Enter the offset in the kinematics, or exchange that cardan for one whose axes meet."
    on_pose: ClassVar = True
    cardans: ClassVar = tuple(CARDANS)

    def needs(self, motion: Motion) -> str | None:
        lacking = motion.no_cardans(self.cardans)
        if lacking or self.end in (ends := CARDANS[str(motion.actuator.joints)]):
            return lacking
        return f"takes a cardan at end {' or '.join(f'{e:g}' for e in ends)} of the strut"

    def deviation(self, motion: Motion) -> Floats:
        at_home = require_hexapod_or_redundant_hexapod(motion.mechanism).home
        excess, home = self._excess(motion, motion.poses()), self._excess(motion, at_home)
        return self.axes(motion.places) * (excess - home)

    def covariate(self, motion: Motion) -> Covariate:
        along, across = self._along_and_across(motion, motion.poses())
        return Covariate(np.degrees(np.arctan2(along, across)), "angle of the cardan about its second axis, degrees")

    def _excess(self, motion: Motion, T: RigidTransform) -> Floats:
        """(..., struts) m that the joints are farther apart than the strut is long."""
        along, across = self._along_and_across(motion, T)
        return np.hypot(along, across) - np.hypot(along, across - self.offset)

    def _along_and_across(self, motion: Motion, T: RigidTransform) -> tuple[Floats, Floats]:
        """((..., struts), (..., struts)) m, the strut along its cardan's first axis and across it, at poses T (...)."""
        reason = self.needs(motion)
        if reason:
            raise RigError(f"{self.name} {reason}")
        m = require_hexapod_or_redundant_hexapod(motion.mechanism)
        matrix = T.as_matrix()[..., None, :, :]
        R = matrix[..., :3, :3]
        strut = (R @ m.platform_joints[..., None])[..., 0] + matrix[..., :3, 3] - m.base_joints
        axes = (
            (R @ cardan_plate_axes(m.platform_joints)[..., None])[..., 0]
            if self.end
            else cardan_plate_axes(m.base_joints)
        )
        axes = axes / np.linalg.norm(axes, axis=-1, keepdims=True)
        along = np.einsum("...i,...i->...", strut, np.broadcast_to(axes, strut.shape))
        return along, np.linalg.norm(np.cross(strut, axes), axis=-1)

    @classmethod
    def drawn(cls, place: str, drawing: Drawing, rng: np.random.Generator) -> Self:
        offset = draw_scalar_parameter(cls.parameters[0], drawing, rng)
        return cls(place, offset, float(rng.choice(CARDANS[drawing.motion.actuator.joints or BALL])))

    @classmethod
    def linear(cls, place: str) -> list[Linear]:
        return [Linear("offset", None, STEP)]

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        ends = CARDANS[context.moved().actuator.joints or BALL]
        return [Candidate(cls, place, [{"end": end} for end in ends], cls.linear(place), extra=len(ends) - 1)]
