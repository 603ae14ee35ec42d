"""Choice of smooth curves, over time, travel or a sensor, for axis errors that a diagnosis leaves unexplained.

Curves are tried at the axes that have such a finding, one after the other, the largest finding first. Each is fitted
with geometry and effects together, and the next is asked of what it leaves.

Of every candidate the marginal likelihood of a normal prior on its coefficients says how large and how fine it is
(Rasmussen and Williams, Gaussian processes for machine learning, 2006, ch. 5). Whether it holds is asked of stretches
of the recording held out whole, for which the candidate, its size and its coefficients are chosen anew without them.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, cast

import numpy as np
from scipy.linalg import cho_factor, cho_solve, null_space

from calib.correction.physical_effects_of_calibration_and_their_compensation import Unknown
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import (
    RIDGE,
    cross_validation_folds_of_frames,
    signed_rank_gain_in_standard_errors,
)
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import Sensitivities, effect_context
from calib.diagnosis.problems.platform.joint_refinement_of_cameras_geometry_poses_and_effects import (
    Refinement,
    refine_operating_point,
)
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import CLOSURES, CORNERS, LinearisedModel
from calib.models.arm.arm_error_model_and_instrument_observations import observations_of_samples
from calib.models.arm.joint_effect_fit_and_held_out_scatter import (
    Columns,
    JointFit,
    WhitenedSamples,
    fit_geometry_and_effects,
)
from rig.array_and_json_types import Floats, Integers
from rig.effects.framework.effect_base_class import Candidate, Effect
from rig.effects.framework.effect_checks_and_fit_coordinates import (
    conserved_coordinate_sums,
    fit_coordinates_of_effects,
)
from rig.effects.framework.parameters_covariates_and_marker_table import Context
from rig.effects.framework.unmodelled_curve_and_formula_quantities import (
    curve_classes_by_covariate,
    curve_covariate_words,
)
from rig.model.machine_motion_simulation import motion_of_commands

SIZES = np.geomspace(1e-7, 1e-2, 26)  # prior standard deviations of a curve, in the axis' unit
TRANSIENT = 3.0  # log of how much likelier a curve over time, which may not come again, must be than another
LIKELIER = 5.0  # log of how much likelier a curve must be than none
SCATTERS = (0.03, 0.1, 0.3, 1.0)  # shares of an axis' scatter without a curve, that it may have beside one
GAIN = 2.0  # standard errors by which held-out stretches must gain


@dataclass(frozen=True, slots=True, eq=False)
class AxisRows:
    """What a recording says of an axis, whitened by a scatter that the axis may have. residual : (m,)
    nuisances : (m, p); frame : (m,) of each row; columns : of each candidate (m, q) per unit of its coefficients
    gram, right : of some frames (F,) bool, (p, p) and (p,) of the nuisances over all that was measured; known : the
    same of what was known beforehand; level : (F,) log of each frame's whitening; in_units : whitened rows (m,) ->
    (F,) in m or rad; noise : RMS of what measuring adds
    """

    residual: Floats
    nuisances: Floats
    frame: Integers
    columns: Sequence[Floats]
    gram: Callable[[Floats], Floats]
    right: Callable[[Floats], Floats]
    known: tuple[Floats, Floats]
    level: Floats
    in_units: Callable[[Floats], Floats]
    noise: float

    @property
    def parts(self) -> list[slice]:
        """Where each candidate's columns are among all."""
        edges = np.r_[0, np.cumsum([part.shape[1] for part in self.columns])].tolist()
        return [slice(a, b) for a, b in zip(edges[:-1], edges[1:])]


@dataclass(frozen=True, slots=True, eq=False)
class ChosenCurve:
    """effect : the curve with its size and coefficients; before, after : RMS on held-out poses without it and with it,
    what noise adds taken off; gain : standard errors by which these gain
    """

    effect: Effect
    before: float
    after: float
    gain: float


@dataclass(frozen=True, slots=True, eq=False)
class _Training:
    """Normal equations of all candidates' columns, the nuisances eliminated: G (Q, Q), b (Q,); onto : (p, Q) of the
    nuisances, solved for; at : (p,) nuisances alone; likelihood : its logarithm without a curve, but for a constant
    """

    G: Floats
    b: Floats
    onto: Floats
    at: Floats
    likelihood: float


class _Choice(NamedTuple):
    """view : index of the scatter; number : of the candidate; size; likelier : log of how much likelier than none;
    theta : (q,) coefficients; nuisances : (p,) with them; bare : (p,) without.
    """

    view: int
    number: int
    size: float
    likelier: float
    theta: Floats
    nuisances: Floats
    bare: Floats


def choose_curve_for_residual(
    rows_by_scatter: Sequence[AxisRows], candidates: Sequence[Candidate]
) -> ChosenCurve | None:
    """The smooth curve, of the candidates, that explains an axis' residual best on held-out stretches.

    None where none holds on held-out stretches.
    rows_by_scatter : the same by scatters that the axis may have, which is chosen with the curve
    """
    frames = len(rows_by_scatter[0].level)
    fold = cross_validation_folds_of_frames(frames, True)
    C = [np.concatenate(rows.columns, axis=1) for rows in rows_by_scatter]
    folds = [
        [_products(rows, columns, fold == h) for h in np.unique(fold)] for rows, columns in zip(rows_by_scatter, C)
    ]
    before, after = np.zeros(frames), np.zeros(frames)
    for h in np.unique(fold).tolist():
        found = _best(rows_by_scatter, candidates, [[part for k, part in enumerate(each) if k != h] for each in folds])
        rows, held = rows_by_scatter[found.view], fold == h
        bare = rows.residual - rows.nuisances @ found.bare
        with_curve = rows.residual - rows.nuisances @ found.nuisances - rows.columns[found.number] @ found.theta
        before[held], after[held] = rows.in_units(bare)[held], rows.in_units(with_curve)[held]
    gain = signed_rank_gain_in_standard_errors(before**2 - after**2)
    found = _best(rows_by_scatter, candidates, folds)
    if gain < GAIN or found.likelier < LIKELIER:
        return None
    chosen = candidates[found.number]
    effect = chosen.effect({**chosen.grid[0], "size": found.size}, found.theta / found.size)
    squares = [float(np.mean(part**2)) - rows_by_scatter[0].noise ** 2 for part in (before, after)]
    return ChosenCurve(effect, math.sqrt(max(squares[0], 0.0)), math.sqrt(max(squares[1], 0.0)), gain)


def _products(rows: AxisRows, C: Floats, some: Floats) -> tuple[Floats | float, ...]:
    """Of some frames (F,) bool: products of nuisances (p, p) and (p,), of columns C (m, Q) with nuisances (p, Q), with
    each other (Q, Q) and with the residual (Q,); log likelihood of the residual.
    """
    own = some[rows.frame]
    part, left = C[own], rows.residual[own]
    likelihood = float(rows.level[some].sum() - left @ left / 2)
    return rows.gram(some), rows.right(some), rows.nuisances[own].T @ part, part.T @ part, part.T @ left, likelihood


def _trained(rows: AxisRows, folds: Sequence[tuple[Floats | float, ...]]) -> _Training:
    gram, right, cross, square, with_residual, likelihood = (np.sum(parts, axis=0) for parts in zip(*folds))
    gram, right = gram + rows.known[0] + RIDGE * np.eye(len(gram)), right + rows.known[1]
    factor = cho_factor(gram)
    onto, at = cho_solve(factor, cross), cho_solve(factor, right)
    likelihood = float(likelihood + right @ at / 2 - np.log(np.diag(factor[0])).sum())
    return _Training(square - cross.T @ onto, with_residual - cross.T @ at, onto, at, likelihood)


def _best(
    views: Sequence[AxisRows], candidates: Sequence[Candidate], folds: Sequence[Sequence[tuple[Floats | float, ...]]]
) -> _Choice:
    """The _Choice by some folds of each view, the choice among the candidates of a kind allowed for."""
    trained = [_trained(rows, each) for rows, each in zip(views, folds)]
    parts, found = views[0].parts, []
    for view, one in enumerate(trained):
        for number, (candidate, part) in enumerate(zip(candidates, parts)):
            values, vectors = np.linalg.eigh(one.G[part, part])
            values, z = np.maximum(values, 0.0), vectors.T @ one.b[part]
            gained = (z**2 / (SIZES[:, None] ** -2.0 + values) - np.log1p(SIZES[:, None] ** 2 * values)).sum(axis=1) / 2
            alike = sum(other.kind is candidate.kind for other in candidates)
            rarer = TRANSIENT if candidate.kind.sudden else 0.0
            score = one.likelihood + float(gained.max()) - math.log(alike) - rarer
            found.append((score, view, number, float(SIZES[gained.argmax()])))
    score, view, number, size = max(found)
    one, part = trained[view], parts[number]
    information = one.G[part, part] + np.eye(part.stop - part.start) / size**2
    theta = cast(Floats, np.linalg.solve(information, one.b[part]))
    likelier = score - max(other.likelihood for other in trained)
    return _Choice(view, number, size, likelier, theta, one.at - one.onto[:, part] @ theta, one.at)


ROUNDS = 3  # curves at one axis, at the most

Chooser = Callable[[str], ChosenCurve | None]  # the curve that helps most at an axis' place, as all stands


@dataclass(slots=True, eq=False)
class _Undone:
    """What curves undo at an axis. names : of their covariates; before, after : held out, m or rad"""

    names: list[str]
    before: float
    after: float


def refinement_with_curves_for_unexplained(
    refined: Refinement, unexplained: Sequence[Unknown]
) -> tuple[Refinement, tuple[Unknown, ...]]:
    """Refinement with curves for what has no name at struts.

    Returns (Refinement, the Unknowns with what these curves undo)
    """
    context = effect_context(refined.point)

    def chosen(place: str) -> ChosenCurve | None:
        free = _free_directions(refined.point.effects)
        column = None if refined.column is None else refined.column.take(slice(None)) @ free
        model = refined.model if column is None or not free.size else refined.model.marginalise(column)
        axis, candidates = context.moved().places.index(place), _candidates(place, context)
        motion = refined.point.motion(refined.point.effects)
        moved = [c.deviation(c.grid[0], motion) for c in candidates]
        shares = SCATTERS if model.closures.scatter[axis] > 0 else (1.0,)
        return choose_curve_for_residual([_strut_rows(model, axis, moved, share) for share in shares], candidates)

    def add(effect: Effect) -> None:
        nonlocal refined
        point = refined.point.with_effects((*refined.point.effects, effect))
        refined = refine_operating_point(point, Sensitivities(point))

    units = dict(zip(context.moved().places, context.moved().units))
    undone = _undone(unexplained, units, chosen, add)
    return refined, undone


def arm_fit_with_curves_for_unexplained(
    fit: JointFit, unexplained: Sequence[Unknown]
) -> tuple[JointFit, tuple[Unknown, ...]]:
    """JointFit of an arm with curves for what has no name at joints.

    Returns (JointFit, the Unknowns with what these curves undo)
    """
    history, samples = fit.history, fit.measured
    motion = motion_of_commands(
        history.design, history.commands, samples.t, fit.effects, history.sensors, samples.T_base_platform
    )
    context = Context(history.design, samples.t, history.sensors, motion)

    def chosen(place: str) -> ChosenCurve | None:
        found, candidates = history.identified(fit.samples, fit.arm), _candidates(place, context)
        moved = [c.deviation(c.grid[0], motion) for c in candidates]
        shares = SCATTERS if found.scatter.any() else (1.0,)
        views = [WhitenedSamples.of(fit.samples, replace(found, scatter=share * found.scatter)) for share in shares]
        return choose_curve_for_residual([_hand_rows(fit, seen, moved) for seen in views], candidates)

    def add(effect: Effect) -> None:
        nonlocal fit
        fit = fit_geometry_and_effects(samples, history, fit.arm, (*fit.effects, effect), fit.before)

    undone = _undone(unexplained, dict.fromkeys(motion.places, "m"), chosen, add)
    return fit, undone


def _undone(
    unknown: Sequence[Unknown], units: Mapping[str, str], chosen: Chooser, add: Callable[[Effect], None]
) -> tuple[Unknown, ...]:
    """The Unknowns with what curves at the axes undo; every curve that helps is added.

    units : {axis' place: unit of what is held out}, an axis' own or m at the hand
    """
    out = []
    for one in sorted(unknown, key=lambda u: -u.magnitude):
        done: _Undone | None = None
        for _ in range(ROUNDS if one.place in units else 0):
            curve = chosen(one.place)
            if curve is None:
                break
            add(curve.effect)
            if done is None:
                done = _Undone([], curve.before, curve.after)
            done.names.append(curve_covariate_words(curve.effect))
            done.after = curve.after
        out.append(
            one
            if done is None
            else replace(
                one,
                by=tuple(dict.fromkeys(done.names)),
                held_out=(done.before, done.after),
                held_out_unit=units[one.place],
            )
        )
    return tuple(out)


def _free_directions(effects: tuple[Effect, ...]) -> Floats:
    """(c, k) directions in which effects' coordinates can still move: none of a number at its bound, which takes up
    nothing, and none that changes a sum that stays.
    """
    coordinates = fit_coordinates_of_effects(effects)
    free = np.array([c.at_bound(effects[c.effect]) is None for c in coordinates], bool)
    sums = conserved_coordinate_sums(coordinates, effects)[:, free]
    out = np.zeros((len(coordinates), free.sum()))
    out[free] = np.eye(free.sum())
    return out @ null_space(sums) if sums.any() else out


def _candidates(place: str, context: Context) -> list[Candidate]:
    """The curves that a recording can show at an axis."""
    channels = () if context.sensors is None else tuple(context.sensors.channels)
    return [c for kind in curve_classes_by_covariate(channels).values() for c in kind.candidates(place, context)]


def _strut_rows(model: LinearisedModel, axis: int, moved: Sequence[Floats], share: float) -> AxisRows:
    """AxisRows of a strut: the loop closures of all struts, this one with a share of its scatter.

    moved : of each candidate (F, axes, q) m per unit of its coefficients
    """
    linear, before, scatter = model.linear, model.closures.W, model.closures.scatter
    F, axes = before.shape[:2]
    back = np.linalg.inv(before)
    less = np.zeros(axes)
    less[axis] = scatter[axis] ** 2 * (1 - share**2)
    W = np.linalg.inv(np.linalg.cholesky(back @ np.swapaxes(back, 1, 2) - np.diag(less)))
    closures, known = slice(0, F * axes), slice(F * axes, None)
    residual, basis = linear.blocks[CLOSURES].residual, linear.columns.whole[CLOSURES]
    corners, seen = linear.blocks[CORNERS], linear.columns.whole[CORNERS]
    y = (W @ back @ residual[closures].reshape(F, axes, 1)).ravel()
    Q = (W @ back @ basis[closures].reshape(F, axes, -1)).reshape(F * axes, -1)
    frame = np.repeat(np.arange(F), axes)
    inverse = np.linalg.inv(W)

    def gram(some: Floats) -> Floats:
        own = Q[some[frame]]
        return np.sum([own.T @ own, *(seen[rows].T @ seen[rows] for rows in corners.rows_of(some))], axis=0)

    def right(some: Floats) -> Floats:
        own = some[frame]
        products = [seen[rows].T @ corners.residual[rows] for rows in corners.rows_of(some)]
        return np.sum([Q[own].T @ y[own], *products], axis=0)

    return AxisRows(
        y,
        Q,
        frame,
        [(W @ part).reshape(F * axes, -1) for part in moved],
        gram,
        right,
        (basis[known].T @ basis[known], basis[known].T @ residual[known]),
        np.linalg.slogdet(W)[1],
        lambda rows: (inverse @ rows.reshape(F, axes, 1))[:, axis, 0],
        float(np.sqrt(np.mean(model.strut_noise()[:, axis] - scatter[axis] ** 2))),
    )


def _hand_rows(fit: JointFit, seen: WhitenedSamples, moved: Sequence[Floats]) -> AxisRows:
    """AxisRows of an arm's joint: the hand's poses, or positions, of those samples that agree with the fit.

    moved : of each candidate (n, joints, q) rad or m per unit of its coefficients
    """
    basis = np.linalg.qr(np.column_stack([seen.basis, seen.whitened(fit.columns) @ _free_directions(fit.effects)]))[0]
    m, k = seen.W.shape[:2]
    rows, left = np.repeat(np.flatnonzero(seen.inliers), k), seen.left(fit.samples)
    inside, known = slice(0, m * k), slice(m * k, None)
    covariance = observations_of_samples(fit.samples).covariance[seen.inliers, :3, :3]
    level = np.zeros(len(fit.samples))
    level[seen.inliers] = np.linalg.slogdet(seen.W)[1]

    def shifts(whitened: Floats) -> Floats:
        out = np.zeros(len(fit.samples))
        back = np.linalg.solve(seen.W, whitened.reshape(m, k, 1))
        out[seen.inliers] = np.linalg.norm(back[:, :3, 0], axis=1)
        return out

    def gram(some: Floats) -> Floats:
        own = basis[inside][some[rows]]
        return own.T @ own

    def right(some: Floats) -> Floats:
        own = some[rows]
        return basis[inside][own].T @ left[inside][own]

    return AxisRows(
        left[inside],
        basis[inside],
        rows,
        [seen.whitened(Columns.of_joints(part))[inside] for part in moved],
        gram,
        right,
        (basis[known].T @ basis[known], basis[known].T @ left[known]),
        level,
        shifts,
        float(np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean())),
    )
