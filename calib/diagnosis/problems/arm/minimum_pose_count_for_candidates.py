"""Minimum count of poses that a candidate needs.

It is of an arm or a chain; also how many numbers so many poses bear.
"""

import numpy as np

from calib.diagnosis.engine.cross_validation_and_chance_probabilities import FOLDS, STRETCHES, time_stretch_folds
from calib.models.arm.arm_identification_and_joint_profiles import independent_arm_parameter_mask
from calib.models.machine_parameters_and_file_entries import independent_parameter_names_units_sizes_and_jacobian
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.errors import NotEnoughData
from rig.model.design import Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_arm

ROOM = 3  # rows that are left for each number of a candidate, where a fold is held out
LEAST = 20  # poses: five stretches of four, fewer of which cannot gain by as many standard errors as a finding takes


def most_parameters_of_candidate(
    poses: int, values_per_pose: int, geometry_parameters: int, moves_whole_hand: bool
) -> int:
    """Most parameters that a candidate may have.

    Of each, ROOM rows are left to the geometry's freedoms in every fold.
    poses : that are fitted; values_per_pose : numbers measured of each; geometry_parameters : how many are fitted
    moves_whole_hand : whether the candidate moves the hand itself, of which a pose has values_per_pose values, and not
    one joint, of which it has one
    """
    held = int(np.bincount(time_stretch_folds(poses, STRETCHES) % FOLDS).max())
    return int(
        (poses - held - geometry_parameters / values_per_pose) * (values_per_pose if moves_whole_hand else 1) / ROOM
    )


def minimum_pose_count(
    values_per_pose: int,
    geometry_parameters: int,
    candidate_parameters: int = 1,
    moves_whole_hand: bool = False,
    start: int = LEAST,
) -> int:
    """Least count of poses that a candidate needs.

    It is for so many parameters, counted up from start.
    """
    count = start
    while (
        most_parameters_of_candidate(count, values_per_pose, geometry_parameters, moves_whole_hand)
        < candidate_parameters
    ):
        count += 1
    return count


def require_enough_poses(samples: Samples, design: Design) -> None:
    """Raise NotEnoughData where poses are not enough.

    They then bear no number beside the geometry's; the error says how many it takes.
    """
    if samples.measured == "direction":
        k, freedoms = 2, int(independent_arm_parameter_mask(require_arm(design.mechanism), "direction").sum())
    else:
        k = 6 if samples.measured == "pose" else 3
        names = independent_parameter_names_units_sizes_and_jacobian(design.mechanism).names
        freedoms = len(names) - (0 if k == 6 else 3)
    least = minimum_pose_count(k, freedoms)
    if len(samples) < least:
        raise NotEnoughData(
            f"{len(samples)} poses are too few to diagnose an arm or a chain: minimum {least} for {freedoms} numbers "
            "of the geometry and one of an effect, better 500"
        )
