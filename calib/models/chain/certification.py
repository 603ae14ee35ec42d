"""Certification of a chain's calibration: fit to all samples, errors from stretches held out in turn."""

from dataclasses import dataclass, replace

import numpy as np

from calib.certification.calibration import Calibration
from calib.certification.distinct_configurations import LEAST, configuration_numbers, mean_sample_per_configuration
from calib.certification.held_out_error_statistics import HeldErrors, held_out_error_statistics, standardised_residuals
from calib.certification.held_out_errors import HeldOut, compare_errors, errors_before_and_after_correction
from calib.certification.platform_certification import Progress, held_out_errors_by_fold, silent_progress
from calib.certification.workspace_claim import (
    DRAWS,
    PLACES,
    Claim,
    ConfigurationInformation,
    Workspace,
    claim_of_drawn_machines,
    claim_of_too_few_configurations,
)
from calib.correction.correction import AnyCorrection, Correction, commands_with_pose
from calib.models.arm.held_out_scatter import unexplained_scatter_sentences
from calib.models.chain import error_model
from calib.models.chain.identification import Identified, identify_chain
from calib.samples.pose_samples import Samples
from rig.arrays import Floats, Integers
from rig.model.mechanism_geometry import Chain
from rig.model.mechanisms import chain as mechanism
from rig.model.pose import pose_difference
from rig.planning.configuration_sets import FILL, sobol_configurations


@dataclass(frozen=True, slots=True, eq=False)
class Certified:
    """correction : Correction of all samples, every stage's; found : Identified; label : (n,) configuration of each
    sample
    held_out : HeldOut, whole stretches of configurations in turn, and left : HeldErrors of it, or None for too few of
        them"""

    correction: AnyCorrection
    found: Identified
    label: Integers
    held_out: HeldOut | None
    left: HeldErrors | None = None


def certify_chain(
    samples: Samples, nominal: Chain, rng: np.random.Generator, progress: Progress | None = None
) -> Certified:
    """Certified chain: all stages together. rng : numpy Generator, for the bootstrap

    Raises what `identify` raises
    """
    said = progress or silent_progress
    label = configuration_numbers(samples.commanded, mechanism.travel(nominal))
    said("fitting the geometry", 0, 1)
    found = identify_chain(samples, nominal)
    correction = _corrected(nominal, found)
    said("fitting the geometry", 1, 1)
    if label.max() + 1 < LEAST:
        return Certified(correction, found, label, None)
    before, after = held_out_errors_by_fold(
        samples, label, lambda some: [_corrected(nominal, identify_chain(some, nominal))], said
    )
    good = found.inliers
    agreed = samples.take(good)
    J = error_model.parameter_jacobian(agreed.commanded, found.chain)
    noise = agreed.covariance + np.diag(found.scatter**2)
    freed = standardised_residuals(
        errors_before_and_after_correction(correction, agreed)[1], J, found.covariance, noise, label[good]
    )
    left = held_out_error_statistics(freed, agreed, label[good])
    scatter = np.maximum(
        found.scatter, np.sqrt(np.repeat(left.shown(rng) / 3, 3))
    )  # what a model lacks a fit takes into itself
    return Certified(
        correction,
        replace(found, scatter=scatter),
        label,
        compare_errors(before, after, samples.total_covariance(), rng, label),
        left,
    )


def _corrected(nominal: Chain, found: Identified) -> AnyCorrection:
    parts: tuple[None, ...] = (None,) * len(nominal.axes)
    return Correction(nominal, found.chain, parts)


def chain_pose_covariance(calibration: Calibration, commands: Floats) -> Floats:
    """Covariance (n, 6, 6) of the corrected chain's pose at commands (n, axes) m or rad."""
    J = error_model.parameter_jacobian(commands, calibration.correction.fitted)
    return J @ calibration.covariance @ np.swapaxes(J, 1, 2) + np.diag(calibration.scatter**2)


def chain_workspace_claim(samples: Samples, certified: Certified, rng: np.random.Generator) -> Claim:
    """Claim of a certified chain over its workspace, each configuration once."""
    found, nominal = certified.found, certified.correction.nominal
    kept = samples.take(found.inliers)
    label = np.unique(certified.label[found.inliers], return_inverse=True)[1]
    each = mean_sample_per_configuration(kept, label, mechanism.jacobian(kept.commanded, nominal))
    words = f"the middle {FILL * 100:.0f} % of every travel, all axes free of each other"
    asked = int((error_model.parameter_tolerances(nominal) > 0).sum())
    told = ConfigurationInformation(
        len(each),
        asked - len(found.undetermined),
        asked - len(found.undetermined),
        asked,
        "what no pose tells stays as stated",
    )
    if len(each) < LEAST:
        return claim_of_too_few_configurations(told, words)
    values, T = commands_with_pose(sobol_configurations(mechanism.travel(nominal), PLACES, FILL), certified.correction)
    own = (
        (found.scatter**2).reshape(2, 3).sum(axis=1)
        if certified.left is None
        else certified.left.own_draws(0.0, DRAWS, rng)
    )
    workspace = Workspace(
        error_model.parameter_jacobian(values, found.chain),
        pose_difference(mechanism.forward(values, nominal), T),
        own,
        words,
    )
    draws = rng.multivariate_normal(np.zeros(len(found.covariance)), found.covariance, DRAWS, method="eigh")
    return replace(
        claim_of_drawn_machines(workspace, draws, each, told, rng),
        unexplained=unexplained_scatter_sentences(found.scatter, each.covariance),
    )
