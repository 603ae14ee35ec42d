"""Certification of an additional pass: correction maps fitted on a machine that is already corrected.

Source: configuration-space patent, [0035]
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.certification.calibration import Calibration
from calib.certification.distinct_configurations import axis_ranges, configuration_numbers
from calib.certification.extension_certification import (
    Stand,
    Tried,
    certify_interpolation_method,
    mean_stated_position_variance,
)
from calib.certification.platform_certification import Certified, Progress, platform_pose_covariance, silent_progress
from calib.certification.workspace_claim import extension_error_squares, sample_workspace
from calib.correction.correction import AnyCorrection
from calib.correction.interpolation.field import Field
from calib.correction.interpolation.field_combinations import RestrictedMap, SpacePart, SummedPasses
from calib.correction.pose_space_map import PoseMap, pose_coordinates
from calib.correction.summand_extension import (
    base_geometry,
    correction_with_map,
    correction_with_pass,
    fit_summand_field,
    home_pose,
    pass_residual_poses,
    pass_residual_summands,
    pose_coordinate_indices,
)
from calib.models.platform.identification import inverse_strut_length_jacobian
from calib.samples.pose_samples import Samples
from rig.arrays import Booleans
from rig.errors import NotEnoughData
from rig.model.pose import pose_difference

CONFIGURATION, POSE, BOTH = "configuration", "pose", "both"
SPACES = (CONFIGURATION, POSE, BOTH)


class Pass(NamedTuple):
    """What is asked of a pass. kind : one of `interpolation_methods.ALL`, or AUTO; space : of SPACES;
    configurations : Part of the configuration
    space in which it holds, poses : Part of pose space, in the coordinates of `pose_coordinate_indices`; None for all
        of it."""

    kind: str
    space: str = CONFIGURATION
    configurations: SpacePart | None = None
    poses: SpacePart | None = None


def certify_additional_pass(
    samples: Samples,
    previous_calibration: Calibration,
    requested_pass: Pass,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> tuple[Certified, tuple[Tried, ...], int]:
    """(Certified additional pass, methods tried, samples used): a pass of correction by samples measured anew.

    Raises NotEnoughData where a part holds no samples; the rest as `certify_extended`
    """
    correction, said = previous_calibration.correction, progress or silent_progress
    some = samples.take(_within(samples, correction, requested_pass))
    found = base_geometry(samples, correction.nominal, True)
    if (
        requested_pass.configurations is not None or requested_pass.poses is not None
    ):  # beyond the part the machine is known as it was before
        found = replace(found, covariance=previous_calibration.covariance, scatter=previous_calibration.scatter)
    basis = (
        correction.nominal,
        configuration_numbers(some.commanded, axis_ranges(correction.nominal)),
        replace(found, mechanism=correction.fitted),
    )

    def struts(of: Samples) -> Stand:
        return Stand(
            pass_residual_summands(of, correction),
            lambda field: correction_with_pass(correction, _part(field, requested_pass.configurations)),
            lambda field, at: mean_stated_position_variance(field, at, correction.nominal),
        )

    done, tried = certify_interpolation_method(
        some,
        basis,
        struts if requested_pass.space != POSE else _posed(lambda of: correction, requested_pass.poses),
        requested_pass.kind,
        rng,
        said,
    )
    if requested_pass.space == BOTH:
        done, more = certify_interpolation_method(
            some,
            basis,
            _posed(_again(done.correction, correction, requested_pass), requested_pass.poses),
            requested_pass.kind,
            rng,
            said,
        )
        tried = (*tried, *more)
    found = replace(
        found, mechanism=correction.fitted, residuals=pass_residual_summands(samples, done.correction).values
    )
    done = replace(done, label=configuration_numbers(samples.commanded, axis_ranges(correction.nominal)), found=found)
    return _with_covariance(done, previous_calibration, rng), tried, len(some)


def _with_covariance(done: Certified, before: Calibration, rng: np.random.Generator) -> Certified:
    """The Certified with the covariance of the calibration before it, as great as configurations held out show errors
    to be now: a pass takes away no more than it moves, and nothing that those do not tell from noise."""
    if done.left is None:
        return done
    commands, T = sample_workspace(done.correction)
    was = float(np.trace(platform_pose_covariance(before, T)[:, :3, :3], axis1=1, axis2=2).mean())
    stated = float(
        extension_error_squares(done.correction, commands, inverse_strut_length_jacobian(T, done.correction.fitted))[0]
    )
    moved = pose_difference(before.correction.predict(commands), T)[:, :3]
    held = float(done.left.own(stated, rng)[0])
    now = max(held, was - float((moved**2).sum(axis=1).mean()), min(was, done.left.unnoticed()))
    struts = np.diag(before.scatter**2) if before.strut_covariance is None else before.strut_covariance
    scale = now / was if was else 0.0
    return replace(done, covariance=scale * before.covariance, strut_covariance=scale * struts)


def _posed(base: Callable[[Samples], AnyCorrection], part: SpacePart | None) -> Callable[[Samples], Stand]:
    """The stand of a map in pose space on a Correction by some samples."""

    def stand(of: Samples) -> Stand:
        on = base(of)
        return Stand(
            pass_residual_poses(of, on),
            lambda field: correction_with_map(on, _part(field, part)),
            lambda field, at: _said(field, at, on),
        )

    return stand


def _again(done: AnyCorrection, before: AnyCorrection, asked: Pass) -> Callable[[Samples], AnyCorrection]:
    """By some samples alone, the Correction with the map in the configuration space that all of them chose."""
    extension = done.extension
    field = extension.fields[-1] if isinstance(extension, SummedPasses) else extension
    if extension is before.extension or field is None:
        return lambda of: before
    own = field.field if isinstance(field, RestrictedMap) else field
    return lambda of: correction_with_pass(
        before, _part(fit_summand_field(pass_residual_summands(of, before), own.kind, own), asked.configurations)
    )


def _said(field: Field, at: Samples, on: AnyCorrection) -> float:
    one = PoseMap(home_pose(on.nominal), pose_coordinate_indices(on.nominal), field)
    return float((one.error(on.predict(at.commanded))[:, :3] ** 2).sum(axis=1).mean())


def _part(field: Field | None, part: SpacePart | None) -> Field | None:
    return field if field is None or part is None else RestrictedMap(field, part)


def _within(samples: Samples, correction: AnyCorrection, asked: Pass) -> Booleans:
    """(n,) bool, the samples in the parts asked for."""
    keep = np.ones(len(samples), bool)
    if asked.configurations is not None:
        keep &= asked.configurations.holds(samples.commanded)
    if asked.poses is not None:
        at = pose_coordinates(correction.predict(samples.commanded), home_pose(correction.nominal))
        keep &= asked.poses.holds(at[:, list(pose_coordinate_indices(correction.nominal))])
    if not keep.any():
        raise NotEnoughData(f"none of {len(samples)} samples lies in the part that is asked for")
    return keep
