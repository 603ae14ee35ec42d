"""The fewest poses for a promise: kept on rigs drawn at random, fewer than evenly spread ones, and the next best beside
those given.
"""

import numpy as np
import pytest

from calib.models.fewest_configurations_for_accuracy import fewest_configurations_for_accuracy
from calib.models.machine_parameters_and_file_entries import independent_parameter_names_units_sizes_and_jacobian
from calib.models.platform.platform_identification import identify_platform
from rig.errors import RigError
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.mechanisms import hexapod
from rig.model.pose import pose_difference
from rig.planning.configuration_generators import evenly_spread_configurations
from tests.calib.drift.test_watch_of_other_machines import rig_toml
from tests.calib.noisy_samples import rms, sampled, workspace

SIGMAS = (1e-5, 1e-4)  # m, rad
PROMISE = 2e-5  # m


@pytest.fixture(scope="module")
def found(design):
    return fewest_configurations_for_accuracy(design.mechanism, PROMISE, SIGMAS)


def test_what_is_promised_is_kept_and_not_one_pose_sooner(design, found):
    assert (
        found.left[-1] <= PROMISE < found.left[-2]
        and (np.diff(found.left) < 0).all()
        and len(found.left) == len(found.commands) + 1
    )
    wanted = workspace(design, 100)
    holds = []
    for seed in range(12):
        samples, true = sampled(design, seed, len(found.commands), commands=found.commands, own=np.repeat(SIGMAS, 3))
        fitted = identify_platform(samples, design.mechanism, prior=np.full(42, 5e-4)).mechanism
        left = rms(pose_difference(hexapod.forward(hexapod.inverse(wanted, fitted), true), wanted))[0]
        holds.append(left)
    assert np.mean(np.array(holds) <= PROMISE) >= 11 / 12 and np.median(holds) > 0.3 * PROMISE


def test_what_was_visited_counts(design, found):
    rest = fewest_configurations_for_accuracy(design.mechanism, PROMISE, SIGMAS, found.commands[:10])
    assert abs(len(rest.commands) + 10 - len(found.commands)) <= 1 and rest.left[0] == pytest.approx(
        found.left[10], rel=1e-6
    )
    assert len(fewest_configurations_for_accuracy(design.mechanism, PROMISE, SIGMAS, found.commands).commands) == 0


def test_a_promise_that_measuring_cannot_keep_is_refused(design, monkeypatch):
    monkeypatch.setattr("calib.models.fewest_configurations_for_accuracy.MOST", 12)
    with pytest.raises(RigError, match="12 poses leave"):
        fewest_configurations_for_accuracy(design.mechanism, 1e-7, SIGMAS)


@pytest.mark.parametrize("name", ["delta", "planar2", "arm"])
def test_other_machines_keep_what_is_promised(name, tmp_path):
    machine = design_from_rig_toml.load_design(rig_toml(name, tmp_path)).mechanism
    found = fewest_configurations_for_accuracy(machine, 5e-5, SIGMAS)
    assert found.left[-1] <= 5e-5 < found.left[-2]
    parameters = independent_parameter_names_units_sizes_and_jacobian(machine)
    rows = parameters.jacobian(found.commands) * parameters.size / np.repeat(SIGMAS, 3)[:, None]
    information = np.eye(len(parameters.size)) + np.einsum("nip,niq->pq", rows, rows)
    places = evenly_spread_configurations(machine, 100, 0.8)
    J = (parameters.jacobian(places) * parameters.size)[:, :3]
    rms_error = np.sqrt(np.einsum("nip,pq,niq->n", J, np.linalg.inv(information), J).mean())
    assert rms_error < 5e-5
