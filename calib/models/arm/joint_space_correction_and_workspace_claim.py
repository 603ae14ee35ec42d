"""Joint-space correction of an arm, and its claim over the workspace.

It is certified on held-out configurations, and claimed of the workspace by draws of possible arms.

KSF_PM(x) = x - IK(GDK(x)), IK of the nominal model or of the fitted geometry, as near x as may be; KSF_KR is its Field
over the joint space, by the same ways as of machines on struts. Source: configuration-space patent, [0026] to [0030],
[0130]
"""

from dataclasses import replace

import numpy as np

from calib.certification.claimed_error_reduction_over_workspace import (
    DRAWS,
    PLACES,
    Claim,
    ConfigurationInformation,
    Workspace,
    claim_from_machine_draws,
    draw_variance_ratio,
    empty_claim_of_too_few_configurations,
    mean_square_pose_errors_stated_by_extension,
)
from calib.certification.configuration_space_correction_certification import (
    NONE,
    ExtensionBasis,
    ExtensionRequest,
    Tried,
    certify_interpolation_method,
    empty_claim_without_held_out_data,
    extension_in_words,
)
from calib.certification.held_out_pose_error_statistics import draw_mean_square_common_pose_errors
from calib.certification.held_out_pose_errors_and_distinct_configurations import (
    LEAST,
    axis_travel_limits,
    configuration_numbers,
    mean_sample_per_configuration,
    time_block_folds_of_configurations,
)
from calib.certification.platform_certification import FOLDS, Progress, ignore_progress
from calib.correction.correction_tables import CorrectionSummands, correction_summands_by_nearest_axis_values
from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import Field, FieldSamples
from calib.models.arm import arm_error_model_and_instrument_observations
from calib.models.arm.arm_certification import (
    UNPLACED,
    CertifiedArm,
    arm_correction_and_identification,
    placed_nominal_arm,
    start_arm_of_fit,
)
from calib.models.arm.arm_correction import ArmCorrection
from calib.models.arm.arm_error_model_and_instrument_observations import (
    PLAUSIBLE,
    Observations,
    Rank,
    joint_jacobian,
    observations_of_samples,
    parameter_jacobian,
    predicted_target_poses,
)
from calib.models.arm.arm_identification_and_joint_profiles import (
    Identified,
    identify_arm,
    independent_arm_parameter_mask,
)
from calib.models.arm.joint_effect_fit_and_held_out_scatter import (
    held_out_geometry_errors,
    identification_with_held_out_scatter,
    mean_square_arm_errors_caused_by_parameters,
    unexplained_scatter_sentences,
)
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.model.design import Instrument
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.pose import pose_difference
from rig.planning.configuration_generators import FILL, sobol_configurations

PLACES_HELD = 256  # at which a single step is held against the fixed point, and what is promised is worked out


def joint_correction_summands_for_interpolation(samples: Samples, arm: Arm, common_error_draw: Floats) -> FieldSamples:
    """Samples for a field of joint correction summands, rad or m.

    Common errors are removed.
    """
    found = commanded_minus_joint_values_of_measured_poses(samples, arm, common_error_draw)
    return FieldSamples(
        samples.commanded, found.values, np.einsum("mii->mi", found.covariance), mechanism.travel_ranges(arm)
    )


def commanded_minus_joint_values_by_stated_arm(samples: Samples, placed_arm: Arm) -> CorrectionSummands:
    """Commanded minus joint values by the stated arm (CorrectionSummands).

    The joint values are those that give the measured poses.

    They are the joint correction summands. placed_arm : placed as the instrument sees it
    Their covariance includes what all poses share. Raises RigError as `correction_summands_by_nearest_axis_values`
    """
    whole = replace(samples, covariance=samples.total_covariance(), common=samples.common[..., :0])
    return commanded_minus_joint_values_of_measured_poses(whole, placed_arm, np.zeros(0))


def commanded_minus_joint_values_of_measured_poses(
    samples: Samples, arm: Arm, common_error_draw: Floats
) -> CorrectionSummands:
    """Commanded minus joint values of measured poses (CorrectionSummands).

    The nearest joint values that give the poses, rad or m.

    They are the joint correction summands.
    arm : the model; common_error_draw : (j,) draw of the poses' common errors, taken out
    Raises RigError as `correction_summands_by_nearest_axis_values`
    """
    o = observations_of_samples(samples)
    away = np.einsum("mkj,j->mk", o.common, common_error_draw)

    def model(q: Floats) -> tuple[Floats, Floats]:
        now = replace(o, q=q)
        return now.residuals(arm) - away, now.joint_jacobian(arm)

    return correction_summands_by_nearest_axis_values(
        samples.frame, o.q, model, o.covariance, np.full(o.q.shape[1], PLAUSIBLE["rad"])
    )


def certify_arm_correction_extension(
    samples: Samples,
    nominal: Arm,
    instrument: Instrument | None,
    request: ExtensionRequest,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> tuple[CertifiedArm, tuple[Tried, ...]]:
    """Certify an arm's correction extended over the joint space, on held-out configurations.

    Returns (CertifiedArm, methods tried).
    Raises RigError where the way asked for does not take these samples, or where too little of their poses was
        measured; NotEnoughData
    """
    if samples.measured in UNPLACED:
        raise RigError(
            "--extend takes an arm's poses, or its positions, since joint values are computed from them; here "
            f"{UNPLACED[samples.measured]}"
        )
    report = progress or ignore_progress
    label = configuration_numbers(samples.commanded, axis_travel_limits(nominal))
    report("fitting the geometry", 0, 1)
    start = start_arm_of_fit(observations_of_samples(samples), nominal, instrument)

    def geometry(some: Samples) -> tuple[ArmCorrection, Identified]:
        return (
            nominal_arm_correction_and_placement(some, nominal, instrument, start)
            if request.alone
            else arm_correction_and_identification(some, nominal, instrument, False, start)
        )

    whole = geometry(samples)
    correction, found = whole
    report("fitting the geometry", 1, 1)

    def stand(some: Samples) -> ExtensionBasis:
        plain, by = whole if some is samples else geometry(some)
        return ExtensionBasis(
            joint_correction_summands_for_interpolation(some, plain.fitted, by.shared),
            lambda field: replace(plain, extension=field),
            lambda field, at: _mean_square_field_error(field, at, plain.fitted),
        )

    done, tried = certify_interpolation_method(
        samples, (correction.nominal, label, found), stand, request.kind, rng, report
    )
    corrected = replace(correction, extension=done.correction.extension)
    bare = next((one.held_out for one in tried if one.kind == NONE), None)
    found, held = _without(samples, corrected, found, request.alone), done.left
    if held is not None and not request.alone and len(found.scatter) == 6:
        agreed, of_agreed = samples.take(found.inliers), label[found.inliers]
        if corrected.extension is None:  # the geometry as it is, of which more is known
            held = held_out_geometry_errors(found, corrected, agreed, of_agreed)
        else:
            held = replace(
                held,
                parameters=mean_square_arm_errors_caused_by_parameters(
                    found, corrected, agreed, time_block_folds_of_configurations(of_agreed, min(FOLDS, len(agreed)))
                ),
            )
        found = identification_with_held_out_scatter(found, held, rng)
    return CertifiedArm(corrected, found, label, done.held_out, None, bare, held), tried


def nominal_arm_correction_and_placement(
    samples: Samples, nominal: Arm, instrument: Instrument | None, start: Arm
) -> tuple[ArmCorrection, Identified]:
    """Correction of the nominal arm, and its placement: nothing else is fitted.

    Returns (ArmCorrection, Identified)
    """
    o = observations_of_samples(samples)
    arm = placed_nominal_arm(o, nominal, instrument, start)
    return ArmCorrection(arm, arm, (None,) * len(arm.joints), o.q), identified_arm_without_fit(o, arm)


def identified_arm_without_fit(observations: Observations, arm: Arm) -> Identified:
    """Unfitted arm (Identified).

    Nothing is fitted; it says what the arm leaves of observations.
    """
    p, k = 12 + 5 * len(arm.joints), observations.common.shape[1]
    rank = Rank(np.zeros(p, bool), (), 1.0, 0)
    return Identified(
        arm,
        np.zeros((p, p)),
        rank.free,
        rank,
        np.zeros(observations.common.shape[2]),
        observations.residuals(arm),
        np.zeros(k),
        np.ones(len(observations), bool),
        0,
    )


def _mean_square_field_error(field: Field, samples: Samples, arm: Arm) -> float:
    """m^2, mean square by which a Field says that positions of samples may be off."""
    J = arm_error_model_and_instrument_observations.joint_jacobian(samples.commanded, arm)[:, :3]
    return float((J**2 @ (field.error(samples.commanded) ** 2)[..., None]).sum(axis=1).mean())


def _without(samples: Samples, correction: ArmCorrection, found: Identified, alone: bool) -> Identified:
    """The Identified once the extension is taken off: what that corrects is no scatter and widens no parameter."""
    o = observations_of_samples(samples)
    effective = replace(o, q=o.q - correction.rho(o.q))
    if alone or correction.extension is None:
        return replace(
            found, residuals=effective.residuals(correction.fitted) - np.einsum("mkj,j->mk", o.common, found.shared)
        )
    repeated = identify_arm(
        effective, correction.fitted, independent_arm_parameter_mask(correction.nominal, effective.kind)
    )
    return replace(repeated, arm=found.arm, rank=found.rank)


def claim_without_geometry(samples: Samples, certified: CertifiedArm, rng: np.random.Generator) -> Claim:
    """Claim of an arm's correction without fitted geometry.

    Its field's error estimate at the middle angles.
    """
    correction = certified.correction
    each = mean_sample_per_configuration(
        samples,
        certified.label,
        arm_error_model_and_instrument_observations.joint_jacobian(samples.commanded, correction.fitted),
    )
    information = ConfigurationInformation(
        len(each), 0, 0, 0, f"no parameters were fitted: the summands are extended by {extension_in_words(correction)}"
    )
    middle = f"the middle {FILL * 100:.0f} % of the recorded angles, all joints independent"
    if len(each) < LEAST:
        return empty_claim_of_too_few_configurations(information, middle)
    q = configurations_evenly_over_visited_joint_ranges(correction)
    T = correction.predict(q)
    if certified.left is None:
        return empty_claim_without_held_out_data(information, middle)
    stated = float(
        mean_square_pose_errors_stated_by_extension(
            correction, q, arm_error_model_and_instrument_observations.joint_jacobian(q, correction.fitted)
        )[0]
    )
    own = certified.left.own_draws(stated, DRAWS, rng) + draw_mean_square_common_pose_errors(samples, DRAWS, rng)
    offset = pose_difference(
        arm_error_model_and_instrument_observations.predicted_target_poses(q, correction.nominal), T
    )
    known = certified.found.covariance  # of what an earlier pass left
    draws = np.zeros((DRAWS, len(known)))
    if known.any():
        draws = rng.multivariate_normal(np.zeros(len(known)), known, DRAWS, method="eigh")
    return claim_from_machine_draws(
        Workspace(
            arm_error_model_and_instrument_observations.parameter_jacobian(q, correction.fitted), offset, own, middle
        ),
        draws,
        each,
        information,
        rng,
    )


def rms_and_greatest_joint_single_step_error(correction: ArmCorrection) -> tuple[float, float]:
    """Errors (RMS, greatest) rad or m of joints corrected in a single step.

    X + KSF(X) instead of to the fixed point.
    Source: configuration-space patent, [0030], [0091]
    """
    q = configurations_evenly_over_visited_joint_ranges(correction)
    x = q - _summand(correction, q)
    near = np.isfinite(x).all(axis=1)
    off = mechanism.joint_value_difference(x[near] + _summand(correction, x[near]), q[near], correction.nominal)
    return float(np.sqrt(np.nanmean(off**2))), float(np.nanmax(np.abs(off)))


def _summand(correction: ArmCorrection, q: Floats) -> Floats:
    """KSF (m, joints) of the correction at commands q (m, joints); NaN where no way from them leads to the pose by the
    nominal model: of a stretched arm it lies beyond its reach by micrometres, or on another branch."""
    if correction.deficient:
        return correction.summand(q)
    found, rest = mechanism.damped_least_squares_arm_inverse_and_error(
        correction.predict(q), correction.nominal, q, starts=0
    )
    return np.where(
        (rest <= mechanism.GOOD)[:, None], mechanism.joint_value_difference(q, found, correction.nominal), np.nan
    )


def configurations_evenly_over_visited_joint_ranges(correction: ArmCorrection) -> Floats:
    """Configurations (m, joints) rad or m, evenly over visited joint ranges.

    They are over the middle of the values visited.
    """
    seen = np.stack([correction.visited.min(axis=0), correction.visited.max(axis=0)], axis=1)
    return sobol_configurations(seen, PLACES_HELD, FILL)


def arm_workspace_claim(samples: Samples, certified: CertifiedArm, rng: np.random.Generator) -> Claim:
    """Claim of a certified arm over its workspace.

    It is that of recorded joint angles, each configuration once.
    """
    found, correction = certified.found, certified.correction
    good = found.inliers
    if samples.measured in UNPLACED:
        fitted = int(found.rank.free.sum())
        return Claim(
            int(certified.label.max()) + 1,
            fitted,
            fitted,
            found.rank.requested,
            "all determined parameters are fitted without one",
            "none",
            None,
            None,
            None,
            None,
            UNPLACED[samples.measured],
        )
    retained, hands = samples.take(good), max(len(found.arm.hands), 1)
    numbers = certified.label[good] * hands + (0 if retained.hand is None else retained.hand)
    label = np.unique(numbers, return_inverse=True)[1]
    each = mean_sample_per_configuration(retained, label, joint_jacobian(retained.commanded, found.arm, retained.hand))
    words = f"the middle {FILL * 100:.0f} % of the recorded angles, all joints independent"
    fitted = int(found.rank.free.sum())
    configurations = len(np.unique(certified.label[good]))
    information = ConfigurationInformation(
        configurations, fitted, fitted, found.rank.requested, "all determined parameters are fitted without one"
    )
    if certified.held_out is None:
        return empty_claim_of_too_few_configurations(information, words)
    seen = np.stack([each.commanded.min(axis=0), each.commanded.max(axis=0)], axis=1)
    q = sobol_configurations(seen, PLACES, FILL)
    hand = None if retained.hand is None else np.arange(len(q)) % hands  # the hands in turn
    moved = q + _linear_part_of_known_physics(samples, q)
    T = (
        correction.predict(moved)
        if hand is None
        else predicted_target_poses(moved - correction.rho(q), correction.fitted, hand)
    )
    stated = mean_square_pose_errors_stated_by_extension(correction, q, joint_jacobian(q, found.arm, hand))
    own = certified.left.own_draws(float(stated[0]), DRAWS, rng) if certified.left is not None else stated
    workspace = Workspace(
        parameter_jacobian(q, correction.fitted, hand),
        pose_difference(predicted_target_poses(q, correction.nominal, hand), T),
        own,
        words,
    )
    observed = observations_of_samples(each)
    free = independent_arm_parameter_mask(
        correction.nominal, observed.kind
    )  # of the figures stated: axes found a little off parallel tell no more
    repeated = identify_arm(replace(observed, q=observed.q - correction.rho(observed.q)), correction.fitted, free)
    whitened = np.linalg.solve(
        np.linalg.cholesky(observed.covariance + np.diag(repeated.scatter**2)), repeated.residuals[..., None]
    )[repeated.inliers]
    freedom = max(whitened.size - int(repeated.rank.free.sum()), 1)
    draws = rng.multivariate_normal(np.zeros(len(repeated.covariance)), repeated.covariance, DRAWS, method="eigh")
    draws *= np.sqrt(draw_variance_ratio(float((whitened**2).sum()), freedom, DRAWS, rng))[:, None]
    return replace(
        claim_from_machine_draws(workspace, draws, each, information, rng),
        unexplained=unexplained_scatter_sentences(repeated.scatter, observed.covariance),
    )


def _linear_part_of_known_physics(samples: Samples, q: Floats) -> Floats:
    """(m, axes) m or rad that known physics adds at commands q (m, axes), as far as it is linear in the commands.

    Geometry and physics may exchange that much of each other, as squareness and a coupling of two slides do: without it
    the geometry alone would be another machine than the one that was measured.
    """
    if samples.known is None:
        return np.zeros_like(q)
    middle = samples.commanded.mean(axis=0)
    visited = np.column_stack([np.ones(len(samples)), samples.commanded - middle])
    linear = np.linalg.lstsq(visited, samples.known, rcond=None)[0]
    return np.asarray(np.column_stack([np.ones(len(q)), q - middle]) @ linear)
