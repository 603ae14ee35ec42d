"""Two faces were exchanged, or one glued on turned."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from rig.effects.base import Effect, Parameter
from rig.effects.sheet import moved
from rig.pose import exp


@dataclass(frozen=True, slots=True)
class MarkerSwap(Effect):
    """The marker sits where `other` should and the other way round (other < 0: with none), and is turned by quarter turns,
    counter-clockwise seen from outside."""

    place: str
    other: float = -1.0
    turn: float = 0.0
    name: ClassVar = "marker_swap"
    stage: ClassVar = "targets"
    places: ClassVar = ("marker",)
    parameters: ClassVar = (Parameter("other", "", (-1, 1e5), (0, 100)), Parameter("turn", "", (0, 3), (0, 3)))
    experiment: ClassVar = "look at the cube"

    def attach(self, markers):
        number = int(self.place.split(" ")[1])
        ids = markers.id.copy()
        if self.other >= 0:
            a, b = markers.id == number, markers.id == int(self.other)
            ids[a], ids[b] = int(self.other), number
        rows = ids == number
        spin = exp(np.r_[np.zeros(5), int(self.turn) * np.pi / 2])
        return replace(markers, id=ids, T_body_marker=moved(markers.T_body_marker, rows, lambda T: T * spin))
