"""Normal equations of an adjustment in blocks: each frame's unknowns, the shared ones, the cross terms."""

from dataclasses import dataclass

import numpy as np

from rig.array_and_json_types import Floats, Integers
from rig.compute.parallel_map_and_dask_cluster import thread_map
from vision.bundle import corner_jacobians
from vision.bundle.corner_jacobians import (
    CameraJacobians,
    iterate_camera_jacobians,
    rotate_jacobian,
    small_motion_jacobian,
)
from vision.bundle.printing_errors import SIDE, printing_jacobian
from vision.bundle.unknowns_and_estimate import (
    POSE_SCALE,
    Estimate,
    Unknowns,
    estimated_marker_motions_by_target_motions,
)
from vision.corner_observations import Observations, Whitener
from vision.predict import observed_points_body


@dataclass(frozen=True, slots=True, eq=False)
class Derivatives:
    """What one camera's corners say, whitened, per scaled unknown. rows : slice of the observations.

    whole : (n, 2, k + w + 1) to k unknowns of the corner's frame, to w shared unknowns, and the residual
    own_columns : (k,) theirs in the frame's block; shared_columns : (m, w) theirs, for a corner of each marker
    """

    rows: slice
    whole: Floats
    own_columns: Integers
    shared_columns: Floats

    @property
    def own(self) -> Floats:
        """(n, 2, k) to unknowns of the corner's frame."""
        return self.whole[..., : len(self.own_columns)]

    @property
    def shared(self) -> Floats:
        """(n, 2, w) to shared unknowns."""
        return self.whole[..., len(self.own_columns) : -1]


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Normal equations. local : (F, l, l); cross : (F, l, s); shared : (s, s); right sides own : (F, l),
    common : (s,).
    """

    local: Floats
    cross: Floats
    shared: Floats
    own: Floats
    common: Floats


def linearise(
    observations: Observations, estimate: Estimate, unknowns: Unknowns, whitener: Whitener
) -> tuple[Floats, dict[int, Derivatives]]:
    """Linearised prediction: whitened residuals (n, 2), and {camera index: Derivatives}.

    whitener : Whitener of the observations
    """
    state = estimate.state
    body = observed_points_body(observations, state)
    R_platform = state.platform.rotation.as_matrix()
    markers = observations.marker.max(initial=0) + 1
    if unknowns.markers or unknowns.prints.rows:
        R_marker, in_marker = state.placed.T_body_marker.rotation.as_matrix(), state.placed.in_marker
    if unknowns.targets:
        arms, turns = _about_targets(estimate, unknowns)

    def one(view: CameraJacobians) -> Derivatives:
        i, rows, uv, J_base, J_camera, J_lens = view
        on, marker, corner = observations.on_platform[rows], observations.marker[rows], observations.corner[rows]
        J_body = rotate_jacobian(J_base, R_platform, observations.frame[rows], on)
        own_columns: list[Integers]
        local, own_columns = (
            [np.where(on[:, None, None], small_motion_jacobian(J_body, body[rows]), 0.0)],
            [np.arange(6)],
        )
        shared, columns = [np.zeros((len(on), 2, 0))], [np.zeros((markers, 0), int)]
        if i in unknowns.local_poses:
            local.append(J_camera)
            own_columns.append(_range(unknowns.local_poses[i]))
        for of, J in ((unknowns.poses, J_camera), (unknowns.lenses, J_lens)):
            if i in of:
                shared.append(J)
                columns.append(np.tile(_range(of[i]), (markers, 1)))
        if unknowns.markers or unknowns.prints.rows:
            J_marker, at = rotate_jacobian(J_body, R_marker, marker), in_marker[marker, corner]
        if unknowns.markers:
            shared.append(small_motion_jacobian(J_marker, at))
            columns.append(np.array([_range(unknowns.markers.get(row, slice(0, 6))) for row in range(markers)]))
        if unknowns.prints.rows:
            printed, parts = printing_jacobian(J_marker, small_motion_jacobian(J_marker, at), at), unknowns.prints.parts
            if unknowns.prints.together.stop > unknowns.prints.together.start:
                shared.append(printed[..., SIDE:])
                columns.append(np.tile(_range(unknowns.prints.together), (markers, 1)))
            shared.append(printed[..., parts])
            columns.append(
                np.array([_range(unknowns.prints.rows.get(row, slice(0, len(parts)))) for row in range(markers)])
            )
        if unknowns.targets:
            shared.append(small_motion_jacobian(rotate_jacobian(J_body, turns, marker), arms[marker, corner]))
            names = state.placed.target[:markers]
            columns.append(np.array([_range(unknowns.targets.get(name, slice(0, 6))) for name in names]))
        every, mine = np.concatenate(columns, axis=1), np.concatenate(own_columns)
        whole = np.concatenate([*local, *shared, (observations.uv[rows] - uv)[..., None]], axis=-1)
        scale = np.concatenate(
            [np.full((markers, len(mine)), POSE_SCALE), unknowns.scale[every], np.ones((markers, 1))], axis=1
        )
        corner_jacobians.whiten_and_scale_rows(whitener.own[rows], scale, marker, whole)
        return Derivatives(rows, whitener.mix(whole, rows), mine, every)

    residual, found = np.empty((len(observations), 2)), {}
    views = list(iterate_camera_jacobians(observations, state))
    for view, derivatives in zip(views, thread_map(one, views)):
        residual[derivatives.rows], found[view[0]] = derivatives.whole[..., -1], derivatives
    return residual, found


def _range(columns: slice) -> Integers:
    return np.arange(columns.start, columns.stop)


def _about_targets(estimate: Estimate, unknowns: Unknowns) -> tuple[Floats, Floats]:
    """Corners (m, 4, 3) m along each target's own axes, about its middle, and those axes (m, 3, 3) in the body."""
    markers = estimate.state.placed
    shift = estimated_marker_motions_by_target_motions(estimate, unknowns)
    middle = np.array([unknowns.middles.get(name, np.zeros(3)) for name in markers.target])
    turns = shift.rotation.as_matrix()
    before = (markers.corners - shift.translation[:, None]) @ turns  # the corners, their target's motion taken back
    return before - middle[:, None], turns


def normal_equations(
    observations: Observations, derivatives: dict[int, Derivatives], unknowns: Unknowns, offset: Floats
) -> Blocks:
    """Normal equations as Blocks, from the whitened residuals, their derivatives and the priors.
    offset : (s,) scaled, from the stated
    """
    frames, l, s = len(observations.frames), unknowns.local, unknowns.shared
    blocks = Blocks(
        np.zeros((frames, l, l)),
        np.zeros((frames, l, s)),
        np.diag(unknowns.prior),
        np.zeros((frames, l)),
        -unknowns.prior * offset,
    )
    sums = blocks.local, blocks.cross, blocks.shared, blocks.own, blocks.common
    for found in derivatives.values():
        corner_jacobians.add_corners_to_normal_equations(
            found.whole,
            observations.frame[found.rows],
            observations.marker[found.rows],
            found.own_columns,
            found.shared_columns,
            sums,
        )
    blocks.local[:, np.arange(l), np.arange(l)] += ~unknowns.used  # unknowns that nothing sees stay put
    return blocks


def solve_step(blocks: Blocks, unknowns: Unknowns, damping: float = 0.0) -> tuple[Floats, Floats]:
    """Solved step of the shared unknowns (s,) and of each frame (F, l), scaled, by the Schur complement."""
    diagonal = np.einsum("fii->fi", blocks.local)
    H = blocks.local + damping * diagonal[:, :, None] * np.eye(unknowns.local)
    solved = np.linalg.solve(H, np.concatenate([blocks.cross, blocks.own[..., None]], axis=-1))
    reduced, right = _reduced(blocks, solved)
    reduced += damping * np.diag(np.diag(blocks.shared))
    basis = unknowns.basis
    shared = (
        basis @ np.linalg.solve(basis.T @ reduced @ basis, basis.T @ right)
        if basis.shape[1]
        else np.zeros(unknowns.shared)
    )
    return shared, solved[..., -1] - solved[..., :-1] @ shared


def predicted_decrease(blocks: Blocks, shared_step: Floats, local_step: Floats) -> float:
    """Predicted decrease of the cost by the undamped steps of `solve_step`, to first order.

    shared_step, local_step : the steps (s,), (frames, l), scaled, as `solve_step` gives them
    """
    return float(blocks.common @ shared_step + (blocks.own * local_step).sum())


def schur_complement(blocks: Blocks) -> tuple[Floats, Floats, Floats]:
    """Schur complement of the shared unknowns: (gain (F, l, s), reduced (s, s), right (s,)).
    The frames' own unknowns are eliminated; own = ... - gain @ shared.
    """
    solved = np.linalg.solve(blocks.local, np.concatenate([blocks.cross, blocks.own[..., None]], axis=-1))
    return solved[..., :-1], *_reduced(blocks, solved)


def _reduced(blocks: Blocks, solved: Floats) -> tuple[Floats, Floats]:
    s = blocks.shared.shape[0]
    both = blocks.cross.reshape(blocks.own.size, s).T @ solved.reshape(blocks.own.size, s + 1)
    return blocks.shared - both[:, :-1], blocks.common - both[:, -1]
