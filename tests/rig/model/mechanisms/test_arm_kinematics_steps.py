"""Kinematics in one global frame, step by step: what is read are the joints of every branch, and the points end where
they began.
"""

import numpy as np
import pytest

from rig.model.mechanisms import arm_dynamics_and_step_by_step_kinematics, closed_form_and_numerical_arm_inverse
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from tests.rig.arms import GANTRY, SCARA, SEVEN, STANFORD, UR10
from tests.rig.model.mechanisms.test_six_joint_inverse import ARMS


@pytest.mark.parametrize("name", ARMS)
def test_every_branch_is_read_joint_by_joint_and_returns_to_zero(name):
    six = closed_form_and_numerical_arm_inverse.closed_form_of_six_joint_arm(ARMS[name])
    T = mechanism.forward(np.random.default_rng(3).uniform(-2.5, 2.5, (12, 6)), ARMS[name])
    found = closed_form_and_numerical_arm_inverse.closed_form_inverse(T, six)
    zero = six.hand + (six.key - six.hand[0])
    for i, b in np.argwhere(found.exists):
        steps = arm_dynamics_and_step_by_step_kinematics.steps_of_closed_form_inverse(T[i], six, found.q[i, b])
        assert [step.joint for step in steps] == list(range(7))
        np.testing.assert_allclose(
            np.exp(1j * np.array([step.value for step in steps[1:]])), np.exp(1j * found.q[i, b]), atol=1e-8
        )
        np.testing.assert_allclose(steps[-1].points, zero, atol=1e-12)
        elbow = steps[2].points[-1] - six.points[2]
        np.testing.assert_allclose(
            np.cross(elbow, six.axes[2]), 0, atol=1e-8
        )  # E lies on axis 3 where that stands at zero
        for before, after in zip(steps, steps[1:]):  # each step is a turn about its axis, of the points that both have
            common = [n for n in before.names if n in after.names]
            at = [step.points[[step.names.index(n) for n in common]] for step in (before, after)]
            np.testing.assert_allclose(
                arm_dynamics_and_step_by_step_kinematics.rotate_points(at[0], *after.axis, -after.value),
                at[1],
                atol=1e-12,
            )


def test_the_points_of_a_branch_are_hand_worked():
    """A UR10 stretched along x at zero: the elbow E one upper arm out, D on axis 4 one forearm on, A at the crossing of
    axes 5 and 6.
    """
    six = closed_form_and_numerical_arm_inverse.closed_form_of_six_joint_arm(UR10)
    steps = arm_dynamics_and_step_by_step_kinematics.steps_of_closed_form_inverse(
        mechanism.forward(np.zeros(6), UR10), six, np.zeros(6)
    )
    assert (
        steps[1].names == ("A", "B", "C", "D", "E")
        and steps[3].names == ("A", "B", "C", "D")
        and steps[4].names == ("A", "B", "C")
    )
    D, E = steps[1].points[3:]
    assert np.linalg.norm(E - six.points[1]) == pytest.approx(0.612) and np.linalg.norm(
        (D - E) @ np.diag([1, 0, 1])
    ) == pytest.approx(0.5723)


@pytest.mark.parametrize("arm", [UR10, SEVEN, SCARA, GANTRY, STANFORD], ids=["6R", "7R", "scara", "gantry", "stanford"])
def test_forward_by_points_is_the_chain(arm):
    """A, B, C turned and moved about the axes at zero, the last joint first, are those of the hand."""
    q = np.random.default_rng(4).uniform(*arm.limits.T)
    steps = arm_dynamics_and_step_by_step_kinematics.hand_points_after_moving_each_joint(q, arm)
    assert [step.joint for step in steps] == [0, *range(len(q), 0, -1)]
    frame = closed_form_and_numerical_arm_inverse.frame_at_first_axes_crossing(arm)
    start, end = mechanism.forward(0 * q, arm), mechanism.forward(q, arm)
    turn = (frame.inv() * end * start.inv() * frame).rotation
    np.testing.assert_allclose(steps[-1].points[0], frame.inv().apply(end.translation), atol=1e-12)
    np.testing.assert_allclose(
        steps[-1].points[1:] - steps[-1].points[0], turn.apply([[0, 0, 1], [0, 1, 0]]), atol=1e-12
    )


def test_singular_poses_take_what_the_solution_has():
    six = closed_form_and_numerical_arm_inverse.closed_form_of_six_joint_arm(ARMS["puma"])
    q = np.array([0.3, 0.4, 0.5, 0.6, 0.0, 0.8])
    T = mechanism.forward(q, ARMS["puma"])
    found = closed_form_and_numerical_arm_inverse.closed_form_inverse(T, six, free_joint_values=q)
    b = int(np.nanargmin(np.abs(found.q - q).max(axis=1)))
    steps = arm_dynamics_and_step_by_step_kinematics.steps_of_closed_form_inverse(T, six, found.q[b])
    np.testing.assert_allclose([step.value for step in steps[1:]], q, atol=1e-6)
    np.testing.assert_allclose(steps[-1].points, six.hand + (six.key - six.hand[0]), atol=1e-9)
