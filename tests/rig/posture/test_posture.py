"""Postures for force: measures and their slopes, searches that leave the hand alone, wrenches that are as certain as
they say.
"""

import json
from importlib.resources import files

import numpy as np
import pinocchio
import pytest
from scipy.stats import chi2

from rig.cli import command_line
from rig.errors import RigError
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.mechanisms import arm_dynamics_and_step_by_step_kinematics
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.pose import pose_difference, pose_to_vector
from rig.posture import (
    arm_force_transmission_and_exertable_wrench,
    arm_motion_between_postures,
    null_space_posture_search,
    wrench_estimation_from_torques,
)
from rig.posture.arm_force_transmission_and_exertable_wrench import TransmissionObjective
from tests.numerical_derivatives import jacobian
from tests.rig.arms import SEVEN, UR10, configurations, random_arm
from tests.rig.pinocchio_arm import build

PANDA = design_from_rig_toml.load_design(files("rig") / "arms" / "panda.toml").mechanism
WISHES = [
    TransmissionObjective(("fy",)),
    TransmissionObjective(("fy",), np.inf),
    TransmissionObjective(("fx", "mz"), length=0.3),
    TransmissionObjective(),
    TransmissionObjective((), 2, "norm"),
    TransmissionObjective((), np.inf, "norm"),
]


@pytest.mark.parametrize("wish", WISHES, ids=str)
def test_slope_of_the_measure_agrees_with_differences(wish):
    for arm in (PANDA, random_arm(np.random.default_rng(3), 8)):
        q = configurations(arm, 4, np.random.default_rng(0), 0.8)
        for one, slope in zip(q, arm_force_transmission_and_exertable_wrench.transmission_gradient(q, arm, wish)):
            np.testing.assert_allclose(
                slope,
                jacobian(
                    lambda x, arm=arm: arm_force_transmission_and_exertable_wrench.transmission_measure(x, arm, wish),
                    one,
                ),
                atol=1e-7,
            )


def test_measures_are_hand_worked():
    """Two links of 1 m in line along x, as three joints about z and one above: a force along the line is not felt by
    any.
    """
    arm = type(PANDA)([[0, 0, 1.0, 0], [0, 0, 1.0, 0]], [[-3, 3]] * 2)
    np.testing.assert_allclose(
        arm_force_transmission_and_exertable_wrench.torque_norms_by_direction(
            np.zeros(2), arm, TransmissionObjective()
        ),
        [0, np.sqrt(5), 0, 0, 0, np.sqrt(2)],
        atol=1e-15,
    )
    assert (
        arm_force_transmission_and_exertable_wrench.transmission_measure(
            np.zeros(2), arm, TransmissionObjective(("fx", "fy"))
        )
        == 0
        and arm_force_transmission_and_exertable_wrench.transmission_measure(
            np.zeros(2), arm, TransmissionObjective(("fy",), np.inf)
        )
        == 2
    )
    assert arm_force_transmission_and_exertable_wrench.transmission_measure(
        np.zeros(2), arm, TransmissionObjective(("mz",), length=0.1)
    ) == pytest.approx(0.1 * np.sqrt(2))


@pytest.mark.slow
@pytest.mark.parametrize(
    "wish",
    [TransmissionObjective(("fy",)), TransmissionObjective(("fx", "mz"), np.inf), TransmissionObjective()],
    ids=str,
)
def test_searches_leave_the_hand_and_keep_the_limits(wish):
    q = configurations(PANDA, 25, np.random.default_rng(1), 0.9)
    gradient = null_space_posture_search.gradient_search(q, PANDA, wish)
    sampled = null_space_posture_search.sampled_search(q, PANDA, wish, np.random.default_rng(2), count=80)
    best = null_space_posture_search.whole_self_motion_search(q, PANDA, wish)
    for found in (gradient, sampled, best):
        assert (
            found.moved.max() < 1e-9
            and (mechanism.signed_limit_excess(found.q, PANDA) == 0).all()
            and (found.value >= found.start).all()
        )
        np.testing.assert_allclose(
            found.value,
            arm_force_transmission_and_exertable_wrench.transmission_measure(found.q, PANDA, wish),
            rtol=1e-12,
        )
        np.testing.assert_allclose(
            pose_difference(mechanism.forward(q, PANDA), mechanism.forward(found.q, PANDA)), 0, atol=1e-9
        )
    assert (gradient.value <= best.value * (1 + 1e-7)).all() and np.median(gradient.value / best.value) > 0.99
    assert np.median(best.value / gradient.start) > 1.02


@pytest.mark.slow
def test_global_search_is_the_best_of_the_traced_self_motion():
    q = configurations(PANDA, 3, np.random.default_rng(3), 0.8)
    wish = TransmissionObjective(("fz",))
    for one, value in zip(q, null_space_posture_search.whole_self_motion_search(q, PANDA, wish).value):
        path = null_space_posture_search.trace_self_motion(one, PANDA)
        assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() < 2 * null_space_posture_search.TRACE
        ends = [
            np.abs(
                mechanism.signed_limit_excess(path[k] + 1.01 * (path[k] - path[k + (1 if k == 0 else -1)]) * 2, PANDA)
            ).max()
            > 0
            for k in (0, -1)
        ]
        assert all(ends) or np.linalg.norm(np.sin((path[0] - path[-1]) / 2)) < 2 * null_space_posture_search.TRACE
        reached = arm_force_transmission_and_exertable_wrench.transmission_measure(path, PANDA, wish).max()
        assert reached <= value <= reached * 1.001


@pytest.mark.slow
def test_a_full_turn_of_the_elbow_is_traced_once():
    round_ = type(SEVEN)(SEVEN.joints, [[-50, 50]] * 7)
    path = null_space_posture_search.trace_self_motion(np.array([0.3, 0.7, 0.2, 1.2, 0.4, 0.9, 0.1]), round_)
    assert (
        np.linalg.norm(np.sin((path[0] - path[-1]) / 2)) < null_space_posture_search.TRACE
        and len(path) * null_space_posture_search.TRACE > np.pi
    )


def test_a_limit_suffices():
    q = configurations(PANDA, 20, np.random.default_rng(4), 0.9)
    wish = TransmissionObjective(("fy",))
    limit = float(np.median(arm_force_transmission_and_exertable_wrench.transmission_measure(q, PANDA, wish)))
    found = null_space_posture_search.gradient_search(q, PANDA, wish, sufficient_value=limit)
    already = found.start > limit
    assert (
        (found.q[already] == q[already]).all()
        and already.any()
        and (found.value[~already] > found.start[~already]).any()
    )


def test_a_six_joint_arm_may_turn_its_hand_only():
    q = configurations(UR10, 5, np.random.default_rng(5), 0.3)
    with pytest.raises(RigError, match="6 joints hold the hand's pose without redundancy"):
        null_space_posture_search.gradient_search(q, UR10, TransmissionObjective(("fy",)))
    found = null_space_posture_search.gradient_search(
        q, UR10, TransmissionObjective(("fy",)), fixed_hand_part="position"
    )
    assert found.moved[:, 0].max() < 1e-9 and (found.value > found.start).all()
    with pytest.raises(RigError, match="3 dimensions"):
        null_space_posture_search.whole_self_motion_search(
            q, UR10, TransmissionObjective(("fy",)), fixed_hand_part="position"
        )


def test_a_start_beyond_its_limits_is_refused():
    with pytest.raises(RigError, match="joint 4 at 0.000 degrees, outside its limits -176"):
        null_space_posture_search.gradient_search(np.zeros((1, 7)), PANDA, TransmissionObjective(("fy",)))


def links(rng, n=7):
    half = rng.normal(size=(n, 3, 3))
    return arm_dynamics_and_step_by_step_kinematics.LinkMasses(
        rng.uniform(1, 4, n), 0.1 * rng.normal(size=(n, 3)), 0.01 * half @ np.swapaxes(half, 1, 2)
    )


def test_weight_and_motion_agree_with_pinocchio():
    rng = np.random.default_rng(6)
    arm, own, gravity = random_arm(rng, 7), links(rng), np.array([1.0, -2.0, -9.5])
    model, _ = build(arm)
    for i, row in enumerate(arm.rows):
        to_link = pinocchio.SE3(
            pinocchio.utils.rotate("x", row[3]) @ pinocchio.utils.rotate("y", row[4]), np.array([row[2], 0, 0])
        )
        model.appendBodyToJoint(i + 1, pinocchio.Inertia(own.mass[i], own.centre[i], own.inertia[i]), to_link)
    model.gravity.linear = gravity
    data = model.createData()
    q, v, a = rng.normal(size=(3, 20, 7))
    theirs = [pinocchio.rnea(model, data, *state) for state in zip(q, v, a)]
    np.testing.assert_allclose(
        arm_dynamics_and_step_by_step_kinematics.joint_torques(q, v, a, arm, own, gravity), theirs, atol=1e-10
    )


def test_stated_covariance_of_a_wrench_covers_its_scatter():
    rng = np.random.default_rng(7)
    count, own, gravity = 4000, links(rng), np.array([0, 0, -9.80665])
    q = configurations(PANDA, count, rng, 0.8)
    q = q[arm_force_transmission_and_exertable_wrench.transmission_measure(q, PANDA, TransmissionObjective()) > 1e-4]
    v, a = rng.normal(size=(2, *q.shape))
    true = rng.normal(size=(len(q), 6)) * [20, 20, 20, 3, 3, 3]
    half = 0.1 * (np.eye(7) + 0.3 * rng.normal(size=(7, 7)))
    noise = rng.normal(size=q.shape) @ half.T
    pushed = np.einsum("mai,ma->mi", mechanism.jacobian(q, PANDA, "base"), true)
    measured = arm_dynamics_and_step_by_step_kinematics.joint_torques(q, v, a, PANDA, own, gravity) - pushed + noise
    found = wrench_estimation_from_torques.estimate_wrench(
        wrench_estimation_from_torques.external_joint_torques(measured, q, v, a, PANDA, own, gravity),
        q,
        PANDA,
        half @ half.T,
    )
    error = found.value - true
    inside = np.einsum("mi,mij,mj->m", error, np.linalg.inv(found.covariance), error) < chi2.ppf(0.95, 6)
    each = np.abs(error) < 1.96 * np.sqrt(np.einsum("mii->mi", found.covariance))
    assert 0.93 < inside.mean() < 0.97 and each.mean(axis=0).min() > 0.93 and each.mean(axis=0).max() < 0.97
    assert found.left.mean() == pytest.approx(1, abs=0.1)  # seven torques, six of them explained


def test_equal_sensors_give_the_plain_pseudo_inverse():
    q = configurations(PANDA, 1, np.random.default_rng(8), 0.7)[0]
    tau = np.arange(7.0)
    found = wrench_estimation_from_torques.estimate_wrench(tau, q, PANDA, 0.01 * np.eye(7))
    np.testing.assert_allclose(found.value, np.linalg.pinv(mechanism.jacobian(q, PANDA, "base").T) @ tau, rtol=1e-9)


def test_a_blind_posture_names_what_it_does_not_feel():
    stretched = np.zeros(7)  # every axis meets the line of the arm
    with pytest.raises(RigError, match=r"posture 0 is blind to \("):
        wrench_estimation_from_torques.estimate_wrench(np.zeros(7), stretched, SEVEN, np.eye(7))


@pytest.mark.slow
def test_motions_end_in_the_posture():
    rng = np.random.default_rng(9)
    q = configurations(PANDA, 1, rng, 0.6)[0]
    goal = null_space_posture_search.whole_self_motion_search(q, PANDA, TransmissionObjective(("fy",))).q[0]
    rows = arm_motion_between_postures.motion_with_hand_still(q, goal, PANDA)
    np.testing.assert_allclose(
        pose_difference(mechanism.forward(q, PANDA), mechanism.forward(rows, PANDA)), 0, atol=1e-9
    )
    assert (rows[0] == q).all() and (rows[-1] == goal).all() and np.abs(np.diff(rows, axis=0)).max() < 0.03
    before = np.clip(q + 0.15 * rng.normal(size=7), *PANDA.limits.T)
    motion = arm_motion_between_postures.motion_with_hand_on_straight_line(before, goal, PANDA)
    hand = mechanism.forward(motion, PANDA).translation
    a, b = hand[0], hand[-1]
    line = (b - a) / np.linalg.norm(b - a)
    assert np.linalg.norm(np.cross(hand - a, line), axis=1).max() < 1e-8 and (motion[-1] == goal).all()
    t = arm_motion_between_postures.posture_times(motion, 0.5)
    assert (np.diff(t) > 0).all() and (np.abs(np.diff(motion, axis=0)).max(axis=1) / np.diff(t)).max() < 0.5 * (
        1 + 1e-9
    )
    with pytest.raises(RigError, match="no motion of the elbow alone"):
        arm_motion_between_postures.motion_with_hand_still(q, goal + 0.3, PANDA)


POSE = "0.4,0.1,0.5,3.0,0.2,0"


@pytest.mark.slow
def test_the_command_finds_and_certifies(capsys, tmp_path):
    out = tmp_path / "commands.csv"
    assert (
        command_line.main(
            ["posture", "panda", "--pose", POSE, "--force", "y", "--norm", "2", "--json", "--out", str(out)]
        )
        == 0
    )
    tree = json.loads(capsys.readouterr().out)
    q = np.array(tree["q"])
    np.testing.assert_allclose(pose_to_vector(mechanism.forward(q, PANDA)), np.array(POSE.split(","), float), atol=1e-9)
    assert (
        tree["value"]
        == pytest.approx(
            arm_force_transmission_and_exertable_wrench.transmission_measure(q, PANDA, TransmissionObjective(("fy",)))
        )
        and tree["value"] > tree["start"]["value"]
    )
    assert (
        tree["certificate"]["reached_over_best_of_all_self_motions"] > 0.999 and tree["hand_moved"]["position"] < 1e-9
    )
    lines = out.read_text().splitlines()
    assert lines[0] == "t,q1,q2,q3,q4,q5,q6,q7" and np.allclose(
        [float(x) for x in lines[-1].split(",")[1:]], q, atol=1e-9
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "words, message",
    [
        (["--pose", "3.4,0,0.5,3,0,0"], "out of the arm's reach"),
        (["--pose", "1,2"], "--pose takes 6 numbers"),
        (["--pose", POSE, "--force", "q"], "takes x, y or z, not 'q'"),
        (["--pose", POSE, "--force", "y", "--above", "9"], "no posture found whose measure"),
        (["--pose", POSE, "--from", "0,0,0,-1,0,1,0"], "bring it there first"),
    ],
)
def test_the_command_refuses_with_a_reason(words, message, capsys):
    assert command_line.main(["posture", "panda", *words]) == 1
    assert message in capsys.readouterr().err


RAIL = """schema = "rig/1"
[mechanism]
kind = "arm"
joints = [["prismatic", 0.0, 0.1, 0.0, -1.5707963267948966], [0.0, 0.3, 0.0, 1.5707963267948966], [0.0, 0.0, 0.4, 0.0],
          [0.0, 0.1, 0.0, -1.5707963267948966], [0.0, 0.3, 0.0, 1.5707963267948966], [0.0, 0.1, 0.05, 1.2], [0.0, 0.1, \
0.0, 0.0]]
limits = [[-0.5, 0.5], [-2.9, 2.9], [-2.9, 2.9], [-2.9, 2.9], [-2.9, 2.9], [-2.9, 2.9], [-2.9, 2.9]]
[dynamics]
torque_limits = [400, 90, 90, 50, 12, 12, 12]     # N m, of the slide N
"""


def test_an_arm_on_a_rail_is_told_in_mm_and_newton_where_it_slides(tmp_path, capsys):
    (tmp_path / "rail.toml").write_text(RAIL)
    arm = design_from_rig_toml.load_design(tmp_path / "rail.toml").mechanism
    q = np.array([[0.1, 0.4, 0.5, -0.6, 0.7, 0.3, 0.2], [0.7, 0.4, 0.5, -0.6, 0.7, 0.3, 0.2]])
    at, beyond = (",".join(map(repr, row)) for row in pose_to_vector(mechanism.forward(q, arm)).tolist())
    words = ["posture", str(tmp_path / "rail.toml"), "--force", "z", "--above", "0", "--exert", "0,0,-30", "--pose", at]
    assert command_line.main(words) == 0
    output = capsys.readouterr().out
    first = output.split("joint values, degrees and, of slides, mm: ")[1].split("\n")[0].split(", ")
    assert first[0].endswith(" mm") and not any("mm" in cell for cell in first[1:])
    torques = output.split("margin to the limits: ")[1].split("\n")[0].split(", ")
    assert " N (" in torques[0] and all(" Nm (" in cell for cell in torques[1:])
    assert command_line.main([*words, "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert tree["q_units"] == ["m"] + ["rad"] * 6 and abs(tree["q"][0]) <= 0.5
    assert abs(float(first[0].split()[0]) - 1e3 * tree["q"][0]) < 1e-3
    assert command_line.main([*words[:-1], beyond, "--from", ",".join(map(str, q[1]))]) == 1
    assert "slide 1 at 700.000 mm, outside its limits -500.000 .. 500.000" in capsys.readouterr().err


def test_shipped_arms_are_named(capsys):
    assert command_line.main(["posture", "pandda", "--pose", POSE]) == 1
    assert "shipped arms: gantry, panda, puma560" in capsys.readouterr().err
