"""From images and corners to a calibrated rig, on the shared recordings, against their truth (skipped where they are
absent).
"""

import json
import subprocess
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certification.held_out_pose_error_statistics import compare_errors, errors_before_and_after_correction
from calib.correction.machine_correction import fit_geometry_and_remainder_of_correction
from calib.models.platform.platform_identification import pose_parameter_jacobian
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.model.mechanisms import hexapod
from rig.model.pose import pose_difference
from rig.recording import corner_and_pose_csv_tables, recording_folder
from tests.cli import RIG
from tests.conftest import SHARED


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    if not SHARED.is_dir():
        yield "the shared recordings are not beside the project", "skipped", ""
        return
    with tempfile.TemporaryDirectory() as folder:
        yield from _measured(
            Path(folder),
            "first-light",
            "<= 14 um and 60 urad",
            "first-light: `rig measure`, whole, first run compiles",
            "<= 40 s",
        )
        yield from _corners(Path(folder) / "first-light")
        yield from _measured(Path(folder), "open-quiet", "<= 8 um and 48 urad", "", "")
        start = time.perf_counter()
        subprocess.run(
            [*RIG, "calibrate", SHARED / "recordings/open-quiet", "--out", Path(folder) / "c.json"],
            check=True,
            capture_output=True,
        )
        yield "open-quiet: `rig calibrate`, whole", f"{time.perf_counter() - start:.1f} s", "<= 30 s"
    yield from _workspace()
    for name in ("open-quiet", "first-light"):
        yield from _unused(name)


def _measured(folder, name, wanted, clock, limit):
    start = time.perf_counter()
    subprocess.run(
        [*RIG, "measure", SHARED / "recordings" / name, "--out", folder / name], check=True, capture_output=True
    )
    seconds = time.perf_counter() - start
    if clock:
        yield clock, f"{seconds:.1f} s", limit
    poses = corner_and_pose_csv_tables.load_poses(folder / name / "poses.csv")
    true = RigidTransform.from_matrix(np.array(_truth(name)["poses"]).reshape(-1, 4, 4))
    errors = pose_difference(poses.T_base_platform, true[poses.frame])
    position, rotation = _rms(errors)
    bound = [
        np.sqrt(np.trace(poses.covariance[:, part, part], axis1=1, axis2=2).mean())
        for part in (slice(0, 3), slice(3, 6))
    ]
    nees = np.mean(np.einsum("ni,nij,nj->n", errors, np.linalg.inv(poses.covariance), errors))
    count = f"{len(poses.frame)} of {len(true)} frames"
    yield (
        f"{name}: pose error, RMS of its length, {count}",
        f"{position * 1e6:.2f} um, {rotation * 1e6:.1f} urad",
        wanted,
    )
    yield f"{name}: stated standard uncertainty beside it", f"{bound[0] * 1e6:.2f} um, {bound[1] * 1e6:.1f} urad", ""
    yield f"{name}: normalised error squared (its common part is one draw)", f"{nees:.2f}", "6 on average"


def _corners(out):
    true = {tuple(row[:4]): row[4:6] for row in _truth("first-light")["corners"]}
    found = recording_folder.load_recording(out).corners
    error, seen = [], set()
    for key, uv in zip(zip(found.frame.tolist(), found.camera, found.marker.tolist(), found.corner.tolist()), found.uv):
        if key in true:
            seen.add(key)
            error.append(uv - true[key])
    length = np.linalg.norm(error, axis=1)
    yield (
        "first-light: corner error, RMS per axis over all true corners",
        f"{np.sqrt(np.mean(np.square(error))):.4f} px",
        "<= 0.04",
    )
    yield "first-light: true markers lost", f"{(len(true) - len(seen)) // 4} of {len(true) // 4}", "0"
    yield "first-light: outliers beyond 0.5 px", f"{100 * (length > 0.5).mean():.2f} %", "<= 1 %"


def _workspace():
    folder = recording_folder.load_recording(SHARED / "recordings/open-quiet")
    nominal, truth = folder.design.mechanism, _truth("open-quiet")
    true = replace(
        nominal,
        base_joints=truth["base_joints"],
        platform_joints=truth["platform_joints"],
        strut_zeros=truth["strut_zeros"],
    )
    correction, found = fit_geometry_and_remainder_of_correction(sample_recording(folder).samples, nominal)
    rng = np.random.default_rng(0)
    lengths = nominal.strut_range.mean(axis=1) + 0.45 * np.ptp(nominal.strut_range, axis=1) * rng.uniform(
        -1, 1, (2000, 6)
    )
    wanted = hexapod.forward(lengths, nominal)
    before = _rms(pose_difference(wanted, hexapod.forward(hexapod.inverse(wanted, nominal), true)))
    after = _rms(pose_difference(wanted, hexapod.forward(correction.inverse(wanted), true)))
    J = pose_parameter_jacobian(wanted, correction.fitted)
    C = J @ found.covariance @ np.swapaxes(J, 1, 2)
    bound = [np.sqrt(np.trace(C[:, part, part], axis1=1, axis2=2).mean()) * 1e6 for part in (slice(0, 3), slice(3, 6))]
    reached = f"{after[0] * 1e6:.2f} um, {after[1] * 1e6:.1f} urad"
    yield "open-quiet: pose error after correction, over 90 % of the strokes", reached, "<= 6 um and 15 urad"
    yield (
        "open-quiet: stated uncertainty (bound of the joint solve) beside it",
        f"{bound[0]:.2f} um, {bound[1]:.1f} urad",
        "",
    )
    yield (
        "open-quiet: before correction, and how many times better",
        f"{before[0] * 1e3:.3f} mm, {before[0] / after[0]:.0f} x",
        "",
    )


def _unused(name):
    folder = recording_folder.load_recording(SHARED / "recordings" / name)
    samples = sample_recording(folder).samples
    half = np.arange(len(samples)) < len(samples) // 2
    correction, _ = fit_geometry_and_remainder_of_correction(samples.take(half), folder.design.mechanism)
    rest = samples.take(~half)
    held = compare_errors(
        *errors_before_and_after_correction(correction, rest), rest.total_covariance(), np.random.default_rng(0)
    )
    yield (
        f"{name}: second half, calibrated on the first: before / after, as measured",
        f"{held.before.position[0] * 1e6:.0f} / {held.after.position[0] * 1e6:.2f} um = {held.ratio[0]:.0f} x",
        ">= 50 x" if name == "open-quiet" else "",
    )
    true = RigidTransform.from_matrix(np.array(_truth(name)["poses"]).reshape(-1, 4, 4))[rest.frame]
    true_samples = replace(rest, T_base_platform=true)
    held = compare_errors(
        *errors_before_and_after_correction(correction, true_samples), rest.total_covariance(), np.random.default_rng(0)
    )
    reached = f"{held.after.position[0] * 1e6:.2f} um = {held.ratio[0]:.0f} x"
    yield f"{name}: the same against the true poses", reached, ">= 50 x" if name == "open-quiet" else ""


def _truth(name):
    return json.loads((SHARED / "truth" / f"{name}.json").read_text())


def _rms(errors):
    return np.sqrt((errors[:, :3] ** 2).sum(axis=1).mean()), np.sqrt((errors[:, 3:] ** 2).sum(axis=1).mean())
