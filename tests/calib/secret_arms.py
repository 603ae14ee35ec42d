"""Secret arms: errors drawn on nominal figures, seen by a tracker, a ball on the hand, cameras or a drawn wire."""

from dataclasses import replace

import numpy as np

from calib.models.arm import arm_error_model_and_instrument_observations
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.model.design import Actuator, Design, Instrument, Platform
from rig.model.pose import exp, log, pose, pose_difference, pose_to_vector
from rig.recording.corner_and_pose_csv_tables import POSE_COLUMNS, write_table
from tests.rig.arms import configurations

TRACKER = Instrument("free", "free", 2e-5, 1e-4)
BASE, TOOL = pose([1.2, -0.8, 0.4], [0.1, -0.2, 2.0]), pose([0.03, -0.04, 0.12], [0.5, -1.0, 0.3])


def design(nominal):
    """Design of an arm seen by the tracker."""
    return Design(
        "arm",
        np.array([0, 0, -9.80665]),
        nominal,
        TRACKER,
        Actuator(None, None, None),
        Platform(None, None, None),
        (),
        (),
    )


def secret(nominal, rng, size=1.0, parallel=1e-4):
    """An Arm with errors of 0.3 mm and 1 mrad on every row, axes that are parallel by design askew by `parallel` rad,
    placed somewhere: a maker's figures and the real thing."""
    rows = nominal.rows + size * np.array([1e-3, 3e-4, 3e-4, 1e-3, 0.0]) * rng.normal(size=(len(nominal.joints), 5))
    flat = np.abs(np.cos(nominal.rows[:, 3])) > 0.999
    rows[flat, 3] = nominal.rows[flat, 3] + parallel * rng.uniform(-1, 1, flat.sum())
    rows[flat, 4] = parallel * rng.uniform(-1, 1, flat.sum())
    return replace(
        nominal, joints=rows, base=BASE * exp(1e-3 * rng.normal(size=6)), tool=TOOL * exp(1e-3 * rng.normal(size=6))
    )


def configurations_of(arm, count, rng):
    return configurations(arm, count, rng, 0.5)


def tracked(true, nominal, count, rng, sigma=(2e-5, 1e-4), common=(0.0, 0.0), deviation=None, repeats=0):
    """Samples by an instrument of whole poses; deviation(q) -> (m, n) rad is what the joints do beyond their command;
    again : how many of the first commands are given a second time, at the end, among the count."""
    q = configurations_of(nominal, count - repeats, rng)
    q = np.concatenate([q, q[:repeats]])
    scale, shared = (np.repeat(pair, 3) for pair in (sigma, common))
    T = arm_error_model_and_instrument_observations.predicted_target_poses(
        q if deviation is None else q + deviation(q), true
    )
    T = T * exp(shared * rng.normal(size=6) + scale * rng.normal(size=(count, 6)))
    factor = np.tile(np.diag(shared)[:, shared > 0], (count, 1, 1))
    return Samples(np.arange(count), np.arange(count) * 10.0, q, T, np.tile(np.diag(scale**2), (count, 1, 1)), factor)


def touched(true, nominal, count, rng, sigma=2e-5):
    """Observations of positions alone: a reflector, a ball, a touched point."""
    q = configurations_of(nominal, count, rng)
    return arm_error_model_and_instrument_observations.position_observations(
        q,
        arm_error_model_and_instrument_observations.predicted_target_poses(q, true).translation
        + sigma * rng.normal(size=(count, 3)),
        sigma,
    )


def wired(true, nominal, count, rng, sigma=5e-5):
    """Observations of one distance: a drawn wire from the frame's origin to the hand."""
    q = configurations_of(nominal, count, rng)
    return arm_error_model_and_instrument_observations.distance_observations(
        q,
        np.linalg.norm(arm_error_model_and_instrument_observations.predicted_target_poses(q, true).translation, axis=1)
        + sigma * rng.normal(size=count),
        sigma,
    )


def write(folder, nominal, samples, base="free", tool="free", positions_alone=False, sigma=(2e-5, 1e-4)):
    """A recording of Samples as an instrument's owner would leave it."""
    folder.mkdir()
    sigmas = f"position_sigma = {sigma[0]}\n" + ("" if positions_alone else f"rotation_sigma = {sigma[1]}\n")
    rows = [["prismatic"] * slide + row for slide, row in zip(nominal.slides.tolist(), nominal.rows.tolist())]
    (folder / "rig.toml").write_text(
        f'schema = "rig/1"\n[mechanism]\nkind = "arm"\njoints = {rows}\n'
        f'limits = {nominal.limits.tolist()}\n[instrument]\nbase = "{base}"\ntool = "{tool}"\n{sigmas}'
    )
    names = POSE_COLUMNS[: 3 if positions_alone else 6]
    write_table(
        folder / "frames.csv",
        ("frame", "t", "camera", "image"),
        [f"{frame},{t + 5.0},," for frame, t in zip(samples.frame, samples.t)],
    )
    write_table(
        folder / "commands.csv",
        ("t", *nominal.axes),
        [
            ",".join([f"{t + wait}", *(f"{angle:.12f}" for angle in q)])
            for t, q in zip(samples.t, samples.commanded)
            for wait in (4.0, 6.0)
        ],
    )
    rows = pose_to_vector(samples.T_base_platform)[:, : len(names)]
    write_table(
        folder / "poses.csv",
        ("frame", *names),
        [",".join([str(i), *(f"{x:.12f}" for x in row)]) for i, row in zip(samples.frame, rows)],
    )


def same_gauge(true, nominal, free):
    """The true arm's parameters less the nominal's, in the fit's own gauge: the fit of noiseless observations."""
    q = configurations(nominal, 200, np.random.default_rng(99), 0.6)
    T = arm_error_model_and_instrument_observations.predicted_target_poses(q, true)
    arm = replace(nominal, base=BASE, tool=TOOL)
    for _ in range(30):
        J = arm_error_model_and_instrument_observations.parameter_jacobian(q, arm)[..., free].reshape(-1, free.sum())
        step = np.zeros(len(free))
        left = pose_difference(arm_error_model_and_instrument_observations.predicted_target_poses(q, arm), T)
        step[free] = np.linalg.lstsq(J, left.ravel())[0]
        arm = arm_error_model_and_instrument_observations.arm_with_parameter_step(arm, step)
        if np.abs(step).max() < 1e-13:
            return arm
    raise AssertionError("no arm of this gauge is the true one")


def scores(found, true, nominal, free):
    """(free parameters,) errors of an Identified arm, in the standard deviations that it states."""
    truth = same_gauge(true, nominal, free)
    ends = [log(getattr(found.arm, end).inv() * getattr(truth, end)) for end in ("base", "tool")]
    error = np.concatenate([ends[0], (truth.rows - found.arm.rows).ravel(), ends[1]])
    return error[free] / np.sqrt(np.diag(found.covariance))[free]
