"""An estimate, moved by a step of its unknowns: how far it has gone from what was stated, and seen from the frames that
hold it.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.model.pose import exp, log
from vision.bundle.adjustment_unknowns import POSE_SCALE, Estimate, Unknowns
from vision.bundle.printing_errors import apply_printing_errors, printing_offsets
from vision.predict import State
from vision.targets import MarkerMap


def target_motion(name: str, markers: MarkerMap, stated: MarkerMap, unknowns: Unknowns) -> RigidTransform:
    """RigidTransform, how the seen markers of a target, together, have moved from where they were stated, about its
    middle.
    """
    own = [row for row in unknowns.seen if markers.target[row] == name]
    middle = RigidTransform.from_translation(unknowns.middles[name])
    return middle.inv() * align_points(stated.corners[own].reshape(-1, 3), markers.corners[own].reshape(-1, 3)) * middle


def marker_motions(estimate: Estimate, stated: State, unknowns: Unknowns) -> RigidTransform:
    """RigidTransform (m,), what moved each marker beyond its target's own motion; nothing where the marker is held."""
    own = (
        stated.placed.T_body_marker.inv()
        * marker_shifts(estimate, unknowns).inv()
        * estimate.state.placed.T_body_marker
    )
    held = np.array([row not in unknowns.markers for row in range(len(estimate.state.placed.id))])
    return RigidTransform.from_matrix(np.where(held[:, None, None], np.eye(4), own.as_matrix()))


def cameras_hold_base(unknowns: Unknowns, state: State) -> bool:
    """Whether fixed cameras, held as stated, hold the base frame by themselves."""
    return not unknowns.poses and len(state.moving) < len(state.cameras)


def update_estimate(estimate: Estimate, unknowns: Unknowns, shared: np.ndarray, local: np.ndarray) -> Estimate:
    """Estimate after steps shared (s,) and local (F, l), both in scaled units."""
    state, step = estimate.state, shared * unknowns.scale
    cameras = list(state.cameras)
    for i, columns in unknowns.poses.items():
        cameras[i] = replace(cameras[i], pose=cameras[i].pose * exp(step[columns]))
    for i, columns in unknowns.lenses.items():
        d = step[columns]
        matrix = cameras[i].matrix + np.array([[d[0], 0, d[2]], [0, d[1], d[3]], [0, 0, 0]])
        cameras[i] = replace(cameras[i], matrix=matrix, distortion=cameras[i].distortion + d[4:])
    moving = {
        i: T * exp(local[:, unknowns.local_poses[i]] * POSE_SCALE) if i in unknowns.local_poses else T
        for i, T in state.moving.items()
    }
    markers, marker_moves, target_moves = state.markers, estimate.marker_moves, dict(estimate.target_moves)
    if unknowns.markers or unknowns.targets:
        before = marker_shifts(estimate, unknowns)
        for name, columns in unknowns.targets.items():
            target_moves[name] = target_moves[name] * exp(step[columns])
        after = marker_shifts(replace(estimate, target_moves=target_moves), unknowns)
        own = np.zeros((len(state.placed.id), 6))
        for row, columns in unknowns.markers.items():
            own[row] = step[columns]
        marker_moves = marker_moves * exp(own) if marker_moves is not None else None
        T = after * before.inv() * state.placed.T_body_marker * exp(own)
        markers = replace(state.placed, T_body_marker=T)
    elif unknowns.prints.rows:
        markers = apply_printing_errors(state.placed, unknowns.prints, step)
    return Estimate(
        State(tuple(cameras), state.platform * exp(local[:, :6] * POSE_SCALE), moving, markers),
        marker_moves,
        target_moves,
    )


def marker_shifts(estimate: Estimate, unknowns: Unknowns) -> RigidTransform:
    """RigidTransform (m,), what its target's motion does to each marker, in the body's frame."""
    matrices = np.tile(np.eye(4), (len(estimate.state.placed.id), 1, 1))
    for name, T in estimate.target_moves.items():
        own = np.array([target == name for target in estimate.state.placed.target])
        middle = RigidTransform.from_translation(unknowns.middles[name])
        matrices[own] = (middle * T * middle.inv()).as_matrix()
    return RigidTransform.from_matrix(matrices)


def offset_from_stated(estimate: Estimate, stated: State, unknowns: Unknowns) -> np.ndarray:
    """(s,) how far lenses, places, prints and cameras' poses that are held have moved from what was stated, in scaled
    units; 0 for other poses.
    """
    out, cameras = np.zeros(unknowns.shared), estimate.state.cameras
    for i, columns in unknowns.poses.items():
        if unknowns.prior[columns].any():
            out[columns] = log(stated.cameras[i].pose.inv() * cameras[i].pose)
    for i, columns in unknowns.lenses.items():
        matrix = cameras[i].matrix - stated.cameras[i].matrix
        out[columns] = [
            matrix[0, 0],
            matrix[1, 1],
            matrix[0, 2],
            matrix[1, 2],
            *(cameras[i].distortion - stated.cameras[i].distortion),
        ]
    if unknowns.markers:
        moved = log(estimate.marker_moves)
        for row, columns in unknowns.markers.items():
            out[columns] = moved[row]
    for name, columns in unknowns.targets.items():
        out[columns] = log(estimate.target_moves[name])
    if unknowns.prints.rows:
        printing_offsets(estimate.state.placed, stated.placed, unknowns.prints, out)
    return out / unknowns.scale


def to_datums(estimate: Estimate, stated: State, unknowns: Unknowns) -> Estimate:
    """The same cameras, markers and poses seen from the frames that the stated places hold: small steps drift off by
    their squares.

    Corners of all seen markers of a body, taken together, end where they were stated, in the least-squares sense.
    """
    if not (unknowns.markers or unknowns.targets):
        return estimate
    state, D = estimate.state, {}
    on_platform, T = state.placed.on_platform, state.placed.T_body_marker
    for on in (False, True):
        body = unknowns.seen[on_platform[unknowns.seen] == on]
        held = not on and cameras_hold_base(unknowns, state)
        D[on] = (
            RigidTransform.identity()
            if held or not len(body)
            else align_points(state.placed.corners[body].reshape(-1, 3), stated.placed.corners[body].reshape(-1, 3))
        )
    free = np.array(
        [row in unknowns.markers or name in unknowns.targets for row, name in enumerate(state.placed.target)]
    )
    shift = RigidTransform.concatenate(
        [D[on] if moves else RigidTransform.identity() for on, moves in zip(on_platform.tolist(), free)]
    )
    base, markers = D[False], replace(state.placed, T_body_marker=shift * T)
    cameras = tuple(replace(c, pose=base * c.pose) if i in unknowns.poses else c for i, c in enumerate(state.cameras))
    moved = State(
        cameras,
        base * state.platform * D[True].inv(),
        {i: base * T_camera for i, T_camera in state.moving.items()},
        markers,
    )
    target_moves = dict(estimate.target_moves)
    if not unknowns.markers:
        for name, T_target in target_moves.items():
            middle = RigidTransform.from_translation(unknowns.middles[name])
            target_moves[name] = (
                middle.inv() * D[bool(on_platform[state.placed.target.index(name)])] * middle * T_target
            )
        return Estimate(moved, estimate.marker_moves, target_moves)
    found = Estimate(moved, estimate.marker_moves, target_moves)
    return replace(found, marker_moves=marker_motions(found, stated, unknowns))


def align_points(points: np.ndarray, goal: np.ndarray) -> RigidTransform:
    """RigidTransform that maps points (n, 3) m onto goal (n, 3) best. Source: Kabsch 1976, by SciPy."""
    turn, _ = Rotation.align_vectors(goal - goal.mean(axis=0), points - points.mean(axis=0))
    return RigidTransform.from_components(goal.mean(axis=0) - turn.apply(points.mean(axis=0)), turn)
