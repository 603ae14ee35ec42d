"""Base lean under weight.

What the machine stands on, a column or a floor, turns elastically under the weight that it carries.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from rig.array_and_json_types import Floats
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.first_order_lag_weighted_sum_and_curved_scale_laws import independent_load_column_indices
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import Context, Covariate, Parameter
from rig.errors import RigError
from rig.model.mechanisms.arm_kinematics_limits_and_loads import link_weight_base_moments
from rig.model.mechanisms.mechanism_kinds_and_kinematics import has_links

START = 1e-7  # rad/(N m) and rad per m/s^2, from which it is fitted
START_DEPTH = 0.1  # m


@dataclass(frozen=True, slots=True)
class BaseLean(Effect):
    """The base turns by the vector compliance * M, M the moment of what the platform weighs about the base's origin,
    and about a point `depth` below it: half a column's height where a moment bends it evenly.

    moments : where the weight of an arm's links is not stated, their masses and mass moments (kg and kg m, four for
    each link, along its frame) times the compliance, in place of compliance * M, as far as these are not stated with
    the platform
    """

    place: str
    compliance: float = 0.0
    moments: tuple[float, ...] = ()
    depth: float = 0.0
    name: ClassVar = "base_lean"
    stage: ClassVar = "structure"
    places: ClassVar = ("rig",)
    parameters: ClassVar = (
        Parameter("compliance", "rad/(N m)", (-1e-2, 1e-2), (1e-7, 1e-4)),
        Parameter("moments", "kg rad/(N m), kg m rad/(N m)", (-1.0, 1.0), (1e-7, 1e-2), 0),
        Parameter("depth", "m", (-20.0, 20.0), (0.1, 2.0), role="form"),
    )
    experiment: ClassVar = "the same poses with another payload, a tilt sensor on the base"
    action: ClassVar = "Brace what the machine stands on, or correct poses by the load that it carries."
    on_pose: ClassVar = True
    instrumented: ClassVar = True

    def needs(self, motion: Motion) -> str | None:
        if motion.kind.AXIS != "strut" and not has_links(motion.mechanism):
            return "takes an arm, or struts on a base plate"
        if self.moments:
            count = motion.links().shape[2]
            return None if len(self.moments) == count else f"takes {count} moments, not {len(self.moments)}"
        return motion.no_loads()

    def lean(self, motion: Motion) -> Floats:
        out = np.zeros((len(motion.t), 3))
        if self.compliance:
            out = out + self.compliance * _base_moment(motion)
        return out + _link_base_moments(motion) @ np.array(self.moments) if self.moments else out

    def deviation(self, motion: Motion) -> Floats:
        """Of struts, as what each one's length seems to lack at the pose."""
        ends = motion.kind.strut_ends(motion.poses(), motion.mechanism) if motion.kind.AXIS == "strut" else None
        if ends is None:
            return np.zeros(motion.lengths.shape)
        base, tips = ends
        turn, pivot = self._turn_and_pivot(motion)
        about = pivot[:, None]
        moved = np.swapaxes(turn.as_matrix() @ np.swapaxes(base - about, 1, 2), 1, 2) + about
        return np.linalg.norm(tips - base, axis=2) - np.linalg.norm(tips - moved, axis=2)

    def sway(self, motion: Motion) -> Floats:
        if motion.kind.AXIS == "strut":
            return np.zeros((len(motion.t), 6))
        turn, pivot = self._turn_and_pivot(motion)
        shift = turn.apply(motion.poses().translation - pivot) + pivot - motion.poses().translation
        return motion.tangents(np.concatenate([shift, turn.as_rotvec()], axis=1))

    def _turn_and_pivot(self, motion: Motion) -> tuple[Rotation, Floats]:
        """(turn (n,) of the base, (n, 3) m about which), in the frame of poses."""
        reason = self.needs(motion)
        if reason:
            raise RigError(f"{self.name} {reason}")
        down = motion.gravity_in_base() / np.linalg.norm(motion.gravity_in_base(), axis=1, keepdims=True)
        return Rotation.from_rotvec(self.lean(motion)), _base_origin(motion) + self.depth * down

    def covariate(self, motion: Motion) -> Covariate:
        return Covariate(np.linalg.norm(self.lean(motion), axis=1) * 1e3, "lean of the base, mrad")

    def fitted(self, parameter: Parameter) -> tuple[int | None, ...]:
        if parameter.name == "moments":
            return tuple(i for i, value in enumerate(self.moments) if value)
        return super(BaseLean, self).fitted(parameter) if getattr(self, parameter.name) else ()

    @classmethod
    def sites(cls, context: Context) -> tuple[str, ...]:
        raise RigError(
            "a base that leans is fitted where a [[tilt_sensor]] stands on it, and not searched for in poses"
        )


def lean_under_link_weight(motion: Motion) -> BaseLean | None:
    """Lean (BaseLean) of an arm's base under the weight of its links.

    As a fit begins.
    None where nothing shows it.

    Its terms are those that the recording's postures and payloads separate: the links' moments stand for all that the
    arm weighs, and the compliance is a term of its own where a payload varies.
    Raises RigError for a machine that is no arm
    """
    if not has_links(motion.mechanism):
        raise RigError("base_lean is fitted for arms")
    table = _link_base_moments(motion)
    retained = independent_load_column_indices((table - table.mean(axis=0)).reshape(-1, table.shape[2]))
    varies = motion.no_loads() is None and np.ptp(motion.payload()) > 0
    if not len(retained) and not varies:
        return None
    moments = np.zeros(table.shape[2])
    moments[retained] = START
    return BaseLean("rig", START if varies else 0.0, tuple(moments.tolist()), START_DEPTH)


def _base_origin(motion: Motion) -> Floats:
    """(3,) m, where an arm's base stands in the frame of poses; its origin for other machines."""
    return motion.mechanism.base.translation if has_links(motion.mechanism) else np.zeros(3)


def _base_moment(motion: Motion) -> Floats:
    """(n, 3) N m of the weight of the platform and its payload about the base's origin, in the frame of poses.

    Raises RigError where the platform's mass or centre is not stated
    """
    reason = motion.no_loads()
    if reason:
        raise RigError(f"the model {reason}")
    R, wrench = motion.poses().rotation.as_matrix(), motion.platform_wrench().reshape(-1, 2, 3)
    force, moment = np.einsum("nij,nkj->kni", R, wrench)
    return np.cross(motion.poses().translation - _base_origin(motion), force) + moment


def _link_base_moments(motion: Motion) -> Floats:
    """(n, 3, c) N m of the weight of an arm's links about its base's origin, per kg and kg m of each, worked out once;
    c = 0 for other machines.
    """
    m = motion.mechanism
    if not has_links(m):
        return np.zeros((len(motion.t), 3, 0))
    return motion.once(("base moments",), lambda: link_weight_base_moments(motion.lengths, m, motion.gravity_in_base()))
