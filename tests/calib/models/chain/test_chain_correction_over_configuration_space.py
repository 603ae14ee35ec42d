"""Corrections of a hexapod on a gantry over its nine axes: exact at their samples, right about themselves between them,
and better than the geometry where axes do what no geometry does.
"""

from dataclasses import replace

import numpy as np
import pytest

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.configuration_space_correction_certification import ExtensionRequest
from calib.files import calibration_file
from calib.models.chain.chain_certification_and_page import chain_workspace_claim, corrected_chain_pose_covariance
from calib.models.chain.chain_correction_over_configuration_space import (
    certify_chain_correction_extension,
    chain_correction_summands,
    rms_and_greatest_chain_single_step_error,
)
from calib.models.chain.chain_error_model_and_identification import chain_with_parameter_step, parameter_tolerances
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.model.mechanisms import mechanism_chain
from rig.model.pose import exp, pose_difference
from rig.planning.configuration_generators import divided_grid_configurations, sobol_configurations
from tests.gantry_and_hexapod import written

SIGMA = np.repeat([1e-6, 5e-6], 3)  # m, rad


def rms(errors):
    return np.sqrt((errors[:, :3] ** 2).sum(axis=1).mean())


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    """(stated Chain, true Chain, its travels (9, 2) m in whose middle it works)."""
    nominal = written(tmp_path_factory.mktemp("gantry")).mechanism
    rng = np.random.default_rng(4)
    step = 0.05 * parameter_tolerances(nominal) * rng.normal(size=len(parameter_tolerances(nominal)))
    travels = mechanism_chain.travel_ranges(nominal)
    middle, half = travels.mean(axis=1, keepdims=True), 0.25 * np.ptp(travels, axis=1, keepdims=True)
    return nominal, chain_with_parameter_step(nominal, step), middle + half * [-1, 1]


def real(x, machine):
    """Poses at commands x (n, 9): every axis falls short by a part of its own travel and of the next one's."""
    _, true, box = machine
    u = (x - box.mean(axis=1)) / np.ptp(box, axis=1)
    return mechanism_chain.forward(x - 1e-4 * np.sin(u + 0.5 * np.roll(u, 1, axis=1)), true)


def samples_at(x, machine, seed=1):
    n, rng = len(x), np.random.default_rng(seed)
    T = real(x, machine) * exp(SIGMA * rng.normal(size=(n, 6)))
    own = np.tile(np.diag(SIGMA**2), (n, 1, 1))
    return Samples(np.arange(n), 10.0 * np.arange(n), x, T, own, np.zeros((n, 6, 0)))


def test_summands_are_the_least_that_explain_a_pose(machine):
    nominal, _, box = machine
    samples = samples_at(sobol_configurations(box, 30, 1.0), machine)
    k = chain_correction_summands(samples, nominal, samples.covariance).values
    reached = mechanism_chain.forward(samples.commanded - k, nominal)
    assert np.abs(pose_difference(reached, samples.T_base_platform)).max() < 1e-10
    span = np.ptp(mechanism_chain.travel_ranges(nominal), axis=1)
    still = np.linalg.svd(mechanism_chain.jacobian(samples.commanded, nominal) * span)[2][:, 6:]
    assert np.abs(still @ (k / span)[..., None]).max() < 0.02 * np.abs(k / span).max()


@pytest.mark.slow
@pytest.mark.parametrize("kind, alone, most", [("simplex", True, 2e-5), ("radial", False, 1.2 * rms(SIGMA[None]))])
def test_commands_lead_to_wanted_poses_closer_than_any_geometry(machine, kind, alone, most, tmp_path):
    nominal, _, box = machine
    x = np.concatenate(
        [divided_grid_configurations(box, "1@1"), sobol_configurations(box, 40, 0.9, 8)]
        if kind == "simplex"
        else [sobol_configurations(box, 200, 1.0, 3)]
    )
    samples, rng = samples_at(x, machine), np.random.default_rng(0)
    done, tried = certify_chain_correction_extension(samples, nominal, ExtensionRequest(kind, alone), rng)
    assert [one.kind for one in tried if one.chosen] == [kind] and (done.correction.fitted is nominal) == alone
    claim = chain_workspace_claim(samples, done, rng)
    calibration_file.save(
        tmp_path / "c.json",
        Calibration(
            done.correction, done.found.covariance, done.found.scatter, (1,), (), done.held_out, {"seed": 0}, claim
        ),
    )
    calibration = calibration_file.load(tmp_path / "c.json")
    correction = calibration.correction
    if kind == "simplex":
        left = pose_difference(correction.predict(samples.commanded[:512]), samples.T_base_platform[:512])
        assert np.abs(left).max() < 1e-10
    at = sobol_configurations(box, 60, 0.8, 5)
    off = pose_difference(correction.predict(at), real(at, machine))
    bare = pose_difference(replace(correction, extension=None).predict(at), real(at, machine))
    stated = np.sqrt(np.einsum("nii->ni", corrected_chain_pose_covariance(calibration, at))[:, :3].sum(axis=1).mean())
    assert rms(off) < most and rms(off) < 0.1 * rms(bare) and 0.7 < rms(off) / stated < 1.2
    assert claim.after[0][1] < 1.2 * rms(off) and rms(off) < 1.2 * claim.after[0][2]
    wanted = real(at, machine)
    commands = correction.inverse(wanted)
    assert rms(pose_difference(real(commands, machine), wanted)) < 2 * most
    assert rms_and_greatest_chain_single_step_error(correction, x)[0] < 2e-5


def test_nothing_is_claimed_where_nothing_could_be_held_out(machine):
    samples, rng = samples_at(divided_grid_configurations(machine[2], "1@1"), machine), np.random.default_rng(0)
    done, _ = certify_chain_correction_extension(samples, machine[0], ExtensionRequest("linear", True), rng)
    claim = chain_workspace_claim(samples, done, rng)
    assert done.left is None and done.held_out is None and not claim.determined, claim
