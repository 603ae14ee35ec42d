"""Joint clearance: play of a loose joint.

It settles on one side or the other, as the axis pushes or pulls.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.catalogue.compliance import places_loaded_by_links_only
from rig.effects.framework.effect_base_class import Candidate, Effect
from rig.effects.framework.first_order_lag_weighted_sum_and_curved_scale_laws import independent_load_column_indices
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import Context, Covariate, Parameter, load_covariate
from rig.errors import RigError

NOTHING = 1e-9  # of the greatest load; less is rounding, and pushes to neither side
SIDES = 8  # exposures that must lie on either side


@dataclass(frozen=True, slots=True)
class JointClearance(Effect):
    """Deviation -gap / 2 * sign(f), f > 0 where the axis pushes. moment : where the weight of an arm's links is not
    stated, which of their masses and mass moments alone is taken to make f (from 0; see Compliance); none by default:
    what is stated"""

    place: str
    gap: float = 0.0
    moment: float = -np.inf
    name: ClassVar = "joint_clearance"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis",)
    parameters: ClassVar = (
        Parameter("gap", "m", (0, 1e-3), (5e-6, 1.2e-4), joint=((0, 5e-2), (2e-5, 1e-3))),
        Parameter("moment", "", (-np.inf, 1e3), (0, 20), role="choice"),
    )
    experiment: ClassVar = "poses or payloads in which that axis changes from pushing to pulling"
    action: ClassVar = "Preload or exchange that {axis}'s bearings; until then keep its load from changing sign."
    on_pose: ClassVar = True

    def needs(self, motion: Motion) -> str | None:
        if self.moment < 0:
            return motion.no_loads()
        count = motion.links().shape[2]
        return None if self.moment < count else f"takes a moment of 0 to {count - 1}, not {self.moment:g}"

    def deviation(self, motion: Motion) -> Floats:
        reason = self.needs(motion)
        if reason:
            raise RigError(f"{self.name} {reason}")
        load = self._load(motion)
        side = np.sign(load) * (np.abs(load) > NOTHING * np.abs(load).max(initial=0.0))
        return -self.axes(motion.places) * self.gap / 2 * side

    def covariate(self, motion: Motion) -> Covariate:
        return load_covariate(
            self._load(motion),
            motion,
            "{unit} (positive: the {axis} pushes)" if self.moment < 0 else "of one kg or kg m",
        )

    def _load(self, motion: Motion) -> Floats:
        return motion.loads() if self.moment < 0 else motion.links()[:, :, int(self.moment)]

    @classmethod
    def sites(cls, context: Context) -> tuple[str, ...]:
        return places_loaded_by_links_only(context) or super(JointClearance, cls).sites(context)

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        motion = context.moved()
        if not motion.no_loads():
            return [Candidate(cls, place, [{}], cls.linear(place))]
        table = motion.links()[:, motion.places.index(place)]
        turning = [
            i
            for i in independent_load_column_indices(table)
            if min((table[:, i] > 0).sum(), (table[:, i] < 0).sum()) >= SIDES
        ]
        return [Candidate(cls, place, [{"moment": float(i)} for i in turning], cls.linear(place))] if turning else []
