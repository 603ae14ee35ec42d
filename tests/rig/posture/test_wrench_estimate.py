"""Force at the hand: a moving arm's wrench with a covariance that covers, the greatest force against linear
programming, postures visited.
"""

import json
from importlib.resources import files

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.stats import chi2

from rig.cli import command_line
from rig.errors import FileError, RigError
from rig.formats import csv_and_parquet_tables_and_time_origin
from rig.formats.rig_toml import arm_dynamics_entries
from rig.model.mechanisms import arm_dynamics_and_step_by_step_kinematics
from rig.model.mechanisms import arm_dynamics_and_step_by_step_kinematics as dynamics
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.pose import pose_difference
from rig.posture import (
    arm_force_transmission_and_exertable_wrench,
    arm_motion_between_postures,
    null_space_posture_search,
    wrench_estimation_from_torques,
)
from rig.posture.arm_force_transmission_and_exertable_wrench import (
    DIRECTIONS,
    ExertionObjective,
    TorqueBounds,
    TransmissionObjective,
)
from rig.posture.external_wrench_from_torque_table import SETTLED
from tests.numerical_derivatives import jacobian
from tests.rig.arms import UR10, configurations

DESIGN, DYNAMICS = arm_dynamics_entries.load_arm_design_and_dynamics(files("rig") / "arms" / "panda.toml")
PANDA, LINKS, GRAVITY = DESIGN.mechanism, DYNAMICS.links, DESIGN.gravity
STRENGTH = TorqueBounds(DYNAMICS.torque_limits, LINKS, GRAVITY)
RATES = np.repeat([20.0, 2.0], 3)  # N, Nm per root second
SIGMAS = np.full(7, 0.1), np.full(7, 1e-5), np.full(7, 2e-3)
POSE = "0.4,0.1,0.5,3.0,0.2,0"


def moved(rng, records, count, dt=4e-3):
    """(t, q, speed, torques as measured, wrenches as they are) of arms that swing while something pulls at their
    hands.
    """
    t, half = dt * np.arange(count), np.ptp(PANDA.limits, axis=1) / 2
    size, rate, phase = (rng.uniform(*ends, (records, 2, 1, 7)) for ends in ((0.08, 0.25), (0.5, 2.5), (0, 2 * np.pi)))
    size, angle = size * half, rate * t[:, None] + phase
    q, v, a = (
        part.sum(axis=1)
        for part in (size * np.sin(angle), size * rate * np.cos(angle), -size * rate**2 * np.sin(angle))
    )
    q = q + PANDA.limits.mean(axis=1)
    wrench = (RATES * np.sqrt(dt) * rng.normal(size=(records, count, 6))).cumsum(axis=1) + rng.normal(
        size=(records, 1, 6)
    ) * RATES
    torque = dynamics.joint_torques(q, v, a, PANDA, LINKS, GRAVITY) - np.einsum(
        "mkai,mka->mki", mechanism.jacobian(q, PANDA, "base"), wrench
    )
    noise = [sigma * rng.normal(size=q.shape) for sigma in SIGMAS]
    return t, q + noise[1], v + noise[2], torque + noise[0], wrench


def coverage(records, seed):
    """(share of 95 % regions that hold the wrench, and of each direction's intervals) at three moments far apart of so
    many records.
    """
    t, q, v, torque, wrench = moved(np.random.default_rng(seed), records, 90)
    seen = wrench_estimation_from_torques.wrench_by_momentum_observer(
        wrench_estimation_from_torques.momentum_observer_model(
            wrench_estimation_from_torques.ArmMotion(t, q, v, True, torque), PANDA, LINKS, GRAVITY, SIGMAS
        ),
        RATES,
    )
    at = [29, 59, 89]
    error, covariance = (seen.value - wrench)[:, at], seen.covariance[:, at]
    inside = np.einsum("mki,mkij,mkj->mk", error, np.linalg.inv(covariance), error) < chi2.ppf(0.95, 6)
    each = np.abs(error) < 1.96 * np.sqrt(np.einsum("mkii->mki", covariance))
    assert seen.innovation == pytest.approx(1, abs=0.05)
    return inside.mean(), each.mean(axis=(0, 1))


def test_the_covariance_of_a_moving_arms_wrench_covers():
    whole, each = coverage(60, 5)
    assert 0.93 < whole < 0.97 and each.min() > 0.9


@pytest.mark.slow
def test_the_covariance_of_a_moving_arms_wrench_covers_in_many_records():
    shares = [coverage(150, seed) for seed in range(8)]
    assert 0.93 < np.mean([whole for whole, _ in shares]) < 0.97
    each = np.mean([part for _, part in shares], axis=0)
    assert each.min() > 0.93 and each.max() < 0.97


def test_momentum_changes_by_what_is_said():
    """d(M v)/dt by differences along a motion is the torque and what `drift` adds to it."""
    rng = np.random.default_rng(1)
    q, v, a = configurations(PANDA, 4, rng, 0.7), rng.normal(size=(4, 7)), rng.normal(size=(4, 7))

    def moments(s):
        return np.einsum(
            "mij,mj->mi",
            arm_dynamics_and_step_by_step_kinematics.mass_matrix(q + s * v + s**2 / 2 * a, PANDA, LINKS),
            v + s * a,
        )

    change = (moments(1e-5) - moments(-1e-5)) / 2e-5
    torque = dynamics.joint_torques(q, v, a, PANDA, LINKS, GRAVITY)
    np.testing.assert_allclose(
        torque + arm_dynamics_and_step_by_step_kinematics.torque_free_momentum_rate(q, v, PANDA, LINKS, GRAVITY),
        change,
        atol=1e-6,
    )
    M = arm_dynamics_and_step_by_step_kinematics.mass_matrix(q, PANDA, LINKS)
    np.testing.assert_allclose(M, np.swapaxes(M, 1, 2), atol=1e-12)
    assert np.linalg.eigvalsh(M).min() > 0


def programmed(A, low, high, direction):
    """Greatest f . direction over all forces f with low <= A f <= high, by linear programming."""
    found = linprog(
        -direction, np.vstack([A, -A]), np.r_[high, -low], bounds=[(None, None)] * len(direction), method="highs"
    )
    return -found.fun


def test_greatest_forces_are_those_of_linear_programming():
    rng = np.random.default_rng(2)
    q = configurations(PANDA, 12, rng, 0.8)
    for one in q:
        low, high = STRENGTH.box(one, PANDA)
        assert (low < 0).all() and (high > 0).all()
        A = mechanism.jacobian(one, PANDA, "base").T[:, :3]
        every = arm_force_transmission_and_exertable_wrench.force_polytope_corners(A, low, high)
        for direction in rng.normal(size=(4, 3)):
            assert (every @ direction).max() == pytest.approx(programmed(A, low, high, direction), rel=1e-9)
            wrench = np.r_[direction, 0, 0, 0]
            along = programmed((A @ direction)[:, None], low, high, np.ones(1))
            assert ExertionObjective(wrench, STRENGTH).value(one, PANDA) == pytest.approx(along, rel=1e-9)
        least, weak = (
            arm_force_transmission_and_exertable_wrench.greatest_force_in_all_directions_and_weakest_direction(
                A, low, high
            )
        )
        rays = (
            arm_force_transmission_and_exertable_wrench.greatest_load_multiple(
                np.vstack([rng.normal(size=(2000, 3)), weak]) @ A.T, low, high
            )
            * np.r_[np.ones(2000), 1.0]
        )
        assert (
            arm_force_transmission_and_exertable_wrench.greatest_load_multiple(A @ weak, low, high)
            == pytest.approx(least, rel=1e-9)
            == pytest.approx(rays[-1], rel=1e-9)
        )
        unit = rng.normal(size=(2000, 3))
        unit /= np.linalg.norm(unit, axis=1, keepdims=True)
        assert arm_force_transmission_and_exertable_wrench.greatest_load_multiple(
            unit @ A.T, low, high
        ).min() >= least * (1 - 1e-12)


@pytest.mark.slow
def test_a_posture_is_found_that_exerts_more_and_its_slope_is_that_of_differences():
    wish, q = (
        ExertionObjective(np.array([0, 0, -30.0, 0, 0, 0]), STRENGTH),
        configurations(PANDA, 4, np.random.default_rng(3), 0.7),
    )
    np.testing.assert_allclose(
        STRENGTH.weight(q, PANDA), dynamics.joint_torques(q, 0 * q, 0 * q, PANDA, LINKS, GRAVITY), atol=1e-9
    )
    for one in q:
        np.testing.assert_allclose(wish.slope(one, PANDA), jacobian(lambda x: wish.value(x, PANDA), one), atol=1e-4)
    found = null_space_posture_search.whole_self_motion_search(q, PANDA, wish)
    assert (
        (found.value >= found.start).all() and np.median(found.value / found.start) > 1.05 and found.moved.max() < 1e-9
    )


def test_a_weight_that_cannot_be_held_is_negative_and_said():
    feeble = TorqueBounds(np.full(7, 5.0), LINKS, GRAVITY)
    q = np.array([0, 0.5, 0, -1.5, 0, 1.5, 0.0])
    assert ExertionObjective(np.eye(6)[2], feeble).value(q, PANDA) < 0
    with pytest.raises(RigError, match="bears any force along"):
        arm_force_transmission_and_exertable_wrench.force_polytope_corners(
            np.eye(7, 3) * [1, 1, 0], -np.ones(7), np.ones(7)
        )


def test_the_hand_may_move_while_its_orientation_is_held():
    q = configurations(UR10, 4, np.random.default_rng(5), 0.3)
    found = null_space_posture_search.gradient_search(
        q, UR10, TransmissionObjective(("fy",)), fixed_hand_part="orientation"
    )
    assert found.moved[:, 1].max() < 1e-9 and found.moved[:, 0].min() > 1e-3 and (found.value > found.start).all()
    rows = arm_motion_between_postures.motion_with_hand_still(q[0], found.q[0], UR10, "orientation")
    turned = pose_difference(mechanism.forward(q[0], UR10), mechanism.forward(rows, UR10))[:, 3:]
    assert np.abs(turned).max() < 1e-8 and (rows[0] == q[0]).all() and (rows[-1] == found.q[0]).all()


@pytest.mark.slow
def test_the_command_says_what_a_posture_can_exert_and_draws_it(capsys, tmp_path):
    drawn = tmp_path / "force.svg"
    assert (
        command_line.main(["posture", "panda", "--pose", POSE, "--exert", "0,0,-30", "--draw", str(drawn), "--json"])
        == 0
    )
    tree = json.loads(capsys.readouterr().out)
    q, out = np.array(tree["q"]), tree["exert"]
    np.testing.assert_allclose(
        out["torques"],
        STRENGTH.weight(q, PANDA) + mechanism.jacobian(q, PANDA, "base").T @ [0, 0, -30, 0, 0, 0],
        atol=1e-9,
    )
    np.testing.assert_allclose(out["margin"], STRENGTH.limits - np.abs(out["torques"]), atol=1e-12)
    assert (
        tree["measure"] == "greatest multiple"
        and out["greatest_multiple"] == pytest.approx(tree["value"])
        and tree["value"] > 1
    )
    assert out["strongest"]["force"] > out["greatest_multiple"] * 30 > out["weakest"]["force"]
    assert drawn.read_text().startswith("<?xml") and "</svg>" in drawn.read_text()
    assert (
        command_line.main(
            ["posture", "panda", "--pose", POSE, "--force", "z", "--exert", "0,0,-3000", "--hold", "position"]
        )
        == 0
    )
    output = capsys.readouterr().out
    assert "CANNOT be exerted, joint" in output and "smallest column of J^T" in output


@pytest.mark.parametrize(
    "words, says",
    [
        (["--exert", "0,0,0"], "nonzero"),
        (["--exert", "1,2"], "--exert takes 6 numbers"),
        (["--draw", "x.svg"], "require --exert"),
        (["--exert", "1,0,0", "--limits", "1,1,1,1,1,1,0"], "positive torques"),
        (["--among", "typo"], "typo: no such folder"),
    ],
)
def test_the_command_refuses_what_cannot_be_exerted(words, says, capsys):
    assert command_line.main(["posture", "panda", "--pose", POSE, *words]) == 1
    assert says in capsys.readouterr().err


def recorded(folder, q):
    """A recording of an arm that stood at postures (k, 7) rad, five seconds apart."""
    folder.mkdir()
    (folder / "rig.toml").write_text((files("rig") / "arms" / "panda.toml").read_text())
    rows = [f"{5 * k + s},{','.join(f'{x:.9f}' for x in one)}" for k, one in enumerate(q) for s in (0, 3)]
    (folder / "commands.csv").write_text("t,q1,q2,q3,q4,q5,q6,q7\n" + "\n".join(rows) + "\n")
    (folder / "frames.csv").write_text(
        "frame,t,camera,image\n" + "".join(f"{k},{5 * k + 2},,\n" for k in range(len(q)))
    )


def test_the_best_of_postures_visited_is_gone_back_to_the_way_it_came(tmp_path, capsys):
    start = configurations(PANDA, 1, np.random.default_rng(8), 0.5)[0]
    path = null_space_posture_search.trace_self_motion(start, PANDA)
    visited = np.vstack([path[:: max(len(path) // 9, 1)], start + 0.1])  # the last with the hand elsewhere
    recorded(tmp_path / "rec", visited)
    out = tmp_path / "back.csv"
    assert (
        command_line.main(
            ["posture", "panda", "--among", str(tmp_path / "rec"), "--force", "z", "--out", str(out), "--json"]
        )
        == 0
    )
    tree = json.loads(capsys.readouterr().out)
    from rig.posture import arm_force_transmission_and_exertable_wrench

    value = arm_force_transmission_and_exertable_wrench.transmission_measure(
        visited[:-1], PANDA, TransmissionObjective(("fz",))
    )
    assert (
        tree["frame"] == value.argmax()
        and tree["value"] == pytest.approx(value.max(), rel=1e-6)
        and tree["elsewhere"] == 1
    )
    rows = csv_and_parquet_tables_and_time_origin.read_csv_table(out, ("t", *PANDA.axes)).matrix(PANDA.axes)
    np.testing.assert_allclose(rows[[0, -1]], visited[[-1, value.argmax()]], atol=1e-8)
    assert len(rows) == len(visited) - value.argmax()
    assert (
        command_line.main(
            ["posture", "panda", "--among", str(tmp_path / "rec"), "--pose", "0.1,0.1,0.9,0,0,0", "--force", "z"]
        )
        == 1
    )
    assert "0 of" in capsys.readouterr().err


def torque_file(path, moved_, columns="tau", scale=1.0, speeds=True):
    t, q, v, torque, _ = moved_
    names = [
        "t",
        *PANDA.axes,
        *(f"{columns}{i + 1}" for i in range(7)),
        *((f"v{i + 1}" for i in range(7)) if speeds else ()),
    ]
    rows = np.concatenate([t[:, None], q[0], torque[0] / scale, *([v[0]] if speeds else [])], axis=1)
    path.write_text(",".join(names) + "\n" + "\n".join(",".join(f"{x:.9f}" for x in row) for row in rows) + "\n")


def test_the_command_tells_the_wrench_beside_the_plain_one(tmp_path, capsys):
    made = moved(np.random.default_rng(3), 1, 250)
    rig, out = tmp_path / "arm.toml", tmp_path / "wrench.csv"
    text = (files("rig") / "arms" / "panda.toml").read_text()
    rig.write_text(text + "torque_constants = 2.0\ntorque_sigma = 0.1\nangle_sigma = 1e-5\nspeed_sigma = 2e-3\n")
    for columns, scale in (("tau", 1.0), ("i", 2.0)):
        torque_file(tmp_path / "torques.csv", made, columns, scale)
        assert (
            command_line.main(
                ["wrench", str(rig), str(tmp_path / "torques.csv"), "--rate", "20", "2", "--out", str(out), "--json"]
            )
            == 0
        )
        printed, error_text = capsys.readouterr()
        result = json.loads(printed)
        assert ("motor currents" in error_text) == (columns == "i") and "weight and motion subtracted" in error_text
        rows = csv_and_parquet_tables_and_time_origin.read_csv_table(out, ("t", "fx"))
        late = rows.matrix(DIRECTIONS)[int(SETTLED * 250) :]
        np.testing.assert_allclose(result["mean"], late.mean(axis=0), atol=1e-4)
        np.testing.assert_allclose(np.abs(result["largest"]), np.abs(late).max(axis=0), atol=1e-4)
        for part in ("", "plain_"):
            estimated, sigma = (
                rows.matrix([f"{part}{name}" for name in names])[25:]
                for names in (("fx", "fy", "fz"), ("c00", "c11", "c22"))
            )
            share = (np.abs(estimated - made[4][0][25:, :3]) < 2 * np.sqrt(sigma)).mean()
            assert np.abs(estimated - made[4][0][25:, :3]).max() < 8.0 and 0.88 < share < 0.995, (part, share)


@pytest.mark.parametrize(
    "spoil, says",
    [
        (lambda text: text.replace("tau1", "tua1"), "no column 'tau1'; is 'tua1' meant"),
        (lambda text: text.replace("tau", "i"), "states no torque_constants"),
        (lambda text: "\n".join(text.split("\n")[:8]) + "\n", "it requires at least 11"),
        (lambda text: text.replace("\n0.004", "\n0.0001", 1), "resample it"),
        (lambda text: text[: len(text) // 2], "torques.csv:"),
    ],
)
def test_tables_of_torques_that_cannot_be_used_are_refused(tmp_path, capsys, spoil, says):
    path = tmp_path / "torques.csv"
    torque_file(path, moved(np.random.default_rng(3), 1, 30), speeds=False)
    path.write_text(spoil(path.read_text()))
    assert command_line.main(["wrench", "panda", str(path), "--sigma", "0.1", "1e-5", "2e-3"]) == 1
    assert says in capsys.readouterr().err


@pytest.mark.parametrize(
    "line, says",
    [
        ("torque_limits = [87, 87]", "dynamics.torque_limits must have 7 numbers, got 2 entries"),
        ("torque_sigma = -1", "torque_sigma must be > 0"),
        ("friction = [[0, -1], [0, 0], [0, 0], [0, 0], [0, 0], [0, 0], [0, 0]]", "must not be negative, not -1"),
        ("torque_sigmas = 1", "is 'torque_sigma' meant"),
        ("links = [[-1, 0, 0, 0, 1, 1, 1, 0, 0, 0]]", "7xn|7x10"),
    ],
)
def test_dynamics_that_cannot_be_name_line_and_value(tmp_path, line, says):
    path = tmp_path / "arm.toml"
    path.write_text((files("rig") / "arms" / "panda.toml").read_text().split("[dynamics]")[0] + f"[dynamics]\n{line}\n")
    with pytest.raises(FileError, match=says) as error:
        arm_dynamics_entries.load_arm_design_and_dynamics(path)
    assert error.value.line is not None
