"""Joints of an arm that follow others: kinematics, loads, plans, recordings and a calibration of them."""

from dataclasses import replace

import numpy as np
import pytest

import rig
from calib.api.arm_kinematics import ArmKinematics
from calib.models.arm.arm_error_model_and_instrument_observations import (
    arm_with_parameter_step,
    parameter_jacobian,
    parameter_names,
)
from rig.errors import FileError, RigError
from rig.model.arm_hands_effect_places_and_tolerances import Coupling
from rig.model.mechanism_geometry_classes import Chain
from rig.model.mechanisms import arm_kinematics_limits_and_loads as serial
from rig.model.pose import pose_difference
from rig.planning.configuration_generators import evenly_spread_configurations
from rig.planning.recording_plan import build_plan
from rig.posture.best_posture import PostureOptions, best_posture, posture_sweep
from tests.cli import run
from tests.rig.arms import UR10

COUPLINGS = (Coupling(2, 1, -0.8, 0.1), Coupling(4, 0, 0.5, -0.2))
ARM = replace(UR10, couplings=COUPLINGS, limits=np.tile([-1.2, 1.2], (6, 1)))
TOML = """schema = "rig/1"
name = "palletiser"
[mechanism]
kind = "arm"
joints = [[0, 0.4, 0.05, -1.55], [1.57, 0, -0.4, 0], [-1.07, 0, 0.4, 0.1], [1.57, 0, 0, 1.57], [0, 0.2, -0.05, -0.3]]
limits = [[-2.5, 2.5], [-0.8, 1.0], [-0.9, 1.2], [-1.2, 0.9], [-2, 2]]
[[mechanism.coupling]]
joint = 4
leader = 2
multiplier = -0.8
offset = 0.1
[instrument]
base = "free"
tool = "free"
position_sigma = 2e-5
rotation_sigma = 1e-4
"""


def test_jacobians_agree_with_differences():
    q, step = np.random.default_rng(1).uniform(-1, 1, (4, 6)), 1e-6
    T = serial.forward(q, ARM)

    def change(moved):
        below, above = (pose_difference(T, moved(sign * step)) for sign in (-1, 1))
        return (above - below) / (2 * step)

    J, P = serial.jacobian(q, ARM), parameter_jacobian(q, ARM)
    for k, e in enumerate(np.eye(6)):
        np.testing.assert_allclose(J[..., k], change(lambda s, e=e: serial.forward(q + s * e, ARM)), rtol=0, atol=1e-8)
    assert not J[..., [2, 4]].any() and J[..., [0, 1, 3, 5]].any(axis=1).all()
    for k, e in enumerate(np.eye(len(parameter_names(ARM)))):
        moved = change(lambda s, e=e: serial.forward(q, arm_with_parameter_step(ARM, s * e)))
        np.testing.assert_allclose(P[..., k], moved, rtol=0, atol=1e-8)


def test_leaders_bear_their_followers_weight():
    """Torques are what the potential energy changes by with the commanded joints."""
    q, weights = np.random.default_rng(2).uniform(-1, 1, (3, 6)), np.random.default_rng(3).uniform(0.5, 1, 24)
    gravity, step = np.array([0.0, 0.0, -9.81]), 1e-6

    def energy(values):
        after = serial.joint_frames(values, ARM).after
        place, turn, m = after[..., :3, 3], after[..., :3, :3], weights.reshape(6, 4)
        moment = np.einsum("nkij,kj->nki", turn, m[:, 1:]) + m[:, :1] * place
        return -(moment.sum(axis=1) @ gravity)

    held = serial.link_weight_loads(serial.forward(q, ARM), q, ARM, gravity) @ weights
    change = [(energy(q + e) - energy(q - e)) / (2 * step) for e in step * np.eye(6)]
    np.testing.assert_allclose(held, np.stack(change, axis=1), rtol=0, atol=1e-7)


def test_inverse_and_plans_have_followers_where_leaders_have_them():
    q = evenly_spread_configurations(ARM, 20, 0.8)
    np.testing.assert_array_equal(q, ARM.with_followers(q))
    on_another = evenly_spread_configurations(Chain((UR10, ARM)), 20, 0.8)[:, 6:]
    np.testing.assert_array_equal(on_another, ARM.with_followers(on_another))
    found, left = serial.damped_least_squares_arm_inverse_and_error(serial.forward(q, ARM), ARM, q + 0.05, starts=0)
    np.testing.assert_allclose(found, q, atol=1e-7)
    assert left.max() < 1e-10


@pytest.mark.parametrize(
    "couplings, says",
    [
        ((Coupling(2, 2, 1.0, 0.0),), "joint 3 cannot follow joint 3"),
        ((Coupling(2, 7, 1.0, 0.0),), "joint 3 cannot follow joint 8"),
        ((Coupling(2, 1, 1.0, 0.0), Coupling(2, 0, 1.0, 0.0)), "joint 3 follows another joint already"),
        ((Coupling(2, 1, 1.0, 0.0), Coupling(1, 0, 1.0, 0.0)), "joint 2 follows a joint itself"),
        ((Coupling(2, 1, 0.0, 0.0),), "multiplier 0"),
    ],
)
def test_what_couples_nothing_is_refused(couplings, says):
    with pytest.raises(ValueError, match=says):
        replace(UR10, couplings=couplings)


def test_what_takes_joints_one_by_one_is_refused(tmp_path):
    (tmp_path / "rig.toml").write_text(TOML)
    with pytest.raises(RigError, match="searched for arms whose joints all move alone; joint 4 follows joint 2"):
        arm = rig.load_design(tmp_path / "rig.toml").mechanism
        best_posture(arm, PostureOptions(serial.forward(np.zeros(5), arm)))
    with pytest.raises(RigError, match="swept for arms whose joints all move alone"):
        posture_sweep(arm, PostureOptions(serial.forward(np.zeros(5), arm)), 0.1)
    (tmp_path / "bad.toml").write_text(TOML.replace("leader = 2", "leader = 9"))
    with pytest.raises(RigError, match="there is no joint 9, the arm has 5"):
        rig.load_design(tmp_path / "bad.toml")


@pytest.mark.parametrize("time", [False, True])
def test_a_plan_of_commands_that_leaders_do_not_have_is_refused(tmp_path, time):
    (tmp_path / "rig.toml").write_text(TOML)
    table = tmp_path / "commands.csv"
    table.write_text(f"frame,{'t,' * time}q1,q2,q3,q4,q5\n" + f"0,{'0,' * time}0,0,0,0.2,0\n")
    with pytest.raises(FileError, match="joint 4 follows joint 2, and is 0.1 rad off"):
        build_plan(rig.load_design(tmp_path / "rig.toml"), f"commands:{table}")


@pytest.mark.slow
def test_a_machine_with_coupled_joints_is_calibrated(tmp_path):
    """Recorded, identified, corrected and verified; a follower's rows that its leader does not have are refused."""
    (tmp_path / "rig.toml").write_text(TOML)
    rec, truth = tmp_path / "rec", tmp_path / "truth.json"
    run("simulate", tmp_path / "rig.toml", "--plan", "sobol:40", "--out", rec, "--truth", truth, "--seed", 3)
    recording = rig.load(rec)
    q, arm = recording.commands.values, recording.design.mechanism
    np.testing.assert_allclose(q[:, 3], -0.8 * q[:, 1] + 0.1, atol=2e-7)
    run("calibrate", rec, "--quick", "--out", tmp_path / "calibration.json")
    again, poses = tmp_path / "again", tmp_path / "wanted.csv"
    run("simulate", tmp_path / "rig.toml", "--plan", "sobol:30", "--machine", truth, "--out", again, "--seed", 5)
    assert "; the claim is kept (" in run("verify", tmp_path / "calibration.json", again).stdout
    rows = (again / "poses.csv").read_text().splitlines()[:4]
    poses.write_text("\n".join(",".join(row.split(",")[:7]) for row in rows) + "\n")
    run("correct", tmp_path / "calibration.json", "--poses", poses, "--out", tmp_path / "commands.csv")
    commands = np.genfromtxt(tmp_path / "commands.csv", delimiter=",", skip_header=1)[:, 1:]
    np.testing.assert_allclose(commands, arm.with_followers(commands), atol=2e-10)
    given = rig.load(again).commands.at(rig.load(again).exposures.times()[1][:3])
    assert np.abs(commands - given).max() < 0.002
    rows = (rec / "commands.csv").read_text().splitlines()
    cells = rows[3].split(",")
    rows[3] = ",".join([*cells[:4], repr(float(cells[4]) + 0.01), *cells[5:]])
    (rec / "commands.csv").write_text("\n".join(rows) + "\n")
    with pytest.raises(
        FileError, match=r"commands.csv:4:5: .*joint 4 follows joint 2, and is 0.01 rad off -0.8 times it \+0.1"
    ):
        rig.load(rec)


def test_stated_values_of_followers_are_those_of_the_coupling():
    q, frames = np.zeros((2, 6)), np.array([3, 4])
    q[:, [2, 4]] = [0.1, -0.2]
    assert len(ArmKinematics(ARM).forward(frames, q)["frames"]) == 2
    q[1, 2] = 0.3
    with pytest.raises(RigError, match="frame 4: joint 3 follows another .* at 0.1 rad, not at 0.3"):
        ArmKinematics(ARM).forward(frames, q)
