"""What an adjustment may move: its columns, what each is worth as stated, and which motions the datums forbid.

Shared unknowns: poses of fixed cameras, lenses, places of markers on their target, places of targets in their body. Unknowns
of one frame: the platform's pose and each moving camera's.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.design import Camera
from rig.pose import exp, log, skew
from vision import lens
from vision.observations import Observations
from vision.predict import State
from vision.targets import MarkerMap

GROUPS = ("poses", "lenses", "markers", "targets")
# What a stated lens is worth: standard deviations of its terms. Wide enough to leave to the images all that they can see,
# narrow enough that a term they cannot see stays where its owner put it.
FOCAL_PRIOR = 0.02  # of the focal length
CENTRE_PRIOR = 0.02  # of the image's width
TERM_PRIOR = {"k1": 0.1, "k2": 0.3, "p1": 0.005, "p2": 0.005, "k3": 0.3, "k4": 0.1, "k5": 0.1, "k6": 0.1,
              "s1": 0.005, "s2": 0.005, "s3": 0.005, "s4": 0.005, "tau_x": 0.01, "tau_y": 0.01}
PLACE_PRIOR = (0.1, 0.1)  # of the marker's side, and rad: what the stated place of a marker or target is worth
POSE_SCALE = 1e-3  # m, rad; only conditions the equations
POSE_WORTH = 0.01  # m, rad; what the stated pose of a camera is worth where no base targets show where it stands
ANCHORS = 2  # markers of the base that show it
PARTS = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """Which columns belong to whom.

    poses, lenses : {camera index: slice}; markers : {row of the marker map: slice}; targets : {target name: slice}
    local_poses : {moving camera: slice within a frame's block}; shared, local : how many; used : (F, local) bool, seen at all
    scale : (shared,) own units per unknown; prior : (shared,) 1 where the stated value holds it, else 0
    names : (who, which part) of each shared unknown; basis : (shared, k) motions that leave the datums where they are
    middles : {target name: (3,) m, what it turns about}; seen : rows of the marker map that are observed
    """

    poses: dict[int, slice]
    lenses: dict[int, slice]
    markers: dict[int, slice]
    targets: dict[str, slice]
    local_poses: dict[int, slice]
    shared: int
    local: int
    used: np.ndarray
    scale: np.ndarray
    prior: np.ndarray
    names: list[tuple[str, str]]
    basis: np.ndarray
    middles: dict[str, np.ndarray]
    seen: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """State, and how far markers (m,) and targets have moved from where they were stated: T_stated_now, along their own axes."""

    state: State
    marker_moves: RigidTransform | None
    target_moves: dict[str, RigidTransform]


def lens_prior(camera: Camera) -> np.ndarray:
    """(4 + terms,) standard deviations that a stated lens is given."""
    focal = [FOCAL_PRIOR * camera.matrix[0, 0], FOCAL_PRIOR * camera.matrix[1, 1]]
    return np.array(focal + [CENTRE_PRIOR * camera.width] * 2 + [TERM_PRIOR[name] for name in lens.terms(camera.distortion)[4:]])


def unknowns(observations: Observations, state: State, stated: State, free: Sequence[str],
             worth: Callable[[Camera], np.ndarray] = lens_prior) -> tuple[Unknowns, Estimate]:
    """Unknowns of an adjustment, and the Estimate to start from. Raises ValueError for a group that there is not.

    stated : State whose markers stand where their owner says; worth : of a Camera's stated lens, (4 + terms,) as `lens_prior` has it
    """
    if set(free) - set(GROUPS):
        raise ValueError(f"free takes {GROUPS}, got {free}")
    if {"markers", "targets"} & set(free) and state.markers is None:
        raise ValueError("markers and targets can move only in a state that has its markers")
    seen, anchored = set(observations.camera.tolist()), _anchored(observations)
    poses, lenses, local_poses, scale, prior, names = {}, {}, {}, [], [], []
    local = 6

    def add(count: int, scales: list[float], held: float, labels: list[tuple[str, str]]) -> slice:
        scale.extend(scales)
        prior.extend([held] * count)
        names.extend(labels)
        return slice(len(scale) - count, len(scale))

    for i, camera in enumerate(state.cameras):
        if i not in seen:
            continue
        if i in state.moving:
            local_poses[i] = slice(local, local + 6)
            local += 6
        elif "poses" in free:
            scales, held = ([POSE_SCALE] * 6, 0.0) if i in anchored else ([POSE_WORTH] * 6, 1.0)
            poses[i] = add(6, scales, held, [(camera.name, part) for part in PARTS])
        if "lenses" in free:
            terms = lens.terms(camera.distortion)
            lenses[i] = add(len(terms), worth(camera).tolist(), 1.0, [(camera.name, term) for term in terms])
    rows = np.unique(observations.marker)
    markers, targets, middles = {}, {}, {}
    if "markers" in free:
        for row in rows.tolist():
            markers[row] = add(6, _place_prior(state.placed.side[row]), 1.0, [(f"marker {state.placed.id[row]}", part) for part in PARTS])
    if "targets" in free:
        for name in dict.fromkeys(state.placed.target[row] for row in rows):
            own = np.flatnonzero([target == name for target in state.placed.target])
            middles[name] = stated.placed.T_body_marker.translation[own].mean(axis=0)
            targets[name] = add(6, _place_prior(state.placed.side[own].mean()), 1.0, [(f"target {name}", part) for part in PARTS])
    used = np.zeros((len(observations.frames), local), bool)
    used[np.unique(observations.frame[observations.on_platform]), :6] = True
    for i, columns in local_poses.items():
        used[np.unique(observations.frame[observations.camera == i]), columns] = True
    found = Unknowns(poses, lenses, markers, targets, local_poses, len(scale), local, used, np.array(scale), np.array(prior), names,
                     np.eye(len(scale)), middles, rows)
    found = replace(found, basis=_basis(observations, state, found))
    start = Estimate(state, None, {name: _motion_of(name, state.placed, stated.placed, found) for name in targets})
    return found, replace(start, marker_moves=_marker_moves(start, stated, found)) if markers else start


def _anchored(observations: Observations) -> set[int]:
    """{camera index} of those that show enough of the base's markers to say where they stand, all of them in a rig without any."""
    base = np.unique(np.stack([observations.camera, observations.marker], axis=1)[~observations.on_platform], axis=0)
    if not len(base):
        return set(observations.camera.tolist())
    cameras, count = np.unique(base[:, 0], return_counts=True)
    return set(cameras[count >= ANCHORS].tolist())


def _motion_of(name: str, markers: MarkerMap, stated: MarkerMap, unknowns: Unknowns) -> RigidTransform:
    """RigidTransform, how the seen markers of a target, together, have moved from where they were stated, about its middle."""
    own = [row for row in unknowns.seen if markers.target[row] == name]
    middle = RigidTransform.from_translation(unknowns.middles[name])
    return middle.inv() * aligned(stated.corners[own].reshape(-1, 3), markers.corners[own].reshape(-1, 3)) * middle


def _marker_moves(estimate: Estimate, stated: State, unknowns: Unknowns) -> RigidTransform:
    """RigidTransform (m,), what moved each marker beyond its target's own motion; nothing where the marker is held."""
    own = stated.placed.T_body_marker.inv() * shifts(estimate, unknowns).inv() * estimate.state.placed.T_body_marker
    held = np.array([row not in unknowns.markers for row in range(len(estimate.state.placed.id))])
    return RigidTransform.from_matrix(np.where(held[:, None, None], np.eye(4), own.as_matrix()))


def _place_prior(side: float) -> list[float]:
    return [PLACE_PRIOR[0] * side] * 3 + [PLACE_PRIOR[1]] * 3


def _basis(observations: Observations, state: State, unknowns: Unknowns) -> np.ndarray:
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
            if len(body) and (on or not _held_by_cameras(unknowns, state)):
                rows.append(_mean_motion(m, body, unknowns, True))
        if unknowns.markers and unknowns.targets:
            rows += [_mean_motion(m, seen[target[seen] == name], unknowns, False) for name in unknowns.targets]
    rows = np.concatenate(rows) * unknowns.scale
    if not len(rows):
        return np.eye(unknowns.shared)
    _, values, vt = np.linalg.svd(rows)
    rank = int((values > 1e-9 * values[0]).sum()) if len(values) and values[0] > 0 else 0
    return vt[rank:].T


def _held_by_cameras(unknowns: Unknowns, state: State) -> bool:
    """Whether fixed cameras, held as stated, hold the base frame by themselves."""
    return not unknowns.poses and len(state.moving) < len(state.cameras)


def _mean_motion(markers: MarkerMap, rows: np.ndarray, unknowns: Unknowns, with_targets: bool) -> np.ndarray:
    """(6, shared) the motion as one body that small motions of markers (rows) and their targets make: sums over their corners."""
    corners, out = markers.corners, np.zeros((6, unknowns.shared))
    middle = corners[rows].mean(axis=(0, 1))
    R = markers.T_body_marker.rotation.as_matrix()
    for row in rows.tolist():
        arms = corners[row] - middle
        for columns, turn, centre in (
                (unknowns.markers.get(row), R[row], markers.T_body_marker.translation[row]),
                (unknowns.targets.get(markers.target[row]) if with_targets else None, np.eye(3), unknowns.middles.get(markers.target[row]))):
            if columns is None:
                continue
            shift = np.concatenate([np.broadcast_to(turn, (4, 3, 3)), -skew(corners[row] - centre) @ turn], axis=2)  # of each corner
            out[:3, columns] += shift.sum(axis=0)
            out[3:, columns] += (skew(arms) @ shift).sum(axis=0) / np.ptp(corners[rows].reshape(-1, 3), axis=0).max()
    return out


def move(estimate: Estimate, unknowns: Unknowns, shared: np.ndarray, local: np.ndarray) -> Estimate:
    """Estimate after steps shared (s,) and local (F, l), both in scaled units."""
    state, step = estimate.state, shared * unknowns.scale
    cameras = list(state.cameras)
    for i, columns in unknowns.poses.items():
        cameras[i] = replace(cameras[i], pose=cameras[i].pose * exp(step[columns]))
    for i, columns in unknowns.lenses.items():
        d = step[columns]
        matrix = cameras[i].matrix + np.array([[d[0], 0, d[2]], [0, d[1], d[3]], [0, 0, 0]])
        cameras[i] = replace(cameras[i], matrix=matrix, distortion=cameras[i].distortion + d[4:])
    moving = {i: T * exp(local[:, unknowns.local_poses[i]] * POSE_SCALE) if i in unknowns.local_poses else T
              for i, T in state.moving.items()}
    markers, marker_moves, target_moves = state.markers, estimate.marker_moves, dict(estimate.target_moves)
    if unknowns.markers or unknowns.targets:
        before = shifts(estimate, unknowns)
        for name, columns in unknowns.targets.items():
            target_moves[name] = target_moves[name] * exp(step[columns])
        after = shifts(replace(estimate, target_moves=target_moves), unknowns)
        own = np.zeros((len(state.placed.id), 6))
        for row, columns in unknowns.markers.items():
            own[row] = step[columns]
        marker_moves = marker_moves * exp(own) if marker_moves is not None else None
        T = after * before.inv() * state.placed.T_body_marker * exp(own)
        markers = replace(state.placed, T_body_marker=T)
    return Estimate(State(tuple(cameras), state.platform * exp(local[:, :6] * POSE_SCALE), moving, markers), marker_moves, target_moves)


def shifts(estimate: Estimate, unknowns: Unknowns) -> RigidTransform:
    """RigidTransform (m,), what its target's motion does to each marker, in the body's frame."""
    matrices = np.tile(np.eye(4), (len(estimate.state.placed.id), 1, 1))
    for name, T in estimate.target_moves.items():
        own = np.array([target == name for target in estimate.state.placed.target])
        middle = RigidTransform.from_translation(unknowns.middles[name])
        matrices[own] = (middle * T * middle.inv()).as_matrix()
    return RigidTransform.from_matrix(matrices)


def offset(estimate: Estimate, stated: State, unknowns: Unknowns) -> np.ndarray:
    """(s,) how far lenses, places and cameras' poses that are held have moved from what was stated, in scaled units; 0 for other poses."""
    out, cameras = np.zeros(unknowns.shared), estimate.state.cameras
    for i, columns in unknowns.poses.items():
        if unknowns.prior[columns].any():
            out[columns] = log(stated.cameras[i].pose.inv() * cameras[i].pose)
    for i, columns in unknowns.lenses.items():
        matrix = cameras[i].matrix - stated.cameras[i].matrix
        out[columns] = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *(cameras[i].distortion - stated.cameras[i].distortion)]
    if unknowns.markers:
        moved = log(estimate.marker_moves)
        for row, columns in unknowns.markers.items():
            out[columns] = moved[row]
    for name, columns in unknowns.targets.items():
        out[columns] = log(estimate.target_moves[name])
    return out / unknowns.scale


def to_datums(estimate: Estimate, stated: State, unknowns: Unknowns) -> Estimate:
    """The same cameras, markers and poses seen from the frames that the stated places hold: small steps drift off by their squares.

    Corners of all seen markers of a body, taken together, end where they were stated, in the least-squares sense.
    """
    if not (unknowns.markers or unknowns.targets):
        return estimate
    state, D = estimate.state, {}
    on_platform, T = state.placed.on_platform, state.placed.T_body_marker
    for on in (False, True):
        body = unknowns.seen[on_platform[unknowns.seen] == on]
        held = not on and _held_by_cameras(unknowns, state)
        D[on] = RigidTransform.identity() if held or not len(body) else aligned(
            state.placed.corners[body].reshape(-1, 3), stated.placed.corners[body].reshape(-1, 3))
    free = np.array([row in unknowns.markers or name in unknowns.targets for row, name in enumerate(state.placed.target)])
    shift = RigidTransform.concatenate([D[on] if moves else RigidTransform.identity() for on, moves in zip(on_platform.tolist(), free)])
    base, markers = D[False], replace(state.placed, T_body_marker=shift * T)
    cameras = tuple(replace(c, pose=base * c.pose) if i in unknowns.poses else c for i, c in enumerate(state.cameras))
    moved = State(cameras, base * state.platform * D[True].inv(), {i: base * T_camera for i, T_camera in state.moving.items()}, markers)
    target_moves = dict(estimate.target_moves)
    if not unknowns.markers:
        for name, T_target in target_moves.items():
            middle = RigidTransform.from_translation(unknowns.middles[name])
            target_moves[name] = middle.inv() * D[bool(on_platform[state.placed.target.index(name)])] * middle * T_target
        return Estimate(moved, estimate.marker_moves, target_moves)
    found = Estimate(moved, estimate.marker_moves, target_moves)
    return replace(found, marker_moves=_marker_moves(found, stated, unknowns))


def aligned(points: np.ndarray, goal: np.ndarray) -> RigidTransform:
    """RigidTransform that maps points (n, 3) m onto goal (n, 3) best. Source: Kabsch 1976, by SciPy."""
    turn, _ = Rotation.align_vectors(goal - goal.mean(axis=0), points - points.mean(axis=0))
    return RigidTransform.from_components(goal.mean(axis=0) - turn.apply(points.mean(axis=0)), turn)
