"""Arms of which an instrument sees a part of the pose: orientations alone, or the length of a drawn wire; from the
model to the commands.
"""

import re
from dataclasses import replace

import numpy as np
import pytest

from calib.models.arm import (
    arm_base_and_tool_placement_in_instrument_frame,
    arm_error_model_and_instrument_observations,
)
from calib.models.arm.arm_error_model_and_instrument_observations import orientation_observations
from calib.models.arm.arm_identification_and_joint_profiles import identify_arm, independent_arm_parameter_mask
from calib.samples.commanded_and_measured_pose_samples import Samples, sample_recording
from rig.errors import FileError, RigError
from rig.formats.rig_toml.design_from_rig_toml import load_design
from rig.model.pose import exp, pose, pose_difference
from rig.planning.layout.hexapod_layout_and_camera_placement import hexapod_layout_rig_toml
from rig.recording import recording_folder
from tests.calib import secret_arms as worlds
from tests.cli import command
from tests.closed_loops import simulate_with_truth
from tests.numerical_derivatives import jacobian
from tests.rig.arms import SCARA, SEVEN, UR10, configurations

SIGMA = 1e-4  # rad


def leaning(true, nominal, count, rng, noisy=1.0):
    """Observations of orientations alone."""
    q = worlds.configurations_of(nominal, count, rng)
    noise = np.concatenate(
        [np.full((count, 3), 7.0), noisy * SIGMA * rng.normal(size=(count, 3))], axis=1
    )  # positions are rubbish
    return orientation_observations(
        q, arm_error_model_and_instrument_observations.predicted_target_poses(q, true) * exp(noise), SIGMA
    )


def test_rows_of_orientations_agree_with_differences():
    rng = np.random.default_rng(2)
    arm = worlds.secret(UR10, rng)
    seen = leaning(arm, UR10, 4, rng, noisy=0.0)
    predicted = -jacobian(
        lambda step: seen.residuals(arm_error_model_and_instrument_observations.arm_with_parameter_step(arm, step)),
        np.zeros(42),
    )
    np.testing.assert_allclose(seen.jacobian(arm), predicted, atol=1e-7)


@pytest.mark.parametrize("nominal", [UR10, SEVEN], ids=["6R", "7R"])
def test_orientations_tell_the_rotational_parameters_as_well_as_they_say(nominal):
    """Base and target placed by the rotations; every predicted rotation lies within the stated scatter, and lengths
    stay as stated.
    """
    scores = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        true = worlds.secret(nominal, rng)
        seen = leaning(true, nominal, 60, rng)
        found = identify_arm(
            seen, arm_base_and_tool_placement_in_instrument_frame.place_base_and_tool_of_arm(seen, nominal, True, True)
        )
        assert (
            found.rank.free.sum()
            == independent_arm_parameter_mask(nominal, "orientation").sum()
            == 2 * len(nominal.joints) + 3
            and not found.scatter.any()
        )
        np.testing.assert_array_equal(found.arm.rows[:, 1:3], nominal.rows[:, 1:3])
        q = configurations(nominal, 40, rng, 0.5)
        J = arm_error_model_and_instrument_observations.parameter_jacobian(q, found.arm)[:, 3:]
        sigma = np.sqrt(np.einsum("mki,ij,mkj->mk", J, found.covariance, J))
        scores.append(
            pose_difference(
                arm_error_model_and_instrument_observations.predicted_target_poses(q, found.arm),
                arm_error_model_and_instrument_observations.predicted_target_poses(q, true),
            )[:, 3:]
            / sigma
        )
    assert np.abs(scores).max() < 5 and np.mean(np.square(scores)) == pytest.approx(1, abs=0.35)


def test_a_hand_that_turns_about_one_axis_alone_is_not_placed_by_its_rotations():
    rng = np.random.default_rng(3)
    seen = leaning(worlds.secret(SCARA, rng), SCARA, 40, rng)
    with pytest.raises(RigError, match="family of poses"):
        arm_base_and_tool_placement_in_instrument_frame.place_base_and_tool_of_arm(
            replace(seen, value=arm_error_model_and_instrument_observations.predicted_target_poses(seen.q, SCARA)),
            SCARA,
            True,
            True,
        )
    one = arm_base_and_tool_placement_in_instrument_frame.place_base_and_tool_of_arm(
        seen, replace(SCARA, tool=worlds.TOOL), True, False
    )
    assert (one.base.inv() * worlds.BASE).rotation.magnitude() < 0.01


@pytest.mark.parametrize("nominal, base, tool", [(UR10, True, True), (SEVEN, True, True), (UR10, False, True)])
def test_a_wires_lengths_place_its_anchor_and_its_end_on_the_hand(nominal, base, tool):
    """Nothing stated of either; the fit that goes on from there predicts new lengths within what it says."""
    scores = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        true = worlds.secret(nominal, rng)
        start = nominal if base else replace(nominal, base=worlds.BASE)
        q = worlds.configurations_of(nominal, 200, rng)
        lengths = np.linalg.norm(
            arm_error_model_and_instrument_observations.predicted_target_poses(q, true).translation, axis=1
        )
        wire = arm_error_model_and_instrument_observations.distance_observations(
            q, lengths + 2e-5 * rng.normal(size=200), 2e-5
        )
        found = identify_arm(
            wire, arm_base_and_tool_placement_in_instrument_frame.place_base_and_tool_of_arm(wire, start, base, tool)
        )
        assert found.rank.free.sum() == 4 * len(nominal.joints)
        q = configurations(nominal, 40, rng, 0.5)
        new = arm_error_model_and_instrument_observations.distance_observations(q, np.zeros(40), 2e-5)
        J = new.jacobian(found.arm)[:, 0]
        sigma = np.sqrt(np.einsum("mi,ij,mj->m", J, found.covariance, J))
        scores.append((new.residuals(found.arm) - new.residuals(true))[:, 0] / sigma)
    assert np.abs(scores).max() < 5 and np.mean(np.square(scores)) == pytest.approx(1, abs=0.5)


def test_lengths_of_another_arm_place_nothing():
    rng = np.random.default_rng(4)
    wire = arm_error_model_and_instrument_observations.distance_observations(
        worlds.configurations_of(UR10, 60, rng), rng.uniform(0.5, 2.0, 60), 2e-5
    )
    with pytest.raises(RigError, match="the wire's lengths still miss by .* mm"):
        arm_base_and_tool_placement_in_instrument_frame.place_base_and_tool_of_arm(wire, UR10, True, True)


def written(folder, kind, rows, sigma, columns):
    """A recording of an instrument of a kind; rows of poses.csv as text."""
    folder.mkdir()
    (folder / "rig.toml").write_text(
        f'schema = "rig/1"\n[mechanism]\nkind = "arm"\njoints = {UR10.rows.tolist()}\nlimits = {UR10.limits.tolist()}\n'
        f'[instrument]\nkind = "{kind}"\nbase = "free"\ntool = "rig"\n{sigma}\n'
    )
    (folder / "frames.csv").write_text("frame,t,camera,image\n" + "".join(f"{i},{i + 1},,\n" for i in range(len(rows))))
    (folder / "commands.csv").write_text("t,q1,q2,q3,q4,q5,q6\n0,0,0,0,0,0,0\n9,1,1,1,1,1,1\n")
    (folder / "poses.csv").write_text(
        "\n".join([f"frame,{columns}", *(f"{i},{row}" for i, row in enumerate(rows))]) + "\n"
    )
    return folder


def test_a_wires_lengths_and_orientations_are_read(tmp_path):
    lengths = sample_recording(
        recording_folder.load_recording(
            written(tmp_path / "a", "distance", ["1.25", "0.75"], "position_sigma = 1e-5", "distance")
        )
    ).samples
    assert lengths.measured == "distance" and lengths.T_base_platform.translation.tolist() == [
        [1.25, 0, 0],
        [0.75, 0, 0],
    ]
    assert lengths.covariance[0, 0, 0] == pytest.approx(1e-10)
    turned = sample_recording(
        recording_folder.load_recording(
            written(tmp_path / "b", "orientation", ["0.1,0,0.2"], "rotation_sigma = 1e-4", "rx,ry,rz")
        )
    ).samples
    assert turned.measured == "orientation" and turned.T_base_platform.rotation.as_rotvec()[
        0
    ].tolist() == pytest.approx([0.1, 0, 0.2])


@pytest.mark.parametrize(
    "kind, rows, sigma, columns, says",
    [
        ("distance", ["1.2", "-0.1"], "position_sigma = 1e-5", "distance", "must be positive, not -0.1 m"),
        ("distance", ["1250"], "position_sigma = 1e-5", "distance", "millimetres"),
        ("distance", ["1.2"], "position_sigma = 1e-5", "length", "column 'distance' is missing"),
        (
            "distance",
            ["1.2"],
            "position_sigma = 1e-5\nrotation_sigma = 1e-4",
            "distance",
            "sees no rotations; leave out instrument.rotation_sigma",
        ),
        ("orientation", ["0,0,0"], "position_sigma = 1e-5\nrotation_sigma = 1e-4", "rx,ry,rz", "sees no positions"),
        ("orientation", ["0,0,0"], "", "rx,ry,rz", "rotation_sigma is missing"),
        ("distanz", ["1.2"], "position_sigma = 1e-5", "distance", "must be one of 'pose', 'orientation', 'distance'"),
    ],
)
def test_what_an_instrument_cannot_have_seen_is_named(tmp_path, kind, rows, sigma, columns, says):
    with pytest.raises(FileError, match=re.escape(says)):
        recording_folder.load_recording(written(tmp_path / "a", kind, rows, sigma, columns))


@pytest.mark.parametrize("kind, sigma", [("distance", "position_sigma = 1e-5"), ("direction", "rotation_sigma = 1e-5")])
def test_a_platform_with_a_part_of_poses_is_refused_in_rig_toml(tmp_path, kind, sigma):
    path = tmp_path / "rig.toml"
    text = hexapod_layout_rig_toml(0.3) + f'\n[instrument]\nbase = "rig"\ntool = "rig"\nkind = "{kind}"\n{sigma}\n'
    path.write_text(text)
    says = f"kind '{kind}' measures arms; a mechanism of kind 'hexapod' takes whole poses"
    with pytest.raises(FileError, match=says):
        load_design(path)


def test_what_was_measured_of_poses_is_told_by_what_is_known():
    T = pose(np.zeros((2, 3)), np.zeros((2, 3)))
    for variances, measured in (
        ([1] * 6, "pose"),
        ([1, 1, 1] + [np.inf] * 3, "position"),
        ([np.inf] * 3 + [1] * 3, "orientation"),
        ([1] + [np.inf] * 5, "distance"),
    ):
        covariance = np.broadcast_to(np.diag(np.array(variances, float)), (2, 6, 6))
        assert (
            Samples(np.arange(2), np.arange(2.0), np.zeros((2, 6)), T, covariance, np.zeros((2, 6, 0))).measured
            == measured
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind, change, count, left, unit",
    [
        ("orientation", ("position_sigma = 2e-5", 'kind = "orientation"'), 60, 0.25, "mrad"),
        ("distance", ("rotation_sigma = 1e-4", 'kind = "distance"'), 300, 0.03, "mm"),
    ],
)
def test_a_part_of_the_pose_calibrates_through_the_commands(tmp_path, capsys, kind, change, count, left, unit):
    rig = command(capsys)
    rig("design", "--arm", "ur10", "--out", tmp_path / "stated.toml")
    text = (tmp_path / "stated.toml").read_text().replace(*change)
    (tmp_path / "rig.toml").write_text(text)
    simulate_with_truth(tmp_path, f"sobol:{count}", 3)
    output = rig("calibrate", tmp_path / "rec", "--out", tmp_path / "cal.json")
    assert "no factor is claimed" in output and "nan" not in output
    rig(
        "simulate",
        tmp_path / "rig.toml",
        "--plan",
        "sobol:30",
        "--seed",
        "5",
        "--machine",
        tmp_path / "truth.json",
        "--out",
        tmp_path / "other",
    )
    found = re.search(
        rf"([\d.]+) times better .* -> ([\d.]+) {unit} RMS as measured",
        rig("verify", tmp_path / "cal.json", tmp_path / "other"),
    )
    assert float(found[1]) > 5 and float(found[2]) < left
    assert f"the {kind} alone was measured" in rig("diagnose", tmp_path / "rec", "--out", tmp_path / "d", ok=False)
    assert f"the {kind} alone was measured" in rig(
        "certify", tmp_path / "cal.json", tmp_path / "other", "--out", tmp_path / "c.json", ok=False
    )
