"""Detection of swapped markers, and cross-validation of effects.

Misplaced markers and frames are found before any search.

Wild poses, misread or exchanged markers; validation in px of corners or m of closures.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from scipy.spatial import cKDTree

from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import Crowd, LeftOut, Outliers
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import (
    FEWEST,
    FOLDS,
    CrossValidation,
    HeldOut,
    cross_validation_folds_of_frames,
    held_out_residuals,
    summed_gain_in_standard_errors,
)
from calib.diagnosis.engine.linear_residual_model import Column
from calib.diagnosis.problems.covariate_functions_smoothed_temperatures_and_repeats import (
    axis_speeds,
    centred_and_scaled_to_plus_minus_one,
    time_cosines,
)
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import is_image_only_effect
from calib.diagnosis.problems.platform.joint_refinement_of_cameras_geometry_poses_and_effects import Refinement
from calib.diagnosis.problems.platform.linearisation_operating_point import (
    OperatingPoint,
    observations_grouped_into_sightings,
)
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import CLOSURES, CORNERS, LinearisedModel
from calib.diagnosis.problems.platform.linearised_corners import camera_edge_bias_nuisances
from calib.identify.bounded_and_robust_least_squares_fit import (
    ALIKE,
    CONSISTENT,
    IN_PLACE,
    IN_TIME,
    MOST,
    isolated_outlier_rows,
    robust_fit,
    rows_with_several_deviating_or_one_gross_number,
    time_block_folds,
)
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.effects.framework.effect_base_class import Effect
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    loop_closure_parameter_jacobian,
    strut_or_axis_jacobian_by_pose,
)
from rig.recording.recording_folder import PAYLOAD
from vision.corner_observations_and_merging import observations_of_frames
from vision.marker_corner_prediction import predict_sightings

GATE = 7.0  # times the scatter of the others, from which a frame or a marker's corners may be wild
SLOW = 4  # cosines of time that are free
ROWS = 4  # frames for each number that is free in one strut
LEAST = 0.5  # px; corners nearer than this to where they should be are no other marker's
HELD = 2  # sightings that a frame must keep, one of them of the platform
ALONE = (
    "measured pose and command agree with no other frame, neither the previous and next ones nor those at "
    "configurations near it"
)
MISREAD = "its corners deviate unlike those of this marker before and after, or any near them: it was misread"
FAR = 5.0  # px; a sighting farther off than this, in the middle, is misplaced
BROUGHT_BACK = 0.2  # of that distance to which an exchange must bring it
SHARE = 0.7  # of a marker's sightings that must be misplaced


def find_outliers(point: OperatingPoint, covariance: Floats) -> Outliers:
    """Outliers of an OperatingPoint, with the effects that it has. covariance : (F, 6, 6) of its poses"""
    wild = _wild_corners(point) if point.seen is not None else Outliers()
    if not point.axes:
        return wild
    return wild.with_more(_wild_frames(point, covariance), len(point.frames), "frames")


def operating_point_without_outliers(point: OperatingPoint, wild: Outliers) -> OperatingPoint:
    """OperatingPoint without what is wild; what was commanded stays, since it moved the rig."""
    seen = point.seen
    if seen is not None and wild.sightings:
        o = seen.observations
        keys = zip(point.frames[o.frame].tolist(), o.camera.tolist(), o.marker.tolist())
        seen = seen.take(np.array([key not in wild.sightings for key in keys]))
    rows = np.flatnonzero(~np.isin(point.frames, sorted(wild.frames)))
    if len(rows) == len(point.frames):
        return replace(point, seen=seen)
    if seen is not None:
        seen = replace(
            observations_grouped_into_sightings(observations_of_frames(seen.observations, rows), seen.markers),
            stated=seen.stated,
        )
    return replace(
        point,
        frames=point.frames[rows],
        t=point.t[rows],
        T=point.T[rows],
        moving={i: T[rows] for i, T in point.moving.items()},
        own=None if point.own is None else point.own[rows],
        seen=seen,
    )


def _wild_frames(k: OperatingPoint, covariance: Floats) -> Outliers:
    """Outliers of frames whose struts' closures are far off what geometry, moves, load and time may do smoothly, in
    more than one strut. What geometry
    may do is asked at the poses that commands give: at a pose that is wild it may do anything."""
    m, closures = k.platform, k.closures()
    T = mechanisms.kinematics_of(m).forward(k.commanded.at(k.t), m)
    A, loops, smooth = strut_or_axis_jacobian_by_pose(T, m), loop_closure_parameter_jacobian(T, m), _smooth(k)
    sigma = np.sqrt(np.einsum("fij,fjk,fik->fi", A, covariance, A))
    parts = []
    for i in range(k.axes):
        own = loops[:, i, loops[:, i].any(axis=0)]
        free = min(smooth.shape[2], max(len(k.t) // ROWS - own.shape[1], 0))
        columns = np.column_stack([own, smooth[:, i, :free]])
        parts.append(((closures[:, i] / sigma[:, i])[:, None], (columns / sigma[:, i, None])[:, None]))
    found = robust_fit(parts)
    far = isolated_outlier_rows(
        found.relative, k.t, k.commanded.at(k.t), GATE
    ) & rows_with_several_deviating_or_one_gross_number(found.relative, GATE)
    if far.sum() > MOST * len(far):
        return Outliers(crowd=Crowd("frames", int(far.sum()), len(far)))
    left_out = []
    for f in np.flatnonzero(far).tolist():
        i = int(np.abs(found.relative[f]).argmax())
        off, times = float(abs(found.residual[f, i]) * sigma[f, i]), float(abs(found.relative[f, i]))
        left_out.append(LeftOut(int(k.frames[f]), "pose", str(k.places[i]), off, k.axis_unit, times, ALONE))
    return Outliers(frozenset(k.frames[far].tolist()), left_out=tuple(left_out))


def _smooth(k: OperatingPoint) -> Floats:
    """(F, axes, q) what may lengthen struts besides their geometry, the plainest first."""
    path = k.motion(()).path
    pace = axis_speeds(k.commanded, k.t)
    names = list(k.sensors.channels) if k.sensors is not None else []
    logged = {name: k.sensors.at(k.t, name) for name in names} if k.sensors is not None else {}
    varying = {name: values for name, values in logged.items() if np.ptp(values) > 0}
    lengths = k.commanded.at(k.t)
    out = [path.direction, pace]
    for name, values in sorted(varying.items(), key=lambda one: one[0] != PAYLOAD):
        out.append(np.broadcast_to(centred_and_scaled_to_plus_minus_one(values)[:, None], lengths.shape))
        if name == PAYLOAD:
            out.append(centred_and_scaled_to_plus_minus_one(values)[:, None] * (lengths - lengths.mean(axis=0)))
    out += [np.broadcast_to(c[:, None], lengths.shape) for c in time_cosines(k.t, SLOW).T]
    out.append(path.last_step)
    scaled = [values / max(np.abs(values).max(), 1e-300) for values in out if np.any(values)]
    return np.stack(scaled, axis=2) if scaled else np.zeros((*lengths.shape, 0))


def _wild_corners(k: OperatingPoint) -> Outliers:
    """Outliers of sightings some corner of which is far from where the cameras and poses have it, where no sighting
    near it is: neither of the same marker in the same camera before and after, nor of another in the same image, nor at
    the same place in the image."""
    seen = k.observed
    o, s = seen.observations, seen.sightings
    off = np.zeros((len(s.frame), 4, 2))
    off[seen.row, o.corner] = o.uv - k.pixels()
    size = np.linalg.norm(off, axis=2).max(axis=1)
    middle = np.zeros((len(s.frame), 2))
    np.add.at(middle, seen.row, o.uv)
    middle /= np.bincount(seen.row)[:, None]
    scale = np.array(
        [
            CONSISTENT * np.median(np.abs(off[seen.row, o.corner][o.camera == i])) if (o.camera == i).any() else np.inf
            for i in range(len(k.design.cameras))
        ]
    )[s.camera]
    far = (size > GATE * scale) & (size > LEAST)
    wild = far.copy()
    for i in np.flatnonzero(far).tolist():
        others = _near(k, middle, i)
        apart = np.linalg.norm((off[others] - off[i]).reshape(len(others), -1), axis=1)
        wild[i] = not (apart < ALIKE * np.linalg.norm(off[i])).any()
    if wild.sum() > MOST * len(wild):
        return Outliers(crowd=Crowd("images of markers", int(wild.sum()), len(wild)))
    on_platform = seen.markers.on_platform[s.marker]  # without these, nothing says where the platform is
    retained, own = (np.bincount(s.frame[~wild & some], minlength=len(k.frames)) for some in (True, on_platform))
    wild &= ((retained >= HELD) & (own > 0))[s.frame]
    rows, names = np.flatnonzero(wild).tolist(), [camera.name for camera in k.design.cameras]
    left_out = tuple(
        LeftOut(
            int(k.frames[s.frame[i]]),
            "corners",
            f"marker {seen.markers.id[s.marker[i]]} in camera {names[s.camera[i]]}",
            float(size[i]),
            "px",
            float(size[i] / scale[i]),
            MISREAD,
        )
        for i in rows
    )
    keys = frozenset((int(k.frames[s.frame[i]]), int(s.camera[i]), int(s.marker[i])) for i in rows)
    return Outliers(sightings=keys, left_out=left_out)


def _near(k: OperatingPoint, middle: Floats, i: int) -> Floats:
    """Indices of the sightings that would show what sighting i does, were it no mistake of its own. middle : (s, 2)
    px
    """
    s = k.observed.sightings
    same = s.camera == s.camera[i]
    repeated = np.flatnonzero(same & (s.marker == s.marker[i]))
    repeated = repeated[np.argsort(np.abs(k.t[s.frame[repeated]] - k.t[s.frame[i]]), kind="stable")][: 2 * IN_TIME + 1]
    image = np.flatnonzero(same & (s.frame == s.frame[i]))
    alike = np.flatnonzero(same)
    place = alike[cKDTree(middle[alike]).query(middle[i], k=min(IN_PLACE + 1, len(alike)))[1]]
    return np.setdiff1d(np.concatenate([repeated, image, np.atleast_1d(place)]), [i])


def find_marker_swaps(point: OperatingPoint, kinds: Sequence[type[Effect]]) -> list[Effect]:
    """Find the marker swaps.

    Corners then lie whole marker sides from where they should be.
    kinds : of effects with discrete parameters
    """
    seen = point.seen
    if seen is None or not kinds:
        return []
    off = _distance(point, ())
    ids, rows = seen.markers.id, seen.sightings.marker
    misplaced = [m for m in np.unique(rows) if np.mean(off[rows == m] > FAR) > SHARE]
    unseen = np.setdiff1d(np.arange(len(ids)), rows)  # a face that no camera sees may have been exchanged as well
    out: list[Effect] = []
    done: set[int] = set()
    for m in misplaced:
        if m in done:
            continue
        others = [Place("marker", str(ids[n])) for n in (*misplaced, *unseen) if n != m]
        trials = [t for kind in kinds for t in kind.exchanges(Place("marker", str(ids[m])), others)]
        if not trials:
            continue
        worst = []
        for trial in trials:
            moved = _distance(point, (trial,))
            both = {m, *_rows(ids, trial)}
            worst.append(max(np.median(moved[rows == n]) for n in both if (rows == n).any()))
        best = int(np.argmin(worst))
        if worst[best] < max(BROUGHT_BACK * np.median(off[rows == m]), 2.0):
            out.append(trials[best])
            done |= {m, *_rows(ids, trials[best])}
    return out


def operating_point_with_marker_swaps_corrected(
    point: OperatingPoint, marker_swaps: Sequence[Effect]
) -> OperatingPoint:
    """OperatingPoint with marker swaps corrected.

    Each marker sits where they state.
    """
    if not marker_swaps:
        return point
    seen, markers = point.observed, point.observed.markers
    for effect in marker_swaps:
        markers = effect.attach(markers)
    o = seen.observations
    o = replace(o, points=markers.corners[o.marker, o.corner], on_platform=markers.on_platform[o.marker])
    return replace(point, seen=replace(seen, observations=o, markers=markers))


def _distance(point: OperatingPoint, effects: tuple[Effect, ...]) -> Floats:
    """(sightings,) px, the middle corner's distance from where effects put it."""
    seen = point.observed
    quads = predict_sightings(seen.sightings, point.state, seen.markers, point.t, effects, point.sensors)
    error = np.linalg.norm(seen.observations.uv - quads[seen.row, seen.observations.corner], axis=1)
    total, count = np.bincount(seen.row, weights=error), np.bincount(seen.row)
    return total / np.maximum(count, 1)


def _rows(ids: Integers, effect: Effect) -> Integers:
    """Indices of the markers (their ids) at which an effect changes something."""
    return np.flatnonzero(np.isin(ids, [place.number for place in effect.sites_touched()]))


def cross_validate_effects(refinement: Refinement, numbers: set[int], residual_block: int) -> CrossValidation:
    """Cross-validate several admitted effects together, in one block of residuals.

    The block is CORNERS or CLOSURES.
    """
    before, after, _ = _both(refinement, numbers)
    return _compared(refinement.model, before, after, (residual_block,))[0]


def cross_validate_effects_for_each_residual_block(
    refinement: Refinement, numbers: set[int], residual_blocks: tuple[int, ...]
) -> tuple[CrossValidation, ...]:
    """Cross-validate several admitted effects, for each block of residuals.

    All effects together, once for corners and once for closures.
    """
    before, after, _ = _both(refinement, numbers)
    return _compared(refinement.model, before, after, residual_blocks)


def cross_validate_effect_by_regions(
    refinement: Refinement, number: int, residual_block: int, ordering_values: Floats
) -> CrossValidation:
    """Cross-validate one admitted effect by regions.

    Whole regions of the frames' ordering values are held out in turn.
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
    effects = [k.effects[i] for i in sorted(numbers)]
    if fold is None:
        fold = cross_validation_folds_of_frames(
            model.frames, any(e.sudden for e in effects), frames_before_and_after_sudden_changes(effects, k.t)
        )
    with_all = refined.marginalised
    after = held_out_residuals(with_all.linear, tuple(b.residual for b in with_all.linear.blocks), fold)
    others = [i for i, c in enumerate(refined.coordinates) if c.effect not in numbers]
    bare = model.marginalise(refined.column.take(others)) if others and refined.column is not None else model
    done = residual_change_column_with_only_effects(model, [e for i, e in enumerate(k.effects) if i not in numbers])
    grown = tuple(
        b.residual if part is None else b.residual + part[:, 0] for b, part in zip(model.linear.blocks, done.parts)
    )
    return held_out_residuals(bare.linear, grown, fold), after, fold


def frames_before_and_after_sudden_changes(effects: Sequence[Effect], t: Floats) -> list[Booleans]:
    """Frames (F,) bool before and after each sudden change.

    Those after it come first; what is seen changes, at times t (F,) s.
    """
    moments = [
        getattr(e, p.name)
        for e in effects
        if e.sudden and is_image_only_effect(e)
        for p in e.parameters
        if p.role == "moment"
    ]
    return [side for moment in moments for side in (t >= moment, t < moment)]


def residual_change_column_with_only_effects(model: LinearisedModel, effects: Sequence[Effect]) -> Column:
    """Column by which a model's residuals change, nothing refitted, if only these effects were admitted."""
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
    finder = [j for _, j in camera_edge_bias_nuisances(model.nuisances.names, model.point.design)]
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
        model.point.axis_unit,
        gain,
    )


def _corners(model: LinearisedModel, before: HeldOut, after: HeldOut, gain: float) -> CrossValidation:
    px = model.corner_noise()
    degrees = len(model.corner_residual) - model.corners.local.shape[1] * model.frames
    figures = [px * np.sqrt((held.frames[CORNERS] ** 2).sum() / degrees) for held in (before, after)]
    return CrossValidation(float(figures[0]), float(figures[1]), px, "px", gain)
