"""Printing errors of markers (place, height, angle, side) as shared unknowns with priors.

Of each marker its place (x, y on its face), how far it stands off it (z), how it is turned, its side; and the side of
all together, because one printer's feed and one paper stretch them alike. How much of each there is, a recording tells:
vision/bundle/printing_error_estimation.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rig.array_and_json_types import Floats
from rig.model.places_and_tolerances import PLACES, SIDES
from rig.model.pose import exp, log
from vision.targets import MarkerMap

NAMES = ("x", "y", "z", "rx", "ry", "rz", "side")
KINDS = (
    slice(0, 2),
    slice(2, 3),
    slice(3, 6),
    slice(6, 7),
)  # of NAMES that vary equally: on the face, off it, turned, larger
SIDE = 6


@dataclass(frozen=True, slots=True)
class Printing:
    """place, lift, turn, side : standard deviations of printed markers' x and y, z, angles and side, as shares of what
    is tolerated; 0 for none.

    What is tolerated is PLACES.sigma (m) of a place, the same at the middle of its edges of an angle, SIDES.sigma of a
    side
    """

    place: float
    lift: float
    turn: float
    side: float

    def __str__(self) -> str:
        """In words, standard deviations."""
        um, kinds = self.place * PLACES.sigma * 1e6, []
        kinds += (
            [f"positions on their faces by {um:.1f} um"] * (self.place > 0)
            + [f"off their faces by {self.lift * PLACES.sigma * 1e6:.1f} um"] * (self.lift > 0)
            + [f"turned by {self.turn * PLACES.sigma * 1e6:.1f} um at their edges"] * (self.turn > 0)
        )
        return (
            ", ".join(kinds + [f"sides by {self.side * SIDES.sigma:.3%}"] * (self.side > 0))
            + " (standard deviations, estimated from this recording)"
        )

    @property
    def parts(self) -> list[int]:
        """Which of NAMES there are."""
        shares = (self.place, self.lift, self.turn, self.side)
        return [k for kind, share in zip(KINDS, shares) if share > 0 for k in range(len(NAMES))[kind]]

    def sigma(self, side: float) -> Floats:
        """(parts,) m, rad and shares: standard deviations of a marker of that side (m)."""
        m, rad = PLACES.sigma, 2 * PLACES.sigma / side
        full = np.array([self.place * m] * 2 + [self.lift * m] + [self.turn * rad] * 3 + [self.side * SIDES.sigma])
        return full[self.parts]


class Prints(NamedTuple):
    """Columns of the unknowns. parts : which of NAMES each marker has; rows : {row of the marker map: slice};
    together : slice of the side of all, empty where sides are as stated."""

    parts: list[int]
    rows: dict[int, slice]
    together: slice


NONE = Prints([], {}, slice(0, 0))


def apply_printing_errors(markers: MarkerMap, prints: Prints, step: Floats) -> MarkerMap:
    """The MarkerMap with a step (s,) of printing errors applied, m, rad and shares."""
    own, grown = np.zeros((len(markers.id), len(NAMES))), float(step[prints.together].sum())
    for row, columns in prints.rows.items():
        own[row, prints.parts] = step[columns]
        own[row, SIDE] += grown
    return replace(
        markers, T_body_marker=markers.T_body_marker * exp(own[:, :SIDE]), side=markers.side * np.exp(own[:, SIDE])
    )


def fill_printing_error_offsets(markers: MarkerMap, stated: MarkerMap, prints: Prints, offsets: Floats) -> None:
    """Fill offsets (s,) with the printing errors by which markers differ from the stated ones, m, rad and shares.

    Only each marker's whole side shows in images: of it the part that all have in common is what its prior and theirs
    make likeliest.
    """
    away = np.concatenate(
        [log(stated.T_body_marker.inv() * markers.T_body_marker), np.log(markers.side / stated.side)[:, None]], axis=1
    )
    rows = list(prints.rows)
    if prints.together.stop > prints.together.start:
        grown = away[rows, SIDE].sum() / (len(rows) + 1)
        offsets[prints.together] = grown
        away[:, SIDE] -= grown
    for row, columns in prints.rows.items():
        offsets[columns] = away[row, prints.parts]


def printing_jacobian(J: Floats, J_motion: Floats, corners_marker: Floats) -> Floats:
    """(n, 2, 7) Jacobian of corners to the printing errors NAMES.
    J : (n, 2, 3) to the corner in its marker's frame; J_motion : (n, 2, 6) to a motion; corners_marker : (n, 3) m
    """
    return np.concatenate([J_motion, J @ corners_marker[..., None]], axis=2)
