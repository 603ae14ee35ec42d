"""Findings are fitted with the geometry beside wild poses: of a hexapod of own formulas, measured by a tracker."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.diagnosis.geometry_refitted_with_diagnosed_effects import Findings, refit_platform_with_findings
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.cli.shared.measurement_calibration_and_learning_summary_printing import _print_physics
from rig.effects.catalogue.effect_list import BY_NAME
from rig.recording import recording_folder

COUNT, SIGMA, GAP, PLAYED = 80, np.array([1e-5] * 3 + [5e-5] * 3), 5e-5, 3
WILD = (7, 23, 24, 61)  # poses displaced by millimetres


def _rows(values):
    return "[" + ", ".join("[" + ", ".join(f"{v:.6f}" for v in row) + "]" for row in values) + "]"


def _joints(radius, angles):
    at = np.radians(angles)
    return np.stack([radius * np.cos(at), radius * np.sin(at), 0 * at], axis=1)


BASE = _joints(0.35, [-12, 12, 108, 132, 228, 252])
PLATFORM = _joints(0.22, [-50, 50, 70, 170, 190, 290])
RIG = f"""schema = "rig/1"
[mechanism]
kind = "hexapod"
base_joints = {_rows(BASE)}
platform_joints = {_rows(PLATFORM)}
strut_range = {_rows([[0.4, 0.62]] * 6)}
home = {{ position = [0.0, 0.0, 0.5], rotvec = [0.0, 0.0, 0.0] }}
[instrument]
base = "rig"
tool = "rig"
position_sigma = 1e-5
rotation_sigma = 5e-5
"""


def _lengths(p, turn, base, platform):
    return np.linalg.norm(turn.apply(platform) + p - base, axis=1)


def _reached(lengths, p, turn, base, platform):
    """(position m, Rotation) at which struts have lengths (6,) m, by Newton steps from a pose near it."""
    for _ in range(8):
        arm = turn.apply(platform)
        along = arm + p - base
        now = np.linalg.norm(along, axis=1)
        along /= now[:, None]
        step = np.linalg.solve(np.hstack([along, np.cross(arm, along)]), lengths - now)
        p, turn = p + step[:3], Rotation.from_rotvec(step[3:]) * turn
    return p, turn


def recorded(folder):
    """(Recording, (n,) m by which its fourth strut is short of its command) of a hexapod with play and wild poses."""
    rng = np.random.default_rng(9)
    base, platform = (joints + rng.normal(0, 3e-4, (6, 3)) for joints in (BASE, PLATFORM))
    commands, poses, behind, before = [], [], np.zeros(COUNT), None
    for i in range(COUNT):
        p, turn = np.array([0, 0, 0.47]) + rng.uniform(-0.04, 0.04, 3), Rotation.from_rotvec(rng.uniform(-0.1, 0.1, 3))
        lengths = _lengths(p, turn, BASE, PLATFORM)
        if before is not None:
            behind[i] = np.sign(lengths[PLAYED] - before[PLAYED]) * GAP / 2
        before = lengths
        p, turn = _reached(lengths - behind[i] * np.eye(6)[PLAYED], p, turn, base, platform)
        noise = SIGMA * rng.normal(size=6)
        if i in WILD:
            noise = noise + np.r_[rng.normal(0, 4e-3, 3), rng.normal(0, 8e-3, 3)]
        seen = np.r_[p + noise[:3], (turn * Rotation.from_rotvec(noise[3:])).as_rotvec()]
        poses.append(f"{i}," + ",".join(f"{v:.9f}" for v in seen) + "\n")
        commands += [f"{10 * i + wait}," + ",".join(f"{v:.9f}" for v in lengths) + "\n" for wait in (4, 6)]
    folder.mkdir()
    (folder / "rig.toml").write_text(RIG)
    times = "".join(f"{i},{10 * i + 5},,\n" for i in range(COUNT))
    (folder / "frames.csv").write_text("frame,t,camera,image\n" + times)
    (folder / "commands.csv").write_text("t,l1,l2,l3,l4,l5,l6\n" + "".join(commands))
    (folder / "poses.csv").write_text("frame,x,y,z,rx,ry,rz\n" + "".join(poses))
    return recording_folder.load_recording(folder), behind


def test_wild_poses_do_not_undo_a_finding_when_it_is_fitted_with_the_geometry(tmp_path):
    recording, behind = recorded(tmp_path / "recording")
    found = BY_NAME["backlash"](f"strut {PLAYED + 1}", gap=GAP)
    refit = refit_platform_with_findings(recording, sample_recording(recording), Findings((found,), None, ()))
    (effect,) = refit.physics.effects
    assert effect.gap == pytest.approx(GAP, abs=1.5e-5)
    assert np.sqrt(refit.physics.own[0, 0]) < 1e-5
    assert len(refit.samples) == COUNT
    assert np.abs(refit.samples.known[:, PLAYED] + behind)[1:].max() < 1e-5


def test_a_finding_of_no_size_is_not_counted_as_compensated(tmp_path, capsys):
    recording, _ = recorded(tmp_path / "recording")
    found = BY_NAME["backlash"](f"strut {PLAYED + 1}", gap=GAP), BY_NAME["backlash"]("strut 2", gap=0.0)
    physics = refit_platform_with_findings(recording, sample_recording(recording), Findings(found, None, ())).physics
    _print_physics(replace(physics, effects=(physics.effects[0], BY_NAME["backlash"]("strut 2", gap=0.0))))
    compensated, sizeless = capsys.readouterr().out.splitlines()
    assert "strut 4" in compensated and "strut 2" not in compensated
    assert "no size" in sizeless and "strut 2" in sizeless and "strut 4" not in sizeless
