"""Unknowns of an adjustment with their priors, and the estimate to start from.

Stated standard deviations, columns, and motions fixed by datums.

Shared unknowns: poses of fixed cameras, lenses, places of markers on their target, places of targets in their body, or
how markers that are held are printed. Unknowns of one frame: the platform's pose and each moving camera's.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from rig.array_and_json_types import Floats, Integers
from rig.model.arm_hands_effect_places_and_tolerances import SIDES, Place
from rig.model.design import Camera
from rig.model.pose import skew
from vision import opencv_lens_model as lens
from vision.bundle.adjustment_unknowns_estimate_and_marker_printing_errors import (
    NAMES,
    NONE,
    POSE_SCALE,
    SIDE,
    Estimate,
    Printing,
    Prints,
    UnknownName,
    Unknowns,
    datum_marker_rows,
    is_base_frame_held_by_cameras,
    marker_motions_relative_to_targets,
    target_motion_from_stated,
)
from vision.corner_observations_and_merging import Observations
from vision.marker_corner_prediction import MarkerMap, State

GROUPS = ("poses", "lenses", "markers", "targets")
# What a stated lens is worth: standard deviations of its terms. Wide enough to leave to the images all that they can
# see,
# narrow enough that a term they cannot see stays where its owner put it.
FOCAL_PRIOR = 0.02  # of the focal length
CENTRE_PRIOR = 0.02  # of the image's width
TERM_PRIOR = {
    "k1": 0.1,
    "k2": 0.3,
    "p1": 0.005,
    "p2": 0.005,
    "k3": 0.3,
    "k4": 0.1,
    "k5": 0.1,
    "k6": 0.1,
    "s1": 0.005,
    "s2": 0.005,
    "s3": 0.005,
    "s4": 0.005,
    "tau_x": 0.01,
    "tau_y": 0.01,
}
PLACE_PRIOR = (0.1, 0.1)  # of the marker's side, and rad: what the stated place of a marker or target is worth
POSE_SIGMA = 0.01  # m, rad; what the stated pose of a camera is worth where no base targets show where it stands
ANCHORS = 2  # markers of the base that show it
PARTS = ("x", "y", "z", "rx", "ry", "rz")


def stated_lens_prior_sigmas(camera: Camera) -> Floats:
    """Prior standard deviations (sigmas) (4 + terms,) of a stated lens."""
    focal = [FOCAL_PRIOR * camera.matrix[0, 0], FOCAL_PRIOR * camera.matrix[1, 1]]
    return np.array(
        focal
        + [CENTRE_PRIOR * camera.width] * 2
        + [TERM_PRIOR[name] for name in lens.lens_parameter_names(camera.distortion)[4:]]
    )


def _prints(
    printing: Printing,
    state: State,
    rows: list[int],
    add: Callable[[int, list[float], float, list[UnknownName]], slice],
) -> Prints:
    """Unknowns of how each marker was printed. add : (count, scales, prior, names) -> the columns"""
    parts = printing.parts
    own = {
        row: add(
            len(parts),
            printing.sigma(state.placed.side[row]).tolist(),
            1.0,
            [UnknownName(Place("print", str(state.placed.id[row])), NAMES[part]) for part in parts],
        )
        for row in rows
    }
    sides = SIDE in parts
    shared = add(
        int(sides), [printing.side * SIDES.sigma] * sides, 1.0, [UnknownName(Place("prints"), NAMES[SIDE])] * sides
    )
    return Prints(parts, own, shared)


def adjustment_unknowns_and_start_estimate(
    observations: Observations,
    state: State,
    stated: State,
    free: Sequence[str],
    lens_prior_sigmas: Callable[[Camera], Floats] = stated_lens_prior_sigmas,
    printing: Printing | None = None,
) -> tuple[Unknowns, Estimate]:
    """Unknowns of an adjustment with their priors, and the Estimate to start from.
    Raises ValueError for an unknown name in `free`.

    stated : State whose markers stand where their owner says; lens_prior_sigmas : (4 + terms,) of a
        Camera's stated lens, as `stated_lens_prior_sigmas` has it, px
    printing : how far markers are taken to be off where they are not free, or None
    """
    if set(free) - set(GROUPS):
        raise ValueError(f"free takes {GROUPS}, got {free}")
    if {"markers", "targets"} & set(free) and state.markers is None:
        raise ValueError("markers and targets can be adjusted only in a state with markers")
    seen, anchored = set(observations.camera.tolist()), _anchored(observations)
    poses, lenses, local_poses, scale, prior, names = {}, {}, {}, [], [], []
    local = 6

    def add(count: int, scales: list[float], held: float, labels: list[UnknownName]) -> slice:
        scale.extend(scales)
        prior.extend([held] * count)
        names.extend(labels)
        return slice(len(scale) - count, len(scale))

    for i, camera in enumerate(state.cameras):
        if i not in seen:
            continue
        place = Place("camera", camera.name)
        if i in state.moving:
            local_poses[i] = slice(local, local + 6)
            local += 6
        elif "poses" in free:
            scales, held = ([POSE_SCALE] * 6, 0.0) if i in anchored else ([POSE_SIGMA] * 6, 1.0)
            poses[i] = add(6, scales, held, [UnknownName(place, part) for part in PARTS])
        if "lenses" in free:
            terms = lens.lens_parameter_names(camera.distortion)
            lenses[i] = add(
                len(terms), lens_prior_sigmas(camera).tolist(), 1.0, [UnknownName(place, term) for term in terms]
            )
    rows = np.unique(observations.marker)
    markers, targets, middles = {}, {}, {}
    if "markers" in free:
        for row in rows.tolist():
            markers[row] = add(
                6,
                _place_prior(state.placed.side[row]),
                float(state.placed.stated[row]),
                [UnknownName(Place("marker", str(state.placed.id[row])), part) for part in PARTS],
            )
    if "targets" in free:
        for name in dict.fromkeys(state.placed.target[row] for row in rows):
            own = np.flatnonzero([target == name for target in state.placed.target])
            middles[name] = stated.placed.T_body_marker.translation[own].mean(axis=0)
            targets[name] = add(
                6,
                _place_prior(state.placed.side[own].mean()),
                1.0,
                [UnknownName(Place("target", name), part) for part in PARTS],
            )
    printed = printing is not None and not markers and not targets
    prints = _prints(printing, state, rows.tolist(), add) if printed and printing is not None else NONE
    used = np.zeros((len(observations.frames), local), bool)
    used[np.unique(observations.frame[observations.on_platform]), :6] = True
    for i, columns in local_poses.items():
        used[np.unique(observations.frame[observations.camera == i]), columns] = True
    found = Unknowns(
        poses,
        lenses,
        markers,
        targets,
        local_poses,
        len(scale),
        local,
        used,
        np.array(scale),
        np.array(prior),
        names,
        np.eye(len(scale)),
        middles,
        rows,
        prints,
    )
    found = replace(found, basis=_basis(observations, state, found))
    start = Estimate(
        state, None, {name: target_motion_from_stated(name, state.placed, stated.placed, found) for name in targets}
    )
    return found, replace(
        start, marker_moves=marker_motions_relative_to_targets(start, stated, found)
    ) if markers else start


def _anchored(observations: Observations) -> set[int]:
    """{camera index} of those that show enough of the base's markers to say where they stand, all of them in a rig
    without any.
    """
    base = np.unique(np.stack([observations.camera, observations.marker], axis=1)[~observations.on_platform], axis=0)
    if not len(base):
        return set(observations.camera.tolist())
    cameras, count = np.unique(base[:, 0], return_counts=True)
    return set(cameras[count >= ANCHORS].tolist())


def _place_prior(side: float) -> list[float]:
    return [PLACE_PRIOR[0] * side] * 3 + [PLACE_PRIOR[1]] * 3


def _basis(observations: Observations, state: State, unknowns: Unknowns) -> Floats:
    """(shared, k) basis of the shared motions that leave base and platform frame where the stated places put them."""
    rows = [np.zeros((0, unknowns.shared))]
    if observations.on_platform.all() and unknowns.poses and not unknowns.local_poses:
        held = np.zeros((6, unknowns.shared))
        for i, columns in unknowns.poses.items():
            R = state.cameras[i].pose.rotation.as_matrix()
            held[:3, columns.start : columns.start + 3] = R
            held[3:, columns.start + 3 : columns.stop] = R
        rows.append(held)
    seen = unknowns.seen
    if unknowns.markers or unknowns.targets:
        m = state.placed
        target = np.array(m.target)
        for on in (False, True):
            body = seen[m.on_platform[seen] == on]
            if len(body) and (on or not is_base_frame_held_by_cameras(unknowns, state)):
                rows.append(_mean_motion(m, datum_marker_rows(m, body), unknowns, True))
        if unknowns.markers and unknowns.targets:
            rows += [_mean_motion(m, seen[target[seen] == name], unknowns, False) for name in unknowns.targets]
    stacked = np.concatenate(rows) * unknowns.scale
    if not len(stacked):
        return np.eye(unknowns.shared)
    _, values, vt = np.linalg.svd(stacked)
    rank = int((values > 1e-9 * values[0]).sum()) if len(values) and values[0] > 0 else 0
    return vt[rank:].T


def _mean_motion(markers: MarkerMap, rows: Integers, unknowns: Unknowns, with_targets: bool) -> Floats:
    """(6, shared) the motion as one body that small motions of markers (rows) and their targets make: sums over their
    corners.
    """
    corners, out = markers.corners, np.zeros((6, unknowns.shared))
    middle = corners[rows].mean(axis=(0, 1))
    R = markers.T_body_marker.rotation.as_matrix()
    for row in rows.tolist():
        arms = corners[row] - middle
        for columns, turn, centre in (
            (unknowns.markers.get(row), R[row], markers.T_body_marker.translation[row]),
            (
                unknowns.targets.get(markers.target[row]) if with_targets else None,
                np.eye(3),
                unknowns.middles.get(markers.target[row]),
            ),
        ):
            if columns is None:
                continue
            shift = np.concatenate(
                [np.broadcast_to(turn, (4, 3, 3)), -skew(corners[row] - centre) @ turn], axis=2
            )  # of each corner
            out[:3, columns] += shift.sum(axis=0)
            out[3:, columns] += (skew(arms) @ shift).sum(axis=0) / np.ptp(corners[rows].reshape(-1, 3), axis=0).max()
    return out
