"""What a calibration promises, from poses that it was not fitted to."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certify.calibration import Calibration
from calib.certify.distinct_configurations import (
    LEAST,
    axis_ranges,
    configuration_folds,
    configuration_numbers,
    mean_sample_per_configuration,
)
from calib.certify.held_out_error_statistics import HeldErrors
from calib.certify.held_out_errors import HeldOut, compare_errors, errors_before_and_after, is_significant_gain
from calib.certify.machine_draws import COUNT, Sizes, deviation_sizes, draw_machines
from calib.certify.possible_machines import Machines
from calib.certify.workspace_claim import Claim, draw_fit_variance_ratio, sample_workspace, workspace_claim
from calib.correct.correction import Correction, calibrate, identify_geometry
from calib.correct.interpolation.gaussian_process import Radial
from calib.models.platform.identification import (
    Identified,
    identify,
    inverse_strut_jacobian,
    loop_jacobian,
    parameters,
    pose_jacobian,
)
from calib.models.platform.stated_geometry_accuracy import stated_geometry_accuracy
from calib.samples.pose_samples import Samples, inverse_covariance
from rig.compute.parallel_map import parallel_map
from rig.model.mechanism_kinds import Struts

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

    correction: Correction[Struts, Radial]
    found: Identified
    label: np.ndarray
    held_out: HeldOut | None
    machines: Machines | None = None
    covariance: np.ndarray | None = None
    strut_covariance: np.ndarray | None = None
    left: HeldErrors | None = None


def model_covariance(calibration: Calibration, T_base_platform: RigidTransform) -> np.ndarray:
    """(n, 6, 6) covariance of the corrected machine's pose at poses (n,): the parameters', what struts do beyond them,
    each by itself or together, and what an extension may be off.

    docs/mathematics.md (21)

    calibration : Calibration of a machine on struts
    """
    fitted = calibration.correction.fitted
    J = pose_jacobian(T_base_platform, fitted)
    back = inverse_strut_jacobian(T_base_platform, fitted)
    own = np.diag(calibration.scatter**2) if calibration.strut_covariance is None else calibration.strut_covariance
    if calibration.correction.extension is not None:
        error = calibration.correction.extension.error(calibration.correction.inverse_without_physics(T_base_platform))
        own = own + error[:, :, None] ** 2 * np.eye(len(fitted.axes))
    covariance = J @ calibration.covariance @ np.swapaxes(J, 1, 2) + back @ own @ np.swapaxes(back, 1, 2)
    return covariance + calibration.correction.posed_error(T_base_platform)[..., None] ** 2 * np.eye(6)


def certify(samples: Samples, nominal: Struts, rng: np.random.Generator, progress: Progress | None = None) -> Certified:
    """Certified: calibrated on all samples, and what was left at configurations held out in turn.

    The remainder is kept only where it is a significant gain on the held-out stretches; its size and smoothness, and
    how good the owner's figures are, are those found on the whole recording. rng : numpy Generator, for the bootstrap
    progress : called with (label, done, of), or None
    """
    label = configuration_numbers(samples.commanded, axis_ranges(nominal))
    said = progress or silent_progress
    said("fitting the geometry", 0, 1)
    alone = identify_geometry(samples, nominal)
    first = of_geometry(nominal, alone, label)
    if label.max() + 1 < LEAST:  # nothing says whether a remainder pays
        said("fitting the geometry", 1, 1)
        return first
    sizes = sizes_beyond(samples, first, rng)
    correction, found = calibrate(samples, nominal, alone=alone, only=sizes.of_place() > SURELY)
    said("fitting the geometry", 1, 1)
    like, good = correction.remainder, sizes.inliers
    covariance = samples.total_covariance()[good]

    def corrections(some: Samples) -> list[Correction[Struts, Radial]]:
        known = identify_geometry(some, nominal, alone)
        return [calibrate(some, nominal, how, alone=known)[0] for how in (("none", like) if any(like) else ("none",))]

    before, after, *more = [errors[good] for errors in held_out_errors_by_fold(samples, label, corrections, said)]
    done = replace(first, held_out=compare_errors(before, after, covariance, rng, label[good]))
    if more:
        weight = inverse_covariance(covariance)
        loss = [np.einsum("ni,nij,nj->n", e, weight, e) for e in (np.nan_to_num(after), np.nan_to_num(more[0]))]
        if is_significant_gain(loss[0] - loss[1]):
            done = Certified(correction, found, label, compare_errors(before, more[0], covariance, rng, label[good]))
    return with_drawn(samples, done, sizes, rng)


def of_geometry(nominal: Struts, found: Identified, label: np.ndarray) -> Certified:
    """The Certified of a geometry alone, of which nothing was held out. label : (n,) configuration of each sample"""
    plain: Correction[Struts, Radial] = Correction(nominal, found.mechanism, (None,) * len(nominal.axes))
    return Certified(plain, found, label, None)


def silent_progress(label: str, done: int, of: int) -> None:
    """A Progress that says nothing."""


def held_out_errors_by_fold(
    samples: Samples, label: np.ndarray, correct: Callable[[Samples], Sequence[Correction[Any, Any]]], said: Progress
) -> list[np.ndarray]:
    """[before, after, after, ...], each (n, 6) as `errors_before_and_after`, m and rad, of whole stretches held out in
    turn, on all cores.

    label : (n,) configuration of each sample; correct : Corrections by some samples, as many each time
    """
    fold = configuration_folds(label, min(FOLDS, label.max() + 1))

    def errors(k: int) -> list[np.ndarray]:
        rest = samples.take(fold == k)
        each = [errors_before_and_after(correction, rest) for correction in correct(samples.take(fold != k))]
        return [each[0][0], *(after for _, after in each)]

    names = np.unique(fold).tolist()
    said("holding configurations out", 0, len(names))
    found = parallel_map(errors, names, lambda done, of: said("holding configurations out", done, of), few=1)
    out = [np.empty((len(samples), 6)) for _ in found[0]]
    for k, parts in zip(names, found):
        for whole, part in zip(out, parts):
            whole[fold == k] = part
    return out


def sizes_beyond(samples: Samples, first: Certified, rng: np.random.Generator) -> Sizes:
    """Sizes of what struts do beyond their geometry, each visit a sample of its own, by a geometry alone."""
    nominal = first.correction.nominal
    return deviation_sizes(
        first.found,
        stated_geometry_accuracy(_each_configuration(samples, first)[1], nominal),
        samples,
        first.label,
        nominal,
        rng,
    )


def with_drawn(samples: Samples, done: Certified, sizes: Sizes, rng: np.random.Generator) -> Certified:
    """The Certified with the machines that its samples leave possible."""
    correction, found = done.correction, _each_configuration(samples, done)[1]
    noise = draw_fit_variance_ratio(found, correction.nominal, COUNT, rng)
    known = stated_geometry_accuracy(found, correction.nominal)
    return add_machine_draws(
        done,
        draw_machines(
            done.found, known, samples, sizes, correction.nominal, sample_workspace(correction)[0], noise, rng
        ),
    )


def add_machine_draws(done: Certified, machines: Machines) -> Certified:
    """The Certified with Machines about its correction, and what these leave unknown."""
    places, T = sample_workspace(done.correction)
    covariance, struts = machines.second_moments(loop_jacobian(T, done.correction.fitted), done.correction.rho(places))
    return replace(done, machines=machines, covariance=covariance, strut_covariance=struts)


def with_refitted_correction(done: Certified, correction: Correction[Struts, Radial], found: Identified) -> Certified:
    """The Certified with another Correction and Identified of the same samples; its machines are about these."""
    moved = replace(done, correction=correction, found=found)
    if done.machines is None:
        return moved
    return add_machine_draws(
        moved, done.machines.moved(parameters(correction.fitted) - parameters(done.correction.fitted))
    )


def _each_configuration(samples: Samples, done: Certified) -> tuple[Samples, Identified]:
    """(Samples, Identified) with one row for each configuration that was visited, however often."""
    nominal, good = done.correction.nominal, done.found.inliers
    label = np.unique(done.label[good], return_inverse=True)[1]
    agreed = samples.take(good)
    each = mean_sample_per_configuration(agreed, label, inverse_strut_jacobian(agreed.T_base_platform, nominal))
    return each, identify(each, nominal, done.correction.rho(each.effective), done.found.prior, done.found)


def workspace_claim_of(samples: Samples, done: Certified, rng: np.random.Generator) -> Claim:
    """Claim of a certified calibration all over its workspace: each configuration counts once, however often it was
    visited.
    """
    each, found = _each_configuration(samples, done)
    return workspace_claim(
        found,
        stated_geometry_accuracy(found, done.correction.nominal),
        done.correction,
        each,
        rng,
        done.machines,
        done.left,
    )
