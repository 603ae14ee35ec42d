"""Chains and machines of kinematics files go to a pose as hexapods do; another rig's calibration is refused."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from calib.api.correction_server_and_move_to_pose import plan_pose_move, require_same_rig
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.correction import Correction
from calib.models.machine_models import model_of
from rig.driving.emulators.fault_trials import emulated_driver_with_emulator_and_clock
from rig.errors import RigError
from rig.formats.rig_toml.design_from_rig_toml import load_design
from rig.model import mechanisms
from rig.model.pose import pose_difference
from tests.conftest import ROOT
from tests.gantry_and_hexapod import written


@pytest.fixture(params=["chain", "file"])
def driven(request, tmp_path):
    """Design of the machine, with a controller."""
    path = tmp_path / "rig.toml"
    if request.param == "chain":
        written(tmp_path)
    else:
        shutil.copy(ROOT / "docs" / "kinematics" / "delta.py", tmp_path)
        shutil.copy(ROOT / "docs" / "kinematics" / "delta.toml", path)
    path.write_text(path.read_text() + '\n[controller]\nprotocol = "grblhal"\nport = "none"\nmax_speed = 0.1\n')
    return load_design(path)


def calibration(design):
    """A calibration that finds nothing, of parameters known to a micrometre or microradian."""
    m = design.mechanism
    count = model_of(m).parameter_count(m)
    correction = Correction(m, m, (None,) * len(m.axes))
    scatter = np.zeros(6 if m.kind == "chain" else len(m.axes))
    return Calibration(correction, np.eye(count) * 1e-12, scatter, (0,), (), None, {"inputs_sha256": {}})


def test_a_pose_is_gone_to_and_what_is_left_is_stated(driven):
    m, known = driven.mechanism, calibration(driven)
    kinematics = mechanisms.kinematics_of(m)
    wanted = kinematics.forward(kinematics.travel_ranges(m) @ [0.45, 0.55], m)
    require_same_rig(driven, known, "rig.toml", "calibration.json")
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(driven, "grblhal")
    driver.open()
    driver.home()
    done = plan_pose_move(driven, known, wanted).carry_out(driver)
    reached = kinematics.forward(emulator.machine.axes.at(clock.now()), m)
    assert np.abs(pose_difference(reached, wanted)).max() < 5e-6
    assert 1e-7 < done.within[0] < 5e-5 and len(emulator.machine.executed) == 1


def test_a_calibration_of_another_machine_is_refused(driven, design):
    known, m = calibration(driven), driven.mechanism
    others = [replace(driven, mechanism=design.mechanism)]
    if m.kind == "chain":
        others.append(replace(driven, mechanism=replace(m, stages=m.stages[::-1])))
    else:
        others.append(replace(driven, mechanism=replace(m, parameters=m.parameters + 1e-3)))
    for other in others:
        with pytest.raises(RigError, match="of another rig"):
            require_same_rig(other, known, "rig.toml", "calibration.json")
