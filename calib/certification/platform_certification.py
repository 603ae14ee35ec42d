"""Certification of a platform's calibration.

By held-out poses and by machine draws.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.claimed_error_reduction_over_workspace import (
    Claim,
    draw_true_to_stated_pose_variance_ratio_of_fit,
    strut_machine_workspace_claim,
    workspace_commands_and_corrected_poses,
)
from calib.certification.held_out_pose_error_statistics import (
    HeldErrors,
    HeldOut,
    compare_errors,
    errors_before_and_after_correction,
    is_significant_gain,
)
from calib.certification.held_out_pose_errors_and_distinct_configurations import (
    LEAST,
    axis_travel_limits,
    configuration_numbers,
    mean_sample_per_configuration,
    time_block_folds_of_configurations,
)
from calib.certification.possible_machine_draws import (
    COUNT,
    StrutDeviationSizes,
    draw_possible_machines,
    draw_strut_deviation_sizes,
)
from calib.certification.strut_deviation_size_sampler_and_possible_machine_errors import Machines
from calib.correction.interpolation.gaussian_process_interpolation import Radial
from calib.correction.machine_correction import (
    AnyCorrection,
    Correction,
    fit_geometry_and_remainder_of_correction,
    identify_geometry,
)
from calib.models.platform.determined_parameters_and_stated_geometry_tolerance import (
    estimate_tolerance_of_stated_geometry,
)
from calib.models.platform.platform_identification import (
    Identified,
    identify_platform,
    inverse_strut_length_jacobian,
    pose_parameter_jacobian,
)
from calib.samples.commanded_and_measured_pose_samples import Samples, pose_covariance_pseudoinverse
from rig.array_and_json_types import Floats, Integers
from rig.compute.parallel_map_and_dask_cluster import parallel_map
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Parallel,
    geometric_parameters,
    loop_closure_parameter_jacobian,
)

Progress = Callable[[str, int, int], None]  # called with (label, done, of) as work goes on

FOLDS = 5
SURELY = 0.9  # probability of a function of place beside everything else from which a remainder may stand


@dataclass(frozen=True, slots=True, eq=False)
class Certified:
    """correction : Correction of all samples; found : Identified, its geometry; label : (n,) configuration of each
    sample
    held_out : HeldOut, whole stretches of configurations in turn, wild poses left out, or None for fewer than
        configurations.LEAST of them
    machines : Machines that the samples leave possible, or None where none were drawn; covariance : (p, p) m^2 of their
        parameters and
    strut_covariance : (axes, axes) m^2 of what their struts do besides, both about the correction; left : HeldErrors of
    what an extension leaves at configurations held out, None where nothing was extended"""

    correction: Correction[Parallel, Radial]
    found: Identified
    label: Integers
    held_out: HeldOut | None
    machines: Machines | None = None
    covariance: Floats | None = None
    strut_covariance: Floats | None = None
    left: HeldErrors | None = None


def corrected_platform_pose_covariance(calibration: Calibration, T_base_platform: RigidTransform) -> Floats:
    """Covariance (n, 6, 6) of the corrected platform's pose at poses (n,).

    Parameters and strut deviations.

    docs/mathematics.md (21)

    calibration : Calibration of a machine on struts
    """
    fitted = calibration.correction.fitted
    J = pose_parameter_jacobian(T_base_platform, fitted)
    back = inverse_strut_length_jacobian(T_base_platform, fitted)
    own = np.diag(calibration.scatter**2) if calibration.strut_covariance is None else calibration.strut_covariance
    if calibration.correction.extension is not None:
        error = calibration.correction.extension.error(calibration.correction.inverse_without_physics(T_base_platform))
        own = own + error[:, :, None] ** 2 * np.eye(len(fitted.axes))
    covariance = J @ calibration.covariance @ np.swapaxes(J, 1, 2) + back @ own @ np.swapaxes(back, 1, 2)
    return covariance + calibration.correction.pose_map_covariance(T_base_platform)


def certify_platform(
    samples: Samples, nominal: Parallel, rng: np.random.Generator, progress: Progress | None = None
) -> Certified:
    """Certified platform.

    Calibrated on all samples, with errors at configurations held out in turn.

    The remainder is kept only where it is a significant gain on the held-out stretches; its size and smoothness, and
    how good the owner's figures are, are those found on the whole recording. rng : numpy Generator, for the bootstrap
    progress : called with (label, done, of), or None
    """
    label = configuration_numbers(samples.commanded, axis_travel_limits(nominal))
    report = progress or ignore_progress
    report("fitting the geometry", 0, 1)
    alone = identify_geometry(samples, nominal)
    first = uncertified_geometry(nominal, alone, label)
    if label.max() + 1 < LEAST:  # nothing says whether a remainder pays
        report("fitting the geometry", 1, 1)
        return first
    sizes = draw_strut_deviation_sizes_beyond_geometry(samples, first, rng)
    correction, found = fit_geometry_and_remainder_of_correction(
        samples, nominal, geometry=alone, axes_with_remainder=sizes.of_place() > SURELY
    )
    report("fitting the geometry", 1, 1)
    like, good = correction.remainder, sizes.inliers
    covariance = samples.total_covariance()[good]

    def corrections(some: Samples) -> list[Correction[Parallel, Radial]]:
        known = identify_geometry(some, nominal, alone)
        return [
            fit_geometry_and_remainder_of_correction(some, nominal, how, geometry=known)[0]
            for how in (("none", like) if any(like) else ("none",))
        ]

    before, after, *more = [
        errors[good] for errors in held_out_errors_before_and_after_corrections(samples, label, corrections, report)
    ]
    done = replace(first, held_out=compare_errors(before, after, covariance, rng, label[good]))
    if more:
        weight = pose_covariance_pseudoinverse(covariance)
        loss = [np.einsum("ni,nij,nj->n", e, weight, e) for e in (np.nan_to_num(after), np.nan_to_num(more[0]))]
        if is_significant_gain(loss[0] - loss[1]):
            done = Certified(correction, found, label, compare_errors(before, more[0], covariance, rng, label[good]))
    return draw_and_add_possible_machines(samples, done, sizes, rng)


def uncertified_geometry(nominal: Parallel, identified: Identified, label: Integers) -> Certified:
    """Certified result of a geometry alone, of which nothing was held out.

    label : (n,) configuration of each sample
    """
    plain: Correction[Parallel, Radial] = Correction(nominal, identified.mechanism, (None,) * len(nominal.axes))
    return Certified(plain, identified, label, None)


def ignore_progress(label: str, done: int, of: int) -> None:
    """Progress callback that reports nothing."""


def held_out_errors_before_and_after_corrections(
    samples: Samples, label: Integers, correct: Callable[[Samples], Sequence[AnyCorrection]], progress: Progress
) -> list[Floats]:
    """Held-out errors before and after each correction.

    (n, 6) m and rad, fold by fold, on all cores.
    label : (n,) configuration of each sample; correct : Corrections by some samples, as many each time
    """
    fold = time_block_folds_of_configurations(label, min(FOLDS, label.max() + 1))

    def errors(k: int) -> list[Floats]:
        rest = samples.take(fold == k)
        each = [errors_before_and_after_correction(correction, rest) for correction in correct(samples.take(fold != k))]
        return [each[0][0], *(after for _, after in each)]

    names = np.unique(fold).tolist()
    progress("cross-validating configurations", 0, len(names))
    found = parallel_map(
        errors, names, lambda done, of: progress("cross-validating configurations", done, of), items_per_process=1
    )
    out = [np.empty((len(samples), 6)) for _ in found[0]]
    for k, parts in zip(names, found):
        for whole, part in zip(out, parts):
            whole[fold == k] = part
    return out


def draw_strut_deviation_sizes_beyond_geometry(
    samples: Samples, geometry: Certified, rng: np.random.Generator
) -> StrutDeviationSizes:
    """Draw the sizes of strut deviations beyond a geometry.

    They are of samples, beyond the geometry alone, each visit a sample.
    """
    nominal = geometry.correction.nominal
    return draw_strut_deviation_sizes(
        geometry.found,
        estimate_tolerance_of_stated_geometry(_each_configuration(samples, geometry)[1], nominal),
        samples,
        geometry.label,
        nominal,
        rng,
    )


def draw_and_add_possible_machines(
    samples: Samples, certified: Certified, strut_deviation_sizes: StrutDeviationSizes, rng: np.random.Generator
) -> Certified:
    """Certified platform with draws added of the machines that its samples leave possible."""
    correction, found = certified.correction, _each_configuration(samples, certified)[1]
    noise = draw_true_to_stated_pose_variance_ratio_of_fit(found, correction.nominal, COUNT, rng)
    known = estimate_tolerance_of_stated_geometry(found, correction.nominal)
    return certified_with_machine_draws_and_covariance(
        certified,
        draw_possible_machines(
            certified.found,
            known,
            samples,
            strut_deviation_sizes,
            correction.nominal,
            workspace_commands_and_corrected_poses(correction)[0],
            noise,
            rng,
        ),
    )


def certified_with_machine_draws_and_covariance(certified: Certified, machines: Machines) -> Certified:
    """Certified with machine draws about its correction added."""
    places, T = workspace_commands_and_corrected_poses(certified.correction)
    covariance, struts = machines.second_moments(
        loop_closure_parameter_jacobian(T, certified.correction.fitted), certified.correction.rho(places)
    )
    return replace(certified, machines=machines, covariance=covariance, strut_covariance=struts)


def certified_with_refitted_correction(
    certified: Certified, correction: Correction[Parallel, Radial], identified: Identified
) -> Certified:
    """Certified platform with a refitted correction and its geometry, of the same samples."""
    moved = replace(certified, correction=correction, found=identified)
    if certified.machines is None:
        return moved
    return certified_with_machine_draws_and_covariance(
        moved,
        certified.machines.moved(
            geometric_parameters(correction.fitted) - geometric_parameters(certified.correction.fitted)
        ),
    )


def _each_configuration(samples: Samples, done: Certified) -> tuple[Samples, Identified]:
    """(Samples, Identified) with one row for each configuration that was visited, however often."""
    nominal, good = done.correction.nominal, done.found.inliers
    label = np.unique(done.label[good], return_inverse=True)[1]
    agreed = samples.take(good)
    each = mean_sample_per_configuration(agreed, label, inverse_strut_length_jacobian(agreed.T_base_platform, nominal))
    return each, identify_platform(each, nominal, done.correction.rho(each.effective), done.found.prior, done.found)


def platform_workspace_claim(samples: Samples, certified: Certified, rng: np.random.Generator) -> Claim:
    """Claim of a certified platform over its workspace.

    Each configuration counts once.
    """
    each, found = _each_configuration(samples, certified)
    return strut_machine_workspace_claim(
        found,
        estimate_tolerance_of_stated_geometry(found, certified.correction.nominal),
        certified.correction,
        each,
        rng,
        certified.machines,
        certified.left,
    )
