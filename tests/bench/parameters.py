"""The hexapod's 42 parameters: error model, batch, joint solve, plans, online, measuring limbs, export."""

import json
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from calib.certification import measuring_limb_calibration_slips_and_vision_agreement
from calib.correction import simultaneous_camera_and_geometry_fit
from calib.models.platform.d_optimal_hexapod_configurations import CRITERIA, choose_d_optimal_configurations
from calib.models.platform.determined_parameters_and_stated_geometry_tolerance import (
    PLAUSIBLE,
    parameter_combinations_and_visibility,
)
from calib.models.platform.platform_identification import PRIOR, identify_platform, pose_parameter_jacobian
from calib.online.forgetting_least_squares_kalman_and_gradient_learners import Drifting, FirstOrder, Forgetting
from calib.online.hexapod_information_filter import Online
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.formats.exporters import json_csv_linuxcnc_and_camera_file_exports
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.mechanisms import hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import geometric_parameters, mechanism_with_parameters
from rig.model.pose import exp, pose_difference
from rig.planning import configuration_generators
from rig.planning import recording_plan as plan
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.recording import recording_folder
from synthetic import random_true_machine_and_truth_file, recording_simulation
from tests.calib.noisy_samples import sampled
from tests.calib.pose_streams import found_within, learnt, missed_step, stream
from tests.calib.random_hexapods import worst_jacobian
from tests.conftest import SHARED
from tests.rig.genhexkins import forward as genhex_forward

RUNS = 500
MORE_RUNS = 2500  # from which the spread along one combination is known to 1.4 %


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        path.write_text(hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3))
        design = design_from_rig_toml.load_design(path)
    yield "J_p against differences, 1000 random machines and poses, worst", f"{worst_jacobian(1000, 0):.1e}", "<= 1e-6"
    yield from _batch(design)
    yield from _scatter(design)
    yield from _plans(design)
    yield from _online(design)
    yield from _jumps(design)
    yield from _exports(design)
    yield from _limbs()
    if SHARED.is_dir():
        yield from _joint()
    else:
        yield "the shared recordings are not beside the project", "joint solve skipped", ""


def _batch(design):
    samples, _ = sampled(design, 1, count=1000)
    found, times = identify_platform(samples, design.mechanism), []
    for _ in range(9):
        start = time.perf_counter()
        found = identify_platform(samples, design.mechanism)
        times.append(time.perf_counter() - start)
    ours = np.median(times)
    yield "42 parameters and 6 shared errors from 1000 poses, batch, whole, median of 9", f"{ours:.3f} s", "<= 0.2 s"
    whitener, nominal = np.linalg.inv(np.linalg.cholesky(samples.covariance)), geometric_parameters(design.mechanism)

    def cost(q):
        T = hexapod.forward(
            samples.commanded, mechanism_with_parameters(design.mechanism, nominal + q[:42] * 1e-3)
        ) * exp(samples.common @ q[42:])
        left = whitener @ pose_difference(T, samples.T_base_platform)[..., None]
        return np.concatenate([left.ravel(), q[:42] * 1e-3 / PRIOR, q[42:]])

    start = time.perf_counter()
    other = least_squares(cost, np.zeros(48))
    seconds = time.perf_counter() - start
    apart = np.abs(
        (nominal + other.x[:42] * 1e-3 - geometric_parameters(found.mechanism)) / np.sqrt(np.diag(found.covariance))
    ).max()
    yield "scipy least_squares, numeric Jacobian, the same cost", f"{seconds:.2f} s, {seconds / ours:.0f} x", ">= 50 x"
    yield "the two optima apart, greatest", f"{apart:.1e} sigma", ""
    parts, seen = parameter_combinations_and_visibility(found.root, found.mechanism)
    yield (
        "condition number of the 42, worst and best determined combination",
        (f"{seen.condition:.0f}: {parts[0].sigma * 1e6:.0f} and {parts[-1].sigma * 1e6:.2f} um"),
        "",
    )


def _scatter(design):
    first = identify_platform(sampled(design, 0, count=200)[0], design.mechanism)
    along = np.array([part.direction for part in parameter_combinations_and_visibility(first.root, first.mechanism)[0]])
    z = np.empty((MORE_RUNS, 42))
    for seed in range(MORE_RUNS):
        samples, true = sampled(design, seed, count=200)
        found = identify_platform(samples, design.mechanism)
        sigma = np.sqrt(np.einsum("ki,ij,kj->k", along, found.covariance, along))
        z[seed] = along @ (geometric_parameters(found.mechanism) - geometric_parameters(true)) / sigma
    some = z[:RUNS]
    yield (
        f"z-scores along 42 combinations, {RUNS} runs of 200 poses: mean, worst",
        f"{np.abs(some.mean(axis=0)).max():.3f} sigma",
        "<= 0.15",
    )
    yield f"z-scores, {RUNS} runs: spread over all", f"{some.std():.3f}", "0.95 .. 1.05"
    spread = z.std(axis=0)
    yield (
        f"z-scores, {MORE_RUNS} runs: spread along each combination",
        f"{spread.min():.3f} .. {spread.max():.3f}",
        "0.95 .. 1.05",
    )


def _plans(design):
    for criterion in CRITERIA:
        start = time.perf_counter()
        found = choose_d_optimal_configurations(design.mechanism, 60, (1e-5, 1e-4), criterion)
        seconds = time.perf_counter() - start
        s, even = (np.linalg.svd(root * PLAUSIBLE, compute_uv=False) for root in (found.root, found.even))
        better = f"{(s.prod() / even.prod()) ** (1 / 42):.2f}, {s[-1] / even[-1]:.2f} x"
        yield f"60 poses by {criterion} ({seconds:.1f} s) over evenly spread: all 42, worst combination", better, ""
        yield (
            f"60 poses by {criterion}: condition number, evenly spread",
            f"{s[0] / s[-1]:.0f}, {even[0] / even[-1]:.0f}",
            "",
        )


def _online(design):
    samples, true = sampled(design, 1, count=1000)
    batch = identify_platform(samples, design.mechanism)
    along = np.array([part.direction for part in parameter_combinations_and_visibility(batch.root, batch.mechanism)[0]])
    sigma = np.sqrt(np.einsum("ki,ij,kj->k", along, batch.covariance, along))
    alone = replace(samples, common=samples.common[:, :, :0], covariance=samples.total_covariance())
    rest = identify_platform(alone, design.mechanism)
    ways = {
        "square-root filter, 6 shared errors": (Online(design.mechanism, shared=6), samples, batch),
        "square-root filter": (Online(design.mechanism), alone, rest),
        "directional forgetting, none forgotten": (Forgetting(design.mechanism, 1.0), alone, rest),
        "directional forgetting, 0.99 kept": (Forgetting(design.mechanism), alone, rest),
        "iterated Kalman filter, drift 0.1 um": (Drifting(design.mechanism), alone, rest),
        "first order": (FirstOrder(design.mechanism), alone, rest),
    }
    for name, (learner, data, best) in ways.items():
        times, more = [], (data.common,) if name.endswith("errors") else ()
        for x, T, C, *B in zip(data.commanded, data.T_base_platform, data.covariance, *more):
            start = time.perf_counter()
            learner.update(x, T, C, *B)
            times.append(time.perf_counter() - start)
        apart = np.abs(along @ (learner.p - geometric_parameters(best.mechanism)) / sigma).max()
        wanted = "<= 0.1 sigma, 150 us" if name.startswith("square") else ""
        yield (
            f"one pass over 1000 poses, {name}: from the batch; update, median",
            f"{apart:.4f} sigma; {np.median(times) * 1e6:.0f} us",
            wanted,
        )


def _jumps(design):
    found, wrong, sizes = 0, 0, []
    for seed in range(200):
        poses, _, updates, strut, size = missed_step(design, seed)
        found += found_within(updates, poses.at, strut)
        sizes += [(c.size - size) / c.sigma for u in updates for c in u.changes if c.strut == strut][:1]
    yield (
        "200 streams, one missed step of 4-10 sigma: found within three poses, as that strut's",
        f"{found / 2:.1f} %",
        ">= 98 %",
    )
    yield (
        "its size less the true one, over its standard error: mean, spread",
        f"{np.mean(sizes):.2f}, {np.std(sizes):.2f}",
        "",
    )
    for seed in range(100):
        wrong += sum(len(u.changes) + len(u.dropped) for u in learnt(design, stream(design, 5000 + seed, 1000))[1])
    yield "100 000 quiet poses in 100 streams: changes flagged or poses left out", f"{wrong}", "<= 1"


def _exports(design):
    true = random_true_machine_and_truth_file.random_true_machine(design, np.random.default_rng(0)).true
    commands = configuration_generators.sobol_configurations(true.mechanism.strut_range, 200, 0.9)
    theirs = genhex_forward(
        json_csv_linuxcnc_and_camera_file_exports.genhexkins_settings(true.mechanism),
        commands,
        design.mechanism.home,
        1e3,
    )
    worst = np.linalg.norm(pose_difference(hexapod.forward(commands, true.mechanism), theirs)[:, :3], axis=1).max()
    yield (
        "genhexkins' forward kinematics from the exported numbers alone, 200 poses, worst",
        f"{worst:.1e} m",
        "<= 1e-9 m",
    )


def _limbs():
    with tempfile.TemporaryDirectory() as folder:
        text, path = (
            hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, legs=(6, 6)),
            Path(folder) / "rig.toml",
        )
        path.write_text(text)
        design, rng = design_from_rig_toml.load_design(path), np.random.default_rng(0)
        done = recording_simulation.simulate_world(
            random_true_machine_and_truth_file.random_true_machine(design, rng),
            plan.build_plan(design, "axes:9,sobol:150"),
            rng,
        )
        recording_simulation.write_recording(done, Path(folder) / "rec", text, rng, noise=0.04)
        read = recording_folder.load_recording(Path(folder) / "rec")
        frames, lengths = measuring_limb_calibration_slips_and_vision_agreement.frames_and_limb_readings(read)
        samples, nominal = (
            measuring_limb_calibration_slips_and_vision_agreement.samples_with_limb_readings_as_commands(
                sample_recording(read).samples, frames, lengths
            ),
            measuring_limb_calibration_slips_and_vision_agreement.hexapod_of_six_limbs(design),
        )
    T, expected = measuring_limb_calibration_slips_and_vision_agreement.held_out_limb_poses_and_expected_covariance(
        samples, nominal, 1e-6
    )
    found = measuring_limb_calibration_slips_and_vision_agreement.limb_agreement(
        samples.T_base_platform, T, expected, (5e-5, 2e-4)
    )
    for part, name, unit in ((slice(0, 3), "position", "um"), (slice(3, 6), "rotation", "urad")):
        bias, scatter, claim, surely = (
            np.abs(v[part]).max() * 1e6 for v in (found.bias, found.scatter, found.expected, found.proven_limits)
        )
        yield (
            f"measuring limbs less vision, {found.n} poses, worst axis in {name}: bias, scatter (expected), limits",
            f"{bias:.1f}, {scatter:.1f} ({claim:.1f}), {surely:.1f} {unit}",
            "50 um, 200 urad",
        )
    limbs, _ = measuring_limb_calibration_slips_and_vision_agreement.calibrated_limbs_and_identification(
        samples, nominal, 1e-6
    )
    T = limbs.pose(lengths)
    learner, true = Online(read.design.mechanism, shared=42), done.world.true.mechanism
    for each in zip(read.commanded()[2], T, *limbs.uncertainty(T)):
        learner.update(*each)
    spread = configuration_generators.sobol_configurations(true.strut_range, 500, 0.9)
    error = pose_difference(hexapod.forward(spread, true), hexapod.forward(spread, learner.mechanism))
    before = pose_difference(hexapod.forward(spread, true), hexapod.forward(spread, design.mechanism))
    rms = [np.sqrt((e[:, :3] ** 2).sum(axis=1).mean()) * 1e6 for e in (before, error)]
    yield "struts learnt from the limbs' poses: model's pose error before, after", f"{rms[0]:.0f}, {rms[1]:.1f} um", ""


def _joint():
    read = recording_folder.load_recording(SHARED / "recordings/open-quiet")
    truth, nominal = json.loads((SHARED / "truth/open-quiet.json").read_text()), read.design.mechanism
    true = replace(
        nominal,
        base_joints=truth["base_joints"],
        platform_joints=truth["platform_joints"],
        strut_zeros=truth["strut_zeros"],
    )
    done = sample_recording(read)
    samples = done.samples
    rng = np.random.default_rng(0)
    lengths = nominal.strut_range.mean(axis=1) + 0.45 * np.ptp(nominal.strut_range, axis=1) * rng.uniform(
        -1, 1, (2000, 6)
    )
    wanted = hexapod.forward(lengths, true)

    def figure(found, covariance):
        errors, J = pose_difference(wanted, hexapod.forward(lengths, found)), pose_parameter_jacobian(wanted, found)
        C = J @ covariance @ np.swapaxes(J, 1, 2)
        both = []
        for part, unit in ((slice(0, 3), "um"), (slice(3, 6), "urad")):
            reached, bound = (
                np.sqrt((errors[:, part] ** 2).sum(axis=1).mean()),
                np.sqrt(np.trace(C[:, part, part], axis1=1, axis2=2).mean()),
            )
            both.append(f"{reached * 1e6:.2f} ({bound * 1e6:.2f}) {unit}")
        return ", ".join(both)

    start = time.perf_counter()
    corners, commanded, state = simultaneous_camera_and_geometry_fit.inputs_of_camera_and_geometry_fit(
        done.measurement, samples
    )
    one = simultaneous_camera_and_geometry_fit.fit_cameras_and_geometry(
        corners, commanded, state, read.design.cameras, nominal, identify_platform(samples, nominal).mechanism
    )
    seconds = time.perf_counter() - start
    two = identify_platform(samples, nominal)
    pooled = identify_platform(
        replace(samples, covariance=samples.total_covariance(), common=samples.common[:, :, :0]), nominal
    )
    name = "open-quiet, model's pose error over 90 % of the strokes (its stated bound)"
    yield f"{name}: joint solve", figure(one.mechanism, one.covariance), "<= 5.0 um, 10.6 urad"
    yield f"{name}: two steps, shared errors solved", figure(two.mechanism, two.covariance), ""
    yield f"{name}: two steps, poses as if apart", figure(pooled.mechanism, pooled.covariance), ""
    apart = np.abs(
        (geometric_parameters(one.mechanism) - geometric_parameters(two.mechanism)) / np.sqrt(np.diag(one.covariance))
    ).max()
    yield f"joint solve of {len(corners)} corners; from the two-step optimum", f"{seconds:.1f} s; {apart:.4f} sigma", ""
    yield from _over_draws(samples, nominal, true, lengths, wanted)


def _over_draws(samples, nominal, true, lengths, wanted):
    """open-quiet's own plan, poses and covariances, noise and shared errors drawn anew: which two-step solve is better
    on average.
    """
    rng, squares, claims = np.random.default_rng(0), [], []
    T, factor = hexapod.forward(samples.commanded, true), np.linalg.cholesky(samples.covariance)
    for _ in range(60):
        noise = (
            samples.common @ rng.normal(size=samples.common.shape[2])
            + (factor @ rng.normal(size=(len(samples), 6, 1)))[..., 0]
        )
        drawn = replace(samples, T_base_platform=T * exp(noise))
        apart = replace(drawn, covariance=drawn.total_covariance(), common=drawn.common[:, :, :0])
        found = [identify_platform(each, nominal) for each in (drawn, apart)]
        errors = [pose_difference(wanted[:300], hexapod.forward(lengths[:300], each.mechanism)) for each in found]
        squares.append([[(e[:, :3] ** 2).sum(axis=1).mean(), (e[:, 3:] ** 2).sum(axis=1).mean()] for e in errors])
        off = [geometric_parameters(each.mechanism) - geometric_parameters(true) for each in found]
        claims.append([d @ np.linalg.solve(each.covariance, d) / 42 for d, each in zip(off, found)])
    rms = np.sqrt(np.mean(squares, axis=0)) * 1e6
    for k, name in enumerate(("shared errors solved", "poses as if apart")):
        yield (
            f"the same over 60 draws of the noise: {name}; squared error over claimed",
            (f"{rms[k, 0]:.2f} um, {rms[k, 1]:.1f} urad; {np.mean(claims, axis=0)[k]:.2f}"),
            "" if k else "1 on average",
        )
