"""An arm with several hands as one calibration: parameters, identification, a trunk seen by both hands, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

import calib
import rig
import synthetic
from calib.certification.calibration_evidence_verdict_and_claim_check import verify_claim_on_samples
from calib.certification.held_out_pose_error_statistics import pose_errors, predicted_poses
from calib.models.arm import arm_error_model_and_instrument_observations as model
from calib.models.arm.arm_base_and_tool_placement_in_instrument_frame import place_base_and_tool_of_arm
from calib.models.arm.arm_identification_and_joint_profiles import identify_arm, independent_arm_parameter_mask
from rig.errors import NotEnoughData
from rig.model.arm_hands_effect_places_and_tolerances import Branch, Hand
from rig.model.mechanism_geometry_classes import Arm
from rig.model.pose import exp, pose, pose_difference
from rig.recording.corner_and_pose_csv_tables import write_poses
from rig.recording.frame_selection_and_content_hashes import select_hand
from tests.cli import run
from tests.two_armed import HUMANOID, NOISE, drawn, humanoid, observed

STEP = 1e-6
NONE = RigidTransform.identity()


@pytest.fixture(scope="module")
def arm():
    return humanoid().mechanism


def gantry_with_two_heads():
    """Two slides that both heads share, and a slide of each head."""
    rows = [[0, 0, 0, -np.pi / 2], [-np.pi / 2, 0, 0, -np.pi / 2], [0, 0, 0, 0], [0, 0, 0.2, 0]]
    heads = tuple(Hand(name, joint, pose([0, 0.05, 0.1], [0, 0, 0])) for name, joint in (("one", 2), ("two", 3)))
    branch = Branch(3, 1, pose([0.3, 0, 0], [0, 0, 0]))
    return Arm(rows, [[-0.4, 0.4]] * 4, slides=np.ones(4, bool), branches=(branch,), hands=heads)


def test_the_parameter_jacobian_is_the_derivative_of_every_hands_pose(arm):
    rng = np.random.default_rng(2)
    arm = drawn(arm, rng, 50)
    q, hand = rng.uniform(*arm.limits.T, (4, 15)), np.array([0, 1, 1, 0])
    J, here = model.parameter_jacobian(q, arm, hand), model.predicted_target_poses(q, arm, hand)
    assert J.shape == (4, 6, len(model.parameter_names(arm))) and len(model.parameter_units(arm)) == J.shape[2]
    for k, step in enumerate(STEP * np.eye(J.shape[2])):
        ends = (model.arm_with_parameter_step(arm, sign * step) for sign in (-1, 1))
        low, high = (pose_difference(here, model.predicted_target_poses(q, one, hand)) for one in ends)
        np.testing.assert_allclose(J[..., k], (high - low) / (2 * STEP), atol=1e-8)


@pytest.mark.parametrize(
    ("make", "count"),
    [
        (lambda: humanoid().mechanism, 4 * 15 + 6 + 6),  # each further hand adds a tool: 6
        (gantry_with_two_heads, 2 * 4 + 6 + 6),
    ],
)
def test_as_many_parameters_are_independent_as_the_rank_of_all_hands_together(make, count):
    """Each further hand adds six, where its target sits; counted by the rank of the whole Jacobian at random arms."""
    arm, rng = make(), np.random.default_rng(8)
    free = independent_arm_parameter_mask(arm, "pose")
    assert free.sum() == count
    arm = replace(arm, hand=0).with_ends(tool=pose(rng.normal(size=3), rng.normal(size=3)))
    q = rng.uniform(*arm.limits.T, (200, len(arm.limits)))
    J = model.parameter_jacobian(q, arm, np.arange(200) % 2)
    rank = [np.linalg.matrix_rank(part.reshape(1200, -1), 1e-8 * 1200) for part in (J, J[..., free])]
    assert rank == [count, count]


@pytest.mark.parametrize("make", [lambda: humanoid().mechanism, gantry_with_two_heads])
def test_exact_poses_give_the_arm_back_and_its_base_and_tools_are_placed(make):
    nominal, rng = make(), np.random.default_rng(5)
    true = replace(drawn(nominal, rng), base=pose([0.5, -1.0, 0.3], [0.3, 0.2, 1.0]))
    for number in range(2):
        true = true.of_hand(number).with_ends(tool=pose(0.1 * rng.normal(size=3), rng.normal(size=3)))
    seen = observed(true, 60, rng, noise=np.zeros(6))
    found = identify_arm(
        seen, place_base_and_tool_of_arm(seen, nominal, True, True), independent_arm_parameter_mask(nominal, "pose")
    )
    assert np.abs(found.residuals).max() < 1e-9 and found.inliers.all()
    elsewhere = observed(true, 30, rng, noise=np.zeros(6))
    assert np.abs(elsewhere.residuals(found.arm)).max() < 1e-8


def test_errors_of_poses_are_as_stated_for_each_hand(arm):
    """The scatter over seeds of poses elsewhere against the stated covariance: chi-square per number about 1."""
    rng, squares = np.random.default_rng(6), []
    true = drawn(arm, rng)
    elsewhere = observed(true, 20, rng, noise=np.zeros(6))
    for _ in range(6):
        found = identify_arm(observed(true, 40, rng), arm)
        J = elsewhere.jacobian(found.arm)
        covariance = J @ found.covariance @ np.swapaxes(J, 1, 2)
        off = elsewhere.residuals(found.arm)
        squares.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off) / 6)
    left, right = np.mean(squares, axis=0).reshape(20, 2).mean(axis=0)
    assert 0.7 < left < 1.4 and 0.7 < right < 1.4


def test_a_trunk_is_known_better_by_both_hands_than_by_one(arm):
    """Errors of the trunk's own parameters, the fit begun at the truth so that all else stands for the same."""
    rng, true = np.random.default_rng(7), drawn(arm, np.random.default_rng(1))
    trunk = [model.parameter_names(arm).index(f"{name} {row}") for row in (1, 2) for name in ("a", "alpha")]
    errors, stated = {(0,): [], (0, 1): []}, {}
    for _ in range(8):
        for hands in errors:
            found = identify_arm(observed(true, 40, rng, hands), true)
            assert found.free[trunk].all()
            errors[hands].append((found.arm.rows - true.rows)[:2, [2, 3]].ravel())
            stated[hands] = np.sqrt(np.diag(found.covariance))[trunk]
    alone, both = (np.sqrt(np.mean(np.square(part), axis=0)) for part in errors.values())
    assert (stated[0, 1] < 0.85 * stated[(0,)]).all()
    assert np.linalg.norm(both / alone) < 0.9 * 2


def test_what_one_hand_alone_shows_of_the_other_is_named(arm):
    found = identify_arm(observed(drawn(arm, np.random.default_rng(3)), 60, np.random.default_rng(4), (0,)), arm)
    unseen = [name for name, others in found.rank.dependent if not others]
    assert "right tool x" in unseen and "alpha 12" in unseen and "left tool x" not in unseen
    assert np.abs(found.residuals / NOISE).max() < 6


@pytest.mark.parametrize("seen", [0, 1])
def test_base_and_tool_are_placed_by_the_hand_that_was_measured(arm, seen):
    rng, hands = np.random.default_rng(11), ("left", "right")
    true = replace(drawn(arm, rng), base=pose([0.5, -1.0, 0.3], [0.3, 0.2, 1.0]))
    true = true.of_hand(seen).with_ends(tool=pose(0.1 * rng.normal(size=3), rng.normal(size=3)))
    found = place_base_and_tool_of_arm(observed(true, 60, rng, (seen,)), arm, True, True)
    elsewhere = observed(true, 20, rng, (seen,), noise=np.zeros(6))
    assert np.abs(elsewhere.residuals(found)).max() < 0.02 and found.hand == 0
    other = 1 - seen
    np.testing.assert_array_equal(found.hands[other].tool.as_matrix(), arm.hands[other].tool.as_matrix())
    few = observed(true, 2, rng, (seen,))
    with pytest.raises(NotEnoughData, match=f"2 observations of a pose of the hand {hands[seen]!r} cannot locate"):
        place_base_and_tool_of_arm(few, arm, True, True)


@pytest.mark.slow
@pytest.mark.parametrize("seen", ["left", "right"])
def test_poses_of_one_hand_are_calibrated_and_what_the_other_would_show_is_named(tmp_path, seen):
    synthetic.simulate(HUMANOID, synthetic.SimulateOptions(plan="sobol:40", seed=4)).write(tmp_path / "REC")
    path, other = tmp_path / "REC" / "poses.csv", {"left": "right", "right": "left"}[seen]
    path.write_text("".join(line for line in path.read_text().splitlines(True) if f",{other}," not in line))
    assert 'base = "free"\ntool = "free"' in (tmp_path / "REC" / "rig.toml").read_text()
    assert "nothing wrong" in run("check", tmp_path / "REC").stdout
    output = run("calibrate", tmp_path / "REC", "--quick", "--out", tmp_path / "c.json").stdout
    assert "40 of them agree with one geometry" in output
    assert f"{other} tool x has no effect on what was measured and remains as stated" in output
    assert f"{seen} tool x has no effect" not in output
    command = ("correct", tmp_path / "c.json", "--poses", tmp_path / "wanted.csv", "--out", tmp_path / "commands.csv")
    write_poses(tmp_path / "wanted.csv", select_hand(rig.load(tmp_path / "REC"), seen).poses.take(np.arange(1)))
    assert f"the hand {other!r} was not measured" in run(*command, "--hand", other, ok=False).stderr
    assert "1 of 1 poses written" in run(*command, "--hand", seen).stdout


def test_a_wild_pose_of_one_hand_leaves_the_other_in_the_fit(arm):
    true, rng = drawn(arm, np.random.default_rng(3)), np.random.default_rng(4)
    seen = observed(true, 60, rng)
    wild = exp(np.where(np.arange(120)[:, None] == 41, [0.02, 0, 0, 0, 0, 0], 0.0))
    found = identify_arm(replace(seen, value=seen.value * wild), arm)
    assert np.flatnonzero(~found.inliers).tolist() == [41]


@pytest.mark.slow
def test_the_claim_is_held_against_the_poses_of_every_hand(tmp_path):
    simulated = synthetic.simulate(HUMANOID, synthetic.SimulateOptions(plan="sobol:40", seed=5))
    simulated.write(tmp_path / "REC")
    recording = rig.load(tmp_path / "REC")
    done = calib.calibrate(recording, calib.CalibrateOptions(quick=True))
    errors = pose_errors(predicted_poses(done.calibration.correction, done.samples), done.samples)
    assert len(errors) == 80 and np.abs(errors / NOISE).max() < 6
    found = verify_claim_on_samples(done.calibration, done.samples, np.random.default_rng(0))
    assert found is not None and found.kept
