"""Certification of a chain's calibration, and its page.

By held-out stretches; the page is HTML.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.claimed_error_reduction_over_workspace import (
    DRAWS,
    PLACES,
    Claim,
    ConfigurationInformation,
    Workspace,
    claim_from_machine_draws,
    empty_claim_of_too_few_configurations,
    mean_square_pose_errors_stated_by_extension,
)
from calib.certification.configuration_space_correction_certification import empty_claim_without_held_out_data
from calib.certification.held_out_pose_error_statistics import (
    HeldErrors,
    HeldOut,
    compare_errors,
    errors_before_and_after_correction,
    mean_square_held_out_errors_by_configuration,
    residuals_corrected_for_absorbed_noise,
)
from calib.certification.held_out_pose_errors_and_distinct_configurations import (
    LEAST,
    configuration_numbers,
    mean_sample_per_configuration,
)
from calib.certification.platform_certification import (
    Progress,
    held_out_errors_before_and_after_corrections,
    ignore_progress,
)
from calib.correction.machine_correction import AnyCorrection, Correction, solvable_commands_and_poses
from calib.models.arm.joint_effect_fit_and_held_out_scatter import unexplained_scatter_sentences
from calib.models.chain import chain_error_model_and_identification
from calib.models.chain.chain_error_model_and_identification import Identified, identify_chain
from calib.report.platform_and_lens_calibration_pages import (
    evidence_html,
    view_3d_html,
    write_calibration_page_from_parts,
)
from calib.report.pose_and_effect_figures import FITTED, correction_error_figures, pose_coverage_figures
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Floats, Integers
from rig.model.mechanism_geometry_classes import Chain
from rig.model.mechanisms import mechanism_chain as mechanism
from rig.model.pose import pose_difference, pose_to_vector
from rig.planning.configuration_generators import FILL, sobol_configurations
from rig.recording.recording_folder import Recording
from rig.report.pages.html_and_svg_elements import (
    collapsible_section_html,
    heading_html,
    paragraph_html,
    section_html,
    table_html,
)
from rig.report.pages.page_templates_and_index_page import Link


@dataclass(frozen=True, slots=True, eq=False)
class CertifiedChain:
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
) -> CertifiedChain:
    """CertifiedChain of a chain.

    All stages together.
    rng : numpy Generator, for the bootstrap
    Raises what `identify_chain` raises
    """
    report = progress or ignore_progress
    label = configuration_numbers(samples.commanded, mechanism.travel_ranges(nominal))
    report("fitting the geometry", 0, 1)
    found = identify_chain(samples, nominal)
    correction = _corrected(nominal, found)
    report("fitting the geometry", 1, 1)
    if label.max() + 1 < LEAST:
        return CertifiedChain(correction, found, label, None)
    before, after = held_out_errors_before_and_after_corrections(
        samples, label, lambda some: [_corrected(nominal, identify_chain(some, nominal))], report
    )
    good = found.inliers
    agreed = samples.take(good)
    J = chain_error_model_and_identification.parameter_jacobian(agreed.commanded, found.chain)
    noise = agreed.covariance + np.diag(found.scatter**2)
    freed = residuals_corrected_for_absorbed_noise(
        errors_before_and_after_correction(correction, agreed)[1], J, found.covariance, noise, label[good]
    )
    left = mean_square_held_out_errors_by_configuration(freed, agreed, label[good])
    scatter = np.maximum(
        found.scatter, np.sqrt(np.repeat(left.shown(rng) / 3, 3))
    )  # what a model lacks a fit takes into itself
    return CertifiedChain(
        correction,
        replace(found, scatter=scatter),
        label,
        compare_errors(before, after, samples.total_covariance(), rng, label),
        left,
    )


def _corrected(nominal: Chain, found: Identified) -> AnyCorrection:
    parts: tuple[None, ...] = (None,) * len(nominal.axes)
    return Correction(nominal, found.chain, parts)


def corrected_chain_pose_covariance(calibration: Calibration, commands: Floats) -> Floats:
    """Covariance (n, 6, 6) of the corrected chain's pose at commands (n, axes) m or rad."""
    correction = calibration.correction
    J = chain_error_model_and_identification.parameter_jacobian(commands, correction.fitted)
    covariance = J @ calibration.covariance @ np.swapaxes(J, 1, 2) + np.diag(calibration.scatter**2)
    if correction.posed:
        covariance = covariance + correction.pose_map_covariance(correction.predict(commands))
    if correction.extension is None:
        return covariance
    axes = mechanism.jacobian(commands, correction.fitted)
    return covariance + (axes * correction.extension.error(commands)[:, None] ** 2) @ np.swapaxes(axes, 1, 2)


def chain_workspace_values_and_poses(correction: AnyCorrection, commanded: Floats) -> tuple[Floats, RigidTransform]:
    """Values (n, axes) m or rad over a chain's workspace, and their poses (n,).

    They are over the middle of every travel, all axes independent; where a correction is extended, over the middle of
    what was commanded (m, axes).
    """
    ranges = mechanism.travel_ranges(correction.nominal)
    if correction.is_extended:
        ranges = np.stack([commanded.min(axis=0), commanded.max(axis=0)], axis=1)
    return solvable_commands_and_poses(sobol_configurations(ranges, PLACES, FILL), correction)


def chain_workspace_claim(samples: Samples, certified: CertifiedChain, rng: np.random.Generator) -> Claim:
    """Claim of a certified chain over its workspace.

    Each configuration counts once.
    """
    found, nominal = certified.found, certified.correction.nominal
    retained = samples.take(found.inliers)
    label = np.unique(certified.label[found.inliers], return_inverse=True)[1]
    each = mean_sample_per_configuration(retained, label, mechanism.jacobian(retained.commanded, nominal))
    part = "the recorded values" if certified.correction.is_extended else "every travel"
    words = f"the middle {FILL * 100:.0f} % of {part}, all axes independent"
    requested = int((chain_error_model_and_identification.parameter_tolerances(nominal) > 0).sum())
    determined = requested - len(found.undetermined) if found.covariance.any() else 0
    information = ConfigurationInformation(
        len(each),
        determined,
        determined,
        requested if determined else 0,
        "parameters that no pose determines remain as stated" if determined else "no parameters were fitted",
    )
    if len(each) < LEAST:
        return empty_claim_of_too_few_configurations(information, words)
    if certified.correction.is_extended and certified.left is None:
        return empty_claim_without_held_out_data(information, words)
    values, T = chain_workspace_values_and_poses(certified.correction, samples.commanded)
    stated = mean_square_pose_errors_stated_by_extension(
        certified.correction, values, mechanism.jacobian(values, found.chain)
    )
    own = (
        (found.scatter**2).reshape(2, 3).sum(axis=1) + stated
        if certified.left is None
        else certified.left.own_draws(float(stated[0]), DRAWS, rng)
    )
    workspace = Workspace(
        chain_error_model_and_identification.parameter_jacobian(values, found.chain),
        pose_difference(mechanism.forward(values, nominal), T),
        own,
        words,
    )
    draws = rng.multivariate_normal(np.zeros(len(found.covariance)), found.covariance, DRAWS, method="eigh")
    return replace(
        claim_from_machine_draws(workspace, draws, each, information, rng),
        unexplained=unexplained_scatter_sentences(found.scatter, each.covariance),
    )


def write_chain_calibration_page(
    path: Path | str,
    recording: Recording,
    calibration: Calibration,
    samples: Samples,
    certified: CertifiedChain,
    links: Sequence[Link] = (),
) -> None:
    """Write the HTML page of a chain's calibration.

    It is as certified on held-out samples.
    links : to other pages
    """
    parts = [
        heading_html("Errors before and after, by pose"),
        correction_error_figures(
            *errors_before_and_after_correction(calibration.correction, samples), samples.frame, FITTED
        ),
        *section_html("At poses that were not fitted", evidence_html(calibration)),
        *view_3d_html(recording, calibration, samples),
        heading_html("Stage by stage"),
        *(paragraph_html(line) for line in certified.found.report()),
        _chain_parameters(certified),
        heading_html("Positions of the last platform"),
        pose_coverage_figures(pose_to_vector(samples.T_base_platform)),
    ]
    write_calibration_page_from_parts(path, recording, calibration, parts, links)


def _chain_parameters(done: CertifiedChain) -> str:
    found, nominal = done.found, done.correction.nominal
    sigma = np.sqrt(np.diag(found.covariance))
    rows = [
        (name, f"{1e3 * step:+.4f}", f"{2e3 * s:.4f}", "mm" if unit == "m" else "mrad")
        for name, unit, step, s in zip(
            chain_error_model_and_identification.parameter_names(nominal),
            chain_error_model_and_identification.parameter_units(nominal),
            found.step,
            sigma,
        )
        if s > 0
    ]
    return collapsible_section_html("Every parameter", table_html(("change from nominal", "", "± (k = 2)", ""), rows))
