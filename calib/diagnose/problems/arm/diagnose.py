"""An arm's recording -> its ArmDiagnosis: which effect sits at which joint, how large, how sure, and what nobody can name."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from calib.arms.identify import Identified
from calib.arms.model import moved
from calib.diagnose.engine.candidates import NotAsked
from calib.diagnose.engine.crossvalidate import CrossValidation, stretches
from calib.diagnose.engine.lack_of_fit import LackOfFit
from calib.diagnose.engine.problem import Progress
from calib.diagnose.engine.select import Finding, choose, labelled_part, select
from calib.diagnose.problems.arm.candidates import JointCandidate, joint_candidates
from calib.diagnose.problems.arm.fit import Fit, fit
from calib.diagnose.problems.arm.lack_of_fit import lack_of_fit
from calib.diagnose.problems.arm.poses import Arms, arms_of
from calib.diagnose.problems.arm.problem import ArmProblem
from calib.diagnose.problems.arm.repeats import Repeats, repeats
from calib.diagnose.problems.asked import Asked
from calib.diagnose.problems.temperature_smoothing import smoothed
from calib.pipeline import sample_recording
from rig.design import Arm
from rig.origin import Origin
from rig.recording import Recording

PARTS = 3
FINE, COARSE = 30, 6  # stretches of time; every third is held out at once


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutPoses:
    """Residuals (n, k), m and rad, of poses by structures chosen and fitted on other stretches: geometry alone, and with effects.

    stretches : how many there were; names : per part, what was chosen on the others
    far : (n,) rad, how far the joint that is farthest stood from any angle that it was fitted at"""

    before: np.ndarray
    after: np.ndarray
    stretches: int
    names: tuple[tuple[str, ...], ...]
    far: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class ArmDiagnosis:
    """recording : its name; source : of the poses; arms : Arms; arm : Arm as its geometry was fitted beside the findings
    before, fit : Fit by the geometry alone and with all findings; findings : [Finding]; cross_validations : one for each
    asked : how many candidates were; not_asked : [NotAsked]; held : [HeldOutPoses], fine stretches first; repeats : Repeats or None
    left : [LackOfFit]; origin : of the owner's clock, which moments are told by"""

    recording: str
    source: str
    arms: Arms
    arm: Arm
    before: Fit
    fit: Fit
    findings: list[Finding]
    cross_validations: list[CrossValidation]
    asked: int
    not_asked: list[NotAsked]
    held: list[HeldOutPoses]
    repeats: Repeats | None
    left: list[LackOfFit]
    origin: Origin = Origin()


@threadpool_limits.wrap(limits=1)
def diagnose(recording: Recording, only: list[str] | None = None, without: tuple[str, ...] = (), progress: Progress | None = None) -> ArmDiagnosis:
    """ArmDiagnosis of a Recording of an arm. only, without : effects, or "effect joint 3"; progress : called with (label, done, of)

    Raises NotEnoughData where too little was measured, and what calibrating raises
    """
    sampled = sample_recording(recording, progress=progress)
    sensors, _ = smoothed(recording.sensors)
    arms, found = arms_of(sampled.samples, recording.design, recording.commands, sensors)
    asked = Asked(tuple(only or ()), tuple(without))
    return replace(diagnosed(arms, found, recording.folder.resolve().name, sampled.source, asked, progress), origin=recording.origin)


def diagnosed(arms: Arms, found: Identified, name: str, source: str, asked: Asked, progress: Progress | None = None,
              coarse: bool = True) -> ArmDiagnosis:
    """ArmDiagnosis of Arms linear about the Arm that was Identified; coarse : whether long stretches are held out as well."""
    candidates, not_asked = joint_candidates(arms, asked)
    problem = ArmProblem(arms, candidates)
    selection = select(problem, progress)
    chosen = selection.fit
    held = [nested(arms, candidates, count, progress) for count in ((FINE, COARSE) if coarse else (FINE,))]
    again, step = repeats(chosen), np.zeros(len(found.free))
    step[found.free] = chosen.theta[: found.free.sum()]
    proofs = [problem.cross_validation(chosen, f.number) for f in selection.findings]
    return ArmDiagnosis(name, source, arms, moved(found.arm, step), fit(arms), chosen, selection.findings, proofs, selection.asked, not_asked, held,
                        again, lack_of_fit(chosen, again, problem.policy.cluster))


def nested(arms: Arms, candidates: list[JointCandidate], count: int, progress: Progress | None = None) -> HeldOutPoses:
    """HeldOutPoses over `count` stretches of time: effects are chosen, and all is fitted, on two thirds of them at a time."""
    part = stretches(len(arms), count) % PARTS
    before, after, far, names = np.empty(arms.left.shape), np.empty(arms.left.shape), np.empty(len(arms)), []
    for k in range(PARTS):
        label = f"part {k + 1} of {PARTS} of {count} stretches held out, "
        chosen = choose(ArmProblem(arms, candidates, part != k), labelled_part(progress, label))
        before[part == k] = fit(arms, (), part != k).left[part == k]
        after[part == k] = chosen.left[part == k]
        far[part == k] = _farthest(arms.q[part == k], arms.q[part != k])
        names.append(tuple(f"{t.candidate.name} {t.candidate.place}" for t in chosen.terms))
    return HeldOutPoses(before, after, count, tuple(names), far)


def _farthest(q: np.ndarray, fitted: np.ndarray) -> np.ndarray:
    """(m,) rad: over the joints, the greatest distance of angles q (m, joints) from the nearest of fitted (n, joints)."""
    return np.stack([cKDTree(b[:, None]).query(a[:, None])[0] for a, b in zip(q.T, fitted.T)]).max(axis=0)
