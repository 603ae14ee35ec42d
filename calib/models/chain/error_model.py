"""Error model of a chain: parameters of its stages, their Jacobian, and least-squares equations by stage.

Parameters stand in one vector, stage after stage, as changes from the owner's figures: of a hexapod its 42, of two
struts their 6, of an arm base, rows and tool in the order of calib.models.arm.error_model_and_observations. tangent =
sum over stages of Ad(T_k+1 .. T_n)^-1 J_k dp_k.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.identify.least_squares_and_robust_fit import Linear, excess_scatter
from calib.models.arm import error_model_and_observations as arms
from calib.models.arm.error_model_and_observations import PLAUSIBLE
from calib.models.arm.identification_and_joint_profiles import independent_arm_parameters as independent
from calib.models.platform.determined_parameters_and_stated_geometry_tolerance import base_motion_columns
from calib.models.platform.identification import PRIOR, pose_parameter_jacobian
from calib.samples.pose_samples import Samples
from rig.array_and_json_types import Booleans, Floats
from rig.model.mechanism_geometry_classes import Arm, Chain, Stage
from rig.model.mechanisms import mechanism_chain as mechanism
from rig.model.mechanisms.mechanism_kinds_and_kinematics import NAMES, geometric_parameters, mechanism_with_parameters
from rig.model.pose import pose_difference


def parameter_names(chain: Chain) -> tuple[str, ...]:
    """Names of a chain's parameters, in order: "stage 1 base x" .., "stage 2 base joint 1 x" .."""
    return tuple(
        f"stage {k + 1} {name}" for k, stage in enumerate(chain.stages) for name in _stage_parameter_names(stage)
    )


def _stage_parameter_names(stage: Stage) -> tuple[str, ...]:
    return arms.parameter_names(stage) if isinstance(stage, Arm) else NAMES[stage.kind]


def parameter_units(chain: Chain) -> tuple[str, ...]:
    """Unit of each parameter, "m" or "rad"."""
    return tuple(
        unit
        for stage in chain.stages
        for unit in (
            arms.parameter_units(stage) if isinstance(stage, Arm) else ("m",) * len(_stage_parameter_names(stage))
        )
    )


def parameter_tolerances(chain: Chain) -> Floats:
    """Tolerances (p,) m and rad of the stated parameters; 0 for those that are not independent (Hayati)."""
    out = []
    for stage in chain.stages:
        if isinstance(stage, Arm):
            out.append(np.array([PLAUSIBLE[unit] for unit in arms.parameter_units(stage)]) * independent(stage, "pose"))
        else:
            out.append(np.full(len(_stage_parameter_names(stage)), PRIOR))
    return np.concatenate(out)


def stage_parameter_slices(chain: Chain) -> list[slice]:
    """Slice of the parameters of each stage."""
    sizes = [len(_stage_parameter_names(stage)) for stage in chain.stages]
    ends = np.cumsum(sizes)
    return [slice(int(end - size), int(end)) for size, end in zip(sizes, ends)]


def chain_with_parameter_step(chain: Chain, step: Floats) -> Chain:
    """Chain with its parameters changed by a step (p,) m and rad."""
    return replace(
        chain,
        stages=tuple(_moved(stage, step[part]) for stage, part in zip(chain.stages, stage_parameter_slices(chain))),
    )


def _moved(stage: Stage, step: Floats) -> Stage:
    return (
        arms.arm_with_parameter_step(stage, step)
        if isinstance(stage, Arm)
        else mechanism_with_parameters(stage, geometric_parameters(stage) + step)
    )


def stage_parameter_change_by_base_motion(stage: Stage) -> Floats:
    """Columns (p, 6 or 3) of a stage's base motion: change of its parameters with its base frame."""
    return np.eye(len(_stage_parameter_names(stage)), 6) if isinstance(stage, Arm) else base_motion_columns(stage)


def parameter_jacobian(values: Floats, chain: Chain, last_stage: int | None = None) -> Floats:
    """Parameter Jacobian (n, 6, p): change of the last platform's pose (m, rad) at values (n, axes).

    last_stage : number (from 1) of the stage whose platform is meant in the place of the last; what is above it does
        not move it
    """
    poses = mechanism.stage_transforms(values, chain)[:last_stage]
    own = np.concatenate(
        [
            back @ _own(own, T, stage)
            for (stage, own), T, back in zip(
                mechanism.stages_and_values(values, chain), poses, mechanism.stage_tangent_maps(poses)
            )
        ],
        axis=-1,
    )
    return np.pad(own, ((0, 0), (0, 0), (0, len(parameter_names(chain)) - own.shape[-1])))


def _own(values: Floats, T: RigidTransform, stage: Stage) -> Floats:
    return arms.parameter_jacobian(values, stage) if isinstance(stage, Arm) else pose_parameter_jacobian(T, stage)


# share of the squares that a fit is taken to have followed: where it followed all, nothing is left to tell scatter by
MOST = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredStage:
    """What was measured of one stage: values (m, axes) effective; T (m,); covariance (m, 6, 6); common (m, 6, k);
    stage : None for the last.
    """

    values: Floats
    T: RigidTransform
    covariance: Floats
    common: Floats
    stage: int | None

    def linear(self, chain: Chain, white: Floats, free: Booleans) -> tuple[Floats, Floats, Floats]:
        """(residual, jacobian, common) as in Linear, at a chain. white : (m, 6, 6); free : (p,) bool"""
        stands = mechanism.stage_poses(self.values, chain)[-1 if self.stage is None else self.stage - 1]
        left = pose_difference(stands, self.T)
        J = parameter_jacobian(self.values, chain, self.stage)[..., free]
        return (white @ left[..., None])[..., 0], white @ J, white @ self.common

    def scatter(self, white: Floats, residual: Floats, inliers: Booleans, hat: Floats) -> Floats:
        """(6,) m and rad of its scatter beyond the instrument's own. residual : (m, 6) whitened; hat : (m, 6, 6) of the
        fit, whitened
        """
        if not inliers.any():
            return np.zeros(6)
        half = np.linalg.inv(white[inliers])
        left = (half @ residual[inliers][..., None])[..., 0]
        gone, whole = (np.einsum("nij,njk,nik->i", half, H, half) for H in (hat[inliers], np.eye(6)[None]))
        share = np.minimum(gone.reshape(2, 3).sum(axis=1) / whole.reshape(2, 3).sum(axis=1), MOST)
        return excess_scatter(left, self.covariance[inliers], share)


def measured_stages(samples: Samples) -> list[MeasuredStage]:
    """Measured stages of a chain: the last platform, and those below it of which some pose was measured."""
    last = MeasuredStage(samples.effective, samples.T_base_platform, samples.covariance, samples.common, None)
    return [
        last,
        *(
            MeasuredStage(
                samples.effective[b.seen], b.T_base_stage[b.seen], b.covariance[b.seen], b.common[b.seen], b.stage
            )
            for b in samples.below
            if b.seen.any()
        ),
    ]


def noise_leverage(linear: Linear, inliers: Booleans, sigma: Floats) -> Floats:
    """Leverage (n, 6, 6) of each pose's noise: the share of it that a fit follows.

    sigma : (k,) the prior of the parameters
    """
    A = np.concatenate([linear.common, linear.jacobian], axis=2)
    rows = A[inliers].reshape(-1, A.shape[2])
    prior = np.r_[np.ones(linear.common.shape[2]), 1 / sigma**2]
    return A @ np.linalg.solve(rows.T @ rows + np.diag(prior), np.swapaxes(A, 1, 2))
