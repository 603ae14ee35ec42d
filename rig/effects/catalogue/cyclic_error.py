"""Cyclic error of a screw or gear.

It repeats with every turn.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Candidate, Effect
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import (
    Context,
    ControllerTerm,
    Covariate,
    Node,
    Parameter,
    sine_and_cosine_columns_of_travel,
)
from rig.model.arm_hands_effect_places_and_tolerances import Place

FINE = 0.3  # step of a joint's orders, of what its travel resolves
ORDERS = 450.0  # cycles per turn of a joint; twice what a gear of 1 : 101 with four cycles per motor turn shows
SLOWEST = 0.5  # of them, and half a cycle over the joint's travel


@dataclass(frozen=True, slots=True)
class CyclicError(Effect):
    """Deviation amplitude * sin(2 pi order l / turn + phase), l the commanded value, turn the screw's lead or the
    joint's own turn.
    """

    place: str
    amplitude: float = 0.0
    phase: float = 0.0
    order: float = 1.0
    name: ClassVar = "cyclic_error"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis",)
    parameters: ClassVar = (
        Parameter("amplitude", "m", (0, 5e-4), (2e-6, 3e-5), joint=((0, 5e-2), (1e-5, 5e-4))),
        Parameter("phase", "rad", (-7, 7), (-3.1416, 3.1416), role="phase"),
        Parameter("order", "", (0.05, 20), (1, 2), role="even", joint=((0.05, 1e4), (1, ORDERS))),
    )
    experiment: ClassVar = "steps that are no whole part of the pitch, over several turns of one screw"
    joint_experiment: ClassVar = (
        "steps that are no whole part of a gear's or an encoder's turn, over the whole travel of that joint"
    )
    action: ClassVar = (
        "Look at the {axis}'s bearings, gear and coupling for run-out; a table of one turn in the controller "
        "takes it out."
    )
    form: ClassVar = "sinusoid"
    own_axis: ClassVar = 2
    whole_turns: ClassVar = True

    def angle(self, motion: Motion) -> Floats:
        """(n, axes) rad that the order multiplies; 0 at axes where it does not sit."""
        sits = self.axes(motion.places) > 0
        return 2 * np.pi * np.where(sits, motion.lengths, 0.0) / np.where(sits, motion.turn(), 1.0)

    def deviation(self, motion: Motion) -> Floats:
        return self.axes(motion.places) * self.amplitude * np.sin(self.order * self.angle(motion) + self.phase)

    def in_controller(self, motion: Motion) -> ControllerTerm:
        rate = 2 * np.pi * self.order / motion.turn()
        return ControllerTerm(
            tuple(
                f"d[{i}] += {self.amplitude!r} * sin({rate[i].item()!r} * c[{i}] + {self.phase!r});"
                for i in np.flatnonzero(self.axes(motion.places)).tolist()
            )
        )

    def covariate(self, motion: Motion) -> Covariate:
        return Covariate(self.order * self.angle(motion) / (2 * np.pi) % 1, "turn of the drive times order")

    @classmethod
    def columns_of_nodes(cls, candidate: Candidate, nodes: Sequence[Node], motion: Motion) -> Floats:
        effects, one = [cls(candidate.place, **node) for node in nodes], cls(candidate.place)
        own = one.axes(motion.places) > 0
        return sine_and_cosine_columns_of_travel(
            one.angle(motion), own, [e.order for e in effects], [e.phase for e in effects]
        )

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        found = super(CyclicError, cls).candidates(place, context)
        if Place.parse(place).kind != "joint":
            return found
        travel = max(np.ptp(context.moved().lengths[:, context.moved().places.index(place)]), 1e-6)
        spacing = FINE * 2 * np.pi / travel
        orders = spacing * np.arange(int(np.ceil(max(SLOWEST, np.pi / travel) / spacing)), int(ORDERS / spacing))
        return [replace(found[0], grid=[{"order": float(w)} for w in orders], spacing=spacing)] if len(orders) else []
