"""Where two hypotheses come apart: of many configurations the few that tell most between them, as struts, images and
cameras see them.
"""

from collections.abc import Sequence

import numpy as np

from calib.experiment.experiment_question import PerFrame, Question
from rig.errors import RigError
from rig.model.design import Design
from rig.planning.configuration_sets import grid, low_discrepancy
from rig.planning.plan import Plan, axis_strokes, build_plan

POOL = 96  # configurations to choose from, beside the corners of what the axes reach
NAME = "apart"  # of the part of a plan that they become


def discriminating_configurations(asked: Sequence[Question], design: Design, count: int, seed: int) -> np.ndarray:
    """(count, axes) configurations, in the order in which they were chosen: each the one that, with those before it,
    tells most between each question's two likeliest names, what geometry, cameras and their own numbers may do taken
    out.

    A camera counts by what its image shows: configurations that bring markers where the two differ are chosen for it.
    seed : of the pool
    Raises RigError where the rig cannot follow the pool, no camera sees some of it, or no question has two names
    """
    open_ones = [q for q in asked if len(q.named) > 1]
    if not open_ones:
        raise RigError("one name alone is thought of, so there are no two that come apart anywhere")
    strokes = axis_strokes(design)
    pool = np.concatenate([low_discrepancy(strokes, POOL, seed=seed), grid(strokes, 2)])
    plan = build_plan(design, "pool", own={"pool": pool})
    return pool[choose_exposures([q.predict_outcomes_by_frame(plan) for q in open_ones], count)]


def choose_exposures(questions: Sequence[PerFrame], count: int) -> np.ndarray:
    """(count,) numbers of the exposures that together tell most, greedily, each one once.

    Raises ValueError for more than there are, or no question
    """
    if not questions or count > len(questions[0].of):
        raise ValueError(f"{count} exposures are to be chosen of {len(questions[0].of) if questions else 0}")
    sums = [(0.0, np.zeros(q.onto.shape[1]), np.eye(q.onto.shape[1])) for q in questions]
    free, out = np.ones(len(questions[0].of), bool), []
    for _ in range(count):
        told = np.zeros(len(free))
        for q, (of, onto, left) in zip(questions, sums):
            b = onto + q.onto[free]
            told[free] += (
                of + q.of[free] - np.einsum("fp,fp->f", b, np.linalg.solve(left + q.open[free], b[..., None])[..., 0])
            )
        best = int(np.argmax(np.where(free, told, -np.inf)))
        sums = [
            (of + q.of[best], onto + q.onto[best], left + q.open[best]) for q, (of, onto, left) in zip(questions, sums)
        ]
        free[best] = False
        out.append(best)
    return np.array(out)


def camera_shares(asked: Sequence[Question], plan: Plan) -> dict[str, float]:
    """{camera: share of what its images show otherwise under each question's two likeliest names}, the one that sees
    most first; none where an instrument measures."""
    parts: dict[str, float] = {}
    for question in asked:
        for name, squares in (
            question.predict_outcomes_by_frame(plan).by_camera if len(question.named) > 1 else {}
        ).items():
            parts[name] = parts.get(name, 0.0) + float(squares.sum())
    whole = max(sum(parts.values()), 1e-300)
    return dict(sorted(((name, part / whole) for name, part in parts.items()), key=lambda item: -item[1]))
