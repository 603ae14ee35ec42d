"""A platform on struts, and a delta, before an instrument whose place nobody knows: truth of plain trigonometry."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calib.api.calibrate import CalibrateOptions, calibrate
from calib.api.diagnose import diagnose
from calib.api.recording_check_combination_and_view import check
from calib.api.verify_and_watch import verify
from rig.errors import RigError
from rig.model.pose import align_poses, exp
from rig.recording.recording_folder import load_recording

NOISE = (8e-6, 3e-5)  # m, rad
COUNT, HEIGHT = 40, 0.42
DOCS = Path(__file__).parents[3] / "docs" / "kinematics"
OWNER = np.random.default_rng(11)
AZIMUTHS = np.radians([[-10, 10, 110, 130, 230, 250], [-50, 50, 70, 170, 190, 290]])
BASE, PLATE = (radius * np.stack([np.cos(a), np.sin(a), 0 * a], axis=1) for radius, a in zip((0.35, 0.20), AZIMUTHS))
REAL_BASE, REAL_PLATE = BASE + OWNER.normal(size=(6, 3)) * 4e-4, PLATE + OWNER.normal(size=(6, 3)) * 4e-4
ZEROS = OWNER.normal(size=6) * 5e-4
INSTRUMENT = '[instrument]\nbase = "{}"\ntool = "{}"\nposition_sigma = 8e-6\n'


def hexapod_run(seed, count=COUNT):
    """(lengths (n, 6), true poses (n, 4, 4)) of a hexapod whose joints and zeros are not as stated."""
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, 3] = rng.uniform(-1, 1, (count, 3)) * [0.05, 0.05, 0.04] + [0, 0, HEIGHT]
    T[:, :3, :3] = Rotation.from_rotvec(rng.uniform(-1, 1, (count, 3)) * np.radians(10)).as_matrix()
    legs = REAL_PLATE @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3] - REAL_BASE
    return np.linalg.norm(legs, axis=2) - ZEROS, T


def written(folder, rig, axes, values, columns, seen):
    """Recording of commands, each held, and of what was seen in the middle of each hold."""
    folder.mkdir(exist_ok=True)
    (folder / "rig.toml").write_text(rig)
    t = 1.7e9 + 7.0 * np.arange(len(values))
    rows = [
        ",".join([f"{when + late:.2f}", *map(repr, row)]) for when, row in zip(t, values.tolist()) for late in (0, 4)
    ]
    (folder / "commands.csv").write_text("\n".join([f"t,{axes}", *rows]) + "\n")
    rows = [f"{k},{when + 3:.2f},," for k, when in enumerate(t)]
    (folder / "frames.csv").write_text("\n".join(["frame,t,camera,image", *rows]) + "\n")
    rows = [",".join([str(k), *(f"{x:.12g}" for x in row)]) for k, row in enumerate(seen)]
    (folder / "poses.csv").write_text("\n".join([f"frame,{columns}", *rows]) + "\n")
    return load_recording(folder)


def tracked(folder, seed, station, wild=(), ends=("free", "free"), count=COUNT):
    """Recording of the hexapod from a station of its own, with a probe that sits anywhere."""
    lengths, T = hexapod_run(seed, count)
    rng, number = np.random.default_rng(seed + 500), np.random.default_rng(station)
    base = exp(np.r_[number.normal(size=3), number.normal(size=3)]) if ends[0] == "free" else exp(np.zeros(6))
    tool = exp([0.03, -0.02, 0.06, 0.01, 0.02, 0.5]) if ends[1] == "free" else exp(np.zeros(6))
    seen = base * RigidTransform.from_matrix(T) * tool
    seen = seen * exp(rng.normal(size=(count, 6)) * np.repeat(NOISE, 3))
    p = seen.translation
    p[list(wild)] += [2e-3, -1e-3, 1e-3]
    rig = (
        f'schema = "rig/1"\n[mechanism]\nkind = "hexapod"\nbase_joints = {BASE.tolist()}\n'
        f"platform_joints = {PLATE.tolist()}\nstrut_range = {[[0.35, 0.60]] * 6}\n"
        f"home = {{ position = [0.0, 0.0, {HEIGHT}], rotvec = [0.0, 0.0, 0.0] }}\n"
        + INSTRUMENT.format(*ends)
        + "rotation_sigma = 3e-5\n"
    )
    values = np.c_[p, seen.rotation.as_rotvec()]
    return written(folder, rig, "l1,l2,l3,l4,l5,l6", lengths, "x,y,z,rx,ry,rz", values)


def true_error(calibration):
    """RMS m of where the calibrated machine takes its platform, base and tool placed where they fit best."""
    lengths, T = hexapod_run(77, 200)
    found, real = calibration.correction.predict(lengths), RigidTransform.from_matrix(T)
    base, tool = align_poses(found, real, (True, True))
    off = (base * found * tool).translation - real.translation
    return float(np.sqrt((off**2).sum(axis=1).mean()))


@pytest.mark.slow
def test_stations_and_wild_rows(tmp_path):
    """Three recordings, the tracker stationed anew each time, a row of each wrong: as good as the noise allows."""
    three = [tracked(tmp_path / str(k), k, station=k, wild=(7 * k,)) for k in (1, 2, 3)]
    assert check(tmp_path / "1").found == ()
    lines = []
    result = calibrate(three, CalibrateOptions(quick=True), notice=lines.append)
    assert lines[-1] == "the instrument stands anywhere: its place is fitted in each recording"
    assert result.calibration.held_out.after.position[0] < 1.2 * np.sqrt(3) * NOISE[0]
    error = true_error(result.calibration)
    assert error < 0.6 * NOISE[0] and error < result.calibration.claim.after[0][2]
    assert not diagnose(three).report.findings
    found = verify(result.calibration, tracked(tmp_path / "4", 4, station=4))
    assert found.figures.found.kept and found.figures.held.after.position[0] < 1.2 * np.sqrt(3) * NOISE[0]
    assert "12 numbers were estimated from these 40 poses" in found.figures.displacement[0]
    loaded = verify(result.calibration, load_recording(tmp_path / "2"))
    assert len(loaded.figures.same) == COUNT, "a recording is known again though its poses were moved"


@pytest.mark.slow
def test_one_recording_and_a_probe_that_is_known(tmp_path):
    recording = tracked(tmp_path / "1", 1, station=1, ends=("free", "rig"))
    result = calibrate(recording, CalibrateOptions(quick=True))
    assert result.calibration.held_out.after.position[0] < 1.2 * np.sqrt(3) * NOISE[0]
    assert true_error(result.calibration) < NOISE[0]


def test_poses_of_other_commands_are_refused(tmp_path):
    recording = tracked(tmp_path / "1", 1, station=1)
    rows = (tmp_path / "1" / "poses.csv").read_text().splitlines()
    mixed = [rows[0], *(f"{k},{row.partition(',')[2]}" for k, row in enumerate(rows[:0:-1]))]
    (tmp_path / "1" / "poses.csv").write_text("\n".join(mixed) + "\n")
    assert recording.poses is not None
    with pytest.raises(RigError, match="no place of base and tool fits"):
        calibrate(load_recording(tmp_path / "1"), CalibrateOptions(quick=True))


def delta(seed, count=60):
    """(heights (n, 3) of the carriages, positions (n, 3)) of docs/kinematics/delta.py with other figures."""
    rng, m = np.random.default_rng(seed), np.random.default_rng(5)
    a = np.radians([90.0, 210.0, 330.0])
    out = np.stack([np.cos(a), np.sin(a)], axis=1)
    centre = 0.20 * out + m.normal(size=(3, 2)) * 4e-4 - 0.05 * out
    bars, zeros = 0.30 + m.normal(size=3) * 4e-4, m.normal(size=3) * 4e-4
    p = rng.uniform(-1, 1, (count, 3)) * [0.05, 0.05, 0.04] + [0, 0, 0.09]
    across = p[:, None, :2] - centre
    return p[:, 2:] + np.sqrt(bars**2 - (across**2).sum(axis=2)) - zeros, p


@pytest.mark.slow
@pytest.mark.parametrize("ends", [("free", "free"), ("rig", "rig")])
def test_positions_alone_of_a_platform_that_stays_level(tmp_path, ends):
    """A delta before a tracker that sees one reflector, in the tracker's own frame or in the machine's."""
    station = exp([1.5, -0.7, 0.4, 0.3, -0.5, 1.8]) if ends[0] == "free" else exp(np.zeros(6))

    def recording(name, seed):
        values, p = delta(seed)
        offset = [0.01, 0.02, -0.03] if ends[1] == "free" else [0, 0, 0]
        seen = station.apply(p + offset) + np.random.default_rng(seed).normal(size=p.shape) * NOISE[0]
        rig = 'schema = "rig/1"\n[mechanism]\nkind = "file:delta.py"\n' + INSTRUMENT.format(*ends)
        (tmp_path / name).mkdir()
        shutil.copy(DOCS / "delta.py", tmp_path / name)
        return written(tmp_path / name, rig, "q1,q2,q3", values, "x,y,z", seen)

    result = calibrate(recording("a", 1), CalibrateOptions(quick=True))
    assert result.calibration.held_out.after.position[0] < 1.25 * np.sqrt(3) * NOISE[0]
    found = verify(result.calibration, recording("b", 2))
    assert found.figures.found.kept and found.figures.held.after.position[0] < 1.25 * np.sqrt(3) * NOISE[0]
