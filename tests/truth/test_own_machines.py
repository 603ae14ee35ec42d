"""The instrument of truth itself: forward against inverse, a known machine driven, figures worked by hand."""

from dataclasses import replace

import numpy as np
import pinocchio
import pytest
from scipy.spatial.transform import Rotation

from tests.truth import KINDS, PLANS, draw, drive, errors, matrices, record, rms, wanted
from tests.truth.draw_machines import nominal, secret
from tests.truth.journey import middle
from tests.truth.kinematics import Arm


@pytest.mark.parametrize("kind", KINDS)
def test_forward_and_inverse_agree(kind):
    rng = np.random.default_rng(4)
    machine = secret(nominal(kind, rng), 1e-3, rng)
    values = middle(machine.ranges, rng.uniform(size=(12, machine.width)))
    poses = machine.forward(values)
    back = machine.inverse(poses, values + rng.normal(0, 1e-4, values.shape))
    assert np.abs(errors(machine.forward(back), poses)).max() < 1e-9
    if kind in ("hexapod", "planar2"):
        assert np.abs(back - values).max() < 1e-12


@pytest.mark.parametrize("plan", PLANS)
def test_a_machine_that_is_known_goes_where_it_is_wanted(plan):
    case = draw(1, "none", "none", plan)
    poses = wanted(case, 30)
    assert max(rms(errors(drive(case, case.machine.inverse(poses)), poses))) < 1e-12
    assert rms(errors(drive(case, case.owner.inverse(poses)), poses))[0] > 5e-5  # the owner's belief does not


def test_a_level_platform_rises_by_hand():
    machine = replace(nominal("hexapod", np.random.default_rng(2)), zeros=np.full(6, 1e-3))
    # of plates with mirrored corners every leg is as long: across^2 by the law of cosines, and up
    inner, outer = np.linalg.norm(machine.plate[0]), np.linalg.norm(machine.base[0])
    apart = np.arccos(machine.base[0] @ machine.plate[0] / inner / outer)
    across = inner**2 + outer**2 - 2 * inner * outer * np.cos(apart)
    up = machine.height + 0.01
    pose = machine.forward(np.full((1, 6), np.sqrt(across + up**2) - 1e-3))[0]
    assert np.allclose(pose, matrices(np.array([[0, 0, up, 0, 0, 0]]))[0], atol=1e-12)


def test_an_arm_by_hand():
    arm = Arm(
        np.array([[0, 0.3, 0.0, 0], [0, 0, 0.5, 0]]),
        np.array([True, False]),
        np.zeros(2),
        np.full((2, 2), [-1.0, 1.0]),
        np.zeros(2),
    )
    pose = arm.forward(np.array([[0.2, np.pi / 2]]))[0]
    assert np.allclose(pose[:3, 3], [0.0, 0.5, 0.5])
    assert np.allclose(pose[:3, 0], [0.0, 1.0, 0.0])


def test_the_same_seed_is_the_same_case(tmp_path):
    one, two = (record(draw(5, "hysteresis", "weak", "revisits"), tmp_path / name) for name in ("one", "two"))
    assert sorted(p.name for p in one.iterdir()) == ["commands.csv", "frames.csv", "poses.csv", "rig.toml"]
    for path in one.iterdir():
        assert path.read_bytes() == (two / path.name).read_bytes()


def test_an_arm_stands_where_pinocchio_has_it():
    rng = np.random.default_rng(6)
    arm = secret(nominal("arm", rng), 5e-3, rng)
    model, fixed = pinocchio.Model(), pinocchio.SE3.Identity()
    joint = 0
    for i, (theta, d, a, alpha) in enumerate(arm.rows):  # each turns about the z that the rows before leave it
        joint = model.addJoint(joint, pinocchio.JointModelRZ(), fixed, f"joint{i}")
        turn = Rotation.from_euler("z", theta + arm.zeros[i]) * Rotation.from_euler("x", alpha)
        lean = Rotation.from_euler("z", theta + arm.zeros[i]).apply([a, 0, d])
        fixed = pinocchio.SE3((turn * Rotation.from_euler("y", arm.tilts[i])).as_matrix(), lean)
    hand = model.addFrame(pinocchio.Frame("hand", joint, 0, fixed, pinocchio.FrameType.OP_FRAME))
    data = model.createData()
    values = middle(arm.ranges, rng.uniform(size=(5, 6)))
    for q, pose in zip(values, arm.forward(values)):
        pinocchio.framesForwardKinematics(model, data, q)
        assert np.allclose(data.oMf[hand].homogeneous, pose, atol=1e-12)
