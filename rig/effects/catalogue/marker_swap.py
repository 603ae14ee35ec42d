"""Marker swap: two faces' markers are exchanged.

Or one is glued on turned.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.parameters_covariates_and_marker_table import (
    Drawing,
    Markers,
    Parameter,
    markers_with_replaced_columns,
)
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.pose import displace_selected_poses, exp


@dataclass(frozen=True, slots=True)
class MarkerSwap(Effect):
    """The marker sits where `other` should and the other way round (other < 0: with none), and is turned by quarter
    turns, counter-clockwise seen from outside."""

    place: str
    other: float = -1.0
    turn: float = 0.0
    name: ClassVar = "marker_swap"
    stage: ClassVar = "targets"
    places: ClassVar = ("marker",)
    parameters: ClassVar = (
        Parameter("other", "", (-1, 1e5), (0, 100), role="choice"),
        Parameter("turn", "", (0, 3), (0, 3), role="choice"),
    )
    experiment: ClassVar = "look at the cube"
    action: ClassVar = "Correct the faces of that cube in rig.toml."
    discrete: ClassVar = True

    @classmethod
    def drawn(cls, place: str, drawing: Drawing, rng: np.random.Generator) -> "MarkerSwap":
        number = Place.parse(place).number
        target = next(target for target in drawing.design.targets if number in target.ids)
        if rng.random() < 0.5:
            return cls(place, other=float(rng.choice([i for i in target.ids if i != number])))
        return cls(place, turn=float(rng.integers(1, 4)))

    @classmethod
    def exchanges(cls, marker: Place, others: Sequence[Place]) -> list[Self]:
        turned = [cls(str(marker), turn=float(turn)) for turn in (1, 2, 3)]
        return turned + [
            cls(str(a), float(b.number), float(turn))
            for other in others
            for a, b in ((marker, other), (other, marker))
            for turn in range(4)
        ]

    def sites_touched(self) -> tuple[Place, ...]:
        other = (Place("marker", str(int(self.other))),) if self.other >= 0 else ()
        return (self.site, *other)

    def problem(self) -> str | None:
        return (
            None
            if self.other == int(self.other) and self.turn == int(self.turn)
            else "other and turn are whole numbers"
        )

    def attach(self, markers: Markers) -> Markers:
        a = np.flatnonzero(markers.id == self.site.number)
        b = np.flatnonzero(markers.id == int(self.other)) if self.other >= 0 else a
        order, both = (
            np.arange(len(markers.id)),
            min(len(a), len(b)),
        )  # a print of a cube that was put back turned has a row for each seat
        order[a[:both]], order[b[:both]] = b[:both], a[:both]
        spin = exp(np.r_[np.zeros(5), int(self.turn) * np.pi / 2])
        poses = displace_selected_poses(
            markers.T_body_marker[order], np.isin(np.arange(len(order)), a), lambda T: T * spin
        )
        return markers_with_replaced_columns(
            markers,
            T_body_marker=poses,
            on_platform=markers.on_platform[order],
            target=[markers.target[k] for k in order],
            stage=markers.stage[order],
        )
