"""Correction of a chain over its configuration space.

It is certified on held-out configurations.

Summands are commands less the axis values nearest to them that give the measured pose, each axis in shares of its
travel: with more axes than freedoms the least that explain it. Source: configuration-space patent, [0026] to [0030],
[0130]
"""

from dataclasses import replace

import numpy as np

from calib.certification.claimed_error_reduction_over_workspace import mean_square_pose_errors_stated_by_extension
from calib.certification.configuration_space_correction_certification import (
    ExtensionBasis,
    ExtensionRequest,
    Tried,
    certify_interpolation_method,
)
from calib.certification.held_out_pose_error_statistics import mean_square_pose_errors_caused_by_parameters
from calib.certification.held_out_pose_errors_and_distinct_configurations import (
    configuration_numbers,
    time_block_folds_of_configurations,
)
from calib.certification.platform_certification import FOLDS, Progress, ignore_progress
from calib.correction.correction_tables import CorrectionSummands, correction_summands_by_nearest_axis_values
from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import Field, FieldSamples
from calib.correction.machine_correction import AnyCorrection, Correction
from calib.models.chain.chain_certification_and_page import CertifiedChain, chain_workspace_values_and_poses
from calib.models.chain.chain_error_model_and_identification import (
    Identified,
    identify_chain,
    measured_stages,
    parameter_jacobian,
    parameter_tolerances,
)
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Floats
from rig.model.mechanism_geometry_classes import Chain
from rig.model.mechanisms import mechanism_chain as mechanism
from rig.model.pose import pose_difference

TINY = 1e-100  # pose change per share of travel, in place of none: the variance of what no pose determines is vast
NEAR = 0.1  # of an axis' travel, by which the model may be off


def chain_correction_summands(samples: Samples, chain: Chain, covariance: Floats) -> CorrectionSummands:
    """Correction summands (n, axes) m or rad of a chain at samples.

    They are of its axes, nearest to none.
    covariance : (n, 6, 6) of the measured poses. Raises RigError as `correction_summands_by_nearest_axis_values`
    """

    def model(values: Floats) -> tuple[Floats, Floats]:
        left = pose_difference(mechanism.forward(values, chain), samples.T_base_platform)
        return left, mechanism.jacobian(values, chain)

    near = NEAR * np.ptp(mechanism.travel_ranges(chain), axis=1)
    return correction_summands_by_nearest_axis_values(samples.frame, samples.effective, model, covariance, near)


def chain_correction_summands_for_interpolation(samples: Samples, chain: Chain) -> FieldSamples:
    """Samples for a field of a chain's correction summands.

    What moves no pose adds nothing to their variances.
    """
    known, ranges = chain_correction_summands(samples, chain, samples.covariance), mechanism.travel_ranges(chain)
    span = np.ptp(ranges, axis=1)
    U, s, Vt = np.linalg.svd(mechanism.jacobian(samples.effective, chain) * span, full_matrices=False)
    back = span[:, None] * np.swapaxes(Vt, 1, 2) / np.maximum(s, TINY)[:, None] @ np.swapaxes(U, 1, 2)
    determined = np.einsum("nij,njk,nik->ni", back, samples.covariance, back)
    variances = np.minimum(determined, np.einsum("nii->ni", known.covariance))
    return FieldSamples(samples.commanded, known.values, variances, ranges)


def certify_chain_correction_extension(
    samples: Samples,
    nominal: Chain,
    request: ExtensionRequest,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> tuple[CertifiedChain, tuple[Tried, ...]]:
    """Certify a chain's correction extended over its configuration space, on held-out configurations.

    Returns (CertifiedChain, methods tried). Raises RigError where the way asked for does not take these samples, and
        what `identify_chain` raises
    """
    report = progress or ignore_progress
    label = configuration_numbers(samples.commanded, mechanism.travel_ranges(nominal))

    def geometry(some: Samples) -> Identified:
        return identified_chain_without_fit(some, nominal) if request.alone else identify_chain(some, nominal)

    report("fitting the geometry", 0, 1)
    found = geometry(samples)
    report("fitting the geometry", 1, 1)

    def stand(some: Samples) -> ExtensionBasis:
        chain = (found if some is samples else geometry(some)).chain
        return ExtensionBasis(
            chain_correction_summands_for_interpolation(some, chain),
            lambda field: _corrected(nominal, chain, field),
            lambda field, at: _mean_square_field_error(field, at, chain),
        )

    done, tried = certify_interpolation_method(samples, (nominal, label, found), stand, request.kind, rng, report)
    correction = _corrected(nominal, found.chain, done.correction.extension)
    if correction.extension is not None and not request.alone:  # what that corrects is no scatter
        known = -correction.rho(samples.commanded) + (0.0 if samples.known is None else samples.known)
        left_by_it = replace(samples, known=known)
        scatter = identify_chain(left_by_it, found.chain).scatter
        found = replace(found, scatter=scatter, covariance=_covariance(left_by_it, found.chain, nominal, scatter))
    if done.left is None:
        return CertifiedChain(correction, found, label, None), tried
    noise = samples.covariance + np.diag(found.scatter**2)
    absorbed = mean_square_pose_errors_caused_by_parameters(
        parameter_jacobian(samples.commanded, found.chain),
        found.covariance,
        noise,
        time_block_folds_of_configurations(label, min(FOLDS, label.max() + 1)),
    )
    left = replace(done.left, parameters=absorbed)
    values, _ = chain_workspace_values_and_poses(correction, samples.commanded)
    inside = np.ones(len(values), bool) if correction.extension is None else correction.extension.inside(values)
    values = values[inside] if inside.any() else values  # beyond the samples the extension states an error itself
    stated = mean_square_pose_errors_stated_by_extension(correction, values, mechanism.jacobian(values, found.chain))
    own = np.maximum(left.own(float(stated[0]), rng) - stated, 0.0)  # what no part of the correction states
    found = replace(found, scatter=np.maximum(found.scatter, np.sqrt(np.repeat(own / 3, 3))))
    return CertifiedChain(correction, found, label, done.held_out, left), tried


def rms_and_greatest_chain_single_step_error(correction: AnyCorrection, commanded: Floats) -> tuple[float, float]:
    """Position errors (RMS, greatest) m of a chain's correction in a single step.

    They are of position, as its axes have different units, over the places of `chain_workspace_values_and_poses`.
    commanded : (n, axes)
    The single step is X + KSF(X). Source: configuration-space patent, [0030], [0091]
    """
    _, wanted = chain_workspace_values_and_poses(correction, commanded)
    missed = pose_difference(correction.predict(correction.single_step(wanted)), wanted)
    off = np.linalg.norm(missed[:, :3], axis=1)
    return float(np.sqrt((off**2).mean())), float(off.max())


def _covariance(samples: Samples, fitted: Chain, nominal: Chain, scatter: Floats) -> Floats:
    """Covariance (p, p) of a fitted chain's parameters at a scatter (6,) of the last platform, linear about that chain:
    combinations without information, which are known to their tolerance alone, move no pose of it.
    """
    sigma = parameter_tolerances(nominal)
    free = sigma > 0
    rows = [np.eye(int(free.sum()))]  # in shares of the tolerances
    for one in measured_stages(samples):
        own = one.covariance + np.diag(scatter**2) * (one.stage is None) + one.common @ np.swapaxes(one.common, 1, 2)
        J = one.linear(fitted, np.linalg.inv(np.linalg.cholesky(own)), free)[1] * sigma[free]
        rows.append(J.reshape(-1, J.shape[-1]))
    root = sigma[free, None] * np.linalg.inv(np.linalg.qr(np.concatenate(rows), mode="r"))
    covariance = np.zeros((len(sigma), len(sigma)))
    covariance[np.ix_(free, free)] = root @ root.T
    return covariance


def identified_chain_without_fit(samples: Samples, nominal: Chain) -> Identified:
    """Unfitted chain (Identified).

    Nothing is fitted, the chain is as it is.
    """
    count = parameter_jacobian(samples.commanded[:1], nominal).shape[-1]
    every = np.ones(len(samples), bool)
    return Identified(nominal, np.zeros(count), np.zeros((count, count)), (), (), np.zeros(6), every)


def _corrected(nominal: Chain, fitted: Chain, field: Field | None) -> AnyCorrection:
    parts: tuple[None, ...] = (None,) * len(nominal.axes)
    return Correction(nominal, fitted, parts, extension=field)


def _mean_square_field_error(field: Field, samples: Samples, chain: Chain) -> float:
    """m^2, mean square by which a Field says that positions of samples may be off."""
    J = mechanism.jacobian(samples.commanded, chain)[:, :3]
    return float((J**2 @ (field.error(samples.commanded) ** 2)[..., None]).sum(axis=1).mean())
