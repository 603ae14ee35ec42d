"""Passes on calibrations of arms and chains: over configurations, over poses and over both, each on what the one before
it leaves; kept in files; refused where a map over poses cannot be.
"""

from dataclasses import replace

import numpy as np
import pytest

from calib.api.correction_extension_over_configuration_or_pose_space import ExtendOptions, certify_correction_extension
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.platform_certification import ignore_progress
from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import SummedPasses
from calib.correction.machine_correction import Correction
from calib.files import calibration_file
from calib.models.additional_correction_pass import CorrectionPass, certify_additional_pass
from calib.models.arm.arm_correction import ArmCorrection
from calib.models.chain.chain_error_model_and_identification import parameter_jacobian, parameter_tolerances
from calib.models.machine_parameters_and_file_entries import corrected_pose_covariance
from calib.samples.commanded_and_measured_pose_samples import Sampled, Samples
from rig.errors import RigError
from rig.model.mechanisms import mechanism_chain
from rig.model.pose import exp, pose, pose_difference
from rig.planning.configuration_generators import divided_grid_configurations, sobol_configurations
from tests.calib import secret_arms as worlds
from tests.calib.noisy_samples import rms
from tests.gantry_and_hexapod import written
from tests.rig.arms import SCARA, UR10

OWN = np.repeat([1e-7, 1e-6], 3)  # m, rad; so little that what is left is the map's own
BOX = np.array([0.3, -1.2, 1.4, -0.7, -1.4, 0.2])[:, None] + [-0.15, 0.15]  # rad
FEW = np.array([0.5, 0.9, 0.1, 1.0])[:, None] + np.outer([0.2, 0.2, 0.05, 0.2], [-1, 1])  # of a SCARA, elbow bent
PROVENANCE = {"recording": "first", "created": "then", "data": ["1"]}


def sagging(T):
    """Poses of a hand whose stand yields, the more the farther out it reaches, by whichever joints."""
    x = T.translation - [1.4, -0.8, 0.6]
    return T * exp(1e-3 * np.concatenate([x + 2 * x * x[:, [1, 2, 0]], x[:, ::-1]], axis=1))


def seen(T, commands, sigma=OWN):
    n = len(commands)
    T = T * exp(sigma * np.random.default_rng(1).normal(size=(n, 6)))
    own = np.tile(np.diag(sigma**2), (n, 1, 1))
    return Samples(np.arange(n), np.arange(n) * 10.0, commands, T, own, np.zeros((n, 6, 0)))


def calibration(correction, parameters):
    return Calibration(correction, 1e-12 * np.eye(parameters), np.zeros(6), (), (), None, PROVENANCE)


@pytest.fixture(scope="module")
def arm():
    """(Calibration by the true geometry of an arm, its commands (150, 6) of a first pass)."""
    true = worlds.secret(UR10, np.random.default_rng(3))
    visited = sobol_configurations(BOX, 150, 1.0, 5)
    placed = UR10.with_ends(true.base, true.tool)
    return calibration(ArmCorrection(placed, true, (None,) * 6, visited), 42), visited


def real(before, q):
    return sagging(before.correction.predict(q))


def left(correction, before, wanted):
    """RMS m by which the sagging machine misses wanted poses."""
    return rms(pose_difference(wanted, real(before, correction.inverse(wanted))))[0]


@pytest.mark.parametrize("space", ["configuration", "pose", "both"])
def test_each_pass_takes_what_the_one_before_it_left(arm, space, tmp_path):
    before, q = arm
    first, _, count = certify_additional_pass(
        seen(real(before, q), q), before, CorrectionPass("axes", space), np.random.default_rng(0)
    )  # which holds no products of axes
    assert count == 150 and (first.correction.extension is None) == (space == "pose")
    assert len(first.correction.posed) == (space != "configuration")
    assert first.held_out.after.position[0] < 0.3 * first.held_out.before.position[0]
    wanted = real(before, sobol_configurations(BOX, 40, 0.7, 9))
    commands = first.correction.inverse(wanted)
    assert np.abs(pose_difference(first.correction.predict(commands), wanted)).max() < 1e-10
    once = left(first.correction, before, wanted)
    assert once < 0.3 * left(before.correction, before, wanted)
    made = Calibration(first.correction, first.found.covariance, first.found.scatter, (), (), None, PROVENANCE)
    stated = np.sqrt(np.trace(corrected_pose_covariance(made, wanted, commands)[:, :3, :3], axis1=1, axis2=2).mean())
    assert 0.2 * once < stated < 20 * once
    calibration_file.save(tmp_path / "c.json", made)
    loaded = calibration_file.load(tmp_path / "c.json")
    assert np.abs(pose_difference(loaded.correction.predict(q), first.correction.predict(q))).max() < 1e-13
    again = sobol_configurations(BOX, 150, 1.0, 77)  # measured anew, with the corrected machine
    second, _, _ = certify_additional_pass(
        seen(real(before, again), again), loaded, CorrectionPass("polynomial", space), np.random.default_rng(0)
    )
    assert len(second.correction.posed) == 2 * (space != "configuration")
    assert space == "pose" or isinstance(second.correction.extension, SummedPasses)
    assert left(second.correction, before, wanted) < 0.5 * once


def test_passes_over_grids_are_exact_at_their_vertices(arm):
    before, _ = arm
    grid = divided_grid_configurations(BOX, "1x1x1x1x1x1@1")
    q = np.concatenate([grid, sobol_configurations(BOX, 30, 0.9, 8)])
    samples = seen(real(before, q), q)
    done, tried, _ = certify_additional_pass(samples, before, CorrectionPass("simplex"), np.random.default_rng(0))
    assert [one.kind for one in tried if one.chosen] == ["simplex"] and done.held_out.after.n == 30
    assert np.abs(
        pose_difference(done.correction.predict(grid), seen(real(before, q), q).T_base_platform[:64])
    ).max() < (1e-10)


@pytest.mark.parametrize("tilted", [False, True])
def test_an_arm_of_few_joints_has_a_pose_space_where_its_frame_shows_one(tilted):
    true = worlds.secret(SCARA, np.random.default_rng(5), 0.1)
    base = true.base if tilted else pose([1.2, -0.8, 0.4], [0, 0, 1.0])
    true = true.with_ends(base, true.tool if tilted else pose([0, 0, 0.1], [0, 0, 0]))
    q = sobol_configurations(FEW, 120, 1.0, 5)
    before = calibration(ArmCorrection(SCARA.with_ends(true.base, true.tool), true, (None,) * 4, q), 32)
    samples, rng = seen(real(before, q), q), np.random.default_rng(0)
    if tilted:
        with pytest.raises(RigError, match="lie in fewer dimensions.*--space configuration"):
            certify_additional_pass(samples, before, CorrectionPass("polynomial", "pose"), rng)
        return
    done, _, _ = certify_additional_pass(samples, before, CorrectionPass("polynomial", "pose"), rng)
    (one,) = done.correction.posed
    assert one.coordinates == (0, 1, 2, 5)
    assert done.held_out.after.position[0] < 0.1 * done.held_out.before.position[0]
    wanted = real(before, sobol_configurations(FEW, 30, 0.7, 9))
    off = [
        np.linalg.norm(pose_difference(wanted, real(before, c.inverse(wanted)))[:, :3], axis=1).mean()
        for c in (before.correction, done.correction)
    ]
    assert off[1] < 0.1 * off[0]


def test_a_chain_takes_passes_over_poses(tmp_path):
    nominal = written(tmp_path).mechanism
    travels = mechanism_chain.travel_ranges(nominal)
    box = travels.mean(axis=1, keepdims=True) + 0.25 * np.ptp(travels, axis=1, keepdims=True) * [-1, 1]
    x = sobol_configurations(box, 150, 1.0, 3)
    count = parameter_jacobian(x[:1], nominal).shape[-1]
    assert count == len(parameter_tolerances(nominal))
    before = calibration(Correction(nominal, nominal, (None,) * 9), count)
    for space in ("pose", "configuration"):
        done, _, _ = certify_additional_pass(
            seen(real(before, x), x), before, CorrectionPass("polynomial", space), np.random.default_rng(0)
        )
        assert done.held_out.after.position[0] < 0.2 * done.held_out.before.position[0], space
        inner = sobol_configurations(box, 30, 0.7, 4)
        off = pose_difference(done.correction.predict(inner), real(before, inner))
        assert rms(off)[0] < 0.2 * rms(pose_difference(before.correction.predict(inner), real(before, inner)))[0]


def test_a_tracker_that_was_moved_is_no_error_of_the_machine(arm):
    before, q = arm
    moved = pose([0.02, -0.01, 0.03], [0.01, 0.02, -0.015])
    samples = seen(moved * real(before, q), q)
    options = ExtendOptions("polynomial", onto=before, name="first.json")
    design = worlds.design(UR10)
    options.refuse_unsuited(design)
    result = certify_correction_extension(
        options, design, Sampled(samples, "poses.csv", None, None), np.random.default_rng(0), ignore_progress
    )
    assert (
        "pass 2" in result.base
        and "the base stands elsewhere" in result.remarks[0]
        and result.provenance["samples"] == 150
    )
    wanted = before.correction.predict(sobol_configurations(BOX, 30, 0.7, 9))
    off = np.linalg.norm(result.done.correction.inverse(wanted) - before.correction.inverse(wanted), axis=1)
    assert off.max() < 3e-3  # rad; the motion of the tracker alone is ten times that


def test_what_no_map_over_poses_can_hold_is_refused(arm):
    before, q = arm
    samples = seen(real(before, q), q)
    rng = np.random.default_rng(0)
    wide = worlds.configurations_of(UR10, 60, rng)
    with pytest.raises(RigError, match="degrees from their mean.*--space configuration"):
        certify_additional_pass(seen(real(before, wide), wide), before, CorrectionPass("radial", "pose"), rng)
    alone = np.where(np.eye(6) * np.r_[0, 0, 0, 1, 1, 1] > 0, np.inf, samples.covariance)
    with pytest.raises(RigError, match="the position alone was measured"):
        certify_additional_pass(replace(samples, covariance=alone), before, CorrectionPass("radial", "pose"), rng)
    other = replace(UR10, joints=UR10.joints + 1e-3)
    with pytest.raises(RigError, match="another machine"):
        ExtendOptions("radial", onto=before).refuse_unsuited(worlds.design(other))
