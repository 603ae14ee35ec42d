"""Mechanism kinds, and the kinematics of each.

Predicates and requirements of kinds, and the kinematics module of each kind with their common interface, axis names
and units.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.mechanism_geometry_classes import Arm, Chain, FileMechanism, Free, Hexapod, Planar2
from rig.model.mechanisms import arm_kinematics_limits_and_loads as arm
from rig.model.mechanisms import hexapod, mechanism_chain, two_strut_planar_mechanism
from rig.model.mechanisms import user_kinematics_file_mechanism as file_mechanism

if TYPE_CHECKING:
    from typing_extensions import TypeIs


Mechanism = Hexapod | Planar2 | FileMechanism | Arm | Chain | Free
Struts = Hexapod | Planar2  # what moves a platform, or a hinge, on struts
Parallel = Hexapod | Planar2 | FileMechanism  # each of whose axes follows from the pose by an equation of its own
Commanded = Hexapod | Planar2 | FileMechanism | Arm | Chain  # what has axes


def has_struts(mechanism: Mechanism) -> TypeIs[Struts]:
    """Whether a mechanism has struts that drive it as a whole."""
    return mechanism.strut_joints is not None


def is_parallel(mechanism: Mechanism) -> TypeIs[Parallel]:
    """Whether a mechanism is parallel.

    Each of its axes follows from the pose by an equation of its own.
    """
    return mechanism.closes_loops


def is_hexapod(mechanism: Mechanism) -> TypeIs[Hexapod]:
    """Whether a mechanism is a hexapod.

    Six struts or more between two plates, holding all six coordinates of a pose.
    """
    return mechanism.plates is not None


def has_links(mechanism: Mechanism) -> TypeIs[Arm]:
    """Whether a mechanism has links, one joint after the other."""
    return mechanism.link_rows is not None


def has_stages(mechanism: Mechanism) -> TypeIs[Chain]:
    """Whether a mechanism has stages, one upon the other."""
    return len(mechanism.stages) > 1


def has_axes(mechanism: Mechanism) -> TypeIs[Commanded]:
    """Whether a mechanism has axes to command, struts or joints."""
    return bool(mechanism.axes)


def require_hexapod(
    mechanism: Mechanism, refusal: str = "this requires a hexapod, not a mechanism of kind {kind!r}"
) -> Hexapod:
    """Require that a mechanism is a hexapod on six struts, and return it.

    Raises RigError for another kind, and for more struts.
    """
    platform = require_hexapod_or_redundant_hexapod(mechanism, refusal)
    if len(platform.axes) > 6:
        raise RigError(
            f"this is for six struts, and this platform has {len(platform.axes)}: docs/more-struts.md lists what "
            "works with more"
        )
    return platform


def require_hexapod_or_redundant_hexapod(
    mechanism: Mechanism, refusal: str = "this requires a hexapod, not a mechanism of kind {kind!r}"
) -> Hexapod:
    """Require that a mechanism is a hexapod on six struts or more, and return it.

    Raises RigError for another kind.
    """
    if not is_hexapod(mechanism):
        raise RigError(refusal.format(kind=mechanism.kind))
    return mechanism


def is_redundant(mechanism: Mechanism) -> TypeIs[Hexapod]:
    """Whether a mechanism is a redundant hexapod, on more than six struts."""
    return is_hexapod(mechanism) and len(mechanism.axes) > 6


def require_parallel(
    mechanism: Mechanism, refusal: str = "this requires a parallel mechanism, not one of kind {kind!r}"
) -> Parallel:
    """Require that a mechanism is parallel, and return it.

    Each of its axes follows from the pose.
    Raises RigError for another kind.
    """
    if not is_parallel(mechanism):
        raise RigError(refusal.format(kind=mechanism.kind))
    return mechanism


def require_arm(mechanism: Mechanism) -> Arm:
    """Require that a mechanism is an arm, and return it.

    Raises RigError for another kind.
    """
    if not has_links(mechanism):
        raise RigError(f"this requires an arm, not a mechanism of kind {mechanism.kind!r}")
    return mechanism


def require_chain(mechanism: Mechanism) -> Chain:
    """Require that a mechanism is a chain, and return it.

    Raises RigError for another kind.
    """
    if not has_stages(mechanism):
        raise RigError(f"this requires a chain of mechanisms, not a mechanism of kind {mechanism.kind!r}")
    return mechanism


def target_bodies(mechanism: Mechanism) -> tuple[str, ...]:
    """Names of the bodies of a mechanism that may carry targets.

    Platform, base, and a chain's lower stages.
    """
    return ("platform", "base", *mechanism.bodies)


def require_axes(mechanism: Mechanism) -> Commanded:
    """Require that a mechanism has axes to command, and return it.

    Raises RigError for a free body.
    """
    if not has_axes(mechanism):
        raise RigError("this requires a machine with axes, not a body that is moved by hand")
    return mechanism


K = TypeVar("K", bound=Hexapod | Planar2 | FileMechanism | Arm | Chain | Free)
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

    def signed_limit_excess(self, values: Floats, mechanism: M, /) -> Floats:
        """How far commanded values (..., axes) lie outside the travel: negative below, positive above, 0 inside."""
        ...

    def travel_ranges(self, mechanism: M, /) -> Floats:
        """(axes, 2) least and greatest value that can be commanded."""
        ...

    def home_values(self, mechanism: M, /) -> Floats:
        """(axes,) commanded values from which strokes count."""
        ...

    def axis_forces_and_torques(self, T: RigidTransform, values: Floats, mechanism: M, wrench: Floats, /) -> Floats:
        """(n, axes) force or torque that the axes exert, in the direction of growing values, to hold a wrench (n, 6) on
        the platform.
        """
        ...

    def link_weight_loads(self, T: RigidTransform, values: Floats, mechanism: M, gravity: Floats, /) -> Floats:
        """(n, axes, c) the same per unit of what the machine's own moving members weigh, c numbers of mass (kg) and
        mass moment (kg m); c = 0 where their weight is not borne by the axes."""
        ...

    def axis_deviation_and_sway_by_member_growth(
        self, T: RigidTransform, values: Floats, mechanism: M, share: Floats, /
    ) -> tuple[Floats, Floats]:
        """(deviation (n, axes), sway (n, 6)) of the machine whose axes' members have grown by shares (n, axes) of their
        length.
        """
        ...

    def inverse_kinematics_jacobian(self, T: RigidTransform, values: Floats, mechanism: M, /) -> Floats:
        """(n, axes, 6) change of the axes (m or rad) with the pose's tangent (m, rad) at poses T (n,), values (n,
        axes).
        """
        ...

    def jacobian_rows_by_axis(self, T: RigidTransform, values: Floats, mechanism: M, /) -> Floats:
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
    "planar2": two_strut_planar_mechanism,
    "arm": arm,
    "chain": mechanism_chain,
    "file": file_mechanism,
}
AXIS_UNITS = {"strut": "m", "slide": "m", "joint": "rad"}  # by what an axis is called


def kinematics_of(mechanism: K) -> MechanismKinematics[K]:
    """The kinematics module of a mechanism by its kind.

    Raises RigError for a kind without kinematics.
    """
    if mechanism.kind not in ALL:
        raise RigError(f"no kinematics for a mechanism of kind {mechanism.kind!r}; there are {', '.join(ALL)}")
    return ALL[mechanism.kind]


def axis_places(mechanism: Mechanism) -> tuple[Place, ...]:
    """Places of a mechanism's axes.

    They are strut 1 .., joint 1 .., slide 3, a chain's stage 2 strut 1.
    """
    if mechanism.bodies:
        return tuple(place for k, stage in enumerate(mechanism.stages) for place in _numbered(stage.axis_words, k + 1))
    return _numbered(mechanism.axis_words)


@cache
def _numbered(words: tuple[str, ...], stage: int = 0) -> tuple[Place, ...]:
    """The places of axes that are called so, counted from 1."""
    return tuple(Place(word, str(i + 1), stage) for i, word in enumerate(words))


def axis_place_texts(mechanism: Mechanism) -> tuple[str, ...]:
    """Texts of the places of a mechanism's axes.

    They are "strut 1" .., a chain's "stage 2 strut 1".
    """
    return _texts(axis_places(mechanism))


@cache
def _texts(places: tuple[Place, ...]) -> tuple[str, ...]:
    return tuple(map(str, places))


def travel_unit(mechanism: Mechanism) -> str:
    """Unit of the axes' travel, "m" or "rad".

    It is "rad or m" for an arm with both.
    """
    return " or ".join(dict.fromkeys(sorted(axis_units(mechanism), reverse=True)))


def axis_units(mechanism: Mechanism) -> tuple[str, ...]:
    """Unit of each axis of a mechanism, "m" or "rad".

    None for a free body.
    """
    return tuple(AXIS_UNITS[word] for word in mechanism.axis_words)


def with_followers(values: Floats, mechanism: Commanded) -> Floats:
    """Commanded values (..., axes) m or rad with those of followers as their leaders have them."""
    out, at = np.array(values, float), 0
    for stage in mechanism.stages:
        if has_links(stage):
            own = slice(at, at + len(stage.axes))
            out[..., own] = stage.with_followers(out[..., own])
        at += len(stage.axes)
    return out


def parameter_names(mechanism: Parallel) -> tuple[str, ...]:
    """Names of the geometric parameters of a parallel mechanism, in order."""
    if isinstance(mechanism, FileMechanism):
        return file_mechanism.parameter_names(mechanism)
    count = len(mechanism.axes)
    plates, axes = (("base", "platform"), "xyz") if isinstance(mechanism, Hexapod) else (("base",), "xy")
    return (
        *(f"{plate} joint {i + 1} {axis}" for plate in plates for i in range(count) for axis in axes),
        *(f"zero of strut {i + 1}" for i in range(count)),
    )


S = TypeVar("S", Hexapod, Planar2, FileMechanism, Hexapod | Planar2, Hexapod | Planar2 | FileMechanism)


def geometric_parameters(mechanism: Parallel) -> Floats:
    """Geometric parameters (p,) m.

    Joints and zeros in the order of `parameter_names`.

    Of a kinematics file its parameters less the owner's, each tolerance counted as `file_mechanism.SCALE`
    """
    if isinstance(mechanism, FileMechanism):
        return file_mechanism.scaled_parameters(mechanism)
    platform = mechanism.platform_joints.ravel() if isinstance(mechanism, Hexapod) else np.zeros(0)
    return np.concatenate([mechanism.base_joints.ravel(), platform, mechanism.strut_zeros])


def parameter_units_and_scales(mechanism: Parallel) -> tuple[tuple[str, ...], Floats]:
    """Units and scales of a parallel mechanism's parameters.

    Returns (units, "m" or "rad"; (p,) how much of it each of the geometric parameters counts)
    """
    if isinstance(mechanism, FileMechanism):
        return file_mechanism.parameter_units_and_scales(mechanism)
    count = len(parameter_names(mechanism))
    return ("m",) * count, np.ones(count)


def parameter_group_sizes(mechanism: Parallel) -> tuple[int, int]:
    """Sizes of the groups of parameters.

    How many are joints' coordinates and how many are zeros; a kinematics file has one group.
    """
    count = len(geometric_parameters(mechanism))
    return (count, 0) if isinstance(mechanism, FileMechanism) else (count - len(mechanism.axes), len(mechanism.axes))


def mechanism_with_parameters(mechanism: S, p: Floats) -> S:
    """The mechanism with parameters p (p,) m, as `geometric_parameters` has them."""
    if isinstance(mechanism, FileMechanism):
        return file_mechanism.with_scaled_parameters(mechanism, p)
    if isinstance(mechanism, Hexapod):
        base, platform, zeros = np.split(p, [3 * len(mechanism.axes), 6 * len(mechanism.axes)])
        return replace(
            mechanism, base_joints=base.reshape(-1, 3), platform_joints=platform.reshape(-1, 3), strut_zeros=zeros
        )
    return replace(mechanism, base_joints=p[:4].reshape(2, 2), strut_zeros=p[4:])


def strut_or_axis_jacobian_by_pose(T_base_platform: RigidTransform, mechanism: Parallel) -> Floats:
    """Jacobian (..., axes, 6) of the struts' lengths, or the axes, by the pose.

    In m/m and m/rad, by the poses' tangents on the right.
    """
    if isinstance(mechanism, FileMechanism):
        return file_mechanism.jacobian(T_base_platform, mechanism)
    if isinstance(mechanism, Hexapod):
        return hexapod.jacobian(T_base_platform, mechanism)
    return two_strut_planar_mechanism.jacobian(T_base_platform, mechanism)


def nearest_reachable_poses(T_base_platform: RigidTransform, mechanism: Mechanism) -> RigidTransform:
    """Nearest poses (...) to poses T_base_platform (...) that a mechanism's platform can reach."""
    if isinstance(mechanism, Planar2):
        return RigidTransform.from_translation(T_base_platform.translation * [1, 1, 0])
    if isinstance(mechanism, FileMechanism):
        return file_mechanism.nearest_reachable_poses_of_kinematics_file(T_base_platform, mechanism)
    return T_base_platform


def loop_closure_parameter_jacobian(T_base_platform: RigidTransform, mechanism: Parallel) -> Floats:
    """Loop closure Jacobian (..., axes, p).

    Change of zero - length with the parameters, at poses (...).
    """
    if isinstance(mechanism, FileMechanism):
        return file_mechanism.loop_closure_parameter_jacobian(T_base_platform, mechanism)
    if isinstance(mechanism, Planar2):
        return two_strut_planar_mechanism.two_strut_loop_jacobian(T_base_platform, mechanism)
    matrix = T_base_platform.as_matrix()
    R = matrix[..., :3, :3]
    struts = mechanism.platform_joints @ np.swapaxes(R, -1, -2) + matrix[..., None, :3, 3] - mechanism.base_joints
    u = struts / np.linalg.norm(struts, axis=-1, keepdims=True)
    count = len(mechanism.axes)
    D = np.zeros((*u.shape[:-2], count, 7 * count))
    turned = u @ R
    for i in range(count):
        D[..., i, 3 * i : 3 * i + 3] = u[..., i, :]
        D[..., i, 3 * (count + i) : 3 * (count + i) + 3] = -turned[..., i, :]
        D[..., i, 6 * count + i] = 1
    return D
