"""Extensions over an arm's joint space: exact at their samples, kept and told in files, refused where they cannot
serve, and worth it held out.
"""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.configuration_space_correction_certification import ExtensionRequest
from calib.correction.correction_field_methods_fitting_combination_and_json import field_from_entries, field_to_dict
from calib.files import calibration_file
from calib.models.arm import arm_error_model_and_instrument_observations
from calib.models.arm.arm_certification import corrected_arm_pose_covariance
from calib.models.arm.joint_space_correction_and_workspace_claim import (
    certify_arm_correction_extension,
    claim_without_geometry,
    joint_correction_summands_for_interpolation,
    nominal_arm_correction_and_placement,
    rms_and_greatest_joint_single_step_error,
)
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.errors import RigError
from rig.formats.checked_toml_and_json_entries import Entries
from rig.model.pose import exp, pose_difference
from rig.planning.configuration_generators import divided_grid_configurations, sobol_configurations
from rig.recording import recording_folder
from rig.recording.corner_and_pose_csv_tables import write_poses
from rig.recording.recording_folder import Poses
from tests.calib import secret_arms as worlds
from tests.cli import command
from tests.rig.arms import SCARA, SEVEN, UR10

BOX = np.array([0.3, -1.2, 1.4, -0.7, -1.4, 0.2])[:, None] + [-0.15, 0.15]  # rad; all of it bent
OWN = (2e-6, 1e-5)  # m, rad


def geared(q):
    """What gears do to joints, and each to the next: no geometry shows that."""
    return 2e-4 * np.sin(2 * q + 0.3) + 1e-4 * np.sin(q + np.roll(q, 1, axis=-1))


def samples_at(q, true, sigma=OWN, seed=1):
    scale = np.repeat(sigma, 3)
    T = arm_error_model_and_instrument_observations.predicted_target_poses(q - geared(q), true) * exp(
        scale * np.random.default_rng(seed).normal(size=(len(q), 6))
    )
    return Samples(
        np.arange(len(q)),
        np.arange(len(q)) * 10.0,
        q,
        T,
        np.tile(np.diag(scale**2), (len(q), 1, 1)),
        np.zeros((len(q), 6, 0)),
    )


@pytest.fixture(scope="module")
def gridded():
    """(Samples on a grid of 64 vertices and at 30 configurations besides it, true Arm)."""
    true = worlds.secret(UR10, np.random.default_rng(3))
    return samples_at(
        np.concatenate([divided_grid_configurations(BOX, "1x1x1x1x1x1@1"), sobol_configurations(BOX, 30, 0.9, 8)]), true
    ), true


@pytest.mark.parametrize("alone", [False, True])
def test_corrected_poses_are_exact_at_the_samples_and_commands_lead_there(gridded, alone):
    samples, true = gridded
    done, tried = certify_arm_correction_extension(
        samples, UR10, worlds.TRACKER, ExtensionRequest("simplex", alone), np.random.default_rng(0)
    )
    on = slice(0, 64)
    assert (
        np.abs(pose_difference(done.correction.predict(samples.commanded[on]), samples.T_base_platform[on])).max()
        < 1e-10
    )
    assert (done.correction.fitted is done.correction.nominal) == alone and [
        one.kind for one in tried if one.chosen
    ] == ["simplex"]
    assert done.held_out.after.n == 30 and done.held_out.after.position[0] < 0.6 * done.held_out.before.position[0]
    wanted = arm_error_model_and_instrument_observations.predicted_target_poses(
        sobol_configurations(BOX, 20, 0.6, 3), true
    )
    commands = done.correction.inverse(wanted)
    assert np.abs(pose_difference(done.correction.predict(commands), wanted)).max() < 1e-10
    real, bare = (
        pose_difference(arm_error_model_and_instrument_observations.predicted_target_poses(c - geared(c), true), wanted)
        for c in (commands, done.correction.uncorrected(wanted))
    )
    assert np.linalg.norm(real[:, :3], axis=1).mean() < 0.5 * np.linalg.norm(bare[:, :3], axis=1).mean()
    assert 0 < rms_and_greatest_joint_single_step_error(done.correction)[1] < 1e-5


def test_it_is_kept_in_the_file_and_says_how_sure_it_is(gridded, tmp_path):
    samples, true = gridded
    done, _ = certify_arm_correction_extension(
        samples, UR10, worlds.TRACKER, ExtensionRequest("linear", True), np.random.default_rng(0)
    )
    claim = claim_without_geometry(samples, done, np.random.default_rng(0))
    calibration = Calibration(
        done.correction, done.found.covariance, done.found.scatter, (1,), (), done.held_out, {"seed": 0}, claim
    )
    calibration_file.save(tmp_path / "c.json", calibration)
    loaded = calibration_file.load(tmp_path / "c.json")
    inner = sobol_configurations(BOX, 60, 0.7, 4)
    np.testing.assert_array_equal(loaded.correction.rho(inner), done.correction.rho(inner))
    error = pose_difference(
        loaded.correction.predict(inner),
        arm_error_model_and_instrument_observations.predicted_target_poses(inner - geared(inner), true),
    )
    stated = np.sqrt(np.einsum("nii->ni", corrected_arm_pose_covariance(loaded, inner))[:, :3].sum(axis=1).mean())
    assert (
        0.4 < np.sqrt((error[:, :3] ** 2).sum(axis=1).mean()) / stated < 2
    )  # the extension's own error is in what is stated
    plain = replace(loaded, correction=replace(loaded.correction, extension=None))
    assert stated > 2 * np.sqrt(
        np.einsum("nii->ni", corrected_arm_pose_covariance(plain, inner))[:, :3].sum(axis=1).mean()
    )
    assert "extended by linear" in claim.tolerance and claim.after[0][0] < 0.5 * claim.before[0][0]


@pytest.mark.parametrize("arm", [UR10, SEVEN], ids=["six", "seven"])
def test_summands_meet_the_poses_and_keep_none_where_a_pose_tells_no_joint(arm):
    true = worlds.secret(arm, np.random.default_rng(5))
    rng = np.random.default_rng(6)
    q = rng.uniform(-1.2, 1.2, (40, len(arm.joints)))
    q[0, len(arm.joints) - 2] = 0.0  # two axes of the wrist in one line
    samples = samples_at(q, true)
    plain, _ = nominal_arm_correction_and_placement(
        samples, arm, worlds.TRACKER, replace(arm, base=true.base, tool=true.tool)
    )
    known = joint_correction_summands_for_interpolation(samples, plain.fitted, np.zeros(0))
    missed = np.abs(
        pose_difference(
            arm_error_model_and_instrument_observations.predicted_target_poses(q - known.values, plain.fitted),
            samples.T_base_platform,
        )
    ).max(axis=1)
    assert (missed < 1e-11).mean() > 0.7 and np.abs(known.values).max() < 0.05
    if len(arm.joints) == 6:
        assert missed[0] > 1e-6 and known.variances[0].max() >= known.variances.max() / 4


def test_what_cannot_serve_is_refused_by_name(gridded):
    samples, true = gridded
    with pytest.raises(RigError, match="the 30 samples fill no grid .* over 6 axes it has 64 vertices at least"):
        certify_arm_correction_extension(
            samples.take(slice(64, 94)),
            UR10,
            worlds.TRACKER,
            ExtensionRequest("simplex", True),
            np.random.default_rng(0),
        )
    turned = replace(samples, covariance=np.where(np.eye(6) * np.r_[1, 1, 1, 0, 0, 0] > 0, np.inf, samples.covariance))
    with pytest.raises(RigError, match="--extend takes an arm's poses, or its positions.* orientations alone"):
        certify_arm_correction_extension(
            turned, UR10, worlds.TRACKER, ExtensionRequest("radial", False), np.random.default_rng(0)
        )


@pytest.mark.slow
def test_gears_are_corrected_through_the_command_line(tmp_path, capsys):
    rig, rng = command(capsys), np.random.default_rng(2)
    true = worlds.secret(UR10, rng)
    noise = (2e-5, 1e-4)
    for name, count in (("rec", 400), ("rec2", 120)):
        q = worlds.configurations_of(UR10, count, rng)
        worlds.write(tmp_path / name, UR10, samples_at(q[np.abs(q[:, 2]) > 0.3], true, noise, count))
    figures = {}
    for extension in ("auto", "radial"):
        output = rig("calibrate", tmp_path / "rec", "--extend", extension, "--out", tmp_path / f"{extension}.json")
        figures[extension] = {kind: float(mm) for kind, mm in re.findall(r"(\w+) +held out ([\d.]+) mm", output)}
        assert re.search(r"KSF over the whole configuration space: \w+, on the fitted geometry", output)
        assert "the single step X + KSF(X) misses the fixed point" in output and " urad RMS" in output
    assert figures["radial"]["radial"] < 0.6 * figures["radial"]["none"]  # what is left is mostly what measuring adds
    assert (
        set(figures["auto"]) == {"none", "delaunay", "axes", "radial", "polynomial"}
        and "<svg" in (tmp_path / "auto.html").read_text()
    )
    rig("calibrate", tmp_path / "rec", "--out", tmp_path / "plain.json")
    result = {
        name: json.loads(rig("verify", tmp_path / f"{name}.json", tmp_path / "rec2", "--json"))
        for name in ("radial", "plain")
    }
    assert result["radial"]["after"]["position"]["rms"] < 0.2 * result["radial"]["before"]["position"]["rms"]
    wanted = arm_error_model_and_instrument_observations.predicted_target_poses(
        sobol_configurations(BOX, 40, 0.9, 3), true
    )
    write_poses(tmp_path / "wanted.csv", Poses(np.arange(40), wanted, None))
    left = {}
    for name, more in (("radial", ()), ("bare", ("--uncorrected",)), ("single", ("--single-step",))):
        rig("correct", tmp_path / "radial.json", "--poses", tmp_path / "wanted.csv", "--out", tmp_path / "c.csv", *more)
        c = np.genfromtxt(tmp_path / "c.csv", delimiter=",", skip_header=1)[:, 1:]
        left[name] = np.sqrt(
            (
                pose_difference(
                    arm_error_model_and_instrument_observations.predicted_target_poses(c - geared(c), true), wanted
                )[:, :3]
                ** 2
            )
            .sum(axis=1)
            .mean()
        )
    assert left["radial"] < 0.1 * left["bare"] and left["radial"] < 6e-5 and left["single"] < 2 * left["radial"]
    stated = rig("certify", tmp_path / "radial.json", tmp_path / "rec2", "--out", tmp_path / "certificate.json")
    assert "95 %" in stated and json.loads((tmp_path / "certificate.json").read_text())
    again = ("calibrate", tmp_path / "rec2", "--extend", "axes", "--onto", tmp_path / "radial.json")
    output = rig(*again, "--out", tmp_path / "again.json")
    assert "radial.json, pass 2" in output and "the base stands where it stood" in output
    assert json.loads((tmp_path / "again.json").read_text())["provenance"]["pass"]["number"] == 2
    assert "degrees from their mean" in rig(*again, "--space", "pose", "--out", tmp_path / "pose.json", ok=False)


def test_a_smooth_field_promises_what_it_does_where_nothing_was_measured():
    """Its own standard error, of sizes and smoothness as they are likeliest, is less than half of that."""
    true, box = worlds.secret(UR10, np.random.default_rng(3)), BOX + [-0.45, 0.45]
    samples = samples_at(sobol_configurations(box, 100, 1.0, 1), true)
    done, _ = certify_arm_correction_extension(
        samples, UR10, worlds.TRACKER, ExtensionRequest("radial", True), np.random.default_rng(0)
    )
    claim, q = claim_without_geometry(samples, done, np.random.default_rng(0)), sobol_configurations(box, 256, 0.8, 7)
    error = pose_difference(
        done.correction.predict(q),
        arm_error_model_and_instrument_observations.predicted_target_poses(q - geared(q), true),
    )[:, :3]
    assert done.correction.extension.inflation > 1.5
    size = np.sqrt((error**2).sum(axis=1).mean())  # nearer the middle than most that were held out
    assert 0.6 < size / claim.after[0][0] < 1.3 and claim.after[0][1] < claim.after[0][2] < 4 * claim.after[0][1]
    result = field_from_entries(
        Entries(json.loads(json.dumps(field_to_dict(done.correction.extension))), ("extension",), "c.json", {}), 6
    )
    np.testing.assert_array_equal(result.error(q), done.correction.extension.error(q))


@pytest.mark.slow
def test_correction_values_of_an_arm_meet_what_was_measured(tmp_path, capsys):
    rig, rng = command(capsys), np.random.default_rng(2)
    true = worlds.secret(UR10, rng)
    worlds.write(tmp_path / "rec", UR10, worlds.tracked(true, UR10, 60, rng))
    rig("calibrate", tmp_path / "rec", "--out", tmp_path / "c.json")
    rows = np.genfromtxt(tmp_path / "c.ksf.csv", delimiter=",", names=True)
    x, y, k = (np.stack([rows[f"{name}{i}"] for i in range(1, 7)], axis=1) for name in "xyk")
    np.testing.assert_allclose(k, x - y, atol=2e-12)
    placed = calibration_file.load(tmp_path / "c.json").correction.nominal
    missed = pose_difference(
        arm_error_model_and_instrument_observations.predicted_target_poses(y, placed),
        recording_folder.load_recording(tmp_path / "rec").poses.T_base_platform,
    )
    assert (np.abs(missed).max(axis=1) < 1e-9).mean() > 0.7 and 1e-4 < np.sqrt((k**2).mean()) < 1e-2


@pytest.mark.slow
def test_vertices_without_a_pose_are_listed_and_planned_and_corrected_nearly_as_well(tmp_path, capsys):
    rig, rng = command(capsys), np.random.default_rng(7)
    true = worlds.secret(SCARA, rng, 0.3)
    box = np.array([0.5, 0.9, 0.1, 1.0])[:, None] + np.outer([0.2, 0.2, 0.05, 0.2], [-1, 1])  # elbow bent
    grid = divided_grid_configurations(box, "2x2x2x2@1")
    lost = np.sort(rng.permutation(81)[:6])
    x = np.concatenate([np.delete(grid, lost, axis=0), sobol_configurations(box, 30, 0.9, 8)])
    worlds.write(tmp_path / "rec", SCARA, samples_at(x, true, sigma=(2e-6, 1e-5)), sigma=(2e-6, 1e-5))
    output = rig("calibrate", tmp_path / "rec", "--extend", "linear", "--alone", "--out", tmp_path / "c.json")
    assert "6 of the grid's 81 vertices were not measured" in output and "exact at its 75 samples" in output
    listed = np.genfromtxt(tmp_path / "c.lost.csv", delimiter=",", names=True)
    np.testing.assert_allclose(
        np.stack([listed[f"q{i + 1}"] for i in range(4)], axis=1), grid[lost][np.lexsort(grid[lost].T[::-1])], atol=1e-6
    )
    correction = calibration_file.load(tmp_path / "c.json").correction
    off, bare = (
        pose_difference(
            one.predict(grid[lost]),
            arm_error_model_and_instrument_observations.predicted_target_poses(grid[lost] - geared(grid[lost]), true),
        )[:, :3]
        for one in (correction, replace(correction, extension=None))
    )
    size = [np.sqrt((errors**2).sum(axis=1).mean()) for errors in (off, bare)]
    assert size[0] < 1.3 * np.sqrt(3) * 2e-6 < 0.3 * size[1]  # as a vertex that was measured
