"""Correction over a configuration or pose space.

It is extended from samples at once, or as an additional pass.

Source: configuration-space patent, [0035]
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.error_claim_over_workspace import (
    Claim,
    mean_square_pose_errors_of_extension,
    workspace_samples,
)
from calib.certification.extended_correction_certification import (
    ExtensionBasis,
    ExtensionRequest,
    Tried,
    certify_extended_correction,
    certify_interpolation_method,
    claim_without_geometry,
    mean_stated_position_variance,
)
from calib.certification.held_out_pose_errors_and_distinct_configurations import (
    axis_travel_limits,
    configuration_numbers,
)
from calib.certification.platform_certification import (
    Certified,
    Progress,
    platform_pose_covariance,
    platform_workspace_claim,
    silent_progress,
)
from calib.correction.correction import AnyCorrection
from calib.correction.interpolation.field_interface_and_combinations import (
    Field,
    RestrictedMap,
    SpacePart,
    SummedPasses,
)
from calib.correction.interpolation_methods_and_interpolated_correction_summands import (
    correction_with_additional_pass,
    correction_with_pose_space_map,
    fit_correction_summand_field,
    fitted_or_nominal_geometry,
    home_pose,
    pose_coordinate_indices,
    residual_correction_summands_of_pass,
    residual_pose_tangents_of_pass,
    single_step_command_errors,
)
from calib.correction.timed_command_sequence_and_pose_error_map import NAMES, PoseMap, pose_coordinates
from calib.files.mechanism_and_physics_entries import mechanism_dict
from calib.models.arm import joint_space_correction_and_workspace_claim as arm_extension
from calib.models.arm.certification import CertifiedArm as ArmCertified
from calib.models.arm.joint_space_correction_and_workspace_claim import arm_workspace_claim
from calib.models.chain.certification_and_page import CertifiedChain, chain_workspace_claim
from calib.models.chain.configuration_space_correction import (
    certify_chain_correction_extension,
    single_step_chain_correction_errors,
)
from calib.models.platform.identification import inverse_strut_length_jacobian
from calib.samples.pose_samples import Sampled, Samples
from rig.array_and_json_types import Booleans, Floats, Json
from rig.errors import NotEnoughData, RigError
from rig.formats.numbers_and_units import parse_number
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import require_one_hand
from rig.model.design import Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Parallel,
    has_links,
    is_redundant,
    require_arm,
    require_chain,
    require_parallel,
)
from rig.model.pose import pose_difference

CONFIGURATION, POSE, BOTH = "configuration", "pose", "both"
SPACES = (CONFIGURATION, POSE, BOTH)


class CorrectionPass(NamedTuple):
    """What is asked of a pass. kind : one of `METHODS` of
    calib.correction.interpolation_methods_and_interpolated_correction_summands, or AUTO; space : of SPACES;
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
    requested_pass: CorrectionPass,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> tuple[Certified, tuple[Tried, ...], int]:
    """Additional pass of correction by samples measured anew, certified.

    Returns (Certified, methods tried, samples used)
    Raises NotEnoughData where a part holds no samples; the rest as `certify_extended_correction`
    """
    correction, report = previous_calibration.correction, progress or silent_progress
    some = samples.take(_within(samples, correction, requested_pass))
    found = fitted_or_nominal_geometry(samples, correction.nominal, True)
    if (
        requested_pass.configurations is not None or requested_pass.poses is not None
    ):  # beyond the part the machine is known as it was before
        found = replace(found, covariance=previous_calibration.covariance, scatter=previous_calibration.scatter)
    basis = (
        correction.nominal,
        configuration_numbers(some.commanded, axis_travel_limits(correction.nominal)),
        replace(found, mechanism=correction.fitted),
    )

    def struts(of: Samples) -> ExtensionBasis:
        return ExtensionBasis(
            residual_correction_summands_of_pass(of, correction),
            lambda field: correction_with_additional_pass(correction, _part(field, requested_pass.configurations)),
            lambda field, at: mean_stated_position_variance(field, at, correction.nominal),
        )

    done, tried = certify_interpolation_method(
        some,
        basis,
        struts if requested_pass.space != POSE else _pose_space_field(lambda of: correction, requested_pass.poses),
        requested_pass.kind,
        rng,
        report,
    )
    if requested_pass.space == BOTH:
        done, more = certify_interpolation_method(
            some,
            basis,
            _pose_space_field(_with_same_field(done.correction, correction, requested_pass), requested_pass.poses),
            requested_pass.kind,
            rng,
            report,
        )
        tried = (*tried, *more)
    found = replace(
        found,
        mechanism=correction.fitted,
        residuals=residual_correction_summands_of_pass(samples, done.correction).values,
    )
    done = replace(
        done, label=configuration_numbers(samples.commanded, axis_travel_limits(correction.nominal)), found=found
    )
    return _with_covariance(done, previous_calibration, rng), tried, len(some)


def _with_covariance(done: Certified, before: Calibration, rng: np.random.Generator) -> Certified:
    """The Certified with the covariance of the calibration before it, as great as configurations held out show errors
    to be now: a pass takes away no more than it moves, and nothing that those do not tell from noise."""
    if done.left is None:
        return done
    commands, T = workspace_samples(done.correction)
    was = float(np.trace(platform_pose_covariance(before, T)[:, :3, :3], axis1=1, axis2=2).mean())
    stated = float(
        mean_square_pose_errors_of_extension(
            done.correction, commands, inverse_strut_length_jacobian(T, done.correction.fitted)
        )[0]
    )
    moved = pose_difference(before.correction.predict(commands), T)[:, :3]
    held = float(done.left.own(stated, rng)[0])
    now = max(held, was - float((moved**2).sum(axis=1).mean()), min(was, done.left.unnoticed()))
    struts = np.diag(before.scatter**2) if before.strut_covariance is None else before.strut_covariance
    scale = now / was if was else 0.0
    return replace(done, covariance=scale * before.covariance, strut_covariance=scale * struts)


def _pose_space_field(
    base: Callable[[Samples], AnyCorrection], part: SpacePart | None
) -> Callable[[Samples], ExtensionBasis]:
    """The stand of a map in pose space on a Correction by some samples."""

    def stand(of: Samples) -> ExtensionBasis:
        on = base(of)
        return ExtensionBasis(
            residual_pose_tangents_of_pass(of, on),
            lambda field: correction_with_pose_space_map(on, _part(field, part)),
            lambda field, at: _mean_square_position_error(field, at, on),
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
            fit_correction_summand_field(residual_correction_summands_of_pass(of, before), own.kind, own),
            requested.configurations,
        ),
    )


def _mean_square_position_error(field: Field, at: Samples, on: AnyCorrection) -> float:
    one = PoseMap(home_pose(on.nominal), pose_coordinate_indices(on.nominal), field)
    return float((one.error(on.predict(at.commanded))[:, :3] ** 2).sum(axis=1).mean())


def _part(field: Field | None, part: SpacePart | None) -> Field | None:
    return field if field is None or part is None else RestrictedMap(field, part)


def _within(samples: Samples, correction: AnyCorrection, requested: CorrectionPass) -> Booleans:
    """(n,) bool, the samples in the parts asked for."""
    keep = np.ones(len(samples), bool)
    if requested.configurations is not None:
        keep &= requested.configurations.holds(samples.commanded)
    if requested.poses is not None:
        at = pose_coordinates(correction.predict(samples.commanded), home_pose(correction.nominal))
        keep &= requested.poses.holds(at[:, list(pose_coordinate_indices(correction.nominal))])
    if not keep.any():
        raise NotEnoughData(f"none of {len(samples)} samples lies in the requested part")
    return keep


@dataclass(frozen=True, slots=True, eq=False)
class ExtendOptions:
    """method : how, of "linear", "simplex", "delaunay", "axes", "radial", "polynomial" or, by held-out error, "auto"
    alone : whether to correct the nominal model itself, with no geometry fitted first; onto : Calibration on which this
    is one more pass, or None; name : of that, in words
    space : of a pass, where it maps what is left, one of SPACES, None for configurations
    within : of a pass, the part in which it holds, as "l1=0.40:0.46,z=0.41:" (m, rad), None for all of it
    """

    method: str
    alone: bool = False
    onto: Calibration | None = None
    name: str = "the calibration"
    space: str | None = None
    within: str | None = None

    def __post_init__(self) -> None:
        if self.alone and self.onto is not None:
            raise RigError("--alone and --onto each state the base of --extend; use one of them")
        if (self.space or self.within) and self.onto is None:
            raise RigError("--space and --within apply to a pass; name with --onto its base")

    def refuse_unsuited(self, design: Design) -> None:
        """Raise RigError where a pass cannot be of a design's machine, or stand on its calibration."""
        require_one_hand(design.mechanism, "corrections are extended")
        if is_redundant(design.mechanism) and self.space != POSE:
            raise RigError(
                f"--extend {self.method} interpolates between independent commands, and the lengths of "
                f"{len(design.mechanism.axes)} struts depend on each other; over the six coordinates of poses it is a "
                "pass: --onto CALIBRATION --space pose"
            )
        if self.onto is None:
            return
        if design.mechanism.link_rows is not None or design.mechanism.bodies:
            raise RigError(
                "--onto adds a pass to a calibration of struts; an arm's or a chain's is extended in one step, by all "
                "of its recordings"
            )
        struts = require_parallel(design.mechanism)
        if mechanism_dict(self.onto.correction.nominal) != mechanism_dict(struts):
            raise RigError(f"{self.name} is for another machine than this recording's rig.toml")
        if self.onto.physics is not None:
            raise RigError(
                f"{self.name} models physics besides the configuration; a pass extends corrections by "
                "configuration alone"
            )


@dataclass(frozen=True, slots=True, eq=False)
class ExtendedCorrection:
    """done : Certified, of struts, an arm or a chain; tried : Tried of each way; claim : Claim; provenance : what is
    recorded of a pass; misses : (RMS, greatest) of the single step; unit : of these, m or rad; base : what the
    extension stands on, in words
    """

    done: Certified | ArmCertified | CertifiedChain
    tried: tuple[Tried, ...]
    claim: Claim
    provenance: Json
    misses: tuple[float, float]
    unit: str
    base: str

    @property
    def lost(self) -> Floats:
        """(k, axes) vertices of its grid that were not measured, where corrections are estimated from the others."""
        return next(one.lost for one in self.tried if one.chosen)


def certify_correction_extension(
    options: ExtendOptions, design: Design, sampled: Sampled, rng: np.random.Generator, progress: Progress
) -> ExtendedCorrection:
    """ExtendedCorrection of a machine, certified.

    Raises RigError for a part that bounds nothing
    """
    samples, ask = sampled.samples, ExtensionRequest(options.method, options.alone)
    base = "the nominal model alone" if options.alone else "the fitted geometry"
    if has_links(design.mechanism):
        arm = require_arm(design.mechanism)
        of_arm, tried = arm_extension.certify_arm_correction_extension(
            samples, arm, sampled.instrument, ask, rng, progress
        )
        claim_of = arm_extension.claim_without_geometry if options.alone else arm_workspace_claim
        misses = arm_extension.single_step_correction_errors(of_arm.correction)
        claim = claim_of(samples, of_arm, rng)
        return ExtendedCorrection(of_arm, tried, claim, {}, misses, mechanisms.travel_unit(arm), base)
    provenance: Json = {}
    if design.mechanism.bodies:
        of_chain, tried = certify_chain_correction_extension(
            samples, require_chain(design.mechanism), ask, rng, progress
        )
        misses = single_step_chain_correction_errors(of_chain.correction, samples.commanded)
        claim = chain_workspace_claim(samples, of_chain, rng)
        return ExtendedCorrection(of_chain, tried, claim, provenance, misses, "m", base)
    if options.onto is None:
        done, tried = certify_extended_correction(samples, require_parallel(design.mechanism), ask, rng, progress)
    else:
        done, tried, provenance = _certify_pass(options, options.onto, samples, rng, progress)
        base = f"{options.name}, pass {provenance['number']}"
    fitted = not options.alone and options.onto is None
    claim = platform_workspace_claim(samples, done, rng) if fitted else claim_without_geometry(samples, done, rng)
    return ExtendedCorrection(done, tried, claim, provenance, single_step_command_errors(done.correction), "m", base)


def _certify_pass(
    options: ExtendOptions, before: Calibration, samples: Samples, rng: np.random.Generator, progress: Progress
) -> tuple[Certified, tuple[Tried, ...], Json]:
    """(Certified, what was tried, what the provenance records of it) of one more pass."""
    space = options.space or CONFIGURATION
    configurations, poses = _parts(options.within, before.correction.nominal)
    if configurations is not None and space == POSE or poses is not None and space == CONFIGURATION:
        raise RigError(
            f"--within {options.within}: a pass over {'poses' if space == POSE else 'configurations'} is bounded by "
            f"{'x y z rx ry rz' if space == POSE else 'the axes'}; --space both accepts either"
        )
    done, tried, count = certify_additional_pass(
        samples, before, CorrectionPass(options.method, space, configurations, poses), rng, progress
    )
    return (
        done,
        tried,
        {
            "number": len(before.provenance.get("passes", ())) + 2,
            "way": options.method,
            "space": space,
            "within": options.within,
            "samples": count,
            "chosen": [one.kind for one in tried if one.chosen],
        },
    )


def _parts(text: str | None, mechanism: Parallel) -> tuple[SpacePart | None, SpacePart | None]:
    """(Part of the configuration space, Part of pose space), None for all of it, of a text. Raises RigError for one
    that bounds nothing.
    """
    if text is None:
        return None, None
    spaces = [mechanism.axes, tuple(NAMES[i] for i in pose_coordinate_indices(mechanism))]
    bounds = [np.tile([-np.inf, np.inf], (len(names), 1)) for names in spaces]
    for word in text.split(","):
        name, _, span = word.strip().partition("=")
        low, colon, high = span.partition(":")
        try:
            pair = parse_number(low) if low else -np.inf, parse_number(high) if high else np.inf
        except ValueError:
            pair = np.nan, np.nan
        at = [(k, names.index(name)) for k, names in enumerate(spaces) if name in names]
        if not at or not colon or not pair[0] < pair[1] or pair == (-np.inf, np.inf):
            raise RigError(
                f"--within takes NAME=LOW:HIGH separated by commas, names {' '.join(spaces[0] + spaces[1])}, "
                "low below high and either omitted "
                f"where free, not {word.strip()!r}"
            )
        bounds[at[0][0]][at[0][1]] = pair
    found = [SpacePart(*pair.T) if np.isfinite(pair).any() else None for pair in bounds]
    return found[0], found[1]
