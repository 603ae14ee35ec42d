"""Fresh rigs at pose level, each calibrated, certified from a few of its poses and held against all of them: is the promise kept?

No images and no bundle adjustment: poses come with an instrument's noise of known covariance, a part of it shared by a recording. What
is sampled is what is promised about: the held-out poses are a random few of thousands that the machine took in one run.
"""

from dataclasses import dataclass

import numpy as np

from calib.certify.conformity import CONFORMS, FAILS, GUARD, judged
from calib.certify.held_out import errors_of
from calib.certify.held_poses import held_poses
from calib.certify.promise import promised
from calib.certify.tolerance_limits import smallest
from calib.correct.correction import calibrate
from calib.samples import Samples
from rig import machine, mechanisms, plan
from rig.effects import BY_NAME
from rig.effects.drawing import Drawing
from rig.errors import NotConverged
from rig.pose import difference, exp
from synthetic import world

KINDS = ("backlash", "hysteresis", "thermal_expansion", "base_expansion", "compliance", "joint_clearance", "creep", "cyclic_error", "screw_coupling",
         "scale_error")
POSES = 2000  # noise-free ones, from which the true 95th percentile is taken
FITTED = 120
SIZES = (59, 80, 120, 200)  # held out
OWN, COMMON = np.repeat([3.2e-6, 2.4e-5], 3), np.repeat([2.4e-6, 4.2e-6], 3)  # m and rad an axis, as three cameras have it
DECIDE = smallest(0.95, GUARD)
SPREAD = 0.7  # of the tolerance about what is true, as a logarithm


@dataclass(frozen=True)
class Trial:
    """effects : their names; n held out; per quantity: true 95th percentile, promise, limit as measured, tolerance, verdict with 97.5 % limits."""

    effects: tuple
    n: int
    true: tuple
    promise: tuple
    measured: tuple
    tolerance: tuple
    verdict: tuple

    @property
    def kept(self):
        return tuple(t <= p for t, p in zip(self.true, self.promise))

    @property
    def wrong(self):
        """Per quantity whether the decision, if there is one, is not so."""
        return tuple((v == CONFORMS and t > limit) or (v == FAILS and t <= limit) for v, t, limit in zip(self.verdict, self.true, self.tolerance))


def trial(design, seed):
    """Trial of a rig that a seed draws."""
    rng = np.random.default_rng([18, seed])
    strokes = design.mechanism.strut_range
    goals = np.concatenate([plan.low_discrepancy(strokes, FITTED, seed=seed), plan.scaled(strokes, rng.uniform(-1, 1, (POSES, 6)), plan.FILL)])
    route = plan.settled(goals, strokes.mean(axis=1), plan.speed_of(design))
    warmth, _ = world.temperatures(float(route.commands.t[-1]), rng)
    sensors = plan.logged(route, warmth)
    while True:
        names = tuple(rng.choice(KINDS, rng.integers(0, 3), replace=False).tolist())
        secret = world.draw(design, rng)
        motion = machine.motion(secret.true, route.commands, route.t, (), sensors)
        effects = tuple(_drawn(BY_NAME[name], design, route, motion, rng) for name in names)
        try:
            true = machine.run(secret.true, route.commands, route.t, effects, sensors).T_base_platform
            break
        except NotConverged:
            continue
    correction, _ = calibrate(_samples(route, goals, true, np.arange(FITTED), rng), design.mechanism, "none")
    n = int(rng.choice(SIZES))
    rest = np.arange(FITTED, len(goals))
    seen = _samples(route, goals, true, np.sort(rng.choice(rest, n, replace=False)), rng)
    poses = held_poses(correction, [(seen, route.commands, *errors_of(correction, seen))])
    errors = difference(correction.predict(goals[rest]), true[rest])
    real = tuple(float(np.quantile(np.linalg.norm(errors[:, part], axis=1), 0.95)) for part in (slice(0, 3), slice(3, 6)))
    made = promised(poses, 0.95, 0.95, 0.0, rng)
    tolerance = tuple(value * np.exp(rng.uniform(-SPREAD, SPREAD)) for value in real)
    bounds = (made.position, made.rotation)
    verdict = ("", "")
    if n >= DECIDE:
        guarded = promised(poses, 0.95, GUARD, 0.0, rng)
        verdict = tuple(judged("", t, bound).verdict for t, bound in zip(tolerance, (guarded.position, guarded.rotation)))
    return Trial(names, n, real, tuple(b.upper for b in bounds), tuple(b.measured for b in bounds), tolerance, verdict)


def _drawn(kind, design, route, motion, rng):
    place = str(rng.choice(kind.places))
    axes = mechanisms.places(design.mechanism)
    return kind.drawn(axes[rng.integers(len(axes))] if place == "axis" else place, Drawing(design, route.t, motion, None), rng)


def _samples(route, goals, true, at, rng):
    """Samples of some of a route's poses, as an instrument has them."""
    noise = COMMON * rng.normal(size=6) + OWN * rng.normal(size=(len(at), 6))
    own, common = (np.tile(np.diag(width), (len(at), 1, 1)) for width in (OWN**2, COMMON))
    return Samples(at, route.t[at], goals[at], true[at] * exp(noise), own, common)


def share_kept(trials):
    """Share of Trials whose promise, of position and rotation both, is kept."""
    return float(np.mean([all(t.kept) for t in trials]))


def wrong_decisions(trials):
    """How many decisions of Trials are not so."""
    return int(sum(map(sum, (t.wrong for t in trials))))
