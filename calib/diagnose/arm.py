"""An arm's recording -> its Diagnosis: which effect sits at which joint, how large, how sure, and what nobody can name."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from calib.arms.certify import calibrate
from calib.arms.model import moved
from calib.arms.observations import of_samples
from calib.diagnose.joint_families import families, moments
from calib.diagnose.joint_select import findings, select
from calib.diagnose.joint_unknown import unknowns
from calib.diagnose.joints import Arms, Fit, fit, stretches
from calib.diagnose.repeats import repeats
from calib.diagnose.weather import smoothed
from calib.pipeline import sample_recording
from rig.origin import Origin
from rig.effects.base import Path
from rig.errors import NotEnoughData

FEWEST = 60  # poses
PARTS = 3
FINE, COARSE = 30, 6  # stretches of time; every third is held out at once


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Residuals (n, k), m and rad, of poses by structures chosen and fitted on other stretches: geometry alone, and with effects.

    stretches : how many there were; names : per part, what was chosen on the others
    far : (n,) rad, how far the joint that is farthest stood from any angle that it was fitted at"""

    before: np.ndarray
    after: np.ndarray
    stretches: int
    names: tuple
    far: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class ArmDiagnosis:
    """recording : its name; source : of the poses; arms : Arms; arm : Arm as its geometry was fitted beside the findings
    before, fit : Fit by the geometry alone and with all findings; findings : [Finding]; families : how many were asked
    skipped : [Skipped]; held : [HeldOut], fine stretches first; repeats : Repeats or None; unknown : [Unknown]
    origin : of the owner's clock, which moments are told by"""

    recording: str
    source: str
    arms: Arms
    arm: object
    before: Fit
    fit: Fit
    findings: list
    families: int
    skipped: list
    held: list
    repeats: object
    unknown: list
    origin: Origin = Origin()


def arms_of(samples, nominal, instrument, gravity, commands=None, channels=None):
    """(Arms, Identified) of Samples: calibrated, and linear about it.

    commands : Commands, the whole path; the samples' own commands in their order where None; channels : {name: (n,)}
    Raises NotEnoughData for too few poses, and what calibrating raises
    """
    if len(samples) < FEWEST:
        raise NotEnoughData(f"{len(samples)} poses are too few to diagnose an arm; it takes {FEWEST}, better 500")
    _, found = calibrate(samples, nominal, instrument, profiles=False)
    observations = of_samples(samples)
    J = observations.jacobian(found.arm)
    freedoms = np.concatenate([J[..., found.free], observations.common], axis=2)
    rows = found.arm.rows
    step = np.zeros(J.shape[2])
    step[6:-6].reshape(-1, 5)[:, 1:3] = rows[:, 1:3]  # d and a: what grows with temperature
    t = samples.t
    if commands is None:
        path = Path(t, samples.commanded, np.arange(len(t)))
    else:
        knots = np.union1d(commands.t, t)
        path = Path(knots, np.stack([np.interp(knots, commands.t, c) for c in commands.values.T], axis=1), np.searchsorted(knots, t))
    return Arms(samples.frame, t, samples.commanded, observations.residuals(found.arm), freedoms, observations.joint_jacobian(found.arm),
                observations.covariance, moments(samples.commanded, found.arm, gravity), path, channels or {}, J @ step), found


@threadpool_limits.wrap(limits=1)
def diagnose(recording, only=None, without=(), progress=None):
    """ArmDiagnosis of a Recording of an arm. only, without : effects, or "effect joint 3"; progress : called with (label, done, of)

    Raises NotEnoughData where too little was measured, and what calibrating raises
    """
    sampled = sample_recording(recording, progress=progress)
    s, design = sampled.samples, recording.design
    sensors, _ = smoothed(recording.sensors)
    channels = {} if sensors is None else {name: sensors.at(s.t, name) for name in sensors.channels}
    arms, found = arms_of(s, design.mechanism, design.instrument, design.gravity, recording.commands, channels)
    found = diagnosed(arms, found, recording.folder.resolve().name, sampled.source, only, without, progress)
    return replace(found, origin=recording.origin)


def diagnosed(arms, found, name, source, only=None, without=(), progress=None, coarse=True):
    """ArmDiagnosis of Arms linear about the Arm that was Identified; coarse : whether long stretches are held out as well."""
    asked, skipped = families(arms, only, without)
    chosen = select(arms, asked, progress=progress)
    held = [nested(arms, asked, count, progress) for count in ((FINE, COARSE) if coarse else (FINE,))]
    again, step = repeats(chosen), np.zeros(len(found.free))
    step[found.free] = chosen.theta[: found.free.sum()]
    return ArmDiagnosis(name, source, arms, moved(found.arm, step), fit(arms), chosen, findings(chosen, asked, progress), len(asked), skipped,
                        held, again, unknowns(chosen, again))


def nested(arms, asked, count, progress=None):
    """HeldOut over `count` stretches of time: effects are chosen, and all is fitted, on two thirds of them at a time."""
    part = stretches(len(arms), count) % PARTS
    before, after, far, names = np.empty(arms.left.shape), np.empty(arms.left.shape), np.empty(len(arms)), []
    for k in range(PARTS):
        label = f"part {k + 1} of {PARTS} of {count} stretches held out, "
        chosen = select(arms, asked, part != k, progress and (lambda what, done, of, label=label: progress(label + what, done, of)))
        before[part == k] = fit(arms, (), part != k).left[part == k]
        after[part == k] = chosen.left[part == k]
        far[part == k] = _farthest(arms.q[part == k], arms.q[part != k])
        names.append(tuple(f"{t.family.name} {t.family.place}" for t in chosen.terms))
    return HeldOut(before, after, count, tuple(names), far)


def _farthest(q, fitted):
    """(m,) rad: over the joints, the greatest distance of angles q (m, joints) from the nearest of fitted (n, joints)."""
    return np.stack([cKDTree(b[:, None]).query(a[:, None])[0] for a, b in zip(q.T, fitted.T)]).max(axis=0)
