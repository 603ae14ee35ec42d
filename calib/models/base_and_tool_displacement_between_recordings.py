"""Displacement of base and tool between recordings.

Of an arm or chain: where they stand in a further recording, estimated against a reference.

A robot stationed anew or a tracker that was moved displaces all poses of a recording by one rigid motion on the left; a
probe that was remounted, by one on the right. Six numbers each are estimated by robust least squares, linear about
where they stand, with the geometry where that is fitted as well. What they take of the noise is given back.
Source: docs/mathematics.md (6), (21); Cook and Weisberg, Residuals and Influence in Regression, 1982, section 2.1
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.models.arm import arm_error_model_and_instrument_observations as arms
from calib.models.base_and_tool_placement import ALIKE, ENDS, LOOSE, Placement, p_value_of_displacement
from calib.models.chain import chain_error_model_and_identification as chains
from calib.samples.commanded_and_measured_pose_samples import Samples
from calib.samples.freely_placed_instrument_poses_combined_with_tilts import (
    are_base_and_tool_frames_unknown,
    has_translation_only_platform,
    poses_aligned_with_machine,
)
from rig.array_and_json_types import Booleans, Floats
from rig.model.design import Instrument
from rig.model.mechanism_geometry_classes import Arm, Chain
from rig.model.mechanisms import kinematics_of
from rig.model.pose import adjoint, align_poses, pose_to_vector, skew
from rig.recording.recording_folder import Recording

CLEAR = 2.0  # times what it leaves; a displacement that does less may be what the model leaves out
HUBER = 3.0  # standard deviations, beyond which a pose counts less
STEPS = 30
SETTLED = 1e-9  # m, rad
FEWEST = 8  # poses from which a placement is estimated
NONE = RigidTransform.identity()


def pose_jacobian_by_base_and_tool_placement(predicted: RigidTransform, origin: Floats) -> Floats:
    """Pose Jacobian (n, 6, 12) by base and tool placement.

    Tangents of predicted poses (n,) per step of base and tool, in the predicted frames.
    """
    back = np.swapaxes(predicted.rotation.as_matrix(), 1, 2)
    out = np.zeros((len(back), 6, 12))
    out[:, :3, :3] = out[:, 3:, 3:6] = back
    out[:, :3, 3:6] = -back @ skew(predicted.translation - origin)
    out[:, :, 6:] = np.eye(6)
    return out


def samples_as_measured_in_reference(samples: Samples, placement: Placement, predicted: RigidTransform) -> Samples:
    """Samples as they would have been measured in the reference.

    predicted : (n,) poses there, whose rotations stand for those that positions alone do not tell
    """
    T = placement.undone(samples.T_base_platform)
    covariance, common = samples.covariance, samples.common
    if samples.measured == "position":
        position = (placement.motion.inv() * samples.T_base_platform).translation
        T = RigidTransform.from_translation(position - predicted.rotation.apply(placement.tool.translation))
    elif placement.ends[1]:
        turned = adjoint(placement.tool)
        covariance, common = turned @ covariance @ turned.T, turned @ common
    below = tuple(replace(one, T_base_stage=placement.motion.inv() * one.T_base_stage) for one in samples.below)
    return replace(samples, T_base_platform=T, covariance=covariance, common=common, below=below)


class _White(NamedTuple):
    """left : (n, k) whitened residuals; columns : (n, k, 12), 0 of what was not asked for; weight : (n,)
    W : (n, k, k), what whitens
    """

    left: Floats
    columns: Floats
    weight: Floats
    W: Floats


def _white(predicted: RigidTransform, samples: Samples, placement: Placement, scatter: Floats) -> _White:
    """Whitened residuals and columns of samples about a placement. scatter : (6,) m, rad beyond the poses' noise"""
    moved = samples_as_measured_in_reference(samples, placement, predicted)
    rows = 3 if samples.measured == "position" else 6
    left = pose_to_vector(predicted.inv() * moved.T_base_platform)[:, :rows]
    covariance = moved.total_covariance()[:, :rows, :rows] + np.diag(scatter[:rows] ** 2)
    W = np.linalg.inv(np.linalg.cholesky(covariance))
    W_columns = W @ pose_jacobian_by_base_and_tool_placement(predicted, placement.origin)[:, :rows]
    left = (W @ left[..., None])[..., 0]
    size = np.sqrt((left**2).mean(axis=1))
    weight = np.minimum(1.0, HUBER * max(1.0, float(np.median(size))) / np.maximum(size, 1e-12))
    return _White(left, W_columns * estimated_placement_parameter_mask(placement.ends, samples.measured), weight, W)


def estimated_placement_parameter_mask(ends: tuple[bool, bool], measured: str) -> Booleans:
    """Mask (12,) of the placement parameters that are estimated.

    They are six of the base and six of the tool.
    Positions tell no rotation of the tool.
    """
    return np.repeat([ends[0], ends[0], ends[1], ends[1] and measured == "pose"], 3)


def estimate_placement(
    predicted: RigidTransform, samples: Samples, origin: Floats, scatter: Floats, ends: tuple[bool, bool]
) -> Placement:
    """Estimated placement of the ends asked for.

    By samples (n,) against predicted poses (n,), wherever they stand.
    origin : (3,) m, where the base stood; scatter : (6,) m, rad beyond the poses' noise
    Its covariance is that of the noise, enlarged where the poses scatter by more
    """
    turn = predicted.rotation.mean().as_matrix()
    centre = predicted.translation.mean(axis=0)
    none = Placement(NONE, NONE, origin, np.zeros((12, 12)), ends, centre=centre, turn=turn)
    starts = [
        none,
        *(_aligned(predicted, samples, none, free) for free in ((True, False), (False, True), (True, True))),
    ]
    starts = [one for one in starts if all(end_requested or not used for end_requested, used in zip(ends, one.ends))]

    def far(one: Placement) -> float:
        T = one.undone(samples.T_base_platform)
        return float(np.median(np.linalg.norm(T.translation - predicted.translation, axis=1)))

    found = replace(min(starts, key=far), ends=ends)
    prior = np.eye(12) / LOOSE**2
    for _ in range(STEPS):
        white = _white(predicted, samples, found, scatter)
        A = white.columns * white.weight[:, None, None]
        H = np.einsum("nka,nkb->ab", A, white.columns) + prior
        step = np.linalg.solve(H, np.einsum("nka,nk->a", A, white.left))
        found = found.stepped(step)
        if np.abs(step).max() < SETTLED:
            break
    requested = estimated_placement_parameter_mask(ends, samples.measured)
    freedom = max(white.left.size - int(requested.sum()), 1)
    excess = max(1.0, float(((white.weight[:, None] * white.left) ** 2).sum()) / freedom)
    return replace(found, covariance=np.linalg.inv(H) * excess * np.outer(requested, requested))


def _aligned(predicted: RigidTransform, samples: Samples, none: Placement, ways: tuple[bool, bool]) -> Placement:
    """Placement by which poses, or positions, agree best, the others where they stand."""
    base, tool = align_poses(predicted, samples.T_base_platform, ways, 6 if samples.measured == "pose" else 3)
    to_origin = RigidTransform.from_translation(none.origin)
    return replace(none, base=to_origin.inv() * base * to_origin, tool=tool, ends=ways)


def placement_with_significant_displacements(placement: Placement, always: tuple[bool, bool], clear: bool) -> Placement:
    """Placement with significant displacements of base and tool.

    They have moved by more than chance, or are always asked for.
    always : whether base and tool are placed anew in each recording, as far as anybody states
    clear : whether a displacement does CLEAR times as much as it leaves; else only an end of `always` is asked for
    The ends are to be estimated once more where these are fewer than both
    """
    moved, p = np.r_[pose_to_vector(placement.base), pose_to_vector(placement.tool)], [1.0, 1.0]
    whole = _chance(moved, placement.covariance)
    alone = [_chance(moved[6:], placement.covariance[6:, 6:]), _chance(moved[:6], placement.covariance[:6, :6])]
    if whole < ALIKE:
        p = [alone[1], alone[0]] if max(alone) < ALIKE else [whole, 1.0] if alone[0] >= alone[1] else [1.0, whole]
    ends = tuple(always[k] or (p[k] < ALIKE and clear) for k in range(2))
    return replace(placement, ends=(ends[0], ends[1]), p_values=(p[0] if ends[0] else 1.0, p[1] if ends[1] else 1.0))


def _chance(moved: Floats, covariance: Floats) -> float:
    """Probability of a displacement by chance, of its numbers that were estimated."""
    some = np.diag(covariance) > 0
    if not some.any():
        return 1.0
    return p_value_of_displacement(moved[some], covariance[np.ix_(some, some)])


def is_placement_significant(
    predicted: RigidTransform, samples: Samples, placement: Placement, scatter: Floats
) -> bool:
    """Whether a placement is significant.

    It does CLEAR times as much to the whitened poses as it leaves.
    predicted : (n,) poses in the reference; scatter : (6,) m, rad beyond the poses' noise
    """
    none = replace(placement, base=NONE, tool=NONE)
    before, after = (_white(predicted, samples, one, scatter) for one in (none, placement))
    gone = float((before.weight[:, None] * before.left**2).sum())
    left = float((after.weight[:, None] * after.left**2).sum())
    return gone - left > CLEAR**2 * left


def has_base_and_tool_placements(mechanism: object, measured: str) -> bool:
    """Whether base and tool placements are estimated of a machine.

    Of arms and chains by poses, or by positions alone.
    """
    return isinstance(mechanism, (Arm, Chain)) and measured in ("pose", "position")


def base_origin(mechanism: Arm | Chain) -> Floats:
    """Origin (3,) m of an arm's or a chain's base in the frame in which its poses are given."""
    first = mechanism.stages[0] if isinstance(mechanism, Chain) else mechanism
    return first.base.translation if isinstance(first, Arm) else np.zeros(3)


def target_poses_by_forward_kinematics(samples: Samples, machine: Arm | Chain) -> RigidTransform:
    """Target poses (n,) by a machine's forward kinematics at the samples' effective commands."""
    return kinematics_of(machine).forward(samples.effective, machine)


@dataclass(frozen=True, slots=True, eq=False)
class PlacedSamples:
    """samples : in the calibration's frames; placement : Placement that was removed, None where none was
    lines : what is stated of it; unexpected : ends that stand elsewhere though their place is stated"""

    samples: Samples
    placement: Placement | None = None
    lines: tuple[str, ...] = ()
    unexpected: tuple[str, ...] = ()


def samples_without_displacement(calibration: Calibration, recording: Recording, samples: Samples) -> PlacedSamples:
    """Samples (PlacedSamples) with the displacement of base and tool removed.

    As far as these are free or stand elsewhere.
    samples : of the recording, as measured; those returned are with the physics that is known
    What the numbers take of the noise is given back: residuals are enlarged by the share of it, of positions and of
    rotations apart. The interval of the displacement includes the calibration's own uncertainty
    """
    known = calibration.with_physics(recording, samples)
    placed = placed_samples(calibration, known, recording.design.instrument)
    return replace(placed, samples=calibration.with_physics(recording, placed.samples))


def placed_samples(calibration: Calibration, samples: Samples, instrument: Instrument | None) -> PlacedSamples:
    """PlacedSamples of samples with the physics that is known. instrument : as rig.toml states it, or None"""
    nominal, fitted = calibration.correction.nominal, calibration.correction.fitted
    ends = are_base_and_tool_frames_unknown(instrument, nominal)
    if any(ends):
        predicted = calibration.correction.predict(samples.effective)
        level = has_translation_only_platform(nominal)
        T, turn, line = poses_aligned_with_machine(samples.T_base_platform, predicted, ends, level)
        own, common = turn @ samples.covariance @ turn.T, turn @ samples.common
        return PlacedSamples(replace(samples, T_base_platform=T, covariance=own, common=common), lines=(line,))
    if not has_base_and_tool_placements(fitted, samples.measured):
        return PlacedSamples(samples)
    assert isinstance(fitted, (Arm, Chain))
    always = (
        instrument is not None and instrument.base == "free",
        instrument is not None and instrument.tool == "free",
    )
    if len(samples) < FEWEST:
        few = f"the place of base and tool is not estimated from {len(samples)} poses; minimum {FEWEST}"
        return PlacedSamples(samples, lines=(few,) if any(always) else ())
    predicted, scatter = calibration.correction.predict(samples.effective), np.resize(calibration.scatter, 6)
    origin = base_origin(fitted)

    def estimated(ends: tuple[bool, bool]) -> Placement:
        """Placement whose covariance has what the calibration and the errors that all poses share leave uncertain."""
        one = estimate_placement(predicted, samples, origin, scatter, ends)
        shared = _by_shared_errors(calibration, fitted, samples, predicted, one)
        return replace(one, covariance=one.covariance + shared)

    both = estimated((True, True))
    tested = placement_with_significant_displacements(
        both, always, is_placement_significant(predicted, samples, both, scatter)
    )
    if not any(tested.ends):
        return PlacedSamples(samples)
    found = both
    if not all(tested.ends):
        found = estimated(tested.ends)
    found = replace(found, ends=tested.ends, p_values=tested.p_values)
    moved = samples_as_measured_in_reference(samples, found, predicted)
    white = _white(predicted, samples, found, scatter)
    A = white.columns * white.weight[:, None, None]
    hat = np.linalg.inv(np.einsum("nka,nkb->ab", A, white.columns) + np.eye(12) / LOOSE**2)
    explained = np.einsum("nka,ab,nkb->nk", A, hat, white.columns)
    count = white.left.shape[1]
    share = np.repeat([explained[:, part].mean() for part in (slice(0, 3), slice(3, 6)) if part.start < count], 3)
    grown = np.ones(6)
    grown[:count] = 1 / np.sqrt(1 - np.minimum(share, 0.9))
    left = pose_to_vector(predicted.inv() * moved.T_base_platform) * grown
    T = predicted * RigidTransform.from_components(left[:, :3], Rotation.from_rotvec(left[:, 3:]))
    if samples.measured == "position":
        T = RigidTransform.from_translation(T.translation)
    unexpected = tuple(name for name, moved_, free in zip(ENDS, found.moved, always) if moved_ and not free)
    numbers = int(estimated_placement_parameter_mask(found.ends, samples.measured).sum())
    lines = [
        *found.lines(),
        f"the errors are without this: {numbers} numbers were estimated from these {len(samples)} poses, and what they "
        "took of the noise is given back",
    ]
    return PlacedSamples(replace(moved, T_base_platform=T), found, tuple(lines), unexpected)


def _by_shared_errors(
    calibration: Calibration, fitted: Arm | Chain, samples: Samples, predicted: RigidTransform, found: Placement
) -> Floats:
    """(12, 12) covariance of a placement by the uncertainty of the calibration's parameters, and by the errors that the
    poses share, as of cameras: these are other ones than when it was calibrated.
    """
    q = samples.effective
    J = arms.parameter_jacobian(q, fitted) if isinstance(fitted, Arm) else chains.parameter_jacobian(q, fitted)
    white = _white(predicted, samples, found, np.resize(calibration.scatter, 6))
    J = white.W @ J[:, : white.left.shape[1]]
    H = np.einsum("nka,nkb->ab", white.columns, white.columns) + np.eye(12) / LOOSE**2
    G = np.linalg.solve(H, np.einsum("nka,nkp->ap", white.columns, J))
    common = samples_as_measured_in_reference(samples, found, predicted).common[:, : white.left.shape[1]]
    B = np.linalg.solve(H, np.einsum("nka,nkc->ac", white.columns, white.W @ common))
    requested = estimated_placement_parameter_mask(found.ends, samples.measured)
    return (G @ calibration.covariance @ G.T + B @ B.T) * np.outer(requested, requested)


def placement_lines(placements: Sequence[Placement], names: Sequence[str]) -> list[str]:
    """Lines on placements of base and tool in further recordings.

    Of each, of names (k,).
    """
    out = []
    for one, name in zip(placements, names):
        for line in one.lines():
            out.append(f"{name}: {line}, from where it stood in the first recording; this place is fitted with it")
    return out
