"""Machines whose owner states their kinematics in a file, against a second writer's forward kinematics.

The secret machine is 0.3 mm and 0.6 mrad off the file's figures. Poses are driven to by the corrected commands; the
error against what was wanted is held against the Cramer-Rao bound of the recording.
"""

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

import calib
import rig
from calib.api.calibrate import CalibrateOptions
from calib.api.correction_extension_over_configuration_or_pose_space import ExtendOptions
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from rig.model.mechanisms import kinematics_of
from tests.conftest import ROOT
from tests.truth.other_machines import OTHERS, OtherMachine, grid, measured, scattered
from tests.truth.rigid import errors, rms, rows_of
from tests.truth.written import UPPER, table

EXAMPLES = ROOT / "docs" / "kinematics"
SIGMA = (2e-5, 1e-4)  # m, rad; of a measured pose
MIDDLE = 0.8  # share of every travel that is recorded and driven to
QUICK = CalibrateOptions(quick=True)
SIMPLICES = CalibrateOptions(quick=True, extend=ExtendOptions("simplex", alone=True))
IDENTIFIED, INTERPOLATED = 1.3, 3.0  # of the Cramer-Rao bound


def recorded(machine: OtherMachine, values: np.ndarray, folder: Path, rng: np.random.Generator) -> rig.Recording:
    """A recording of the machine at values (n, axes), a pose each."""
    folder.mkdir(parents=True)
    name = machine.name
    for end, to in (("py", f"{name}.py"), ("toml", "rig.toml")):
        shutil.copy(EXAMPLES / f"{name}.{end}", folder / to)
    t = np.repeat(2.0 * np.arange(len(values)), 2) + np.tile([0.0, 1.5], len(values))
    axes = [f"q{i + 1}" for i in range(values.shape[1])]
    table(folder / "commands.csv", ("t", *axes), np.column_stack([t, np.repeat(values, 2, axis=0)]))
    looked = "".join(f"{k},{2.0 * k + 1.0:.3f},,\n" for k in range(len(values)))
    (folder / "frames.csv").write_text("frame,t,camera,image\n" + looked)
    square = np.diag(np.repeat(np.square(SIGMA), 3))[np.triu_indices(6)]
    seen = np.column_stack([rows_of(measured(machine.forward(values), SIGMA, rng)), np.tile(square, (len(values), 1))])
    table(
        folder / "poses.csv",
        ("frame", "x", "y", "z", "rx", "ry", "rz", *UPPER),
        np.column_stack([np.arange(len(values)), seen]),
    )
    return rig.load(folder)


def driven(calibration: Calibration, machine: OtherMachine, at: np.ndarray) -> float:
    """m, RMS position error of the machine at the poses that values (m, axes) give, driven to by a calibration."""
    wanted = machine.forward(at)
    commands = calib.correct(calibration, RigidTransform.from_matrix(wanted)).values
    return rms(errors(machine.forward(commands), wanted))[0]


def shares(name: str, seeds: range, count: int, folder: Path, middle: float = MIDDLE, simplices: bool = False) -> float:
    """Pooled error over the Cramer-Rao bound, of one secret machine a seed, in the middle share of every travel.

    count : of scattered configurations; with simplices, parts of each axis, of a grid that is interpolated alone
    """
    found, options = [], SIMPLICES if simplices else QUICK
    for seed in seeds:
        rng = np.random.default_rng([seed, 71])
        machine = OTHERS[name]().secret(rng)
        own = grid(machine, count, middle) if simplices else scattered(machine, count, middle, rng)
        at = scattered(machine, 40, 0.9 * middle, rng)
        recording = recorded(machine, own, folder / str(seed), rng)
        calibration = calib.calibrate(recording, options).calibration
        found.append(driven(calibration, machine, at) / machine.bound(own, SIGMA, at))
    print(name, "error over the bound:", " ".join(f"{one:.3f}" for one in found))
    return float(np.sqrt(np.mean(np.square(found))))


@pytest.mark.parametrize("name", OTHERS)
def test_the_file_and_the_second_writer_agree(name):
    machine = OTHERS[name]()
    mechanism = rig.load_design(EXAMPLES / f"{name}.toml").mechanism
    values = scattered(machine, 20, MIDDLE, np.random.default_rng(3))
    T = kinematics_of(mechanism).forward(values, mechanism)
    assert np.abs(errors(T.as_matrix(), machine.forward(values))).max() < 1e-9
    back = kinematics_of(mechanism).inverse(RigidTransform.from_matrix(machine.forward(values)), mechanism)
    assert np.abs(back - values).max() < 1e-9


@pytest.mark.slow
def test_a_delta_is_identified_to_the_bound(tmp_path):
    assert shares("delta", range(1), 30, tmp_path) < IDENTIFIED


@pytest.mark.slow
def test_a_delta_is_corrected_by_simplices_alone(tmp_path):
    assert shares("delta", range(1), 2, tmp_path, 0.6, simplices=True) < INTERPOLATED


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHERS)
def test_campaign_of_identification(name, tmp_path):
    assert shares(name, range(10), 60, tmp_path) < IDENTIFIED


@pytest.mark.slow
@pytest.mark.parametrize(("name", "parts", "middle"), [("delta", 2, 0.6), ("hexaglide", 1, 0.3), ("cranks", 1, 0.3)])
def test_campaign_of_simplices_alone(name, parts, middle, tmp_path):
    assert shares(name, range(6), parts, tmp_path, middle, simplices=True) < INTERPOLATED
