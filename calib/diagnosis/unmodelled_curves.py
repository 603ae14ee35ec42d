"""Curves over time, travel, history or a sensor that undo what a diagnosis leaves without a name at an axis.

Curves are tried at the axes that have such a finding, one after the other, the largest finding first. Each is fitted
with geometry and effects together, and the next is asked of what it leaves.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from calib.correction.physics_compensation import Unknown
from calib.diagnosis.problems.platform.effect_candidates import effect_context
from calib.diagnosis.problems.platform.effect_sensitivities import Sensitivities
from calib.diagnosis.problems.platform.lack_of_fit import closures_in_metres
from calib.diagnosis.problems.platform.linearised_residuals import CLOSURES, LinearisedModel
from calib.diagnosis.problems.platform.simultaneous_refinement import Refinement, refine_operating_point
from calib.diagnosis.unmodelled_curve_selection import AxisRows, ChosenCurve, choose_curve
from calib.models.arm.error_model_and_observations import sample_observations
from calib.models.arm.joint_effects_fit_and_held_out_scatter import (
    Columns,
    JointFit,
    WhitenedSamples,
    fit_geometry_and_effects,
)
from rig.array_and_json_types import Floats
from rig.effects.framework.effect import Candidate, Effect
from rig.effects.framework.effect_parameters_and_covariates import Context
from rig.effects.framework.unmodelled_curve import covariate_words, unmodelled_curves
from rig.model.motion_simulation import motion_of_commands

ROUNDS = 3  # curves at one axis, at the most

Chooser = Callable[[str], ChosenCurve | None]  # the curve that helps most at an axis' place, as all stands


@dataclass(slots=True, eq=False)
class _Undone:
    """What curves undo at an axis. names : of their covariates; before, after : held out, m or rad"""

    names: list[str]
    before: float
    after: float


def refinement_with_curves(refined: Refinement, unknown: Sequence[Unknown]) -> tuple[Refinement, tuple[Unknown, ...]]:
    """(Refinement with curves for what has no name at struts, the Unknowns with what these undo)."""
    context = effect_context(refined.point)

    def chosen(place: str) -> ChosenCurve | None:
        model = refined.marginalised
        candidates = _candidates(place, context)
        motion, W = refined.point.motion(refined.point.effects), model.closures.W
        columns = [(W @ c.deviation(c.grid[0], motion)).reshape(len(W) * W.shape[1], -1) for c in candidates]
        return choose_curve(_strut_rows(model, context.moved().places.index(place)), candidates, columns, len(W))

    def add(effect: Effect) -> None:
        nonlocal refined
        point = refined.point.with_effects((*refined.point.effects, effect))
        refined = refine_operating_point(point, Sensitivities(point))

    undone = _undone(unknown, context.moved().places, chosen, add)
    return refined, undone


def arm_fit_with_curves(fit: JointFit, unknown: Sequence[Unknown]) -> tuple[JointFit, tuple[Unknown, ...]]:
    """(JointFit with curves for what has no name at joints, the Unknowns with what these undo)."""
    history, samples = fit.history, fit.measured
    motion = replace(
        motion_of_commands(history.design, history.commands, samples.t, fit.effects, history.sensors),
        T=samples.T_base_platform,
    )
    context = Context(history.design, samples.t, history.sensors, motion)

    def chosen(place: str) -> ChosenCurve | None:
        seen = WhitenedSamples.of(fit.samples, history.identified(fit.samples, fit.arm))
        candidates = _candidates(place, context)
        columns = []
        for c in candidates:
            moved = c.deviation(c.grid[0], motion)
            columns.append(seen.whitened(Columns(moved, np.zeros((len(moved), 6, moved.shape[2])))))
        rows = _hand_rows(fit, seen)
        return choose_curve(rows, candidates, [part[: len(rows.frame)] for part in columns], len(samples))

    def add(effect: Effect) -> None:
        nonlocal fit
        fit = fit_geometry_and_effects(samples, history, fit.arm, (*fit.effects, effect), fit.before)

    undone = _undone(unknown, motion.places, chosen, add)
    return fit, undone


def _undone(
    unknown: Sequence[Unknown], places: Sequence[str], chosen: Chooser, add: Callable[[Effect], None]
) -> tuple[Unknown, ...]:
    """The Unknowns with what curves at the axes (their places) undo; every curve that helps is added."""
    out = []
    for one in sorted(unknown, key=lambda u: -u.magnitude):
        done: _Undone | None = None
        for _ in range(ROUNDS if one.place in places else 0):
            curve = chosen(one.place)
            if curve is None:
                break
            add(curve.effect)
            if done is None:
                done = _Undone([], curve.before, curve.after)
            done.names.append(covariate_words(curve.effect))
            done.after = curve.after
        out.append(
            one
            if done is None
            else replace(one, by=tuple(dict.fromkeys(done.names)), held_out=(done.before, done.after))
        )
    return tuple(out)


def _candidates(place: str, context: Context) -> list[Candidate]:
    """The curves that a recording can show at an axis."""
    channels = () if context.sensors is None else tuple(context.sensors.channels)
    return [c for kind in unmodelled_curves(channels).values() for c in kind.candidates(place, context)]


def _strut_rows(model: LinearisedModel, axis: int) -> AxisRows:
    """AxisRows of a strut: the loop closures of all struts."""
    linear, (F, axes) = model.linear, model.closures.W.shape[:2]
    residuals = tuple(block.residual for block in linear.blocks)
    known = [(Q[b.known_rows], y[b.known_rows]) for Q, y, b in zip(linear.columns.whole, residuals, linear.blocks)]
    return AxisRows(
        residuals[CLOSURES][: F * axes],
        linear.columns.whole[CLOSURES][: F * axes],
        np.repeat(np.arange(F), axes),
        linear.gram,
        partial(linear.right, residuals=residuals),
        (np.sum([Q.T @ Q for Q, _ in known], axis=0), np.sum([Q.T @ y for Q, y in known], axis=0)),
        lambda rows: closures_in_metres(model, rows)[:, axis],
        float(np.sqrt(np.mean(model.strut_noise()[:, axis] - model.closures.scatter[axis] ** 2))),
    )


def _hand_rows(fit: JointFit, seen: WhitenedSamples) -> AxisRows:
    """AxisRows of an arm's joint: the hand's poses, or positions, of those samples that agree with the fit."""
    basis = np.linalg.qr(np.column_stack([seen.basis, seen.whitened(fit.columns)]))[0]
    m, k = seen.W.shape[:2]
    frame, left = np.repeat(np.flatnonzero(seen.inliers), k), seen.left(fit.samples)
    inside, known = slice(0, m * k), slice(m * k, None)
    covariance = sample_observations(fit.samples).covariance[seen.inliers, :3, :3]

    def shifts(rows: Floats) -> Floats:
        return np.linalg.norm(np.linalg.solve(seen.W, rows.reshape(m, k, 1))[:, :3, 0], axis=1)

    def gram(some: Floats) -> Floats:
        own = basis[inside][some[frame]]
        return own.T @ own

    def right(some: Floats) -> Floats:
        own = some[frame]
        return basis[inside][own].T @ left[inside][own]

    return AxisRows(
        left[inside],
        basis[inside],
        frame,
        gram,
        right,
        (basis[known].T @ basis[known], basis[known].T @ left[known]),
        shifts,
        float(np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean())),
    )
