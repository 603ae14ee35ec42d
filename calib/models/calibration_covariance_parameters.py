"""Parameters of a machine that a calibration's covariance counts.

They are in its order, whatever the machine's kind.

How poses change with each, and which may change one at a time.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.models.arm import arm_error_model_and_instrument_observations as arms
from calib.models.arm.arm_identification_and_joint_profiles import independent_arm_parameter_mask
from calib.models.chain import chain_error_model_and_identification as chains
from calib.models.platform.platform_identification import PRIOR, inverse_strut_length_jacobian, pose_parameter_jacobian
from rig.array_and_json_types import Floats
from rig.model.mechanism_geometry_classes import Arm, Chain
from rig.model.mechanisms import arm_kinematics_limits_and_loads as arm_kinematics
from rig.model.mechanisms import mechanism_chain
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Commanded,
    Parallel,
    geometric_parameters,
    has_struts,
    mechanism_with_parameters,
    parameter_names,
    parameter_units_and_scales,
    require_parallel,
)

UNMEASURED = 1e-2  # rad, scatter of rotations that a calibration says nothing of: it holds them to no model


@dataclass(frozen=True, slots=True, eq=False)
class CovarianceParameters:
    """p parameters of a machine with a number of axes, counted as a calibration's covariance counts them.

    names, units : of each, "m" or "rad"; scale : (p,) m or rad of one count; tolerance : (p,) counts that each may be
    off by, 0 where held; zeros : index of each axis' zero, empty where the machine does not name these
    single : indices of others that may change one at a time; tool : indices of where the target sits on the hand
    jacobian : (values (n, axes), poses T (n,)) -> (n, 6, p) change of the pose's tangent on the right
    axis_jacobian : (values, poses) -> (n, 6, axes) of the same with the axes
    values : (p,) counts, the parameters as they are; 0 of arms and chains, whose parameters are changes
    with_values : (p,) counts -> the mechanism with these parameters
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    scale: Floats
    tolerance: Floats
    zeros: tuple[int, ...]
    single: tuple[int, ...]
    tool: tuple[int, ...]
    jacobian: Callable[[Floats, RigidTransform], Floats]
    axis_jacobian: Callable[[Floats, RigidTransform], Floats]
    values: Floats
    with_values: Callable[[Floats], Any]


def covariance_parameters(mechanism: Commanded) -> CovarianceParameters:
    """CovarianceParameters of a mechanism."""
    if isinstance(mechanism, Arm):
        return _of_arm(mechanism)
    return _of_chain(mechanism) if isinstance(mechanism, Chain) else _of_parallel(require_parallel(mechanism))


def pose_scatter_covariance(mechanism: Commanded, scatter: Floats, T_base_platform: RigidTransform) -> Floats:
    """Covariance (n, 6, 6) of poses (n,) by a calibration's scatter.

    It is of each axis of a parallel machine, (axes,) m or rad, else of the pose, (6,) m and rad, or (3,) m where no
    rotation was measured: rotations are then UNMEASURED.
    """
    if isinstance(mechanism, Arm | Chain):
        whole = np.r_[scatter, [UNMEASURED] * (6 - len(scatter))]
        return np.tile(np.diag(whole**2), (len(T_base_platform), 1, 1))
    spread = inverse_strut_length_jacobian(T_base_platform, require_parallel(mechanism)) * scatter
    return spread @ np.swapaxes(spread, 1, 2)


def _of_arm(arm: Arm) -> CovarianceParameters:
    units, names = arms.parameter_units(arm), arms.parameter_names(arm)
    tolerance = np.array([arms.PLAUSIBLE[unit] for unit in units]) * independent_arm_parameter_mask(arm, "pose")
    zeros = tuple(arms.joint_zero_indices(arm).tolist())
    tool = tuple(range(len(names))[arms.tool_parameter_slice(arm)])
    rows = range(6, 6 + 5 * len(arm.joints))
    return CovarianceParameters(
        names,
        units,
        np.ones(len(names)),
        tolerance,
        zeros,
        tuple(k for k in rows if tolerance[k] > 0 and k not in zeros),
        tool,
        lambda values, _: arms.parameter_jacobian(values, arm),
        lambda values, _: arm_kinematics.jacobian(values, arm),
        np.zeros(len(names)),
        lambda step: arms.arm_with_parameter_step(arm, step),
    )


def _of_chain(chain: Chain) -> CovarianceParameters:
    names, tolerance = chains.parameter_names(chain), chains.parameter_tolerances(chain)
    zeros: list[int] = []
    for stage, part in zip(chain.stages, chains.stage_parameter_slices(chain)):
        own = range(part.start, part.stop)
        zeros += (
            [part.start + k for k in arms.joint_zero_indices(stage).tolist()]
            if isinstance(stage, Arm)
            else list(own[-len(stage.axes) :])
        )
    return CovarianceParameters(
        names,
        chains.parameter_units(chain),
        np.ones(len(names)),
        tolerance,
        tuple(zeros),
        (),
        (),
        lambda values, _: chains.parameter_jacobian(values, chain),
        lambda values, _: mechanism_chain.jacobian(values, chain),
        np.zeros(len(names)),
        lambda step: chains.chain_with_parameter_step(chain, step),
    )


def _of_parallel(mechanism: Parallel) -> CovarianceParameters:
    names, (units, scale) = parameter_names(mechanism), parameter_units_and_scales(mechanism)
    struts, count = has_struts(mechanism), len(names)
    return CovarianceParameters(
        names,
        units,
        scale,
        np.full(count, PRIOR),
        tuple(range(count - len(mechanism.axes), count)) if struts else (),
        () if struts else tuple(range(count)),
        (),
        lambda _, T: pose_parameter_jacobian(T, mechanism),
        lambda _, T: inverse_strut_length_jacobian(T, mechanism),
        geometric_parameters(mechanism),
        lambda p: mechanism_with_parameters(mechanism, p),
    )
