"""Learning as a run goes: what is expected comes near what is measured, a missed step and a drift are said, limbs that
go astray too.
"""

import numpy as np
import pytest

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.machine_correction import Correction
from calib.online.live_learner_limb_watch_run_state_and_display import Learner, LimbWatch
from rig.formats.rig_toml import design_from_rig_toml
from rig.model import mechanisms
from rig.model.pose import exp, transform_points
from rig.planning.configuration_generators import sobol_configurations
from rig.planning.layout import hexapod_layout_and_camera_placement
from synthetic import random_true_machine_and_truth_file

SIGMA = np.r_[np.full(3, 2e-6), np.full(3, 1e-5)]


@pytest.fixture
def machine(design):
    """(stated, true Hexapod, commands (60, 6) m, a function that measures a pose)"""
    rng = np.random.default_rng(8)
    true = random_true_machine_and_truth_file.random_true_machine(design, rng).true.mechanism
    commands = sobol_configurations(design.mechanism.strut_range, 60, seed=2)

    def measured(command, longer=0.0):
        return mechanisms.kinematics_of(true).forward(command + longer, true) * exp(SIGMA * rng.normal(size=6))

    return design.mechanism, true, commands, measured


def test_what_is_expected_comes_near_and_a_missed_step_is_named(machine):
    nominal, _, commands, measured = machine
    learner, changes, errors = Learner(nominal), [], []
    for k, command in enumerate(commands):
        learnt = learner.learn(
            command, measured(command, 6e-5 * (np.arange(6) == 3) if k >= 45 else 0.0), np.diag(SIGMA**2)
        )
        errors.append(np.linalg.norm(learnt.error[:3]))
        changes += [(k, change) for change in learnt.changes]
    assert errors[0] > 1e-4 and np.median(errors[30:45]) < 1e-5
    assert (changes[0][1].kind, changes[0][1].strut) == ("strut", 4) and 45 <= changes[0][0] <= 48, (
        "nothing before it, and it first"
    )
    assert changes[0][1].size == pytest.approx(6e-5, abs=1.5e-5)


def test_a_drift_from_the_calibration_is_said_once(machine):
    nominal, true, commands, measured = machine
    calibration = Calibration(
        Correction(nominal, true, (None,) * 6), np.eye(42) * 1e-12, np.zeros(6), (0,), (), None, {}
    )
    learner, drifts = Learner(nominal, calibration, (5e-5, 1e-3)), []
    for k, command in enumerate(commands):
        learnt = learner.learn(command, measured(command, 1e-5 * max(k - 20, 0)), np.diag(SIGMA**2))
        drifts += [(k, learnt.drift)] if learnt.drift else []
    assert len(drifts) == 1 and 24 <= drifts[0][0] <= 32 and drifts[0][1][0] > 5e-5


def test_limbs_that_go_astray_are_said(tmp_path):
    (tmp_path / "rig.toml").write_text(hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, legs=(6, 6)))
    design = design_from_rig_toml.load_design(tmp_path / "rig.toml")
    rng = np.random.default_rng(8)
    true = random_true_machine_and_truth_file.random_true_machine(design, rng).true
    watch, alarms = LimbWatch(design), []
    for k, command in enumerate(sobol_configurations(design.mechanism.strut_range, 40, seed=2)):
        T = mechanisms.kinematics_of(true.mechanism).forward(command, true.mechanism)
        legs = transform_points(T, true.insitu.platform_joints) - true.insitu.base_joints
        read = np.linalg.norm(legs, axis=1) - true.insitu.zeros + 1e-6 * rng.normal(size=6) + (2e-4 if k >= 33 else 0.0)
        if watch.take(read, T * exp(SIGMA * rng.normal(size=6)), np.diag(SIGMA**2)):
            alarms.append(k)
    assert alarms == [33]
