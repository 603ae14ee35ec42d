"""Extensions over the configuration space: exact on their grid, the best one by held-out poses, and promised no better
than they are.
"""

from dataclasses import replace

import numpy as np
import pytest

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.configuration_space_correction_certification import (
    ExtensionRequest,
    certify_extended_correction,
    claim_without_geometry,
)
from calib.certification.platform_certification import corrected_platform_pose_covariance, platform_workspace_claim
from calib.correction.correction_field_methods_fitting_combination_and_json import (
    rms_and_greatest_strut_single_step_error,
)
from calib.files import calibration_file
from calib.models.additional_correction_pass import CorrectionPass, certify_additional_pass
from rig.errors import RigError
from rig.model.mechanisms import hexapod
from rig.model.pose import pose_difference
from rig.planning.configuration_generators import divided_grid_configurations, sobol_configurations
from rig.recording import corner_and_pose_csv_tables
from tests.calib.noisy_samples import real, rms, sampled, workspace

OWN = np.array([1e-7, 1e-7, 1e-7, 1e-6, 1e-6, 1e-6])  # m, rad; so little that what is left is the way's own


def coupled(commands):
    """Struts that feel each other, smoothly: no geometry does that."""
    u = (commands - commands.mean()) / 0.05
    return 3e-5 * np.stack([np.sin(u[..., i] + u[..., (i + 1) % 6]) for i in range(6)], axis=-1)


@pytest.fixture(scope="module")
def gridded(design):
    """(Samples on the grid 2x1x1x1x1x2 and at 30 configurations besides it, true Hexapod)."""
    strokes = design.mechanism.strut_range
    commands = np.concatenate(
        [divided_grid_configurations(strokes, "2x1x1x1x1x2@0.6"), sobol_configurations(strokes, 30, 0.5, 8)]
    )
    return sampled(design, 4, len(commands), coupled, commands=commands, own=OWN)


@pytest.mark.slow
@pytest.mark.parametrize("alone", [False, True])
def test_corrected_poses_are_exact_at_the_samples(gridded, design, alone):
    samples, true = gridded
    done, _ = certify_extended_correction(
        samples, design.mechanism, ExtensionRequest("simplex", alone), np.random.default_rng(0)
    )
    on = slice(0, 144)
    assert (
        np.abs(pose_difference(done.correction.predict(samples.commanded[on]), samples.T_base_platform[on])).max()
        < 1e-9
    )
    assert done.held_out.after.n == 30 and done.held_out.after.position[0] < 0.2 * done.held_out.before.position[0]
    assert (done.correction.fitted is done.correction.nominal) == alone


@pytest.mark.slow
def test_auto_takes_what_does_best_on_poses_held_out(gridded, design):
    samples, true = gridded
    done, tried = certify_extended_correction(
        samples, design.mechanism, ExtensionRequest("auto", False), np.random.default_rng(0)
    )
    figures = {one.kind: one.held_out.after.position[0] for one in tried if one.held_out}
    chosen = [one.kind for one in tried if one.chosen]
    assert (
        len(chosen) == 1
        and chosen != ["none"]
        and {"simplex", "linear", "delaunay", "axes", "radial", "polynomial", "none"} == set(figures)
    )
    assert figures[chosen[0]] < 1.3 * min(figures.values()) < figures["none"]
    wanted = workspace(design, 60)
    left = [
        rms(pose_difference(wanted, real(c.inverse(wanted), true, coupled)))[0]
        for c in (done.correction, replace(done.correction, extension=None))
    ]
    assert left[0] < left[1]


def test_where_noise_explains_all_that_is_left_a_smooth_field_is_empty(design):
    done, _ = certify_extended_correction(
        sampled(design, 1, 60)[0], design.mechanism, ExtensionRequest("radial", False), np.random.default_rng(0)
    )
    field = done.correction.extension
    assert (
        field.parts == (None,) * 6
        and field.inflation == 1
        and done.held_out.after.position[0] < 0.1 * done.held_out.before.position[0]
    )


@pytest.mark.slow
def test_scattered_samples_leave_the_grids_out_of_auto_and_refuse_them_by_name(design):
    samples, _ = sampled(design, 5, 40)
    with pytest.raises(RigError, match="fill no grid"):
        certify_extended_correction(
            samples, design.mechanism, ExtensionRequest("linear", False), np.random.default_rng(0)
        )
    done, tried = certify_extended_correction(
        samples, design.mechanism, ExtensionRequest("auto", False), np.random.default_rng(0)
    )
    assert {one.kind for one in tried if one.held_out is None} == {"linear", "simplex"}
    assert done.correction.extension is None  # noise alone is left, and no way makes something of it


@pytest.mark.slow
def test_an_extended_calibration_is_kept_and_says_how_sure_it_is(gridded, design, tmp_path):
    samples, true = gridded
    done, _ = certify_extended_correction(
        samples, design.mechanism, ExtensionRequest("linear", True), np.random.default_rng(0)
    )
    claim = claim_without_geometry(samples, done, np.random.default_rng(0))
    calibration = Calibration(
        done.correction, done.found.covariance, done.found.scatter, (1,), (), done.held_out, {"seed": 0}, claim
    )
    calibration_file.save(tmp_path / "c.json", calibration)
    loaded = calibration_file.load(tmp_path / "c.json")
    inner = sobol_configurations(design.mechanism.strut_range, 80, 0.55, 3)
    np.testing.assert_allclose(loaded.correction.rho(inner), done.correction.rho(inner), atol=1e-18)
    T = real(inner, true, coupled)
    error = pose_difference(loaded.correction.predict(inner), T)
    stated = corrected_platform_pose_covariance(loaded, T)
    ratio = (error[:, :3] ** 2).sum() / np.trace(stated[:, :3, :3], axis1=1, axis2=2).sum()
    assert 0.05 < ratio < 4
    top, _ = certify_extended_correction(
        samples, design.mechanism, ExtensionRequest("linear", False), np.random.default_rng(0)
    )
    assert platform_workspace_claim(samples, top, np.random.default_rng(0)).after[0][0] < claim.before[0][0]


def test_the_single_step_misses_what_the_fixed_point_meets(gridded, design):
    samples, _ = gridded
    correction = certify_extended_correction(
        samples, design.mechanism, ExtensionRequest("linear", True), np.random.default_rng(0)
    )[0].correction
    wanted = workspace(design, 40)
    exact, step = correction.inverse(wanted), correction.single_step(wanted)
    x = hexapod.inverse(wanted, design.mechanism)
    np.testing.assert_allclose(step, x + correction.summand(x), atol=1e-15)
    np.testing.assert_allclose(exact, x + correction.summand(exact), atol=1e-11)
    assert 1e-7 < np.abs(step - exact).max() < 1e-4 and rms_and_greatest_strut_single_step_error(correction)[1] > 1e-7


@pytest.mark.slow
def test_readings_become_the_poses_that_they_stand_for(gridded, design, tmp_path):
    """The other way round, through the command: what a measuring machine reads, corrected, with a covariance that its
    errors keep to.
    """
    from rig.cli.command_line import main

    samples, true = gridded
    done, _ = certify_extended_correction(
        samples, design.mechanism, ExtensionRequest("simplex", False), np.random.default_rng(0)
    )
    calibration_file.save(
        tmp_path / "c.json",
        Calibration(done.correction, done.found.covariance, done.found.scatter, (1,), (), None, {"seed": 0}, None),
    )
    read = sobol_configurations(design.mechanism.strut_range, 40, 0.55, 6)
    lines = [f"{k}," + ",".join(f"{v:.9f}" for v in row) for k, row in enumerate(read)]
    (tmp_path / "r.csv").write_text("\n".join(["frame,l1,l2,l3,l4,l5,l6", *lines]) + "\n")
    assert main(
        ["correct", str(tmp_path / "c.json"), "--forward", str(tmp_path / "r.csv"), "--out", str(tmp_path / "p.csv")]
    ) in (0, None)
    got = corner_and_pose_csv_tables.load_poses(tmp_path / "p.csv")
    T = real(read, true, coupled)
    error, before = pose_difference(got.T_base_platform, T), pose_difference(hexapod.forward(read, design.mechanism), T)
    assert rms(error)[0] < 0.05 * rms(before)[0]
    ratio = (error[:, :3] ** 2).sum() / np.trace(got.covariance[:, :3, :3], axis1=1, axis2=2).sum()
    assert 0.05 < ratio < 4
    (tmp_path / "r.csv").write_text("frame,l1,l2,l3,l4,l5,l6\n0,1,1,1,1,1,1\n")
    assert (
        main(
            [
                "correct",
                str(tmp_path / "c.json"),
                "--forward",
                str(tmp_path / "r.csv"),
                "--out",
                str(tmp_path / "q.csv"),
            ]
        )
        == 1
    )


def test_a_second_pass_takes_what_the_first_one_left(gridded, design, tmp_path):
    """A function of each axis alone leaves what struts feel of each other; a pass of simplices on top takes it; both
    are kept in order.
    """
    samples, true = gridded
    first, _ = certify_extended_correction(
        samples, design.mechanism, ExtensionRequest("axes", True), np.random.default_rng(0)
    )
    before = Calibration(first.correction, first.found.covariance, first.found.scatter, (), (), None, {})
    second, tried, count = certify_additional_pass(samples, before, CorrectionPass("simplex"), np.random.default_rng(0))
    assert count == len(samples)
    figures = {one.kind: one.held_out.after.position[0] for one in tried}
    assert figures["simplex"] < 0.7 * figures["none"]
    inner = sobol_configurations(design.mechanism.strut_range, 60, 0.5, 3)
    left = [
        rms(pose_difference(done.correction.predict(inner), real(inner, true, coupled)))[0] for done in (first, second)
    ]
    assert left[1] < 0.7 * left[0]
    assert [field.kind for field in second.correction.extension.fields] == ["axes", "simplex"]
    np.testing.assert_allclose(
        second.correction.extension.gradient(inner), sum(f.gradient(inner) for f in second.correction.extension.fields)
    )
    calibration = Calibration(
        second.correction, second.found.covariance, second.found.scatter, (1,), (), second.held_out, {"seed": 0}
    )
    calibration_file.save(tmp_path / "c.json", calibration)
    np.testing.assert_allclose(
        calibration_file.load(tmp_path / "c.json").correction.rho(inner), second.correction.rho(inner), atol=1e-18
    )
    source = calibration_file.additional_pass_provenance(
        {"recording": "b", "data": ["2"]},
        replace(calibration, provenance={"recording": "a", "data": ["1"], "created": "then"}),
        {"number": 2},
    )
    assert source == {
        "recording": "b",
        "pass": {"number": 2},
        "data": ["1", "2"],
        "passes": [{"recording": "a", "created": "then"}],
    }
