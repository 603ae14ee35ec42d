"""Lost and gained poses: hand-worked in the plane, and what the corrected commands of hexapods and arms say."""

from dataclasses import replace

import numpy as np
import pytest

from calib.correction.machine_correction import Correction, require_commands_in_axis_ranges
from calib.models.arm.arm_correction import ArmCorrection
from calib.workspace.workspace_cell_map_with_margins_and_lost_poses import (
    are_nominal_poses_out_of_corrected_reach,
    correction_that_corrects_nothing,
    reachable_poses_with_lost_mask,
)
from rig.errors import Unreachable
from rig.model.design import Planar2
from rig.model.mechanisms import arm_kinematics_limits_and_loads as arms
from rig.model.mechanisms import hexapod
from rig.model.pose import pose_difference
from rig.planning.configuration_generators import sobol_configurations
from synthetic import random_true_machine_and_truth_file
from tests.calib.secret_arms import secret
from tests.rig.arms import UR10

STROKES = [[0.6, 1.2], [0.6, 1.2]]
PLANAR = Planar2([[0.0, 0.0], [1.0, 0.0]], STROKES)


@pytest.fixture(scope="module")
def rough(design):
    """Correction of a hexapod ten times as far off as rigs are."""
    true = random_true_machine_and_truth_file.random_true_machine(design, np.random.default_rng(2), 10.0).true.mechanism
    return Correction(design.mechanism, true, (None,) * 6)


def test_a_strut_that_is_longer_than_it_says_loses_its_short_end_and_gains_its_long_one():
    correction = Correction(PLANAR, Planar2(PLANAR.base_joints, STROKES, [0.03, 0.0]), (None, None))
    drawn = sobol_configurations(np.array(STROKES), 4096, 1.0)
    believed, real = (
        reachable_poses_with_lost_mask(correction_that_corrects_nothing(correction), correction, drawn),
        reachable_poses_with_lost_mask(correction, correction_that_corrects_nothing(correction), drawn),
    )
    np.testing.assert_array_equal(believed.out, believed.commands[:, 0] < 0.63)  # its command would be below 0.6 m
    np.testing.assert_array_equal(real.out, real.commands[:, 0] > 1.17)  # where the owner believes it longer than 1.2 m
    np.testing.assert_array_equal(are_nominal_poses_out_of_corrected_reach(correction, drawn), drawn[:, 0] < 0.63)


def test_lost_are_the_poses_whose_corrected_commands_leave_the_strokes(rough, design):
    configurations = sobol_configurations(design.mechanism.strut_range, 300, 1.0)
    out = are_nominal_poses_out_of_corrected_reach(rough, configurations)
    T = hexapod.forward(configurations, design.mechanism)
    with pytest.raises(Unreachable) as refused:
        require_commands_in_axis_ranges(rough.inverse(T), design.mechanism, [str(i) for i in range(300)])
    np.testing.assert_array_equal(np.flatnonzero(out), refused.value.index)
    assert 10 < out.sum() < 200
    reachable = ~out
    assert np.abs(pose_difference(rough.predict(rough.inverse(T[reachable])), T[reachable])).max() < 1e-9


def test_what_closes_on_no_pose_is_lost_and_stops_nothing(rough, design):
    configurations = np.repeat(design.mechanism.strut_range.mean(axis=1)[None], 3, axis=0)
    configurations[1, 0] = 3.0  # no platform reaches so far
    np.testing.assert_array_equal(are_nominal_poses_out_of_corrected_reach(rough, configurations), [False, True, False])


def test_an_arm_loses_poses_of_its_own_configuration_alone():
    true = secret(UR10, np.random.default_rng(0), size=3.0)
    correction = ArmCorrection(UR10, replace(true, base=UR10.base, tool=UR10.tool), (None,) * 6, np.zeros((1, 6)))
    q = sobol_configurations(UR10.limits, 64, 1.0)
    out = are_nominal_poses_out_of_corrected_reach(correction, q)
    needed = correction.near(arms.forward(q, UR10), q)
    inside = np.isfinite(needed).all(axis=1) & (arms.signed_limit_excess(np.nan_to_num(needed), UR10) == 0).all(axis=1)
    np.testing.assert_array_equal(out, ~inside)
    assert inside.sum() > 48
    assert np.abs(pose_difference(correction.predict(needed[inside]), arms.forward(q[inside], UR10))).max() < 1e-9
