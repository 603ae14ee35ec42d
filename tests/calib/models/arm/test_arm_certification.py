"""An arm's calibration as a whole: profiles, held-out figures, what to command, the file, and the command line on real
data.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.files import calibration_file
from calib.models.arm import arm_certification as certifying
from calib.models.arm import arm_error_model_and_instrument_observations
from calib.models.arm.arm_certification import arm_correction_and_identification, certify_arm
from calib.models.arm.joint_space_correction_and_workspace_claim import arm_workspace_claim
from rig.cli import command_line
from rig.errors import NotEnoughData, Unreachable
from rig.model.pose import exp, pose_difference, pose_to_vector
from rig.planning.configuration_generators import sobol_configurations
from tests.calib import secret_arms as worlds
from tests.cli import run
from tests.conftest import make_recording
from tests.rig.arms import SEVEN, UR10, configurations


def geared(q):
    """Joints that go wrong by their own angle: a gear's harmonics."""
    out = np.zeros(q.shape)
    out[:, 1], out[:, 3] = 2e-4 * np.sin(2 * q[:, 1] + 0.3), 1.5e-4 * np.cos(3 * q[:, 3])
    return out


@pytest.fixture(scope="module")
def plain():
    rng = np.random.default_rng(0)
    true = worlds.secret(UR10, rng)
    samples = worlds.tracked(true, UR10, 150, rng)
    return true, samples, certify_arm(samples, UR10, worlds.TRACKER, np.random.default_rng(0))


def test_held_out_poses_are_as_good_as_they_are_measured(plain):
    _, _, done = plain
    assert done.held_out.after.n == 150 and done.held_out.after.position[0] < 1.3 * done.held_out.floor[0]
    assert done.held_out.before.mean[0] > 10 * done.held_out.after.mean[0]
    assert done.correction.remainder == (None,) * 6 and done.held_out.after == done.geometry.after


@pytest.mark.parametrize("nominal", [UR10, SEVEN], ids=["UR10", "seven"])
def test_commands_give_wanted_poses_of_the_real_arm(nominal):
    rng = np.random.default_rng(1)
    true = worlds.secret(nominal, rng)
    correction, found = arm_correction_and_identification(
        worlds.tracked(true, nominal, 120, rng), nominal, worlds.TRACKER, False
    )
    q = configurations(nominal, 60, rng, 0.4)
    bent = (
        np.abs(q[:, len(q[0]) - 4]) > 0.3
    )  # a stretched elbow's poses may be out of the fitted arm's reach by micrometres
    wanted = arm_error_model_and_instrument_observations.predicted_target_poses(q[bent], true)
    commands = correction.inverse(wanted)
    assert np.abs(pose_difference(correction.predict(commands), wanted)).max() < 1e-10
    errors = pose_difference(arm_error_model_and_instrument_observations.predicted_target_poses(commands, true), wanted)
    before = pose_difference(
        arm_error_model_and_instrument_observations.predicted_target_poses(correction.uncorrected(wanted), true), wanted
    )
    assert np.linalg.norm(errors[:, :3], axis=1).max() < 5e-5 < np.linalg.norm(before[:, :3], axis=1).mean()


def test_wanted_poses_are_taken_as_the_visited_ones_were(plain):
    _, samples, done = plain
    bent = (np.abs(np.sin(samples.commanded[:, [2, 4]])) > 0.2).all(
        axis=1
    )  # away from singularities, where noise turns joints far
    commands = done.correction.inverse(samples.T_base_platform[bent])
    assert np.abs(commands - samples.commanded[bent]).max() < 0.02


@pytest.mark.slow
def test_a_pose_out_of_reach_is_named(plain):
    _, samples, done = plain
    far = samples.T_base_platform[:3].as_matrix()
    far[2, :3, 3] += 5
    with pytest.raises(Unreachable, match="1 of 3 wanted poses") as caught:
        done.correction.inverse(type(samples.T_base_platform).from_matrix(far))
    assert list(caught.value.index) == [2]


@pytest.mark.slow
def test_joint_profiles_are_found_where_they_pay():
    rng = np.random.default_rng(2)
    true = worlds.secret(UR10, rng)
    samples = worlds.tracked(true, UR10, 400, rng, deviation=geared)
    done = certify_arm(samples, UR10, worlds.TRACKER, np.random.default_rng(0))
    assert (
        done.held_out.after.mean[0] < 0.5 * done.geometry.after.mean[0]
        and done.held_out.after.position[0] < 1.5 * done.held_out.floor[0]
    )
    q = configurations(UR10, 50, rng, 0.45)
    error = pose_difference(
        done.correction.predict(q),
        arm_error_model_and_instrument_observations.predicted_target_poses(q + geared(q), true),
    )
    assert np.linalg.norm(error[:, :3], axis=1).mean() < 5e-5
    wanted = arm_error_model_and_instrument_observations.predicted_target_poses(q, true)
    np.testing.assert_allclose(
        pose_difference(done.correction.predict(done.correction.inverse(wanted)), wanted), 0, atol=1e-10
    )


@pytest.mark.slow
def test_profiles_that_do_not_pay_are_dropped():
    """A drift in time is no function of the joints' angles, whatever the samples it was fitted on say."""
    rng = np.random.default_rng(3)
    true = worlds.secret(UR10, rng)
    samples = worlds.tracked(
        true, UR10, 150, rng, deviation=lambda q: np.linspace(0, 2e-4, len(q))[:, None] * np.array([0, 1.0, 0, 0, 0, 0])
    )
    assert certify_arm(samples, UR10, worlds.TRACKER, np.random.default_rng(0)).correction.remainder == (None,) * 6


def test_poses_in_the_rigs_own_frames_need_no_placing():
    rng = np.random.default_rng(4)
    true = worlds.secret(UR10, rng)
    known = type(UR10)(UR10.joints, UR10.limits, worlds.BASE, worlds.TOOL)
    samples = worlds.tracked(true, UR10, 120, rng)
    done = certify_arm(samples, known, None, np.random.default_rng(0))
    assert done.correction.nominal is known and done.held_out.after.position[0] < 1.3 * done.held_out.floor[0]


def test_stated_uncertainty_of_a_command_covers_its_error(plain):
    true, samples, done = plain
    calibration = Calibration(done.correction, done.found.covariance, done.found.scatter, (), (), done.held_out, {})
    q = configurations(UR10, 200, np.random.default_rng(5), 0.5)
    covariance = certifying.corrected_arm_pose_covariance(calibration, q)
    error = pose_difference(
        done.correction.predict(q), arm_error_model_and_instrument_observations.predicted_target_poses(q, true)
    )
    nees = np.einsum("mi,mij,mj->m", error, np.linalg.inv(covariance), error)
    assert 1.5 < nees.mean() < 18  # one draw of 30 parameters, so not 6 exactly


def test_the_file_keeps_everything(plain, tmp_path):
    _, samples, done = plain
    calibration = Calibration(
        done.correction, done.found.covariance, done.found.scatter, (1, 2), (3,), done.held_out, {"seed": 0}
    )
    calibration_file.save(tmp_path / "c.json", calibration)
    loaded = calibration_file.load(tmp_path / "c.json")
    np.testing.assert_allclose(
        pose_difference(loaded.correction.predict(samples.commanded), done.correction.predict(samples.commanded)),
        0,
        atol=1e-12,
    )
    assert loaded.held_out == done.held_out and loaded.correction.visited.shape == (150, 6)
    assert json.loads((tmp_path / "c.json").read_text())["parameter_order"].startswith("base x, base y")


@pytest.mark.parametrize(
    "base, tool, alone",
    [
        ("free", "free", False),
        pytest.param("rig", "rig", False, marks=pytest.mark.slow),
        pytest.param("free", "rig", False, marks=pytest.mark.slow),
        pytest.param("free", "free", True, marks=pytest.mark.slow),
    ],
)
def test_a_recording_through_the_commands(base, tool, alone, tmp_path, capsys):
    """Whatever of the instrument's place is known, and whatever it sees: what is then commanded gives the wanted
    pose.
    """
    rng = np.random.default_rng(6)
    true = worlds.secret(UR10, rng)
    true = replace(
        true,
        base=true.base if base == "free" else exp(2e-4 * rng.normal(size=6)),
        tool=true.tool if tool == "free" else exp(2e-4 * rng.normal(size=6)),
    )
    worlds.write(tmp_path / "rec", UR10, worlds.tracked(true, UR10, 160, rng), base, tool, alone)
    worlds.write(tmp_path / "other", UR10, worlds.tracked(true, UR10, 40, rng), base, tool, alone)
    assert command_line.main(["calibrate", str(tmp_path / "rec"), "--out", str(tmp_path / "c.json")]) == 0
    assert f"{27 if alone else 30} of {27 if alone else 30} parameters fitted" in capsys.readouterr().out
    assert command_line.main(["verify", str(tmp_path / "c.json"), str(tmp_path / "other"), "--json"]) == 0
    verified = json.loads(capsys.readouterr().out)
    assert (
        verified["held_out"]
        and verified["after"]["position"]["mean"] < 8e-5 < 3e-4 < verified["before"]["position"]["mean"]
    )
    assert (verified["after"]["rotation"]["mean"] is None) == alone
    if alone:
        return
    q = np.array([[0.4, 0.3, 1.0, -0.7, 0.9, 0.2], [-0.8, -0.6, -1.2, 0.5, -1.1, 1.0]])
    wanted = arm_error_model_and_instrument_observations.predicted_target_poses(q, true)
    rows = [",".join([str(i), *(f"{x:.12f}" for x in row)]) for i, row in enumerate(pose_to_vector(wanted))]
    (tmp_path / "wanted.csv").write_text("\n".join(["frame,x,y,z,rx,ry,rz", *rows]) + "\n")
    assert (
        command_line.main(
            [
                "correct",
                str(tmp_path / "c.json"),
                "--poses",
                str(tmp_path / "wanted.csv"),
                "--out",
                str(tmp_path / "q.csv"),
            ]
        )
        == 0
    )
    commands = np.loadtxt(tmp_path / "q.csv", delimiter=",", skiprows=1)[:, 1:]
    assert (
        np.linalg.norm(
            pose_difference(arm_error_model_and_instrument_observations.predicted_target_poses(commands, true), wanted)[
                :, :3
            ],
            axis=1,
        ).max()
        < 5e-5
    )


def test_an_instrument_that_is_not_where_it_says_is_an_error(tmp_path, capsys):
    rng = np.random.default_rng(6)
    worlds.write(tmp_path / "rec", UR10, worlds.tracked(worlds.secret(UR10, rng), UR10, 60, rng), "rig", "free")
    assert command_line.main(["calibrate", str(tmp_path / "rec"), "--anyway", "--out", str(tmp_path / "c.json")]) == 1
    refused = capsys.readouterr().err
    assert "no place of the tool fits" in refused and 'is [instrument] base unknown as well ("free")?' in refused
    assert not (tmp_path / "c.json").exists()


def test_positions_alone_calibrate_no_hexapod(tmp_path, design, rig_text, capsys):
    make_recording(
        tmp_path / "rec",
        design,
        rig_text + '\n[instrument]\nbase = "rig"\ntool = "rig"\nposition_sigma = 1e-5\n',
        3,
        count=8,
    )
    (tmp_path / "rec" / "poses.csv").write_text("frame,x,y,z\n" + "".join(f"{i},0,0,0.4\n" for i in range(8)))
    assert command_line.main(["calibrate", str(tmp_path / "rec"), "--out", str(tmp_path / "c.json")]) == 1
    assert "positions alone calibrate arms" in capsys.readouterr().err


@pytest.mark.parametrize("count", range(1, 16))
@pytest.mark.slow
def test_few_poses_are_fitted_or_say_what_it_takes(count):
    rng = np.random.default_rng(count)
    samples = worlds.tracked(worlds.secret(UR10, rng), UR10, count, rng)
    if count < 6:
        with pytest.raises(NotEnoughData, match="minimum 6 different poses"):
            certify_arm(samples, UR10, worlds.TRACKER, rng)
        return
    if count > 9 and count % 5:
        done = arm_correction_and_identification(samples, UR10, worlds.TRACKER, False)[
            1
        ]  # the folds of these are tried at 8, 9, 10 and 15
        assert done.rank.free.sum() == 30
        return
    done = certify_arm(samples, UR10, worlds.TRACKER, rng)
    claim = arm_workspace_claim(samples, done, rng)
    assert claim.distinct == count and (claim.ratio is None) == (done.held_out is None) == (count < 8)


@pytest.mark.slow
def test_an_arms_claims_cover_what_is_found_elsewhere():
    inside = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        true = worlds.secret(UR10, rng)
        samples = worlds.tracked(true, UR10, 36 + 4 * seed, rng, repeats=4 * seed)
        done = certify_arm(samples, UR10, worlds.TRACKER, rng)
        claim = arm_workspace_claim(samples, done, rng)
        seen = np.stack([samples.commanded.min(axis=0), samples.commanded.max(axis=0)], axis=1)
        q = sobol_configurations(seen, 200, seed=seed)
        real = arm_error_model_and_instrument_observations.predicted_target_poses(q, true)
        before, after = (
            np.mean(pose_difference(T, real)[:, :3] ** 2)
            for T in (
                arm_error_model_and_instrument_observations.predicted_target_poses(q, done.correction.nominal),
                done.correction.predict(q),
            )
        )
        inside.append(claim.ratio[1] <= np.sqrt(before / after) <= claim.ratio[2])
        assert claim.distinct == 36
    assert sum(inside) >= 4  # 0.95 of 6: fewer than 4 once in 500


@pytest.mark.slow
def test_real_arm_through_the_command_line(shared, tmp_path):
    arm = shared / "recordings/arm-1"
    output = run("calibrate", arm, "--out", tmp_path / "c.json").stdout
    assert "30 of 30 parameters fitted" in output and "random" in output
    tree = json.loads((tmp_path / "c.json").read_text())
    assert tree["held_out"]["before"]["mean"][0] > 0.7e-3 and tree["held_out"]["after"]["mean"][0] < 0.13e-3
    assert (tmp_path / "c.html").read_text().count("<svg") >= 8
    wanted = tmp_path / "wanted.csv"
    lines = (arm / "poses.csv").read_text().splitlines()
    wanted.write_text("\n".join([lines[0], *lines[1:60:4]]) + "\n")
    refused = run("correct", tmp_path / "c.json", "--poses", wanted, "--out", tmp_path / "q.csv", ok=False)
    assert "frame 0: no command comes nearer" in refused.stderr and not (tmp_path / "q.csv").exists()
    run("correct", tmp_path / "c.json", "--poses", wanted, "--out", tmp_path / "q.csv", "--skip-unreachable")
    written = (tmp_path / "q.csv").read_text().splitlines()
    assert written[0] == "frame,q1,q2,q3,q4,q5,q6" and len(written) == 15
    verified = json.loads(run("verify", tmp_path / "c.json", arm, "--json", "--wanted", arm / "poses.csv").stdout)
    assert verified["after"]["position"]["mean"] < 0.11e-3 and not verified["held_out"] and verified["n"] == 1495
