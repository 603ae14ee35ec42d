"""Certification of an arm's calibration.

Stretches are held out in turn.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.held_out_pose_error_statistics import (
    HeldErrors,
    HeldOut,
    compare_errors,
    errors_before_and_after_correction,
    is_significant_gain,
    mean_square_held_out_errors_by_configuration,
)
from calib.certification.held_out_pose_errors_and_distinct_configurations import (
    LEAST,
    axis_travel_limits,
    configuration_numbers,
    time_block_folds_of_configurations,
)
from calib.certification.platform_certification import Progress, ignore_progress
from calib.identify.bounded_and_robust_least_squares_fit import CONSISTENT, MOST, isolated_outlier_rows
from calib.models.arm import arm_error_model_and_instrument_observations, arm_identification_and_joint_profiles
from calib.models.arm.arm_base_and_tool_placement_in_instrument_frame import place_base_and_tool_of_arm
from calib.models.arm.arm_correction import ArmCorrection
from calib.models.arm.arm_error_model_and_instrument_observations import (
    KINDS,
    PLAUSIBLE,
    Observations,
    observations_of_samples,
)
from calib.models.arm.arm_identification_and_joint_profiles import (
    GATE,
    Identified,
    identify_arm,
    independent_arm_parameter_mask,
    require_enough_observations,
)
from calib.models.arm.joint_effect_fit_and_held_out_scatter import (
    JointFit,
    held_out_geometry_errors,
    identification_with_held_out_scatter,
    mean_square_arm_errors_caused_by_parameters,
)
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.model.design import Instrument
from rig.model.mechanism_geometry_classes import Arm

STRETCHES = 30  # in time; every third is held out at once, so a third of the samples, and each sample once
PARTS = 3
FEW = 30  # configurations below which one at a time is held out, or a tenth of them
ROUNDS = 2  # of fitting the geometry and the profiles in turn
UNPLACED = {
    "orientation": "orientations alone were measured, which do not determine lengths and positions",
    "distance": "a wire's length alone was measured, which does not determine how the arm's base is turned",
    "direction": "directions alone were measured, which do not determine lengths and positions",
}


@dataclass(frozen=True, slots=True, eq=False)
class CertifiedArm:
    """correction : ArmCorrection of all samples; found : Identified, its geometry; label : (n,) configuration of each
    sample
    held_out : HeldOut on whole stretches, physics refitted without them; scattered : the same on single rows drawn at
    random, which flatter, since neighbours in time share their errors; geometry : on whole stretches, by the geometry
    alone, without physics; left : HeldErrors of held_out; all None where there are too few configurations to hold any
    out"""

    correction: ArmCorrection
    found: Identified
    label: Integers
    held_out: HeldOut | None
    scattered: HeldOut | None
    geometry: HeldOut | None
    left: HeldErrors | None = None


class _PredictionMethod(NamedTuple):
    """How held-out poses are predicted: with the identified effects, with joint profiles on top."""

    physics: bool
    profiles: bool


def certify_arm(
    samples: Samples,
    nominal: Arm,
    instrument: Instrument | None,
    rng: np.random.Generator,
    progress: Progress | None = None,
    physics: JointFit | None = None,
) -> CertifiedArm:
    """Certified arm.

    It has its geometry, and joint profiles only where they improve held-out errors.
    samples : Samples as measured; nominal : Arm as its owner believes it; instrument : Instrument or None (poses in the
        rig's own frames)
    rng : numpy Generator, for the random rows and the bootstrap; progress : called with (label, done, of), or None
    physics : JointFit of what was found, which then is part of the model, or None
    Raises NotEnoughData, RigError as `calibrate`
    """
    report = progress or ignore_progress
    label = configuration_numbers(samples.commanded, axis_travel_limits(nominal))
    parts = _parts(label)
    report("fitting the geometry", 0, 1)
    _enough_for_any(samples, nominal)
    start = start_arm_of_fit(
        observations_of_samples(samples), nominal, instrument
    )  # a basin, not a fit: the folds' own fits forget it
    known = samples if physics is None else physics.samples
    correction, found = arm_correction_and_identification(known, nominal, instrument, False, start)
    report("fitting the geometry", 1, 1)
    if not _enough(samples, found, label, parts):
        return CertifiedArm(correction, found, label, None, None, None)
    in_part, requested = samples.measured in UNPLACED, physics is not None
    ways = [_PredictionMethod(requested, profiles) for profiles in ((False,) if in_part else (False, True))] + [
        _PredictionMethod(False, False)
    ] * requested
    good = _counted(found, samples)
    retained, retained_label = samples.take(good), label[good]
    errors = {
        method: (before[good], after[good])
        for method, (before, after) in zip(
            ways, _held_out((samples, physics), nominal, instrument, (parts, start), ways, report)
        )
    }
    plain = errors[ways[0]]
    full = plain if in_part else errors[ways[1]]
    scale = 1.0 if in_part else _spread(plain[1])
    loss = [np.nansum((e / scale) ** 2, axis=1) for e in (plain[1], full[1])]
    profiled = not in_part and is_significant_gain(loss[0] - loss[1])
    rows = rng.permutation(np.arange(len(samples)) % (parts.max() + 1))
    ((before, after),) = _held_out(
        (samples, physics), nominal, instrument, (rows, start), [_PredictionMethod(requested, profiled)], report
    )
    if profiled:
        correction, found = _profiled(known, correction, found)
    covariance, best = retained.total_covariance(), full if profiled else plain
    held, drawn, bare = (
        compare_errors(*each, covariance, rng, retained_label)
        for each in (best, (before[good], after[good]), errors[_PredictionMethod(False, False)])
    )
    agreed, whole = samples.take(found.inliers), len(found.scatter) == 6
    if (
        whole and not profiled and physics is None
    ):  # few numbers, fitted to all: what they took into themselves is known
        left = held_out_geometry_errors(found, correction, agreed, label[found.inliers])
    else:
        own = (
            mean_square_arm_errors_caused_by_parameters(found, correction, agreed, parts[found.inliers])
            if whole
            else np.zeros(2)
        )
        left = mean_square_held_out_errors_by_configuration(
            best[1] - _shared_errors(retained, found.shared), retained, retained_label, 0.0, own
        )
    return CertifiedArm(
        correction,
        _as_stated(identification_with_held_out_scatter(found, left, rng), samples.measured),
        label,
        held,
        drawn,
        bare,
        left,
    )


def _counted(found: Identified, samples: Samples) -> Booleans:
    """(n,) bool, samples that count where they are held out: all but those that agree with no geometry and no
    neighbour, where these are few.
    """
    sigma = np.sqrt(np.einsum("mkk->mk", observations_of_samples(samples).covariance) + found.scatter**2)
    relative = found.residuals / sigma
    relative = relative / np.maximum(1.0, CONSISTENT * np.median(np.abs(relative), axis=0))
    wild = ~found.inliers & isolated_outlier_rows(relative, samples.t, samples.commanded, GATE)
    return ~wild if wild.mean() <= MOST else np.ones(len(samples), bool)


def _shared_errors(samples: Samples, shared: Floats) -> Floats:
    """(n, 6) m and rad by which what all poses share moves each. shared : (j,) draw of it, as a fit has it"""
    return (
        np.einsum("nik,k->ni", samples.common, shared)
        if len(shared) == samples.common.shape[2]
        else np.zeros((len(samples), 6))
    )


def _as_stated(found: Identified, measured: str) -> Identified:
    """What was found of an arm measured in part: what nothing tells is as uncertain as a maker's figures are."""
    if measured not in UNPLACED:
        return found
    untold = independent_arm_parameter_mask(found.arm, "pose") & ~found.rank.free
    covariance = found.covariance + np.diag(
        np.where(
            untold,
            [PLAUSIBLE[unit] ** 2 for unit in arm_error_model_and_instrument_observations.parameter_units(found.arm)],
            0.0,
        )
    )
    turned = {"orientation": (3, 0), "direction": (3, 1)}  # numbers of a pose before and after those measured
    scatter = np.pad(found.scatter, turned[measured]) if measured in turned else np.repeat(found.scatter, 3)
    return replace(found, covariance=covariance, scatter=scatter)


def _parts(label: Integers) -> Integers:
    """(n,) part of each sample: every third stretch of the configurations (n,) at once; of few configurations, one by
    one or a tenth.
    """
    count = label.max() + 1
    return time_block_folds_of_configurations(label, min(STRETCHES, count)) % (
        PARTS if count >= FEW else min(count, 10)
    )


def _enough_for_any(samples: Samples, nominal: Arm) -> None:
    """Raises NotEnoughData, with how many it takes, for samples too few to fit the arm at all."""
    kind = observations_of_samples(samples).kind
    require_enough_observations(len(samples), KINDS[kind], int(independent_arm_parameter_mask(nominal, kind).sum()))


def _enough(samples: Samples, found: Identified, label: Integers, parts: Integers) -> bool:
    """Whether there are LEAST configurations, and more equations than parameters without the largest part."""
    left = len(samples) - np.bincount(parts).max()
    return label.max() + 1 >= LEAST and left * found.residuals.shape[1] > found.rank.requested


def arm_correction_and_identification(
    samples: Samples, nominal: Arm, instrument: Instrument | None, profiles: bool, start: Arm | None = None
) -> tuple[ArmCorrection, Identified]:
    """Arm calibrated on samples: (ArmCorrection, Identified).

    profiles : whether joint profiles are fitted
    start : Arm, as `start_arm_of_fit` has it where None. Raises what `identify_arm` raises
    """
    plain = _geometry(samples, nominal, instrument, start)
    return _profiled(samples, *plain) if profiles else plain


def _geometry(
    samples: Samples, nominal: Arm, instrument: Instrument | None, start: Arm | None
) -> tuple[ArmCorrection, Identified]:
    """The same by the geometry alone."""
    observations = observations_of_samples(samples)
    start = start_arm_of_fit(observations, nominal, instrument) if start is None else start
    found = identify_arm(observations, start)
    owners = placed_nominal_arm(
        observations_of_samples(replace(samples, known=None)), nominal, instrument, start
    )  # it knows of no physics
    return ArmCorrection(owners, found.arm, (None,) * len(nominal.joints), samples.commanded), found


def _profiled(samples: Samples, correction: ArmCorrection, found: Identified) -> tuple[ArmCorrection, Identified]:
    """The same with joint profiles on top of what `_geometry` found, geometry and profiles in turn."""
    observations, parts = observations_of_samples(samples), correction.remainder
    for _ in range(ROUNDS):
        left = observations.residuals(found.arm) - np.einsum("mkj,j->mk", observations.common, found.shared)
        parts = arm_identification_and_joint_profiles.fit_joint_profiles(observations, replace(found, residuals=left))
        if not any(parts):
            break
        effective = observations.q - replace(correction, remainder=parts).rho(observations.q)
        found = identify_arm(
            replace(observations, q=effective),
            found.arm,
            independent_arm_parameter_mask(correction.nominal, observations.kind),
        )
    return replace(correction, fitted=found.arm, remainder=parts), found


def start_arm_of_fit(observations: Observations, nominal: Arm, instrument: Instrument | None) -> Arm:
    """Arm at which a fit starts.

    It is nominal, with base and tool as placed by the observations.
    """
    if instrument is None:
        return nominal
    return place_base_and_tool_of_arm(observations, nominal, instrument.base == "free", instrument.tool == "free")


def placed_nominal_arm(observations: Observations, nominal: Arm, instrument: Instrument | None, start: Arm) -> Arm:
    """Nominal arm placed in the instrument's frame.

    Nothing else is fitted.
    start : Arm of `start_arm_of_fit`
    """
    if instrument is None or "free" not in (instrument.base, instrument.tool):
        return nominal
    free, placed = np.zeros(len(arm_error_model_and_instrument_observations.parameter_names(nominal)), bool), nominal
    free[:6] = instrument.base == "free"
    for k in range(max(len(nominal.hands), 1)):
        placed = replace(placed, hand=k).with_ends(start.base, replace(start, hand=k).tool)
        free[arm_error_model_and_instrument_observations.tool_parameter_slice(placed)] = instrument.tool == "free"
    return identify_arm(observations, replace(placed, hand=nominal.hand), free, np.inf).arm


def corrected_arm_pose_covariance(calibration: Calibration, commands: Floats) -> Floats:
    """Covariance (m, 6, 6) of the corrected arm's pose at commands (m, joints) rad.

    By its parameters, scatter, maps and extension.

    docs/mathematics.md (21)
    """
    correction = calibration.correction
    J = arm_error_model_and_instrument_observations.parameter_jacobian(commands, correction.fitted)
    known = np.arange(6) < len(
        calibration.scatter
    )  # of rotations that were never measured, nothing is known beyond the parameters
    covariance = J @ calibration.covariance @ np.swapaxes(J, 1, 2) + np.diag(
        np.resize(calibration.scatter, 6) ** 2 * known
    )
    if correction.posed:
        covariance = covariance + correction.pose_map_covariance(correction.predict(commands))
    if correction.extension is None:
        return covariance
    joints = arm_error_model_and_instrument_observations.joint_jacobian(commands, correction.fitted)
    return covariance + (joints * correction.extension.error(commands)[:, None] ** 2) @ np.swapaxes(joints, 1, 2)


def _held_out(
    known: tuple[Samples, JointFit | None],
    nominal: Arm,
    instrument: Instrument | None,
    plan: tuple[Integers, Arm],
    ways: list[_PredictionMethod],
    progress: Progress,
) -> list[tuple[Floats, Floats]]:
    """(before, after), (n, 6) each, of parts held out in turn, in each of the ways asked for."""
    (samples, physics), (part, start) = known, plan
    out = [(np.empty((len(samples), 6)), np.empty((len(samples), 6))) for _ in ways]
    for k in np.unique(part):
        samples_by_physics = {False: samples} if physics is None else {False: samples, True: physics.without(part == k)}
        plain = {
            with_physics: _geometry(samples_by_physics[with_physics].take(part != k), nominal, instrument, start)
            for with_physics in {method.physics for method in ways}
        }
        for (before, after), (requested, profiled) in zip(out, ways):
            correction, found = plain[requested]
            if profiled:
                correction, _ = _profiled(samples_by_physics[requested].take(part != k), correction, found)
            before[part == k], _ = errors_before_and_after_correction(correction, samples.take(part == k))
            _, after[part == k] = errors_before_and_after_correction(
                correction, samples_by_physics[requested].take(part == k)
            )
        progress(
            "cross-validating configurations"
            + (", joints corrected" if any(method.profiles for method in ways) else ""),
            int(k) + 1,
            part.max() + 1,
        )
    return out


def _spread(errors: Floats) -> Floats:
    """(6,) a robust scale of positions and of rotations, for comparing two fits."""
    return np.repeat([np.median(np.abs(errors[:, part])) for part in (slice(0, 3), slice(3, 6))], 3) + 1e-15
