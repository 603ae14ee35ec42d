"""Chains and machines of kinematics files go to a pose as hexapods do; another rig's calibration is refused."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calib.api.correction_server_and_move_to_pose import plan_pose_move, require_same_rig
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.machine_correction import Correction
from calib.models.machine_parameters_and_file_entries import machine_model_of_mechanism
from rig.driving.emulators.move_trials_through_emulator_with_faults import emulated_driver_with_emulator_and_clock
from rig.errors import RigError
from rig.formats.rig_toml.design_from_rig_toml import load_design
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import Coupling
from rig.model.design import Instrument
from rig.model.mechanism_geometry_classes import Chain
from rig.model.pose import pose_difference
from tests.conftest import ROOT
from tests.gantry_and_hexapod import written
from tests.rig.arms import UR10


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
    count = machine_model_of_mechanism(m).parameter_count(m)
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


@pytest.mark.parametrize("stacked", [False, True])
def test_a_calibration_of_an_arm_with_another_tool_is_refused(design, stacked):
    calibrated, longer = UR10, UR10.with_ends(tool=RigidTransform.from_translation([0, 0, 0.1]))
    coupled = replace(UR10, couplings=(Coupling(2, 1, -0.8, 0.1),))
    if stacked:
        calibrated, longer, coupled = (Chain((one, UR10)) for one in (calibrated, longer, coupled))
    known = Calibration(Correction(calibrated, calibrated, (None,) * 6), *[None] * 6)
    for other, says in ((longer, r"tool\S* is 0.1 there, and 0 as calibrated"), (coupled, "coupling is .*leader")):
        with pytest.raises(RigError, match=f"of another rig than rig.toml: mechanism.{'stages.1..' * stacked}{says}"):
            require_same_rig(replace(design, mechanism=other), known, "rig.toml", "calibration.json")
    free = replace(design.instrument, tool="free") if design.instrument else Instrument("rig", "free", 1e-6, 1e-6)
    if not stacked:
        require_same_rig(replace(design, mechanism=longer, instrument=free), known, "rig.toml", "calibration.json")
        base = longer.with_ends(base=RigidTransform.from_translation([0.1, 0, 0]))
        with pytest.raises(RigError, match="mechanism.base"):
            require_same_rig(replace(design, mechanism=base, instrument=free), known, "rig.toml", "calibration.json")
