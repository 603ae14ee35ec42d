"""Columns of a table of markers that effects displace, and the table with some of them replaced."""

from dataclasses import replace
from typing import Any, Protocol, TypeVar, cast

from scipy.spatial.transform import RigidTransform

from rig.arrays import Booleans, Floats, Integers


class MarkerColumns(Protocol):
    """A dataclass of markers, a row each, as vision.targets has it.

    id : (m,); on_platform : (m,) bool; T_body_marker : RigidTransform (m,); side : (m,) m; target : m names; stage :
        (m,) number
    """

    @property
    def id(self) -> Integers: ...

    @property
    def on_platform(self) -> Booleans: ...

    @property
    def T_body_marker(self) -> RigidTransform: ...

    @property
    def side(self) -> Floats: ...

    @property
    def target(self) -> list[str]: ...

    @property
    def stage(self) -> Floats: ...


Markers = TypeVar("Markers", bound=MarkerColumns)


def replace_columns(markers: Markers, **columns: object) -> Markers:
    """The table of markers with some columns replaced."""
    return cast(Markers, replace(cast(Any, markers), **columns))  # a Protocol cannot say that it is a dataclass
