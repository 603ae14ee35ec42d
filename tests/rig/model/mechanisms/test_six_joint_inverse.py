"""Six joints in one global frame: against the Denavit-Hartenberg chain, all branches, near singular and out of
reach.
"""

from importlib.resources import files

import numpy as np
import pytest

from rig.errors import RigError
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import Arm
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.mechanisms import closed_form_and_numerical_arm_inverse
from tests.rig.arms import HALF, SEVEN, UR10, random_arm

PUMA = design_from_rig_toml.load_design(files("rig") / "arms" / "puma560.toml").mechanism
OFFSET = Arm(
    [
        [0, 0.29, 0.15, -HALF],
        [-HALF, 0, 0.27, 0],
        [0, 0, 0.07, -HALF],
        [0, 0.302, 0, HALF],
        [0, 0, 0, -HALF],
        [np.pi, 0.072, 0, 0],
    ],
    [[-3.1, 3.1]] * 6,
)
TILTED = Arm(
    [
        [0.2, 0.3, 0.1, 1.3],
        [0, 0.1, 0.4, 0],
        [0.3, 0.1, 0.05, -1.2],
        [0, 0.4, 0, 1.4],
        [0.1, 0, 0, -1.1],
        [0, 0.1, 0.02, 0.3],
    ],
    [[-3, 3]] * 6,
)
ARMS = {"puma": PUMA, "offset": OFFSET, "UR10": UR10, "tilted": TILTED}


def near_singular(q, rng):
    """Joint angles with wrists and elbows within 1e-6 rad of where two branches meet, some exactly there."""
    q = q.copy()
    third = len(q) // 4
    q[:third, 4] = rng.uniform(-1e-6, 1e-6, third)
    q[third : third + 20, 4] = 0.0
    return q


def check(six, q):
    """(closure (m,) worst of all branches, missed (m,)): every branch must give the pose back, one of them the angles.

    Within s of a singularity the angles themselves are only determined to (rounding / s), so they are compared after
    weighing by s
    """
    matrix = mechanism.single_hand_arm_link_frames(q, six.arm)[:, -1]
    T = mechanism.forward(q, six.arm)
    found = closed_form_and_numerical_arm_inverse.closed_form_inverse(T, six)
    back = mechanism.single_hand_arm_link_frames(np.where(found.exists[..., None], found.q, 0), six.arm)[..., -1, :, :]
    closure = np.where(found.exists, np.abs(back - matrix[:, None]).max(axis=(-1, -2)), 0).max(axis=1)
    apart = np.abs(np.exp(1j * np.where(found.exists[..., None], found.q, np.nan)) - np.exp(1j * q[:, None])).max(
        axis=-1
    )
    sine = np.minimum(1, np.abs(np.sin(q[:, 4])))
    return closure, ~(np.nanmin(np.where(found.exists, apart, 9), axis=1) * sine < 1e-8), found


def test_the_frame_stands_at_the_crossing_of_the_first_axes():
    six = closed_form_and_numerical_arm_inverse.closed_form_of_six_joint_arm(PUMA)
    np.testing.assert_allclose(six.axes[:2], [[0, 0, 1], [0, 1, 0]], atol=1e-15)
    np.testing.assert_allclose([six.frame.translation[2], six.points[1] @ six.points[1]], [0.6718, 0], atol=1e-15)
    np.testing.assert_allclose(six.hand[1:] - six.hand[0], [[0, 0, 1], [0, 1, 0]], atol=1e-15)


@pytest.mark.parametrize("name", ARMS)
def test_every_branch_returns_and_none_is_missed(name):
    rng = np.random.default_rng(1)
    closure, missed, found = check(
        closed_form_and_numerical_arm_inverse.closed_form_of_six_joint_arm(ARMS[name]),
        near_singular(rng.uniform(-np.pi, np.pi, (4000, 6)), rng),
    )
    assert closure.max() < 1e-11 and not missed.any() and not found.reason.any()
    assert np.isnan(found.q[~found.exists]).all()


def test_a_spherical_wrist_over_two_parallel_axes_has_eight_branches():
    """Those that the numeric solver finds from many starts are exactly these."""
    q = np.random.default_rng(2).uniform(-2, 2, (5, 6))
    six = closed_form_and_numerical_arm_inverse.closed_form_of_six_joint_arm(OFFSET)
    T = mechanism.forward(q, OFFSET)
    found = closed_form_and_numerical_arm_inverse.closed_form_inverse(T, six)
    for i in range(5):
        many = mechanism.forward(np.tile(q[i], (150, 1)), OFFSET)
        numeric, left = mechanism.damped_least_squares_arm_inverse_and_error(
            many, OFFSET, np.random.default_rng(3).uniform(-3, 3, (150, 6)), starts=0
        )
        numeric = numeric[left < 1e-10]
        apart = np.abs(np.exp(1j * numeric[:, None]) - np.exp(1j * found.q[i])).max(axis=-1)
        assert np.nanmin(apart, axis=1).max() < 1e-7  # nothing beyond the listed
        assert len(np.unique(np.nanargmin(apart, axis=1))) == found.exists[i].sum()  # and every listed one is real


def test_singular_poses_are_named():
    six = closed_form_and_numerical_arm_inverse.closed_form_of_six_joint_arm(PUMA)
    stretched = -np.arctan2(0.0203, 0.4318) + HALF  # elbow, upper arm and wrist in one line
    q = np.tile([0.3, 0.4, 0.5, 0.6, 0.7, 0.8], (4, 1))
    q[[1, 3], 4], q[2:, 2] = 0, -stretched
    found = closed_form_and_numerical_arm_inverse.closed_form_inverse(mechanism.forward(q, PUMA), six)
    assert [found.why(i) for i in range(4)] == [
        "regular",
        "singular: wrist",
        "singular: elbow",
        "singular: elbow, wrist",
    ]


def test_a_free_joint_takes_what_is_near():
    six = closed_form_and_numerical_arm_inverse.closed_form_of_six_joint_arm(PUMA)
    q = np.array([0.3, 0.4, 0.5, 0.6, 0.0, 0.8])
    found = closed_form_and_numerical_arm_inverse.closed_form_inverse(
        mechanism.forward(q, PUMA), six, free_joint_values=q
    )
    assert np.nanmin(np.abs(found.q - q).max(axis=1)) < 1e-9


@pytest.mark.parametrize(
    "position, reason",
    [
        ([2.0, 0, 0.6], "too far, by 1.1"),
        ([0.05, 0, 0.7], "axis 1 than the arm's offset allows"),
        ([0.0, 0.15005, 0.672], "too near the shoulder"),
    ],
)
def test_poses_out_of_reach_say_why(position, reason):
    bare = Arm(PUMA.joints * np.where(np.arange(6) == 5, 0, 1)[:, None], PUMA.limits)  # the hand is the wrist
    matrix = np.eye(4)
    matrix[:3, 3] = position
    T = type(mechanism.forward(np.zeros(6), bare)).from_matrix(matrix)
    found = closed_form_and_numerical_arm_inverse.closed_form_inverse(
        T, closed_form_and_numerical_arm_inverse.closed_form_of_six_joint_arm(bare)
    )
    assert not found.exists.any() and reason in found.why(0)


@pytest.mark.parametrize(
    "arm, words",
    [
        (SEVEN, "six joints, not 7"),
        (random_arm(np.random.default_rng(0)), "take rig.model.mechanisms.arm_kinematics_limits_and_loads.inverse"),
        (Arm(UR10.joints * [1, 1, 1, 0], UR10.limits), "parallel"),
    ],
)
def test_arms_without_a_closed_form_are_told_what_misses(arm, words):
    with pytest.raises(RigError, match=words):
        closed_form_and_numerical_arm_inverse.closed_form_of_six_joint_arm(arm)
