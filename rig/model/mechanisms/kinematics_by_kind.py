"""Kinematics module of each kind of mechanism, their common interface, axis names and units."""

from functools import cache
from typing import Any, Protocol, TypeVar

from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.model.mechanism_geometry_classes import Arm, Chain, Free, Hexapod, Planar2
from rig.model.mechanisms import arm, hexapod, mechanism_chain, two_strut_plane
from rig.model.places_and_tolerances import Place

K = TypeVar("K", bound=Hexapod | Planar2 | Arm | Chain | Free)
M = TypeVar("M", contravariant=True)  # the geometry of rig.model.design that a kind moves


class MechanismKinematics(Protocol[M]):
    """A kind of machine: n axes that are commanded (m or rad) move one body, the platform.

    AXIS : what an axis is called in a place ("strut", "joint"); UNIT : of its travel, "m" or "rad"
    An arm's prismatic joint is a "slide", its travel in m and its load in N: `rig.model.mechanisms.axis_places` and
    `axis_units` tell them axis by axis.
    A wrench is (force, moment) in N and N m on the platform's origin, in its axes; a tangent stands on the right (m,
    rad).
    """

    AXIS: str
    UNIT: str

    def forward(self, values: Floats, mechanism: M, guess: RigidTransform | None = None, /) -> RigidTransform:
        """T_base_platform (...) of commanded values (..., axes)."""
        ...

    def inverse(self, T_base_platform: RigidTransform, mechanism: M, /) -> Floats:
        """Commanded values (..., axes) that give poses T_base_platform (...)."""
        ...

    def limit_excess(self, values: Floats, mechanism: M, /) -> Floats:
        """How far commanded values (..., axes) lie outside the travel: negative below, positive above, 0 inside."""
        ...

    def travel_ranges(self, mechanism: M, /) -> Floats:
        """(axes, 2) least and greatest value that can be commanded."""
        ...

    def home_values(self, mechanism: M, /) -> Floats:
        """(axes,) commanded values from which strokes count."""
        ...

    def axis_loads(self, T: RigidTransform, values: Floats, mechanism: M, wrench: Floats, /) -> Floats:
        """(n, axes) force or torque that the axes exert, in the direction of growing values, to hold a wrench (n, 6) on
        the platform.
        """
        ...

    def link_weight_loads(self, T: RigidTransform, values: Floats, mechanism: M, gravity: Floats, /) -> Floats:
        """(n, axes, c) the same per unit of what the machine's own moving members weigh, c numbers of mass (kg) and
        mass moment (kg m); c = 0 where their weight is not borne by the axes."""
        ...

    def axis_deviation_and_sway_by_growth(
        self, T: RigidTransform, values: Floats, mechanism: M, share: Floats, /
    ) -> tuple[Floats, Floats]:
        """(deviation (n, axes), sway (n, 6)) of the machine whose axes' members have grown by shares (n, axes) of their
        length.
        """
        ...

    def axis_changes_by_pose(self, T: RigidTransform, values: Floats, mechanism: M, /) -> Floats:
        """(n, axes, 6) change of the axes (m or rad) with the pose's tangent (m, rad) at poses T (n,), values (n,
        axes).
        """
        ...

    def singularity_rows(self, T: RigidTransform, values: Floats, mechanism: M, /) -> Floats:
        """(n, axes, 6) a row for each axis, that coincide where the machine is singular, at poses T (n,), values
        (n, axes).
        """
        ...

    def link_points(self, values: Floats, mechanism: M, /) -> Floats | None:
        """(n, points, 3) m of the line along a machine's links, in the base frame; None for a machine without links."""
        ...

    def strut_ends(self, T: RigidTransform, mechanism: M, /) -> tuple[Floats, Floats] | None:
        """(base joints (axes, 3), platform joints (n, axes, 3)) m in the base frame; None for a machine that has no
        struts.
        """
        ...


ALL: dict[str, MechanismKinematics[Any]] = {
    "hexapod": hexapod,
    "planar2": two_strut_plane,
    "arm": arm,
    "chain": mechanism_chain,
}
AXIS_UNITS = {"strut": "m", "slide": "m", "joint": "rad"}  # by what an axis is called


def kinematics_of(mechanism: K) -> MechanismKinematics[K]:
    """The kinematics module of a mechanism by its kind. Raises RigError for a kind without kinematics."""
    if mechanism.kind not in ALL:
        raise RigError(f"no kinematics for a mechanism of kind {mechanism.kind!r}; there are {', '.join(ALL)}")
    return ALL[mechanism.kind]


def axis_places(mechanism: Hexapod | Planar2 | Arm | Chain | Free) -> tuple[Place, ...]:
    """Places of a mechanism's axes: strut 1 .., joint 1 .., slide 3, a chain's stage 2 strut 1."""
    if mechanism.bodies:
        return tuple(place for k, stage in enumerate(mechanism.stages) for place in _numbered(stage.axis_words, k + 1))
    return _numbered(mechanism.axis_words)


@cache
def _numbered(words: tuple[str, ...], stage: int = 0) -> tuple[Place, ...]:
    """The places of axes that are called so, counted from 1."""
    return tuple(Place(word, str(i + 1), stage) for i, word in enumerate(words))


def axis_place_texts(mechanism: Hexapod | Planar2 | Arm | Chain | Free) -> tuple[str, ...]:
    """Texts of the places of a mechanism's axes: "strut 1" .., a chain's "stage 2 strut 1"."""
    return _texts(axis_places(mechanism))


@cache
def _texts(places: tuple[Place, ...]) -> tuple[str, ...]:
    return tuple(map(str, places))


def travel_unit(mechanism: Hexapod | Planar2 | Arm | Chain | Free) -> str:
    """Unit of the axes' travel, "m" or "rad"; "rad or m" for an arm with both."""
    return " or ".join(dict.fromkeys(sorted(axis_units(mechanism), reverse=True)))


def axis_units(mechanism: Hexapod | Planar2 | Arm | Chain | Free) -> tuple[str, ...]:
    """Unit of each axis of a mechanism, "m" or "rad"; none for a free body."""
    return tuple(AXIS_UNITS[word] for word in mechanism.axis_words)
