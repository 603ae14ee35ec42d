"""What geometry and physics may exchange is no error of a stated machine: slides out of square, and coupled."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.api.calibrate import CalibrateOptions, calibrate
from calib.api.diagnose import diagnose
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.recording import recording_folder

RIG = """schema = "rig/1"
[mechanism]
kind = "arm"
joints = [["prismatic", 0.0, 0.0, 0.0, -1.5707963267948966], ["prismatic", -1.5707963267948966, 0.0, 0.0,
 -1.5707963267948966], ["prismatic", 0.0, 0.0, 0.0, 0.0]]
limits = [[0.0, 0.5], [0.0, 0.4], [0.0, 0.76]]
[instrument]
base = "free"
tool = "free"
position_sigma = 5e-6
"""
COUNT, SIGMA, BOW = 120, 5e-6, 25e-6


def recorded(folder, seed=1, middle=1.0, noise=SIGMA):
    """(Recording, RMS error m of the stated slides) of a gantry out of square, whose third slide runs along a bow.

    middle : share of the travels that is visited; noise : m, of the positions
    """
    rng = np.random.default_rng(seed)
    q = (0.5 + middle * rng.uniform(-0.5, 0.5, (COUNT, 3))) * [0.5, 0.4, 0.76]
    # directions of slides at right angles, as the rows have them: z, then y, then x of the base
    stated = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    true = stated + np.array([[0.0, 0.0, 0.0], [1.8e-4, 0.0, 9e-5], [0.0, 0.0, 2.5e-4]])
    share = (q[:, 2] - 0.38) / 0.38
    p = q @ (true / np.linalg.norm(true, axis=1)[:, None]) + np.outer(BOW * (1 - share**2), stated[1])
    off = p - q @ stated
    off = off - off.mean(axis=0)
    turn = np.linalg.lstsq(_turns(q @ stated), off.ravel(), rcond=None)[0]
    rms = np.sqrt(((off.ravel() - _turns(q @ stated) @ turn) ** 2).sum() / COUNT)
    seen = Rotation.from_rotvec([0.2, -0.1, 1.1]).apply(p) + [0.8, -0.5, 0.2] + rng.normal(0, noise, p.shape)
    (folder / "rig.toml").write_text(RIG)
    rows = [f"{i},{10 * i + 5},,\n" for i in range(COUNT)]
    (folder / "frames.csv").write_text("frame,t,camera,image\n" + "".join(rows))
    rows = [f"{10 * i + wait},{a:.9f},{b:.9f},{c:.9f}\n" for i, (a, b, c) in enumerate(q) for wait in (4, 6)]
    (folder / "commands.csv").write_text("t,q1,q2,q3\n" + "".join(rows))
    rows = [f"{i},{x:.9f},{y:.9f},{z:.9f}\n" for i, (x, y, z) in enumerate(seen)]
    (folder / "poses.csv").write_text("frame,x,y,z\n" + "".join(rows))
    return recording_folder.load_recording(folder), rms


def _turns(p):
    """(3 n, 3) what small turns of a base do to points (n, 3)."""
    return np.stack([np.cross(axis, p - p.mean(axis=0)) for axis in np.eye(3)], axis=-1).reshape(-1, 3)


def test_the_error_before_is_that_of_the_machine_and_not_of_its_geometry_alone(tmp_path):
    recording, _ = recorded(tmp_path)
    diagnosed = diagnose(recording)
    assert [f.effect for f in diagnosed.report.findings] == ["axis_coupling"]
    (tmp_path / "found").mkdir()
    diagnosed.write(tmp_path / "found")
    calibration = calibrate(recording, CalibrateOptions(diagnosis=tmp_path / "found")).calibration
    claim = calibration.claim
    assert claim.workspace.startswith("the middle 80 %")
    (tmp_path / "new").mkdir()
    new, before = recorded(tmp_path / "new", 2, 0.8, 0.0)
    samples = calibration.with_physics(new, sample_recording(new).samples)
    left = calibration.correction.predict(samples.effective).translation - samples.T_base_platform.translation
    after = np.sqrt((left**2).sum(axis=1).mean())
    assert 0.9 * before < claim.before[0][0] < 1.1 * before
    assert claim.ratio[1] < before / after < claim.ratio[2]
    assert claim.ratio[0] == pytest.approx(claim.before[0][0] / claim.after[0][0], rel=0.1)


def test_the_size_of_a_coupling_is_without_what_squareness_explains(tmp_path):
    """Of a bow that is all: its linear part is one with the slides' angles, and known as badly as these."""
    (finding,) = diagnose(recorded(tmp_path)[0]).report.findings
    rms, (low, high) = finding.parameters["rms"].value, finding.parameters["rms"].ci95
    bow = BOW * np.sqrt(4 / 45)  # RMS of 1 - s^2 about its mean, s evenly spread over -1 .. 1
    assert abs(rms - bow) < 0.25 * bow
    assert low < bow < high and high - low < bow
