"""Arms, chains, planar machines and those of kinematics files are watched: a drift is noticed, a sound one is not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.machine_correction import Correction, fit_geometry_and_remainder_of_correction
from calib.drift.choice_and_order_of_visit_configurations import choose_visit_configurations
from calib.drift.visit_history import History, add_visit_and_judge_change, read_history, write_history
from calib.models.arm.arm_certification import arm_correction_and_identification
from calib.models.calibration_covariance_parameters import covariance_parameters, pose_scatter_covariance
from calib.models.chain.chain_error_model_and_identification import identify_chain
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.formats.rig_toml import design_from_rig_toml
from rig.planning import recording_plan as plan
from rig.recording import recording_folder
from synthetic import random_true_machine_and_truth_file as world
from synthetic import recording_simulation
from tests.conftest import ROOT
from tests.gantry_and_hexapod import written
from tests.rig.arms import SEVEN, UR10

SEEN = '[instrument]\nbase = "rig"\ntool = "rig"\nposition_sigma = 1e-5\nrotation_sigma = 5e-5\n'
PLANAR = """schema = "rig/1"
[mechanism]
kind = "planar2"
base_joints = [[-0.15, 0.0], [0.15, 0.0]]
strut_range = [[0.25, 0.45], [0.25, 0.45]]
"""
# machine: (parameter that drifts, by how many m or rad, as what it is named)
DRIFTS = {
    "arm": ("theta 3", 5e-5, "zero of joint 3"),
    "arm by positions": ("theta 3", 5e-5, "zero of joint 3"),
    "arm of seven joints": ("theta 4", 5e-5, "zero of joint 4"),
    "delta": ("bars 2", 3e-5, "bars 2"),
    "planar2": ("zero of strut 2", 3e-5, "zero of strut 2"),
    "chain": ("stage 2 zero of strut 3", 5e-5, "zero of stage 2 strut 3"),
}
QUIET = 5  # visits before the drift


def arm_text(arm):
    limits = arm.limits / 3
    return f'schema = "rig/1"\n[mechanism]\nkind = "arm"\njoints = {arm.rows.tolist()}\nlimits = {limits.tolist()}\n'


def rig_toml(which, folder):
    """Path of the rig.toml of a machine."""
    if which == "delta":
        return ROOT / "docs" / "kinematics" / "delta.toml"
    if which == "chain":
        written(folder)
    else:
        text = PLANAR if which == "planar2" else arm_text(SEVEN if "seven" in which else UR10)
        seen = SEEN.replace("rotation_sigma = 5e-5\n", "") if which == "arm by positions" else SEEN
        (folder / "rig.toml").write_text(text + seen)
    return folder / "rig.toml"


class Watched:
    """A secret machine, calibrated from 80 poses and visited at chosen ones."""

    def __init__(self, which, folder):
        self.folder, path = folder, rig_toml(which, folder)
        self.design, self.text = design_from_rig_toml.load_design(path), path.read_text()
        self.rng = np.random.default_rng(5)
        self.secret = world.random_true_machine(self.design, self.rng)
        self.first_route = plan.build_plan(self.design, "sobol:80", 1)
        self.first = self.recording("first", self.first_route)
        samples, m = sample_recording(self.first).samples, self.design.mechanism
        if m.kind == "arm":
            correction, found = arm_correction_and_identification(samples, m, self.design.instrument, False)
        elif m.kind == "chain":
            found = identify_chain(samples, m)
            correction = Correction(m, found.chain, (None,) * len(m.axes))
        else:
            correction, found = fit_geometry_and_remainder_of_correction(samples, m, "none")
        self.calibration = Calibration(correction, found.covariance, found.scatter, (), (), None, {})
        chosen = choose_visit_configurations(self.calibration, self.design, 12)
        self.route = plan.plan_of_configurations(
            chosen.commands, chosen.commands[0], plan.planned_axis_speeds(self.design)
        )

    def recording(self, name, route):
        run = recording_simulation.simulate_world(self.secret, route, self.rng)
        recording_simulation.write_recording(run, self.folder / name, self.text, self.rng)
        return recording_folder.load_recording(self.folder / name)

    def drift(self, name, size):
        machine = covariance_parameters(self.secret.true.mechanism)
        step = np.array([one == name for one in machine.names]) * size / machine.scale
        assert step.any(), machine.names
        self.secret = replace(
            self.secret, true=replace(self.secret.true, mechanism=machine.with_values(machine.values + step))
        )

    def visit(self, history):
        """(History, Verdict) with one more visit."""
        recording = self.recording(f"visit{history.number}", self.route)
        return add_visit_and_judge_change(history, recording, self.calibration)


@pytest.mark.parametrize("which", DRIFTS)
def test_a_drift_is_named_within_two_visits_and_nothing_before(which, tmp_path):
    watched, history = Watched(which, tmp_path), History("of the calibration")
    for _ in range(QUIET):
        history, verdict = watched.visit(history)
        assert not verdict.alarm
    write_history(tmp_path / "watch.json", history)
    history = read_history(tmp_path / "watch.json", "of the calibration")
    parameter, size, name = DRIFTS[which]
    watched.drift(parameter, size)
    for _ in range(2):
        history, verdict = watched.visit(history)
    assert verdict.alarm and verdict.named is not None
    assert (verdict.named.name, verdict.named.since) == (name, QUIET)
    assert abs(verdict.named.value[0] - size) < 3 * verdict.named.sigma[0] < size


def test_a_calibration_by_positions_holds_no_rotations():
    covariance = pose_scatter_covariance(UR10, np.full(3, 2e-5), RigidTransform.identity(1))[0]
    assert (np.sqrt(np.diag(covariance)[:3]) == 2e-5).all() and (np.sqrt(np.diag(covariance)[3:]) > 1e-3).all()
