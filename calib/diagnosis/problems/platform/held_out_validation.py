"""Held-out validation of a platform's effects, in px of corners or m of closures."""

from collections.abc import Sequence
from typing import cast

import numpy as np

from calib.diagnosis.engine.cross_validation_and_chance import (
    FEWEST,
    FOLDS,
    CrossValidation,
    HeldOut,
    frame_folds,
    held_out_residuals,
    summed_gain_in_standard_errors,
)
from calib.diagnosis.engine.linear_model import Column
from calib.diagnosis.problems.platform.effect_candidates import affects_images_only
from calib.diagnosis.problems.platform.linearised_corners import camera_edge_bias_freedoms
from calib.diagnosis.problems.platform.linearised_residuals import CLOSURES, CORNERS, LinearisedModel
from calib.diagnosis.problems.platform.simultaneous_refinement import Refinement
from calib.samples.pose_samples import time_block_folds
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.effects.framework.effect import Effect


def cross_validate_effects(refinement: Refinement, numbers: set[int], residual_block: int) -> CrossValidation:
    """Cross-validate several admitted effects together, in one block of residuals: CORNERS or CLOSURES."""
    before, after, _ = _both(refinement, numbers)
    return _compared(refinement.model, before, after, (residual_block,))[0]


def cross_validate_effects_by_residual_block(
    refinement: Refinement, numbers: set[int], residual_blocks: tuple[int, ...]
) -> tuple[CrossValidation, ...]:
    """Cross-validate several admitted effects together, once for each block of residuals (corners, closures)."""
    before, after, _ = _both(refinement, numbers)
    return _compared(refinement.model, before, after, residual_blocks)


def cross_validate_effect_by_regions(
    refinement: Refinement, number: int, residual_block: int, ordering_values: Floats
) -> CrossValidation:
    """Cross-validate one admitted effect, whole regions of the frames' ordering values held out in turn.

    ordering_values : (F,) what frames are put in order by
    """
    order = np.argsort(ordering_values, kind="stable")
    fold = np.empty(len(ordering_values), int)
    fold[order] = time_block_folds(len(order), min(FOLDS, max(len(order) // FEWEST, 2)))
    before, after, _ = _both(refinement, {number}, fold)
    return _compared(refinement.model, before, after, (residual_block,), order)[0]


def _both(refined: Refinement, numbers: set[int], fold: Integers | None = None) -> tuple[HeldOut, HeldOut, Integers]:
    """(held out without the effects, with them, folds (F,)). fold : stretches of time where None"""
    model, k = refined.model, refined.point
    asked = [k.effects[i] for i in sorted(numbers)]
    if fold is None:
        fold = frame_folds(model.frames, any(e.sudden for e in asked), sides_of_sudden_changes(asked, k.t))
    with_all = refined.marginalised
    after = held_out_residuals(with_all.linear, tuple(b.residual for b in with_all.linear.blocks), fold)
    others = [i for i, c in enumerate(refined.coordinates) if c.effect not in numbers]
    bare = model.marginalise(refined.column.take(others)) if others and refined.column is not None else model
    done = residual_change_column(model, [e for i, e in enumerate(k.effects) if i not in numbers])
    grown = tuple(
        b.residual if part is None else b.residual + part[:, 0] for b, part in zip(model.linear.blocks, done.parts)
    )
    return held_out_residuals(bare.linear, grown, fold), after, fold


def sides_of_sudden_changes(effects: Sequence[Effect], t: Floats) -> list[Booleans]:
    """[(F,) bool] sides, after and before, of each sudden change of what is seen, at times t (F,) s."""
    moments = [
        getattr(e, p.name)
        for e in effects
        if e.sudden and affects_images_only(e)
        for p in e.parameters
        if p.role == "moment"
    ]
    return [side for moment in moments for side in (t >= moment, t < moment)]


def residual_change_column(model: LinearisedModel, effects: Sequence[Effect]) -> Column:
    """Column (1) of the change of residuals where only these effects are left."""
    k, left = model.point, tuple(effects)
    out = (
        model.lengthened((k.effective() - k.effective(left))[..., None]) if k.axes else Column((None, model.nothing(1)))
    )
    return out if k.seen is None else out + model.fold((k.pixels() - k.pixels(left))[..., None])


def _compared(
    model: LinearisedModel, before: HeldOut, after: HeldOut, blocks: tuple[int, ...], order: Integers | None = None
) -> tuple[CrossValidation, ...]:
    """CrossValidation in each block. order : (F,) in which frames are neighbours, time's where None"""
    F, axes = model.frames, model.point.axes
    finder = [j for _, j in camera_edge_bias_freedoms(model.nuisances.names, model.point.design)]
    squares = []
    for held in (before, after):
        corners, closures = held.frames
        edges = model.linear.blocks[CORNERS].edges
        per_frame = (
            np.add.reduceat(np.r_[corners**2, 0.0], edges[:-1]) * (np.diff(edges) > 0) if len(corners) else np.zeros(F)
        )
        squares.append(per_frame + (closures.reshape(F, axes) ** 2).sum(axis=1))
    known = [held.beforehand[CLOSURES][finder] for held in (before, after)]  # priors' rows stand behind the closures
    fall = squares[0] - squares[1]
    gain = summed_gain_in_standard_errors(
        fall if order is None else fall[order], cast(float, known[0] @ known[0] - known[1] @ known[1])
    )
    return tuple(
        _corners(model, before, after, gain) if block == CORNERS else _closures(model, before, after, gain)
        for block in blocks
    )


def _closures(model: LinearisedModel, before: HeldOut, after: HeldOut, gain: float) -> CrossValidation:
    inverse = np.linalg.inv(model.closures.W)
    F, axes = model.frames, model.point.axes
    figures = [np.sqrt(np.mean((inverse @ held.frames[CLOSURES].reshape(F, axes, 1)) ** 2)) for held in (before, after)]
    return CrossValidation(
        float(figures[0]),
        float(figures[1]),
        float(np.sqrt(np.mean(model.strut_noise() - model.closures.scatter**2))),
        "m",
        gain,
    )


def _corners(model: LinearisedModel, before: HeldOut, after: HeldOut, gain: float) -> CrossValidation:
    px = model.corner_noise()
    degrees = len(model.corner_residual) - model.corners.local.shape[1] * model.frames
    figures = [px * np.sqrt((held.frames[CORNERS] ** 2).sum() / degrees) for held in (before, after)]
    return CrossValidation(float(figures[0]), float(figures[1]), px, "px", gain)
