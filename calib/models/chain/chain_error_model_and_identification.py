"""Error model of a chain, and its identification.

Parameters and Jacobian of a chain of mechanisms; all stages are identified from measured poses.

Parameters stand in one vector, stage after stage, as changes from the owner's figures: of a hexapod its 42, of two
struts their 6, of an arm base, rows and tool in the order of
calib.models.arm.arm_error_model_and_instrument_observations. tangent = sum over stages of Ad(T_k+1 .. T_n)^-1 J_k
dp_k. What one stage does the next may undo: where a gantry's carriage holds the hexapod and where the hexapod's base
joints stand on it are one and the same to the last platform, until the carriage itself is measured. Combinations
without information in the poses stay as the owner's figures have them and are named.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.identify.bounded_and_robust_least_squares_fit import MOST as FEW
from calib.identify.bounded_and_robust_least_squares_fit import Linear, excess_scatter, fit_least_squares, robust_fit
from calib.models.arm import arm_error_model_and_instrument_observations as arms
from calib.models.arm.arm_error_model_and_instrument_observations import PLAUSIBLE
from calib.models.arm.arm_identification_and_joint_profiles import independent_arm_parameter_mask as independent
from calib.models.platform.determined_parameters_and_stated_geometry_tolerance import base_motion_columns
from calib.models.platform.platform_identification import PRIOR, pose_parameter_jacobian
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.errors import NotEnoughData, RigError
from rig.model.mechanism_geometry_classes import Arm, Chain, Stage
from rig.model.mechanisms import mechanism_chain as mechanism
from rig.model.mechanisms.mechanism_kinds_and_kinematics import geometric_parameters, mechanism_with_parameters
from rig.model.mechanisms.mechanism_kinds_and_kinematics import parameter_names as strut_parameter_names
from rig.model.pose import pose_difference


def parameter_names(chain: Chain) -> tuple[str, ...]:
    """Names of a chain's parameters, in order.

    "stage 1 base x" .., "stage 2 base joint 1 x".
    """
    return tuple(
        f"stage {k + 1} {name}" for k, stage in enumerate(chain.stages) for name in _stage_parameter_names(stage)
    )


def _stage_parameter_names(stage: Stage) -> tuple[str, ...]:
    return arms.parameter_names(stage) if isinstance(stage, Arm) else strut_parameter_names(stage)


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
    """Tolerances (p,) m and rad of the stated parameters.

    0 for those that are not independent (Hayati).
    """
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
    """Change (p, 6 or 3) of a stage's parameters by motion of its base frame."""
    return np.eye(len(_stage_parameter_names(stage)), 6) if isinstance(stage, Arm) else base_motion_columns(stage)


def parameter_jacobian(values: Floats, chain: Chain, last_stage: int | None = None) -> Floats:
    """Parameter Jacobian (n, 6, p).

    Change of the last platform's pose (m, rad) at values (n, axes).
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
    """Measured stages of a chain.

    The last platform, and those below it of which some pose was measured.
    """
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
    """Leverage (n, 6, 6) of each pose's noise.

    The share of it that a fit follows.
    sigma : (k,) the prior of the parameters
    """
    A = np.concatenate([linear.common, linear.jacobian], axis=2)
    rows = A[inliers].reshape(-1, A.shape[2])
    prior = np.r_[np.ones(linear.common.shape[2]), 1 / sigma**2]
    return A @ np.linalg.solve(rows.T @ rows + np.diag(prior), np.swapaxes(A, 1, 2))


ROUNDS = 4  # of weighing anew by what scatters beyond the instrument's own
SETTLED = 1e-3  # share by which the scatter may still change
DETERMINED = 0.25  # share of its plausible variance below which a combination is told: half of its size
NAMED = 0.25  # share of a combination's largest part from which a parameter is named
ALIKE = 0.05  # share of a combination that need not be the motion of a base
LISTED = 4  # parameters that a combination is told by
ENOUGH = 4  # numbers measured for each parameter, from which a robust start is taken
GATE = 8.0  # standard deviations, of poses that a robust start leaves out


@dataclass(frozen=True, slots=True, eq=False)
class UndeterminedParameters:
    """A combination that poses leave as stated. parameters : ((name, weight), ..) in plausible sizes, the largest
    first; stages : it spans
    left : of what is plausible, that remains uncertain (1: all); base_stages : (upper, lower) stage where it is the
    upper one's base that moves as a whole on the lower, so that the lower's own parameters do the same; None for
    anything else."""

    parameters: tuple[tuple[str, float], ...]
    stages: tuple[int, ...]
    left: float
    base_stages: tuple[int, int] | None = None

    def __str__(self) -> str:
        parts = ", ".join(f"{weight:+.2f} {name}" for name, weight in self.parameters)
        if len(self.stages) > 1:
            return f"{parts} (between stages {' and '.join(map(str, self.stages))})"
        return f"{parts} (within stage {self.stages[0]})"


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """What a fit of a chain found, p parameters in the order of `parameter_names`.

    chain : with the fitted geometry; step : (p,) m and rad from the owner's figures; covariance : (p, p), 0 for what is
        no freedom
    determined_by_stage : ((determined, asked), ..) combinations of each stage's own parameters, all others unknown as
    well; undetermined : (UndeterminedParameters, ..)
    scatter : (6,) m and rad of the last platform beyond the instrument's own; inliers : (n,) bool, its poses that agree
    below : ((stage, poses that agree, of), ..) of the stages that were measured beside it
    """

    chain: Chain
    step: Floats
    covariance: Floats
    determined_by_stage: tuple[tuple[int, int], ...]
    undetermined: tuple[UndeterminedParameters, ...]
    scatter: Floats
    inliers: Booleans
    below: tuple[tuple[int, int, int], ...] = ()

    def report(self) -> list[str]:
        """Lines for a reader, stage by stage, then what cannot be told apart."""
        lines = [
            f"stage {k + 1} ({stage.kind}): {determined} of {requested} combinations of its parameters are determined"
            for k, (stage, (determined, requested)) in enumerate(zip(self.chain.stages, self.determined_by_stage))
        ]
        lines += [f"stage {k}: {agree} of {of} of its own poses are used" for k, agree, of in self.below]
        for upper, lower in sorted({one.base_stages for one in self.undetermined if one.base_stages is not None}):
            count = sum(one.base_stages == (upper, lower) for one in self.undetermined)
            lines.append(
                f"{count} of 6 figures of the pose of stage {upper} on stage {lower} cannot be distinguished from "
                f"stage {lower}'s own: its "
                f"base moved as a whole, the last platform fixed; they remain as stated"
            )
        rest = [one for one in self.undetermined if one.base_stages is None]
        if rest:
            lines.append(f"{len(rest)} more combinations that no pose determines remain as stated:")
        return lines + [f"  {one}" for one in rest]


def identify_chain(samples: Samples, nominal: Chain) -> Identified:
    """Identified chain.

    The parameters that explain the poses, as near to the stated ones as these allow.
    samples : Samples of the last platform, and of stages below it
    nominal : where the fit starts and where its prior holds what the poses do not tell
    Raises NotEnoughData for fewer than 3 poses, RigError where the fit does not settle
    """
    sigma = parameter_tolerances(nominal)
    free = sigma > 0
    if len(samples) < 3:
        raise NotEnoughData(f"{len(samples)} poses do not determine a chain; minimum 3, better {int(free.sum())}")
    measured = measured_stages(samples)
    rows: list[Integers] = np.split(
        np.arange(sum(len(one.values) for one in measured)), np.cumsum([len(one.values) for one in measured])[:-1]
    )
    scatter = np.zeros((len(measured), 6))
    for _ in range(ROUNDS):
        white = [
            np.linalg.inv(np.linalg.cholesky(one.covariance + np.diag(own**2))) for one, own in zip(measured, scatter)
        ]

        def linearise(p: Floats, white: list[Floats] = white) -> Linear:
            step = np.zeros(len(sigma))
            step[free] = p
            parts = [one.linear(chain_with_parameter_step(nominal, step), W, free) for one, W in zip(measured, white)]
            return Linear(*(np.concatenate(column) for column in zip(*parts)))

        start = np.zeros(free.sum())
        try:
            found = fit_least_squares(linearise, start, start, sigma[free], robust=True)
        except RigError:  # wild poses may lead where no stage closes
            inliers = _agreeing(linearise(start), rows)
            if inliers.all():
                raise
            found = fit_least_squares(linearise, start, start, sigma[free], inliers=inliers, robust=True)
        hat = noise_leverage(linearise(found.parameters), found.inliers, sigma[free])
        recomputed = np.array(
            [
                one.scatter(W, found.residual[own], found.inliers[own], hat[own])
                for one, W, own in zip(measured, white, rows)
            ]
        )
        if np.allclose(recomputed, scatter, rtol=SETTLED, atol=1e-12):
            break
        scatter = recomputed
    step, covariance = np.zeros(len(sigma)), np.zeros((len(sigma), len(sigma)))
    step[free], covariance[np.ix_(free, free)] = found.parameters, found.covariance
    below = tuple(
        (one.stage, int(found.inliers[own].sum()), len(own))
        for one, own in zip(measured, rows)
        if one.stage is not None
    )
    return Identified(
        chain_with_parameter_step(nominal, step),
        step,
        covariance,
        _determined_by_stage(covariance, sigma, nominal),
        _undetermined(covariance, sigma, nominal),
        scatter[0],
        found.inliers[rows[0]],
        below,
    )


def _agreeing(linear: Linear, rows: list[Integers]) -> Booleans:
    """(n,) bool, poses that a robust fit of all parameters, linear about the owner's figures, does not find far off,
    from which a fit may start; all where poses are too few for that, or too many are far off. rows : of each body"""
    near = np.ones(len(linear.residual), bool)
    for own in rows:
        columns = np.concatenate([linear.common[own], linear.jacobian[own]], axis=2)
        if columns[..., 0].size < ENOUGH * columns.shape[2]:
            continue
        found = robust_fit([(linear.residual[own], columns)])
        agree = (np.abs(found.residual) < GATE * np.maximum(1.0, found.scale)).all(axis=1)
        near[own] = agree if (~agree).mean() <= FEW else True
    return near


def _determined_by_stage(covariance: Floats, sigma: Floats, chain: Chain) -> tuple[tuple[int, int], ...]:
    """(told, asked) combinations of each stage: those left with less than half of what is plausible."""
    out = []
    for part in stage_parameter_slices(chain):
        own = np.flatnonzero(sigma[part] > 0) + part.start
        left = np.linalg.eigvalsh(covariance[np.ix_(own, own)] / np.outer(sigma[own], sigma[own]))
        out.append((int((left < DETERMINED).sum()), len(own)))
    return tuple(out)


def _undetermined(covariance: Floats, sigma: Floats, chain: Chain) -> tuple[UndeterminedParameters, ...]:
    """The combinations of all parameters that keep more than half of what is plausible, the least told first."""
    free = np.flatnonzero(sigma > 0)
    values, vectors = np.linalg.eigh(covariance[np.ix_(free, free)] / np.outer(sigma[free], sigma[free]))
    names, out = parameter_names(chain), []
    stage = np.concatenate(
        [np.full(part.stop - part.start, k + 1) for k, part in enumerate(stage_parameter_slices(chain))]
    )[free]
    for i in np.argsort(-values):
        if values[i] <= DETERMINED:
            break
        v = vectors[:, i] * np.sign(vectors[np.argmax(np.abs(vectors[:, i])), i])
        order = np.argsort(-np.abs(v))
        strong = [j for j in order[:LISTED] if abs(v[j]) > NAMED * abs(v[order[0]])]
        spans = tuple(int(k) for k in np.unique(stage) if (v[stage == k] ** 2).sum() > 0.02)
        whole = np.zeros(len(sigma))
        whole[free] = v
        parameters = tuple((names[free[j]], float(v[j])) for j in strong)
        out.append(
            UndeterminedParameters(parameters, spans, float(np.sqrt(values[i])), _stands(whole, sigma, chain, spans))
        )
    return tuple(out)


def _stands(direction: Floats, sigma: Floats, chain: Chain, spans: tuple[int, ...]) -> tuple[int, int] | None:
    """(upper, lower) where a direction (p,) in plausible sizes moves the upper stage's base as a whole, and something
    below it; None elsewhere.
    """
    if len(spans) != 2 or spans[1] != spans[0] + 1:
        return None
    upper = stage_parameter_slices(chain)[spans[1] - 1]
    own = direction[upper]
    motions = (
        stage_parameter_change_by_base_motion(chain.stages[spans[1] - 1])
        / np.where(sigma[upper] > 0, sigma[upper], np.inf)[:, None]
    )
    left = own - motions @ np.linalg.lstsq(motions, own)[0]
    return (spans[1], spans[0]) if np.linalg.norm(left) < ALIKE * np.linalg.norm(own) else None
