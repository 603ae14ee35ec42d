"""Additional pass of a correction.

It is by samples measured anew with a machine that an earlier calibration corrects.

It is of machines on struts, arms and chains, over configurations, over poses or over both, and certified on held-out
configurations.

Source: configuration-space patent, [0035]
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.claimed_error_reduction_over_workspace import (
    mean_square_pose_errors_stated_by_extension,
    workspace_commands_and_corrected_poses,
)
from calib.certification.configuration_space_correction_certification import (
    ExtensionBasis,
    Tried,
    certify_interpolation_method,
)
from calib.certification.held_out_pose_errors_and_distinct_configurations import (
    axis_travel_limits,
    configuration_numbers,
)
from calib.certification.platform_certification import Certified, Progress, ignore_progress
from calib.correction.correction_field_methods_fitting_combination_and_json import (
    correction_with_additional_pass,
    correction_with_pose_space_map,
    fit_correction_summand_field,
    fitted_or_nominal_geometry,
    pose_space_of_mechanism,
    residual_correction_summands_of_pass,
    residual_pose_tangents_of_pass,
)
from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import (
    Field,
    FieldSamples,
    RestrictedMap,
    SpacePart,
    SummedPasses,
)
from calib.correction.machine_correction import AnyCorrection
from calib.correction.timed_command_sequence_and_pose_space_correction_map import (
    NAMES,
    PoseMap,
    PoseSpace,
    pose_coordinates,
)
from calib.models.arm.arm_certification import CertifiedArm
from calib.models.arm.arm_correction import ArmCorrection
from calib.models.arm.arm_error_model_and_instrument_observations import observations_of_samples
from calib.models.arm.joint_space_correction_and_workspace_claim import (
    configurations_evenly_over_visited_joint_ranges,
    identified_arm_without_fit,
    joint_correction_summands_for_interpolation,
)
from calib.models.base_and_tool_displacement_between_recordings import (
    PlacedSamples,
    has_base_and_tool_placements,
    placed_samples,
)
from calib.models.calibration_covariance_parameters import covariance_parameters
from calib.models.chain.chain_certification_and_page import CertifiedChain, chain_workspace_values_and_poses
from calib.models.chain.chain_correction_over_configuration_space import (
    chain_correction_summands_for_interpolation,
    identified_chain_without_fit,
)
from calib.models.machine_parameters_and_file_entries import corrected_pose_covariance
from calib.models.platform.platform_identification import Identified
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Booleans, Floats
from rig.errors import NotEnoughData, RigError
from rig.model.design import Instrument
from rig.model.mechanism_geometry_classes import Arm, Chain
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Commanded, is_parallel
from rig.model.pose import pose_difference

CONFIGURATION, POSE, BOTH = "configuration", "pose", "both"
SPACES = (CONFIGURATION, POSE, BOTH)
WIDEST = 2.5  # rad from the mean orientation; farther out a rotation vector jumps to the other side of a half turn
FLAT = 0.02  # of the greatest extent of poses in all directions, less of which is none: their own errors make it up
STANDS = 1e-3  # m or rad; a coordinate in which an arm's or a chain's poses differ by less is none of its pose space


class CorrectionPass(NamedTuple):
    """What is asked of a pass. kind : one of `METHODS` of
    calib.correction.correction_field_methods_fitting_combination_and_json, or AUTO; space : of SPACES;
    configurations : Part of the configuration space in which it holds, poses : Part of pose space, in the coordinates
    of the mechanism's poses; None for all of it."""

    kind: str
    space: str = CONFIGURATION
    configurations: SpacePart | None = None
    poses: SpacePart | None = None


def mechanism_placed_as_calibrated(mechanism: Commanded, known: Commanded, instrument: Instrument | None) -> Commanded:
    """A stated mechanism, placed as calibrated.

    Of an arm, the ends that are stated free stand where a calibration has them.
    known : the nominal mechanism of the calibration
    """
    if instrument is None or not (isinstance(mechanism, Arm) and isinstance(known, Arm)):
        return mechanism
    base, tool = instrument.base == "free", instrument.tool == "free"
    return mechanism.with_ends(known.base if base else None, known.tool if tool else None)


def samples_in_frames_of_calibration(
    calibration: Calibration, instrument: Instrument | None, samples: Samples
) -> PlacedSamples:
    """Samples in the frames of a calibration.

    They are of an arm or a chain, as measured where its instrument stood for a calibration, which knows no physics.
    Only ends that are stated free are placed anew: what else is off is the machine's. instrument : of rig.toml, or None
    """
    mechanism = calibration.correction.nominal
    free = instrument is not None and "free" in (instrument.base, instrument.tool)
    if not free or not has_base_and_tool_placements(mechanism, samples.measured):
        return PlacedSamples(samples)
    return placed_samples(calibration, samples, instrument)


def certify_additional_pass(
    samples: Samples,
    previous_calibration: Calibration,
    requested_pass: CorrectionPass,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> tuple[Certified | CertifiedArm | CertifiedChain, tuple[Tried, ...], int]:
    """Additional pass of correction by samples measured anew, certified.

    samples : as measured where the instrument stood for the previous calibration
    Returns (Certified of the kind of machine, methods tried, samples used)
    Raises NotEnoughData where a part holds no samples; RigError for a pass over poses whose orientations were not
        measured, or lie too far apart; the rest as `certify_extended_correction`
    """
    correction, report = previous_calibration.correction, progress or ignore_progress
    by_pose = requested_pass.space != CONFIGURATION
    if samples.measured != "pose" and (by_pose or correction.posed):
        raise RigError(
            f"a map in pose space takes whole poses, and of these the {samples.measured} alone was measured; "
            "--space configuration takes them, onto a calibration without such maps"
        )
    space = pose_space_of_additional_pass(samples, correction) if by_pose else None
    requested_pass = requested_pass._replace(poses=_part_of_pose_space(requested_pass.poses, correction.nominal, space))
    some = samples.take(_within(samples, correction, requested_pass, space))
    nominal, limits = correction.nominal, axis_travel_limits(correction.nominal)
    basis = (nominal, configuration_numbers(some.commanded, limits), None)

    def axes(of: Samples) -> ExtensionBasis:
        return ExtensionBasis(
            residual_axis_summands(of, correction),
            lambda field: correction_with_additional_pass(correction, _part(field, requested_pass.configurations)),
            lambda field, at: _mean_square_axis_error(field, at, nominal),
        )

    done, tried = certify_interpolation_method(
        some,
        basis,
        axes
        if space is None or requested_pass.space == BOTH
        else _pose_space_basis(lambda of: correction, space, requested_pass.poses),
        requested_pass.kind,
        rng,
        report,
    )
    if requested_pass.space == BOTH and space is not None:
        on = _with_same_field(done.correction, correction, requested_pass)
        done, more = certify_interpolation_method(
            some, basis, _pose_space_basis(on, space, requested_pass.poses), requested_pass.kind, rng, report
        )
        tried = (*tried, *more)
    label = configuration_numbers(samples.commanded, limits)
    return _certified(samples, replace(done, label=label), previous_calibration, requested_pass, rng), tried, len(some)


def _certified(
    samples: Samples, done: Certified, previous: Calibration, requested: CorrectionPass, rng: np.random.Generator
) -> Certified | CertifiedArm | CertifiedChain:
    """What was certified, of the kind of machine; how well it is known comes of the calibration before it.

    done : of the pass, without a geometry
    """
    correction: Any = done.correction  # of any kind of machine
    fitted, scale = correction.fitted, _share_of_earlier_variance(samples, done, previous, rng)
    if isinstance(fitted, Arm):
        found = identified_arm_without_fit(observations_of_samples(_undone(samples, correction)), fitted)
        known = replace(found, covariance=scale * previous.covariance, scatter=np.sqrt(scale) * previous.scatter)
        return CertifiedArm(correction, known, done.label, done.held_out, None, None, done.left)
    if isinstance(fitted, Chain):
        chain = identified_chain_without_fit(samples, fitted)
        of_chain = replace(chain, covariance=scale * previous.covariance, scatter=np.sqrt(scale) * previous.scatter)
        return CertifiedChain(correction, of_chain, done.label, done.held_out, done.left)
    geometry: Identified = fitted_or_nominal_geometry(samples, correction.nominal, True)
    if requested.configurations is not None or requested.poses is not None:
        # beyond the part the machine is known as it was before
        geometry = replace(geometry, covariance=previous.covariance, scatter=previous.scatter)
    geometry = replace(
        geometry, mechanism=fitted, residuals=residual_correction_summands_of_pass(samples, correction).values
    )
    done = replace(done, found=geometry)
    if done.left is None:
        return done
    struts = np.diag(previous.scatter**2) if previous.strut_covariance is None else previous.strut_covariance
    return replace(done, covariance=scale * previous.covariance, strut_covariance=scale * struts)


def _share_of_earlier_variance(
    samples: Samples, done: Certified, previous: Calibration, rng: np.random.Generator
) -> float:
    """Share of the variances of the calibration before a pass that is left, as great as configurations held out show
    errors to be now: a pass takes away no more than it moves, and nothing that those do not tell from noise."""
    if done.left is None:
        return 1.0
    commands, T = _workspace(samples, done.correction)
    was = float(np.trace(corrected_pose_covariance(previous, T, commands)[:, :3, :3], axis1=1, axis2=2).mean())
    jacobian = covariance_parameters(done.correction.fitted).axis_jacobian(commands, T)
    stated = float(mean_square_pose_errors_stated_by_extension(done.correction, commands, jacobian)[0])
    moved = pose_difference(previous.correction.predict(commands), T)[:, :3]
    held = float(done.left.own(stated, rng)[0])
    now = max(held, was - float((moved**2).sum(axis=1).mean()), min(was, done.left.unnoticed()))
    return now / was if was else 0.0


def _workspace(samples: Samples, correction: AnyCorrection) -> tuple[Floats, RigidTransform]:
    """(commands (m, axes) m or rad, their poses (m,)) over which a kind of machine's errors are compared."""
    if isinstance(correction, ArmCorrection):
        q = configurations_evenly_over_visited_joint_ranges(correction)
        return q, correction.predict(q)
    if isinstance(correction.nominal, Chain):
        return chain_workspace_values_and_poses(correction, samples.commanded)
    return workspace_commands_and_corrected_poses(correction)


def residual_axis_summands(samples: Samples, correction: AnyCorrection) -> FieldSamples:
    """Residual axis summands (n, axes) m or rad that a correction leaves at samples.

    It is that of an earlier calibration; they are nearest to none.
    """
    if isinstance(correction.fitted, Arm):
        return joint_correction_summands_for_interpolation(
            _undone(samples, correction), correction.fitted, np.zeros(samples.common.shape[2])
        )
    if isinstance(correction.fitted, Chain):
        return chain_correction_summands_for_interpolation(_undone(samples, correction), correction.fitted)
    return residual_correction_summands_of_pass(samples, correction)


def _undone(samples: Samples, correction: AnyCorrection) -> Samples:
    """The Samples as the fitted geometry alone has them: what a correction adds to the axes is known, and its maps in
    pose space are taken off."""
    known = (0.0 if samples.known is None else samples.known) - correction.rho(samples.commanded)
    return replace(samples, T_base_platform=correction.target_poses(samples.T_base_platform), known=known)


def _mean_square_axis_error(field: Field, at: Samples, nominal: Commanded) -> float:
    """m^2, mean square by which a Field of summands says that positions of samples may be off."""
    J = covariance_parameters(nominal).axis_jacobian(at.commanded, at.T_base_platform)[:, :3]
    return float((J**2 @ (field.error(at.commanded) ** 2)[..., None]).sum(axis=1).mean())


def pose_space_of_additional_pass(samples: Samples, correction: AnyCorrection) -> PoseSpace:
    """Pose space of an additional pass.

    It maps what is left: of a machine on struts its own, about home; of an arm or a chain about the mean orientation of
    the samples, in the coordinates in which their poses differ.
    Raises RigError where orientations of these lie too far apart for a map over them, or where they fill no space of
        these coordinates
    """
    nominal = correction.nominal
    if is_parallel(nominal):
        return pose_space_of_mechanism(nominal)
    T = correction.predict(samples.commanded)
    home = RigidTransform.from_rotation(T.rotation.mean())
    x = pose_coordinates(T, home)
    widest = float(np.linalg.norm(x[:, 3:], axis=1).max())
    if widest > WIDEST:
        raise RigError(
            f"orientations of these samples are up to {np.degrees(widest):.0f} degrees from their mean, and a map over "
            f"poses takes {np.degrees(WIDEST):.0f} at the most: use --space configuration, or record a part of the "
            "workspace"
        )
    some = np.flatnonzero(np.ptp(x, axis=0) > STANDS)
    scaled = (x[:, some] - x[:, some].mean(axis=0)) / np.ptp(x[:, some], axis=0)
    sizes = np.linalg.svd(scaled, compute_uv=False)
    if not len(some) or len(sizes) < len(some) or sizes[-1] < FLAT * sizes[0]:
        raise RigError(
            f"poses of these samples differ in {', '.join(NAMES[i] for i in some)}, but lie in fewer dimensions, where "
            "a map over them is undetermined: use --space configuration"
        )
    return PoseSpace(home, tuple(some.tolist()))


def _pose_space_basis(
    base: Callable[[Samples], AnyCorrection], space: PoseSpace, part: SpacePart | None
) -> Callable[[Samples], ExtensionBasis]:
    """The stand of a map in pose space on a Correction by some samples."""

    def stand(of: Samples) -> ExtensionBasis:
        on = base(of)
        return ExtensionBasis(
            residual_pose_tangents_of_pass(of, on, space),
            lambda field: correction_with_pose_space_map(on, _part(field, part), space),
            lambda field, at: _mean_square_position_error(PoseMap(*space, field), at, on),
        )

    return stand


def _with_same_field(
    done: AnyCorrection, before: AnyCorrection, requested: CorrectionPass
) -> Callable[[Samples], AnyCorrection]:
    """By some samples alone, the Correction with the map in the configuration space that all of them chose."""
    extension = done.extension
    field = extension.fields[-1] if isinstance(extension, SummedPasses) else extension
    if extension is before.extension or field is None:
        return lambda of: before
    own = field.field if isinstance(field, RestrictedMap) else field
    return lambda of: correction_with_additional_pass(
        before,
        _part(
            fit_correction_summand_field(residual_axis_summands(of, before), own.kind, own), requested.configurations
        ),
    )


def _mean_square_position_error(pose_map: PoseMap, at: Samples, on: AnyCorrection) -> float:
    return float((pose_map.error(on.predict(at.commanded))[:, :3] ** 2).sum(axis=1).mean())


def _part_of_pose_space(part: SpacePart | None, nominal: Commanded, space: PoseSpace | None) -> SpacePart | None:
    """A part over the coordinates of a mechanism's poses, over those of a pose space.

    Raises RigError for a bound in one in which poses do not differ.
    """
    if part is None or space is None:
        return part
    retained = np.isin(nominal.pose_coordinates, space.coordinates)
    bounded = np.isfinite(part.low) | np.isfinite(part.high)
    if (bounded & ~retained).any():
        name = NAMES[nominal.pose_coordinates[int(np.argmax(bounded & ~retained))]]
        raise RigError(f"--within bounds {name}, in which poses of these samples do not differ")
    return SpacePart(part.low[retained], part.high[retained])


def _part(field: Field | None, part: SpacePart | None) -> Field | None:
    return field if field is None or part is None else RestrictedMap(field, part)


def _within(
    samples: Samples, correction: AnyCorrection, requested: CorrectionPass, space: PoseSpace | None
) -> Booleans:
    """(n,) bool, the samples in the parts asked for."""
    keep = np.ones(len(samples), bool)
    if requested.configurations is not None:
        keep &= requested.configurations.holds(samples.commanded)
    if requested.poses is not None and space is not None:
        at = pose_coordinates(correction.predict(samples.commanded), space.home)
        keep &= requested.poses.holds(at[:, list(space.coordinates)])
    if not keep.any():
        raise NotEnoughData(f"none of {len(samples)} samples lies in the requested part")
    return keep
