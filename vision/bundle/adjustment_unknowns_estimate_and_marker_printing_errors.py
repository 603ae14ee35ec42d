"""Estimate of an adjustment's unknowns, and printing errors.

Unknowns as columns, their estimate, and printing errors of markers among them.

The estimate is updated by a step.
A printing error (place, height, angle, side) is a shared unknown with a prior. Of each marker: its place (x, y on its
face), how far it stands off it (z), how it is turned, its side; and the side of all together, because one printer's
feed and one paper stretch them alike. How much of each there is, a recording tells:
vision/bundle/printing_error_variance_estimation.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.model.arm_hands_effect_places_and_tolerances import PLACES, SIDES, Place
from rig.model.pose import exp, log
from vision.marker_corner_prediction import MarkerMap, State

NAMES = ("x", "y", "z", "rx", "ry", "rz", "side")
KINDS = (
    slice(0, 2),
    slice(2, 3),
    slice(3, 6),
    slice(6, 7),
)  # of NAMES that vary equally: on the face, off it, turned, larger
SIDE = 6


@dataclass(frozen=True, slots=True)
class Printing:
    """place, lift, turn, side : standard deviations of printed markers' x and y, z, angles and side, as shares of what
    is tolerated; 0 for none.

    What is tolerated is PLACES.sigma (m) of a place, the same at the middle of its edges of an angle, SIDES.sigma of a
    side
    """

    place: float
    lift: float
    turn: float
    side: float

    def __str__(self) -> str:
        """In words, standard deviations."""
        um, kinds = self.place * PLACES.sigma * 1e6, []
        kinds += (
            [f"positions on their faces by {um:.1f} um"] * (self.place > 0)
            + [f"off their faces by {self.lift * PLACES.sigma * 1e6:.1f} um"] * (self.lift > 0)
            + [f"turned by {self.turn * PLACES.sigma * 1e6:.1f} um at their edges"] * (self.turn > 0)
        )
        return (
            ", ".join(kinds + [f"sides by {self.side * SIDES.sigma:.3%}"] * (self.side > 0))
            + " (standard deviations, estimated from this recording)"
        )

    @property
    def parts(self) -> list[int]:
        """Which of NAMES there are."""
        shares = (self.place, self.lift, self.turn, self.side)
        return [k for kind, share in zip(KINDS, shares) if share > 0 for k in range(len(NAMES))[kind]]

    def sigma(self, side: float) -> Floats:
        """(parts,) m, rad and shares: standard deviations of a marker of that side (m)."""
        m, rad = PLACES.sigma, 2 * PLACES.sigma / side
        full = np.array([self.place * m] * 2 + [self.lift * m] + [self.turn * rad] * 3 + [self.side * SIDES.sigma])
        return full[self.parts]


class Prints(NamedTuple):
    """Columns of the unknowns. parts : which of NAMES each marker has; rows : {row of the marker map: slice};
    together : slice of the side of all, empty where sides are as stated."""

    parts: list[int]
    rows: dict[int, slice]
    together: slice


NONE = Prints([], {}, slice(0, 0))


def apply_printing_errors(markers: MarkerMap, prints: Prints, step: Floats) -> MarkerMap:
    """The MarkerMap with a step (s,) of printing errors applied, m, rad and shares."""
    own, grown = np.zeros((len(markers.id), len(NAMES))), float(step[prints.together].sum())
    for row, columns in prints.rows.items():
        own[row, prints.parts] = step[columns]
        own[row, SIDE] += grown
    return replace(
        markers, T_body_marker=markers.T_body_marker * exp(own[:, :SIDE]), side=markers.side * np.exp(own[:, SIDE])
    )


def fill_printing_error_offsets(markers: MarkerMap, stated: MarkerMap, prints: Prints, offsets: Floats) -> None:
    """Fill offsets (s,) with the printing errors of markers.

    By which they differ from the stated ones, m, rad and shares.

    Only each marker's whole side shows in images: of it the part that all have in common is what its prior and theirs
    make likeliest.
    """
    away = np.concatenate(
        [log(stated.T_body_marker.inv() * markers.T_body_marker), np.log(markers.side / stated.side)[:, None]], axis=1
    )
    rows = list(prints.rows)
    if prints.together.stop > prints.together.start:
        grown = away[rows, SIDE].sum() / (len(rows) + 1)
        offsets[prints.together] = grown
        away[:, SIDE] -= grown
    for row, columns in prints.rows.items():
        offsets[columns] = away[row, prints.parts]


def printing_error_jacobian(J: Floats, J_motion: Floats, corners_marker: Floats) -> Floats:
    """Jacobian (n, 2, 7) of corners to the printing errors NAMES.
    J : (n, 2, 3) to the corner in its marker's frame; J_motion : (n, 2, 6) to a motion; corners_marker : (n, 3) m
    """
    return np.concatenate([J_motion, J @ corners_marker[..., None]], axis=2)


POSE_SCALE = 1e-3  # m, rad; only conditions the equations


class UnknownName(NamedTuple):
    """Name of a shared unknown. place : a camera, marker or target, or "print" and "prints" of how a marker and all are
    printed
    part : "x" .. "rz", a lens term, or a part of a print
    """

    place: Place
    part: str

    def __str__(self) -> str:
        return f"{self.place.name if self.place.kind == 'camera' else self.place} {self.part}"


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """Which columns belong to whom.

    poses, lenses : {camera index: slice}; markers : {row of the marker map: slice}; targets : {target name: slice}
    local_poses : {moving camera: slice within a frame's block}; shared, local : how many; used : (F, local) bool, seen
        at all
    scale : (shared,) own units per unknown; prior : (shared,) 1 where the stated value holds it, else 0
    names : UnknownName of each shared unknown; basis : (shared, k) motions that leave the datums where they are
    middles : {target name: (3,) m, what it turns about}; seen : rows of the marker map that are observed
    prints : Prints, how markers held where they are stated are printed
    """

    poses: dict[int, slice]
    lenses: dict[int, slice]
    markers: dict[int, slice]
    targets: dict[str, slice]
    local_poses: dict[int, slice]
    shared: int
    local: int
    used: Booleans
    scale: Floats
    prior: Floats
    names: list[UnknownName]
    basis: Floats
    middles: dict[str, Floats]
    seen: Integers
    prints: Prints = NONE


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """State, and how far markers (m,) and targets have moved from where they were stated: T_stated_now, along their own
    axes.
    """

    state: State
    marker_moves: RigidTransform | None
    target_moves: dict[str, RigidTransform]


def target_motion_from_stated(name: str, markers: MarkerMap, stated: MarkerMap, unknowns: Unknowns) -> RigidTransform:
    """Motion of a target from its stated place about its middle, by all its seen markers."""
    own = [row for row in unknowns.seen if markers.target[row] == name]
    middle = RigidTransform.from_translation(unknowns.middles[name])
    return (
        middle.inv()
        * rigid_transform_aligning_points(stated.corners[own].reshape(-1, 3), markers.corners[own].reshape(-1, 3))
        * middle
    )


def marker_motions_relative_to_targets(estimate: Estimate, stated: State, unknowns: Unknowns) -> RigidTransform:
    """Motions (m,) of markers relative to their targets, without the targets' motion.

    Identity for held markers.
    """
    own = (
        stated.placed.T_body_marker.inv()
        * estimated_marker_motions_by_target_motions(estimate, unknowns).inv()
        * estimate.state.placed.T_body_marker
    )
    held = np.array([row not in unknowns.markers for row in range(len(estimate.state.placed.id))])
    return RigidTransform.from_matrix(np.where(held[:, None, None], np.eye(4), own.as_matrix()))


def is_base_frame_held_by_cameras(unknowns: Unknowns, state: State) -> bool:
    """Whether the cameras hold the base frame.

    They are fixed, held as stated, and hold it by themselves.
    """
    return not unknowns.poses and len(state.moving) < len(state.cameras)


def estimate_after_step(estimate: Estimate, unknowns: Unknowns, shared_step: Floats, local_step: Floats) -> Estimate:
    """The updated Estimate after a step of the shared (s,) and the local (F, l) unknowns, in scaled units."""
    state, step = estimate.state, shared_step * unknowns.scale
    cameras = list(state.cameras)
    for i, columns in unknowns.poses.items():
        cameras[i] = replace(cameras[i], pose=cameras[i].pose * exp(step[columns]))
    for i, columns in unknowns.lenses.items():
        d = step[columns]
        matrix = cameras[i].matrix + np.array([[d[0], 0, d[2]], [0, d[1], d[3]], [0, 0, 0]])
        cameras[i] = replace(cameras[i], matrix=matrix, distortion=cameras[i].distortion + d[4:])
    moving = {
        i: T * exp(local_step[:, unknowns.local_poses[i]] * POSE_SCALE) if i in unknowns.local_poses else T
        for i, T in state.moving.items()
    }
    markers, marker_moves, target_moves = state.markers, estimate.marker_moves, dict(estimate.target_moves)
    if unknowns.markers or unknowns.targets:
        before = estimated_marker_motions_by_target_motions(estimate, unknowns)
        for name, columns in unknowns.targets.items():
            target_moves[name] = target_moves[name] * exp(step[columns])
        after = estimated_marker_motions_by_target_motions(replace(estimate, target_moves=target_moves), unknowns)
        own = np.zeros((len(state.placed.id), 6))
        for row, columns in unknowns.markers.items():
            own[row] = step[columns]
        marker_moves = marker_moves * exp(own) if marker_moves is not None else None
        T = after * before.inv() * state.placed.T_body_marker * exp(own)
        markers = replace(state.placed, T_body_marker=T)
    elif unknowns.prints.rows:
        markers = apply_printing_errors(state.placed, unknowns.prints, step)
    return Estimate(
        State(tuple(cameras), state.platform * exp(local_step[:, :6] * POSE_SCALE), moving, markers),
        marker_moves,
        target_moves,
    )


def estimated_marker_motions_by_target_motions(estimate: Estimate, unknowns: Unknowns) -> RigidTransform:
    """Estimated motions (m,) of markers by the motions of their targets, in the body's frame."""
    matrices = np.tile(np.eye(4), (len(estimate.state.placed.id), 1, 1))
    for name, T in estimate.target_moves.items():
        own = np.array([target == name for target in estimate.state.placed.target])
        middle = RigidTransform.from_translation(unknowns.middles[name])
        matrices[own] = (middle * T * middle.inv()).as_matrix()
    return RigidTransform.from_matrix(matrices)


def estimate_offset_from_stated(estimate: Estimate, stated: State, unknowns: Unknowns) -> Floats:
    """Offset (s,) of the estimate from what is stated.

    From the stated lenses, places, prints and held camera poses, in scaled units.
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
        fill_printing_error_offsets(estimate.state.placed, stated.placed, unknowns.prints, out)
    return out / unknowns.scale


def datum_marker_rows(markers: MarkerMap, rows: Integers) -> Integers:
    """Datum markers, as rows.

    They hold their body's frame together.

    Of rows (k,) of one body those whose places are stated, the first where none is.
    """
    stated = markers.stated[rows]
    return rows[stated] if stated.any() else rows[:1]


def align_with_datums(estimate: Estimate, stated: State, unknowns: Unknowns) -> Estimate:
    """The Estimate aligned with the datums.

    It is seen from the frames that the stated places define.
    Corners of all seen markers of a body whose places are stated, taken together, end where they were stated, in the
    least-squares sense; those of the first where none is.
    """
    if not (unknowns.markers or unknowns.targets):
        return estimate
    state, D = estimate.state, {}
    on_platform, T = state.placed.on_platform, state.placed.T_body_marker
    for on in (False, True):
        body = unknowns.seen[on_platform[unknowns.seen] == on]
        held = not on and is_base_frame_held_by_cameras(unknowns, state)
        D[on] = (
            RigidTransform.identity()
            if held or not len(body)
            else rigid_transform_aligning_points(
                *(m.corners[datum_marker_rows(m, body)].reshape(-1, 3) for m in (state.placed, stated.placed))
            )
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
    return replace(found, marker_moves=marker_motions_relative_to_targets(found, stated, unknowns))


def rigid_transform_aligning_points(points: Floats, target_points: Floats) -> RigidTransform:
    """RigidTransform that aligns points (n, 3) m with target points (n, 3) m best."""
    turn, _ = Rotation.align_vectors(target_points - target_points.mean(axis=0), points - points.mean(axis=0))
    return RigidTransform.from_components(target_points.mean(axis=0) - turn.apply(points.mean(axis=0)), turn)
