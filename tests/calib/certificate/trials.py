"""Fresh rigs at pose level, each calibrated, certified from a few of its poses and held against all of them: is the
promise kept?

No images and no bundle adjustment: poses come with an instrument's noise of known covariance, a part of it shared by a
recording. What is sampled is what is promised about: the held-out poses are a random few of thousands that the machine
took in one run.
"""

from dataclasses import dataclass

import numpy as np

from calib.certification.held_out_pose_error_statistics import errors_before_and_after_correction
from calib.certification.held_out_pose_errors_and_distinct_configurations import held_out_poses
from calib.certification.noise_free_errors_and_tolerance_limits import least_sample_size
from calib.certification.pose_error_promise_and_conformity import (
    CONFORMS,
    FAILS,
    GUARD,
    POSITION,
    ROTATION,
    Unit,
    greatest_scaled_error_bound,
    pose_error_promise,
    tolerance_conformity,
)
from calib.correction.machine_correction import fit_geometry_and_remainder_of_correction
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.effects.catalogue.effect_list import BY_NAME
from rig.effects.framework.parameters_covariates_and_marker_table import Drawing
from rig.errors import NotConverged
from rig.model import machine_motion_simulation as motion_simulation
from rig.model import mechanisms
from rig.model.pose import exp, pose_difference
from rig.planning import configuration_generators
from rig.planning import recording_plan as plan
from synthetic import random_true_machine_and_truth_file

KINDS = (
    "backlash",
    "hysteresis",
    "thermal_expansion",
    "base_expansion",
    "compliance",
    "joint_clearance",
    "creep",
    "cyclic_error",
    "screw_coupling",
    "scale_error",
)
POSES = 2000  # noise-free ones, from which the true 95th percentile is taken
FITTED = 120
SIZES = (59, 80, 120, 200)  # held out
OWN, COMMON = (
    np.repeat([3.2e-6, 2.4e-5], 3),
    np.repeat([2.4e-6, 4.2e-6], 3),
)  # m and rad an axis, as three cameras have it
SPREAD = 0.7  # of the tolerance about what is true, as a logarithm


@dataclass(frozen=True)
class Trial:
    """effects : their names; n held out; share : of all true poses within both promises; coverage : promised;
    as_good : whether `coverage` of true poses lie within both tolerances; verdict : with 97.5 % limits, "" with too few
        poses for
    one per quantity: true quantile of the coverage, promise, limit as measured."""

    effects: tuple
    n: int
    share: float
    coverage: float
    as_good: bool
    verdict: str
    true: tuple
    promise: tuple
    measured: tuple

    @property
    def holds(self):
        """Whether the promise, of position and rotation at once, is so."""
        return self.share >= self.coverage

    @property
    def wrong(self):
        """Whether the decision, if there is one, is not so."""
        return self.verdict == (FAILS if self.as_good else CONFORMS)


def trial(design, seed, level=(0.95, 0.95), sizes=SIZES, kinds=None, noise=1.0):
    """Trial of a rig that a seed draws. level : (coverage, confidence); sizes : of which the held-out number is one
    kinds : effects' names, none to two of KINDS by default; noise : factor of the instrument's."""
    rng = np.random.default_rng([18, seed])
    strokes = design.mechanism.strut_range
    goals = np.concatenate(
        [
            configuration_generators.sobol_configurations(strokes, FITTED, seed=seed),
            plan.scale_to_strokes(strokes, rng.uniform(-1, 1, (POSES, 6)), plan.FILL),
        ]
    )
    route = plan.plan_of_configurations(goals, strokes.mean(axis=1), plan.planned_axis_speeds(design))
    warmth, _ = random_true_machine_and_truth_file.random_true_and_logged_temperatures(float(route.commands.t[-1]), rng)
    sensors = plan.sensors_with_payload(route, warmth)
    while True:
        names = tuple(rng.choice(KINDS, rng.integers(0, 3), replace=False).tolist()) if kinds is None else kinds
        secret = random_true_machine_and_truth_file.random_true_machine(design, rng)
        motion = motion_simulation.motion_of_commands(secret.true, route.commands, route.t, (), sensors)
        effects = tuple(_drawn(BY_NAME[name], design, route, motion, rng) for name in names)
        try:
            true = motion_simulation.simulate_machine_run(
                secret.true, route.commands, route.t, effects, sensors
            ).T_base_platform
            break
        except NotConverged:
            continue
    fitted = _samples(route, goals, true, np.arange(FITTED), rng, noise)
    correction, _ = fit_geometry_and_remainder_of_correction(fitted, design.mechanism, "none")
    units = lengths(errors_before_and_after_correction(correction, fitted)[1]).mean(
        axis=0
    )  # of poses that are not held out
    n = int(rng.choice(sizes))
    rest = np.arange(FITTED, len(goals))
    seen = _samples(route, goals, true, np.sort(rng.choice(rest, n, replace=False)), rng, noise)
    poses = held_out_poses(correction, [(seen, route.commands, *errors_before_and_after_correction(correction, seen))])
    real = lengths(pose_difference(correction.predict(goals[rest]), true[rest]))
    made = pose_error_promise(poses, *level, 0.0, tuple(units), rng)
    bounds = (made.position, made.rotation)
    share = (real <= [b.upper for b in bounds]).all(axis=1).mean()
    quantiles = np.quantile(real, level[0], axis=0)
    tolerance = quantiles * np.exp(rng.uniform(-SPREAD, SPREAD, 2))
    verdict = ""
    if n >= least_sample_size(level[0], GUARD):
        depth = greatest_scaled_error_bound(
            poses,
            poses.first,
            (Unit(POSITION, tolerance[0]), Unit(ROTATION, tolerance[1])),
            (level[0], GUARD),
            0.0,
            rng,
        )
        verdict = tolerance_conformity(tuple(zip(("position", "rotation"), tolerance)), depth, True, (0, 0))[0].verdict
    as_good = (real <= tolerance).all(axis=1).mean() >= level[0]
    return Trial(
        names,
        n,
        float(share),
        level[0],
        bool(as_good),
        verdict,
        tuple(quantiles),
        tuple(b.upper for b in bounds),
        tuple(b.measured for b in bounds),
    )


def lengths(errors):
    """(n, 2) m and rad, of errors (n, 6)."""
    return np.linalg.norm(errors.reshape(-1, 2, 3), axis=2)


def _drawn(kind, design, route, motion, rng):
    place = str(rng.choice(kind.places))
    axes = mechanisms.axis_place_texts(design.mechanism)
    return kind.drawn(
        axes[rng.integers(len(axes))] if place == "axis" else place, Drawing(design, route.t, motion, None), rng
    )


def _samples(route, goals, true, at, rng, factor):
    """Samples of some of a route's poses, as an instrument has them."""
    noise = factor * (COMMON * rng.normal(size=6) + OWN * rng.normal(size=(len(at), 6)))
    own, common = (np.tile(np.diag(width), (len(at), 1, 1)) for width in ((factor * OWN) ** 2, factor * COMMON))
    return Samples(at, route.t[at], goals[at], true[at] * exp(noise), own, common)


def share_of_claims_that_hold(trials):
    """Share of Trials whose promise, of position and rotation both, is kept."""
    return float(np.mean([t.holds for t in trials]))


def wrong_decisions(trials):
    """How many decisions of Trials are not so."""
    return sum(t.wrong for t in trials)
