"""Nested selection: poses of an arm predicted by terms that were chosen, and fitted, on other stretches of time."""

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from calib.diagnosis.engine.cross_validation import time_stretch_folds
from calib.diagnosis.engine.finding_confirmation import labelled_progress
from calib.diagnosis.engine.problem_interface import Progress
from calib.diagnosis.engine.term_selection import fit_selected_terms
from calib.diagnosis.problems.arm.arm_problem import ArmProblem
from calib.diagnosis.problems.arm.projected_pose_residuals import fit_poses
from calib.diagnosis.problems.measured_evidence import HeldOutPoses
from rig.arrays import Floats
from rig.compute.parallel_map import parallel_map

PARTS = 3
FINE_PARTS, COARSE_PARTS = 30, 6  # stretches of time; every third is held out at once


def nested_held_out_poses(
    problem: ArmProblem, counts: tuple[int, ...], progress: Progress | None = None
) -> list[HeldOutPoses]:
    """HeldOutPoses of what a problem may fit, over each number of stretches of time: effects are chosen, and all is
    fitted, on two thirds of them at a time."""
    arms, kept = problem.arms, np.ones(len(problem.arms), bool) if problem.train is None else problem.train
    parts = [time_stretch_folds(len(arms), count) % PARTS for count in counts]

    def predicted(one: tuple[int, int]) -> tuple[Floats, Floats, tuple[str, ...]]:
        part = parts[one[0]] == one[1]
        with threadpool_limits(1):
            chosen, bare = fit_selected_terms(replace(problem, train=kept & ~part)), fit_poses(arms, (), kept & ~part)
        return (
            bare.left[part],
            chosen.left[part],
            tuple(f"{t.candidate.name} {t.candidate.place}" for t in chosen.terms),
        )

    things = [(i, k) for i in range(len(counts)) for k in range(PARTS)]
    found = dict(
        zip(
            things,
            parallel_map(
                predicted, things, labelled_progress(progress, "choosing anew without stretches"), items_per_process=1
            ),
        )
    )
    out = []
    for i, (count, part) in enumerate(zip(counts, parts)):
        before, after, far = np.empty(arms.left.shape), np.empty(arms.left.shape), np.empty(len(arms))
        for k in range(PARTS):
            before[part == k], after[part == k], _ = found[i, k]
            far[part == k] = _farthest(arms.q[part == k], arms.q[(part != k) & kept])
        out.append(
            HeldOutPoses(before[kept], after[kept], count, tuple(found[i, k][2] for k in range(PARTS)), far[kept])
        )
    return out


def _farthest(q: Floats, fitted: Floats) -> Floats:
    """(m,) rad: over the joints, the greatest distance of angles q (m, joints) from the nearest of fitted (n,
    joints).
    """
    return np.stack([cKDTree(b[:, None]).query(a[:, None])[0] for a, b in zip(q.T, fitted.T)]).max(axis=0)
