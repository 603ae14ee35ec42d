"""Arms: kinematics against an outside library, closed forms, Hayati identification, real data, postures, wrenches."""

import json
import subprocess
import tempfile
import time
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from calib.files import calibration_file
from calib.models.arm import (
    arm_base_and_tool_placement_in_instrument_frame,
    arm_error_model_and_instrument_observations,
)
from calib.models.arm.arm_error_model_and_instrument_observations import pose_observations
from calib.models.arm.arm_identification_and_joint_profiles import identify_arm, independent_arm_parameter_mask
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.mechanisms import arm_dynamics_and_step_by_step_kinematics, closed_form_and_numerical_arm_inverse
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.posture import (
    arm_force_transmission_and_exertable_wrench,
    null_space_posture_search,
    wrench_estimation_from_torques,
)
from rig.posture.arm_force_transmission_and_exertable_wrench import TransmissionObjective
from tests.calib import secret_arms as worlds
from tests.cli import RIG
from tests.conftest import SHARED
from tests.rig import pinocchio_arm
from tests.rig.arms import SEVEN, UR10, configurations, random_arm
from tests.rig.model.mechanisms.test_six_joint_inverse import ARMS, check, near_singular

PANDA = design_from_rig_toml.load_design(files("rig") / "arms" / "panda.toml").mechanism


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    yield from _forward()
    yield from _closed_forms()
    yield from _identification()
    yield from _real()
    yield from _postures()
    yield from _wrenches()


def _forward():
    for name, arm in (("UR10", UR10), ("Panda", PANDA), ("random, Hayati", random_arm(np.random.default_rng(0), 7))):
        q = configurations(arm, 10_000, np.random.default_rng(1))
        ours, theirs = mechanism.single_hand_arm_link_frames(q, arm)[:, -1], pinocchio_arm.poses(arm, q)
        yield (
            f"{name}: forward against pinocchio, 10 000 configurations, worst",
            f"{np.abs(ours - theirs)[:, :3, 3].max():.1e} m, {np.abs(ours - theirs)[:, :3, :3].max():.1e}",
            "<= 1e-12 m",
        )


def _closed_forms():
    rng = np.random.default_rng(2)
    for name, arm in ARMS.items():
        six = closed_form_and_numerical_arm_inverse.closed_form_of_six_joint_arm(arm)
        q = near_singular(rng.uniform(-np.pi, np.pi, (100_000, 6)), rng)
        closure, missed, found = check(six, q)
        yield (
            f"{name} ({six.kind}): round trip, 100 000 poses, 25 000 within 1e-6 of singular",
            f"{closure.max():.1e} m, {missed.sum()} missed",
            "<= 1e-9 m, none missed",
        )
        yield (
            f"{name}: poses by number of branches",
            ", ".join(f"{n}: {k}" for n, k in enumerate(np.bincount(found.exists.sum(1))) if k),
            "",
        )
        T = mechanism.forward(q, arm)
        times = [
            _timed(
                lambda six=six, T=T: closed_form_and_numerical_arm_inverse.closed_form_inverse(T, six),
                time.process_time,
            )
            for _ in range(5)
        ]
        numeric = (
            _timed(
                lambda T=T, q=q, arm=arm: mechanism.damped_least_squares_arm_inverse_and_error(
                    T[:2000], arm, q[:2000] + 0.05, starts=0
                ),
                time.process_time,
            )
            / 2000
        )
        reached = f"{1e5 / np.median(times):.0f} poses/s"
        yield (
            f"{name}: closed-form inverse, all branches, 100 000 at once, median of 5, of one processor",
            reached,
            ">= 400 000",
        )
        yield (
            f"{name}: ratio to the numeric solver, started 0.05 rad away, one branch",
            f"{numeric * 1e5 / np.median(times):.0f} x",
            "",
        )


def _identification():
    for name, nominal in (("UR10", UR10), ("seven joints", SEVEN)):
        free, z, steps = independent_arm_parameter_mask(nominal, "pose"), [], []
        for seed in range(40):
            rng = np.random.default_rng(seed)
            true = worlds.secret(nominal, rng)
            seen = pose_observations(worlds.tracked(true, nominal, 80, rng))
            found = identify_arm(
                seen,
                arm_base_and_tool_placement_in_instrument_frame.place_base_and_tool_of_arm(seen, nominal, True, True),
            )
            z.append(worlds.scores(found, true, nominal, free))
            steps.append(found.iterations)
        z = np.array(z)
        yield (
            f"{name}: {free.sum()} parameters, axes within 1e-4 rad of parallel, 40 arms",
            f"{min(steps)} to {max(steps)} steps",
            "converges",
        )
        yield (
            f"{name}: parameters within 3 sigma; variance of z; worst |z|",
            f"{100 * (np.abs(z) < 3).mean():.2f} %; {np.var(z):.3f}; {np.abs(z).max():.2f}",
            "99.73 %; 1",
        )
    rng = np.random.default_rng(50)
    true = worlds.secret(UR10, rng)
    q = configurations(UR10, 200, rng, 0.5)
    want = arm_error_model_and_instrument_observations.predicted_target_poses(q, true)
    for name, seen in (
        ("tracker, 6D probe, 20 um", pose_observations(worlds.tracked(true, UR10, 120, rng))),
        ("CMM, ball, 20 um", worlds.touched(true, UR10, 120, rng)),
        (
            "vision, 50 um and 0.1 mrad shared 20 um",
            pose_observations(worlds.tracked(true, UR10, 120, rng, (5e-5, 1e-4), (2e-5, 2e-5))),
        ),
        ("drawn wire, 50 um, 400 lengths", worlds.wired(true, UR10, 400, rng)),
    ):
        start = UR10 if seen.kind != "distance" else type(UR10)(UR10.joints, UR10.limits, tool=worlds.TOOL)
        found = identify_arm(
            seen,
            arm_base_and_tool_placement_in_instrument_frame.place_base_and_tool_of_arm(
                seen, start, True, seen.kind != "distance"
            ),
        )
        got = arm_error_model_and_instrument_observations.predicted_target_poses(q, found.arm)
        error = np.linalg.norm(got.translation, axis=1) - np.linalg.norm(want.translation, axis=1)
        error = np.abs(error) if seen.kind == "distance" else np.linalg.norm(got.translation - want.translation, axis=1)
        what = "length" if seen.kind == "distance" else "position"
        yield f"{name}: {what} error at 200 new configurations", f"{error.mean() * 1e6:.1f} um mean", ""


def _real():
    if not SHARED.is_dir():
        yield "the shared recordings are not beside the project", "skipped", ""
        return
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "calibration.json"
        seconds = _timed(
            lambda: subprocess.run(
                [*RIG, "calibrate", SHARED / "recordings/arm-1", "--out", out], check=True, capture_output=True
            )
        )
        held = calibration_file.load(out).held_out
    from calib.models.arm.arm_certification import certify_arm
    from calib.samples.commanded_and_measured_pose_samples import sample_recording
    from rig.recording import recording_folder

    folder = recording_folder.load_recording(SHARED / "recordings/arm-1")
    done = certify_arm(
        sample_recording(folder).samples, folder.design.mechanism, folder.design.instrument, np.random.default_rng(0)
    )
    yield "arm-1: `rig calibrate`, whole", f"{seconds:.1f} s", ""
    yield (
        "arm-1: nominal model, base and probe placed, mean of held-out positions",
        f"{held.before.mean[0] * 1e3:.4f} mm",
        "about 0.8",
    )
    yield (
        "arm-1: geometry and tool, whole stretches held out (a third at a time), mean",
        f"{done.geometry.after.mean[0] * 1e3:.4f} mm",
        "<= 0.42 mm",
    )
    for name, figures in (("whole stretches", done.held_out.after), ("random rows", done.scattered.after)):
        yield (
            f"arm-1: with joint profiles, {name} held out: mean, RMS, 95 %, max",
            ", ".join(f"{v * 1e3:.3f}" for v in (figures.mean[0], *figures.position)) + " mm",
            "<= 0.20 mm mean",
        )
    with tempfile.TemporaryDirectory() as out:
        seconds = _timed(
            lambda: subprocess.run(
                [*RIG, "diagnose", SHARED / "recordings/arm-1", "--out", out], check=True, capture_output=True
            )
        )
        tree = json.loads((Path(out) / "diagnosis.json").read_text())
    yield "arm-1: `rig diagnose`, whole", f"{seconds:.1f} s", "<= 60 s"
    for held in tree["held_out"]:
        yield (
            f"arm-1: effects chosen and fitted elsewhere, {held['stretches']} whole stretches held out a "
            "third at a time, mean before and after",
            f"{held['before']['mean_m'] * 1e3:.3f}, {held['after']['mean_m'] * 1e3:.3f} mm",
            "<= 0.20 mm",
        )
    yield (
        "arm-1: the same command repeated",
        f"{tree['repeats']['mean_m'] * 1e3:.4f} mm mean, {tree['repeats']['pairs']} pairs",
        "",
    )
    yield "arm-1: findings", ", ".join(f"{f['effect']} at {f['place']}" for f in tree["findings"]), ""


def _postures():
    q = configurations(PANDA, 500, np.random.default_rng(3), 0.95)
    for wish in (
        TransmissionObjective(("fy",)),
        TransmissionObjective(("fy",), np.inf),
        TransmissionObjective(("fx", "mz")),
        TransmissionObjective(),
    ):
        found = null_space_posture_search.gradient_search(q, PANDA, wish)
        best = null_space_posture_search.whole_self_motion_search(q, PANDA, wish)
        sampled = null_space_posture_search.sampled_search(q, PANDA, wish, np.random.default_rng(4))
        name = f"Panda, 500 poses, {' and '.join(wish.directions) or 'det'}, norm {wish.norm:g}"
        for kind, answer in (("gradient", found), ("sampled", sampled)):
            ratio = answer.value / best.value
            yield (
                f"{name}: {kind} search / dense search: median, 5 %, worst",
                f"{np.median(ratio):.4f}, {np.quantile(ratio, 0.05):.3f}, {ratio.min():.3f}",
                ">= 0.99 median",
            )
        yield f"{name}: start / dense search, median", f"{np.median(best.start / best.value):.3f}", ""
        yield (
            f"{name}: hand moved, worst of all searches",
            f"{max(f.moved.max() for f in (found, best, sampled)):.1e} m or rad",
            "< 1e-9 m",
        )
        yield (
            f"{name}: joints beyond their limits",
            f"{sum((mechanism.signed_limit_excess(f.q, PANDA) != 0).sum() for f in (found, best, sampled))}",
            "0",
        )


def _wrenches():
    rng = np.random.default_rng(5)
    q = configurations(PANDA, 20_000, rng, 0.9)
    q = q[arm_force_transmission_and_exertable_wrench.transmission_measure(q, PANDA, TransmissionObjective()) > 1e-4]
    own = arm_dynamics_and_step_by_step_kinematics.LinkMasses(
        rng.uniform(1, 4, 7), 0.1 * rng.normal(size=(7, 3)), np.tile(0.02 * np.eye(3), (7, 1, 1))
    )
    gravity, (v, a) = np.array([0, 0, -9.80665]), rng.normal(size=(2, *q.shape))
    true = rng.normal(size=(len(q), 6)) * [20, 20, 20, 3, 3, 3]
    half = 0.1 * (np.eye(7) + 0.3 * rng.normal(size=(7, 7)))
    pushed = np.einsum("mai,ma->mi", mechanism.jacobian(q, PANDA, "base"), true)
    measured = (
        arm_dynamics_and_step_by_step_kinematics.joint_torques(q, v, a, PANDA, own, gravity)
        - pushed
        + rng.normal(size=q.shape) @ half.T
    )
    found = wrench_estimation_from_torques.estimate_wrench(
        wrench_estimation_from_torques.external_joint_torques(measured, q, v, a, PANDA, own, gravity),
        q,
        PANDA,
        half @ half.T,
    )
    error = found.value - true
    inside = np.einsum("mi,mij,mj->m", error, np.linalg.inv(found.covariance), error) < chi2.ppf(0.95, 6)
    each = (np.abs(error) < 1.96 * np.sqrt(np.einsum("mii->mi", found.covariance))).mean(axis=0)
    yield f"wrench, {len(q)} postures: inside the stated 95 % ellipsoid", f"{100 * inside.mean():.2f} %", "93 to 97 %"
    yield (
        "wrench: inside the stated 95 % interval, each component",
        f"{100 * each.min():.2f} to {100 * each.max():.2f} %",
        "93 to 97 %",
    )


def _timed(function, clock=time.perf_counter):
    start = clock()
    function()
    return clock() - start
