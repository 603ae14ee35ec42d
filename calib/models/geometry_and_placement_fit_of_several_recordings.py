"""Geometry and placement fit of several recordings.

Joint fit of an arm's or chain's geometry and of where base and tool stood in each recording.

The first recording's base and tool are the reference. What is still uncertain of the others' places goes on as an error
that the poses of a recording share, so that all later fits, held-out and of effects too, solve for it.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.models.arm.arm_certification import start_arm_of_fit
from calib.models.arm.arm_error_model_and_instrument_observations import observations_of_samples
from calib.models.arm.arm_identification_and_joint_profiles import identify_arm, independent_arm_parameter_mask
from calib.models.base_and_tool_displacement_between_recordings import (
    NONE,
    base_origin,
    estimate_placement,
    estimated_placement_parameter_mask,
    is_placement_significant,
    placement_with_significant_displacements,
    pose_jacobian_by_base_and_tool_placement,
    samples_as_measured_in_reference,
    target_poses_by_forward_kinematics,
)
from calib.models.base_and_tool_placement import LOOSE, Placement
from calib.models.chain import chain_error_model_and_identification as chains
from calib.models.chain.chain_error_model_and_identification import identify_chain
from calib.samples.commanded_and_measured_pose_samples import Below, Samples, sample_recording
from rig.array_and_json_types import Floats
from rig.model.mechanism_geometry_classes import Arm, Chain
from rig.recording.recording_folder import Recording

ROUNDS = 8  # of linearising anew
FIRST = np.repeat([1e-3, 2e-3], 3)  # m, rad; what a maker's figures leave, by which poses weigh before a fit
PLACED = 1e-7  # m, rad; largest step of a placement that has settled
WIDE = 3.0  # times its uncertainty, by which a fit may still move a placement: it costs the fit a tenth of that


def _joined_in_reference(parts: Sequence[Samples], placements: Sequence[Placement], machine: Arm | Chain) -> Samples:
    """Samples of several recordings as measured in the first one's reference; common : columns of all placements.

    parts : of each recording, in order; placements : of all but the first; machine : by which columns are linearised
    """
    none = replace(placements[0], base=NONE, tool=NONE, ends=(False, False))
    moved, count = [], 12 * len(placements)
    for k, (part, place) in enumerate(zip(parts, (none, *placements))):
        T = target_poses_by_forward_kinematics(part, machine)
        one = samples_as_measured_in_reference(part, place, T)
        requested = estimated_placement_parameter_mask(place.ends, part.measured)
        columns = np.zeros((len(part), 6, count))
        below = []
        if k:
            own = slice(12 * k - 12, 12 * k)
            columns[..., own] = pose_jacobian_by_base_and_tool_placement(T, place.origin) * requested
            if part.measured == "position":  # which stand in the frame of poses
                columns[:, :3] = T.rotation.as_matrix() @ columns[:, :3]
        for stage in one.below:
            seen = np.zeros((len(part), 6, count))
            if k:
                seen[..., own] = pose_jacobian_by_base_and_tool_placement(stage.T_base_stage, place.origin) * requested
                seen[..., own][..., 6:] = 0.0
            below.append(replace(stage, common=seen))
        moved.append(replace(one, common=columns, below=tuple(below)))
    return _concatenated(moved)


def _concatenated(parts: Sequence[Samples]) -> Samples:
    """Samples one after the other, without physics and conditions."""
    below = []
    for each in zip(*(part.below for part in parts)):
        below.append(
            Below(
                each[0].stage,
                RigidTransform.concatenate([one.T_base_stage for one in each]),
                *(np.concatenate([getattr(one, name) for one in each]) for name in ("covariance", "common", "seen")),
            )
        )
    arrays = [
        [getattr(part, name) for part in parts] for name in ("frame", "t", "commanded", "T_base_platform", "covariance")
    ]
    frame, t, commanded, T, covariance = arrays
    return Samples(
        np.concatenate(frame),
        np.concatenate(t),
        np.concatenate(commanded),
        RigidTransform.concatenate(T),
        np.concatenate(covariance),
        np.concatenate([part.common for part in parts]),
        below=tuple(below),
    )


class _PlacedGeometry(NamedTuple):
    """machine : fitted; scatter : (6,) m, rad beyond the noise; rows : (N, p + c) whitened columns of parameters, then
    of what samples share; left : (N,) whitened; prior, pull : (p,) information
    on the parameters as stated, and that times how far they stand from there.
    """

    machine: Arm | Chain
    scatter: Floats
    rows: Floats
    left: Floats
    prior: Floats
    pull: Floats


def _placed_geometry(samples: Samples, start: Arm | Chain, nominal: Arm | Chain) -> _PlacedGeometry:
    """_PlacedGeometry of samples, what they share solved for with the parameters. Raises what identifying raises."""
    if isinstance(start, Arm):
        assert isinstance(nominal, Arm)
        seen = observations_of_samples(samples)
        arm = identify_arm(seen, start, independent_arm_parameter_mask(nominal, seen.kind))
        W = np.linalg.inv(np.linalg.cholesky(seen.covariance + np.diag(arm.scatter**2)))[arm.inliers]
        columns = np.concatenate([seen.jacobian(arm.arm)[..., arm.rank.free], seen.common], axis=2)[arm.inliers]
        left = (W @ seen.residuals(arm.arm)[arm.inliers][..., None]).ravel()
        none = np.zeros(int(arm.rank.free.sum()))
        rows = (W @ columns).reshape(len(left), -1)
        return _PlacedGeometry(arm.arm, np.resize(arm.scatter, 6), rows, left, none, none)
    assert isinstance(nominal, Chain)
    found, sigma = identify_chain(samples, nominal), chains.parameter_tolerances(nominal)
    parts = []
    for one in chains.measured_stages(samples):
        W = np.linalg.inv(np.linalg.cholesky(one.covariance + np.diag(found.scatter**2)))
        left, J, common = one.linear(found.chain, W, sigma > 0)
        good = found.inliers if one.stage is None else np.ones(len(left), bool)
        parts.append((left[good].ravel(), np.concatenate([J, common], axis=2)[good].reshape(left[good].size, -1)))
    residual, rows = (np.concatenate(column) for column in zip(*parts))
    prior = 1 / sigma[sigma > 0] ** 2
    return _PlacedGeometry(found.chain, found.scatter, rows, residual, prior, -prior * found.step[sigma > 0])


def remove_base_and_tool_displacement(recording: Recording) -> tuple[Recording, list[Placement]]:
    """Recording with the displacement of base and tool removed.

    Of an arm or a chain: each further recording's base and tool where the first one's were.
    Returns it with the Placement of each further recording. Geometry and placements are fitted together; an end that
    stands where it stood has none. What is still uncertain of them is an error that the recording's poses share, so
    that later fits solve for it with all else.
    Raises what sampling and identifying raise
    """
    samples = sample_recording(recording).samples
    number = np.searchsorted([part.frames for part in recording.parts], samples.frame, side="right") - 1
    design, nominal = recording.design, recording.design.mechanism
    assert isinstance(nominal, (Arm, Chain))
    machine: Arm | Chain = nominal
    if isinstance(nominal, Arm):
        machine = start_arm_of_fit(observations_of_samples(samples.take(number == 0)), nominal, design.instrument)
    parts, scatter, ends = [samples.take(number == k) for k in range(number.max() + 1)], FIRST, (True, True)
    found = [_placement(one, machine, scatter, ends) for one in parts[1:]]
    found, fit = _placed_with_geometry(parts, found, machine, nominal)
    free = () if design.instrument is None else (design.instrument.base == "free", design.instrument.tool == "free")
    tested = []
    for one, part in zip(found, parts[1:]):
        clear = any(free) or is_placement_significant(
            target_poses_by_forward_kinematics(part, fit.machine), part, one, fit.scatter
        )
        repeated = placement_with_significant_displacements(one, (False, False), clear)
        own = one if repeated.ends == (True, True) else _placement(part, fit.machine, fit.scatter, repeated.ends)
        tested.append(replace(own, p_values=repeated.p_values))
    if any(any(one.ends) for one in tested):
        tested, fit = _placed_with_geometry(parts, tested, fit.machine, nominal)
    return _recording_in_reference(recording, parts, tested, fit), tested


def _placement(samples: Samples, machine: Arm | Chain, scatter: Floats, ends: tuple[bool, bool]) -> Placement:
    """Placement of a recording's samples against a machine as it is; no motion where no end is asked for."""
    return estimate_placement(
        target_poses_by_forward_kinematics(samples, machine), samples, base_origin(machine), scatter, ends
    )


class _PlacedFit(NamedTuple):
    """machine : fitted; scatter : (6,) m, rad beyond the noise; covariance : (12 k, 12 k) of the k further
    placements.
    """

    machine: Arm | Chain
    scatter: Floats
    covariance: Floats


def _placed_with_geometry(
    parts: list[Samples], placements: list[Placement], start: Arm | Chain, nominal: Arm | Chain
) -> tuple[list[Placement], _PlacedFit]:
    """(placements, _PlacedFit) of geometry and placements together, linearised anew until the placements settle.

    parts : samples of each recording; placements : of all but the first, where they begin
    """
    machine = start
    for _ in range(ROUNDS):
        samples = _joined_in_reference(parts, placements, machine)
        fit = _placed_geometry(samples, machine, nominal)
        machine, numbers = fit.machine, samples.common.shape[2]
        normal = fit.rows.T @ fit.rows + np.diag(np.r_[fit.prior, np.full(numbers, 1 / LOOSE**2)])
        covariance = np.linalg.inv(normal)[-numbers:, -numbers:]
        step = np.linalg.solve(normal, fit.rows.T @ fit.left + np.r_[fit.pull, np.zeros(numbers)])[-numbers:]
        placements = [one.stepped(own) for one, own in zip(placements, step.reshape(-1, 12))]
        if np.abs(step).max() < PLACED:
            break
    requested = np.concatenate([estimated_placement_parameter_mask(one.ends, samples.measured) for one in placements])
    covariance = covariance * np.outer(requested, requested)
    blocks = [covariance[k : k + 12, k : k + 12] for k in range(0, len(covariance), 12)]
    done = [replace(one, covariance=own) for one, own in zip(placements, blocks)]
    return done, _PlacedFit(machine, fit.scatter, covariance)


def _recording_in_reference(
    recording: Recording, parts: list[Samples], placements: list[Placement], fit: _PlacedFit
) -> Recording:
    """Recording with its poses as measured from where base and tool were in its first part."""
    poses = recording.poses
    if poses is None or not any(any(one.ends) for one in placements):
        return recording
    samples = _joined_in_reference(parts, placements, fit.machine)
    values, vectors = np.linalg.eigh(fit.covariance)
    determined = values > 1e-12 * values[-1]  # the ends that are not asked for leave rounding alone
    factor = WIDE * vectors[:, determined] * np.sqrt(values[determined])
    covariance = samples.covariance if samples.measured == "pose" else poses.covariance
    moved = replace(
        poses, T_base_platform=samples.T_base_platform, covariance=covariance, common=samples.common @ factor
    )
    stages = {
        one.stage: replace(
            recording.stages[one.stage],
            T_base_platform=one.T_base_stage[one.seen],
            common=one.common[one.seen] @ factor,
        )
        for one in samples.below
    }
    return replace(recording, poses=moved, stages={**recording.stages, **stages})
