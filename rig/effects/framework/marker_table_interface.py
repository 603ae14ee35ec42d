"""Interface of a table of markers, which effects change.

Identities, poses on bodies, sides.
"""

from dataclasses import replace
from typing import Any, Protocol, TypeVar, cast

from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats, Integers


class MarkerTable(Protocol):
    """A dataclass of markers, a row each, as vision.predict has it.

    id : (m,); on_platform : (m,) bool; T_body_marker : RigidTransform (m,); side : (m,) m; heights : (m, 4) m
        or (1, 4) for all alike; target : m names; stage : (m,) number
    """

    @property
    def id(self) -> Integers:
        """Identities as printed, (m,)."""

    @property
    def on_platform(self) -> Booleans:
        """Whether each moves, (m,) bool."""

    @property
    def T_body_marker(self) -> RigidTransform:
        """Poses on their bodies, (m,)."""

    @property
    def side(self) -> Floats:
        """Sides, (m,) m."""

    @property
    def heights(self) -> Floats:
        """How far their corners stand off their planes, (m, 4) m, or (1, 4) for all alike."""

    @property
    def target(self) -> list[str]:
        """Names of their targets, m."""

    @property
    def stage(self) -> Floats:
        """Numbers of their stages, (m,)."""


Markers = TypeVar("Markers", bound=MarkerTable)


def replace_marker_columns(markers: Markers, **columns: object) -> Markers:
    """The table of markers with some columns replaced."""
    return cast(Markers, replace(cast(Any, markers), **columns))  # a Protocol cannot say that it is a dataclass
