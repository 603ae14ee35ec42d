"""Arms, chains, planar machines and those of kinematics files are learnt pose by pose, as the batch finds them."""

import json

import numpy as np
import pytest

from calib.api.parameter_learning_pose_by_pose_from_recording import LearnOptions, learn
from calib.models.calibration_covariance_parameters import covariance_parameters
from calib.online.forgetting_least_squares_kalman_and_gradient_learners import load_learner
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.errors import RigError
from rig.model.mechanisms import kinematics_of
from rig.model.pose import pose_difference
from rig.recording.recording_folder import load_recording
from tests.calib.drift.test_watch_of_other_machines import DRIFTS, Watched


@pytest.mark.parametrize("which", [name for name in DRIFTS if name != "arm of seven joints"])
def test_learning_on_line_ends_where_the_batch_does(which, tmp_path):
    batch = Watched(which, tmp_path)
    found = learn(batch.first, LearnOptions(learner="drifting", setting=0.0)).learner
    commands = sample_recording(batch.first).samples.commanded
    T = batch.calibration.correction.predict(commands)
    error = pose_difference(T, kinematics_of(found.mechanism).forward(commands, found.mechanism))
    J = covariance_parameters(found.mechanism).jacobian(commands, T)[..., found.free]
    variance = np.einsum("nij,jk,nik->ni", J, found.covariance, J)
    seen = slice(0, 3 if which == "arm by positions" else 6)
    assert (error**2 <= variance + 1e-18)[:, seen].mean() > 0.95


def test_a_state_goes_on_beside_its_kinematics_file(tmp_path):
    one = Watched("delta", tmp_path)
    first = learn(one.first)
    first.save(tmp_path / "first" / "state.json")
    again = load_learner(tmp_path / "first" / "state.json")
    np.testing.assert_array_equal(again.p, first.learner.p)
    later = learn(one.recording("later", one.route), LearnOptions(tmp_path / "first" / "state.json"))
    assert later.learner.number == first.learner.number + 12
    assert later.tree()["poses_before"] == first.learner.number and json.dumps(later.tree())


def test_an_arm_that_stands_anywhere_starts_from_its_calibration(tmp_path):
    Watched("arm", tmp_path)
    free = (tmp_path / "first" / "rig.toml").read_text().replace('"rig"\ntool = "rig"', '"free"\ntool = "free"')
    (tmp_path / "first" / "rig.toml").write_text(free)
    with pytest.raises(RigError, match="start on-line learning from a calibration"):
        learn(load_recording(tmp_path / "first"))
    with pytest.raises(RigError, match="the learner that names jumps is for hexapods"):
        learn(load_recording(tmp_path / "first"), LearnOptions(learner="filter"))


def test_a_drifted_parameter_is_learnt_from_a_calibration(tmp_path):
    one = Watched("arm", tmp_path)
    one.drift("theta 3", 2e-4)
    options = LearnOptions(calibration=one.calibration, learner="drifting", setting=1e-5)
    found = learn(one.recording("later", one.first_route), options).learner
    k = found.parameters.names.index("theta 3")
    sigma = np.sqrt(np.diag(found.covariance)[found.free == k])
    assert abs(found.p[k] - 2e-4) < 3 * sigma < 1e-4
