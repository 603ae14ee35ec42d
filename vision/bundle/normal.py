"""Corners -> normal equations of an adjustment in blocks: every frame's own, the shared, and the cross terms between them."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from rig.parallel import threaded
from vision.bundle.derivatives import Seen, moved, seen
from vision.bundle.columns import POSE_SCALE, Estimate, Unknowns
from vision.bundle.motions import shifts
from vision.bundle.printing import SIDE, derivative
from vision.observations import Observations, Whitener
from vision.predict import body_points
from vision.targets import SQUARE


@dataclass(frozen=True, slots=True, eq=False)
class Derivatives:
    """What one camera's corners say, whitened, per scaled unknown. rows : slice of the observations.

    own : (n, 2, k) to unknowns of the corner's frame, own_columns : (k,) theirs in the frame's block
    shared : (n, 2, w) to shared unknowns, shared_columns : (m, w) theirs, for a corner of each marker; the first `steady`
    are the same for all markers
    """

    rows: slice
    own: np.ndarray
    own_columns: np.ndarray
    shared: np.ndarray
    shared_columns: np.ndarray
    steady: int


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Normal equations. local : (F, l, l); cross : (F, l, s); shared : (s, s); right sides own : (F, l), common : (s,)."""

    local: np.ndarray
    cross: np.ndarray
    shared: np.ndarray
    own: np.ndarray
    common: np.ndarray


def linearise(observations: Observations, estimate: Estimate, unknowns: Unknowns, whitener: Whitener) -> tuple[np.ndarray, dict[int, Derivatives]]:
    """Whitened residuals (n, 2), seen less predicted, and {camera index: Derivatives} of the prediction.

    whitener : Whitener of the observations
    """
    state = estimate.state
    body = body_points(observations, state)
    R_platform = state.platform.rotation.as_matrix()
    markers = observations.marker.max(initial=0) + 1
    if unknowns.markers or unknowns.prints.rows:
        R_marker, in_marker = state.placed.T_body_marker.rotation.as_matrix(), state.placed.side[:, None, None] * SQUARE
    if unknowns.targets:
        arms, turns = _about_targets(estimate, unknowns)

    def one(view: Seen) -> tuple[Derivatives, np.ndarray]:
        i, rows, uv, J_base, J_camera, J_lens = view
        frame, on = observations.frame[rows], observations.on_platform[rows][:, None, None]
        marker, corner, own = observations.marker[rows], observations.corner[rows], whitener.own[rows]
        whitened = own @ (observations.uv[rows] - uv)[..., None]
        J_base = own @ J_base
        J_body = np.where(on, J_base @ R_platform[frame], J_base)
        local, own_columns = [np.where(on, moved(J_body, body[rows]), 0.0)], [np.arange(6)]
        shared, columns = [np.zeros((len(frame), 2, 0))], [np.zeros((markers, 0), int)]
        if i in unknowns.local_poses:
            local.append(own @ J_camera)
            own_columns.append(_range(unknowns.local_poses[i]))
        for of, J in ((unknowns.poses, J_camera), (unknowns.lenses, J_lens)):
            if i in of:
                shared.append(own @ J)
                columns.append(np.tile(_range(of[i]), (markers, 1)))
        if unknowns.markers or unknowns.prints.rows:
            J_marker, at = J_body @ R_marker[marker], in_marker[marker, corner]
        if unknowns.prints.rows:
            printed = derivative(J_marker, moved(J_marker, at), at)
            if unknowns.prints.together.stop > unknowns.prints.together.start:
                shared.append(printed[..., SIDE:])
                columns.append(np.tile(_range(unknowns.prints.together), (markers, 1)))
        steady = sum(part.shape[1] for part in columns)
        if unknowns.markers:
            shared.append(moved(J_marker, at))
            columns.append(np.array([_range(unknowns.markers.get(row, slice(0, 6))) for row in range(markers)]))
        if unknowns.prints.rows:
            parts = unknowns.prints.parts
            shared.append(printed[..., parts])
            columns.append(np.array([_range(unknowns.prints.rows.get(row, slice(0, len(parts)))) for row in range(markers)]))
        if unknowns.targets:
            shared.append(moved(J_body @ turns[marker], arms[marker, corner]))
            names = state.placed.target[:markers]
            columns.append(np.array([_range(unknowns.targets.get(name, slice(0, 6))) for name in names]))
        every = np.concatenate(columns, axis=1)
        mine, common = np.concatenate(local, axis=-1) * POSE_SCALE, np.concatenate(shared, axis=-1) * unknowns.scale[every[marker]][:, None]
        count = mine.shape[2]
        mixed = whitener.mix(np.concatenate([mine, common, whitened], axis=-1), rows)
        return Derivatives(rows, mixed[..., :count], np.concatenate(own_columns), mixed[..., count:-1], every, steady), mixed[..., -1]

    residual, found = np.empty((len(observations), 2)), {}
    views = list(seen(observations, state))
    for view, (derivatives, left) in zip(views, threaded(one, views)):
        residual[derivatives.rows], found[view[0]] = left, derivatives
    return residual, found


def _range(columns: slice) -> np.ndarray:
    return np.arange(columns.start, columns.stop)


def _about_targets(estimate: Estimate, unknowns: Unknowns) -> tuple[np.ndarray, np.ndarray]:
    """Corners (m, 4, 3) m along each target's own axes, about its middle, and those axes (m, 3, 3) in the body."""
    markers = estimate.state.placed
    shift = shifts(estimate, unknowns)
    middle = np.array([unknowns.middles.get(name, np.zeros(3)) for name in markers.target])
    turns = shift.rotation.as_matrix()
    before = (markers.corners - shift.translation[:, None]) @ turns  # the corners, their target's motion taken back
    return before - middle[:, None], turns


def normal_equations(observations: Observations, derivatives: dict[int, Derivatives], residual: np.ndarray, unknowns: Unknowns,
                     offset: np.ndarray) -> Blocks:
    """Blocks of the whitened residuals (n, 2) and of what the stated values are worth. offset : (s,) scaled, from the stated."""
    frames, l, s = len(observations.frames), unknowns.local, unknowns.shared
    blocks = Blocks(np.zeros((frames, l, l)), np.zeros((frames, l, s)), np.diag(unknowns.prior), np.zeros((frames, l)), -unknowns.prior * offset)
    for sums in threaded(lambda found: _sums(observations, found, residual[found.rows]), list(derivatives.values())):
        sums.add_to(blocks)
    blocks.local[:, np.arange(l), np.arange(l)] += ~unknowns.used  # unknowns that nothing sees stay put
    return blocks


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """One camera's part of Blocks. parts : (name of an array of Blocks, where in it, what is added); repeated : likewise, where places may recur."""

    parts: tuple[tuple[str, Any, np.ndarray], ...]
    repeated: tuple[tuple[str, Any, np.ndarray], ...]

    def add_to(self, blocks: Blocks) -> None:
        """Add them."""
        for name, place, values in self.parts:
            getattr(blocks, name)[place] += values
        for name, place, values in self.repeated:
            np.add.at(getattr(blocks, name), place, values)


def _sums(observations: Observations, found: Derivatives, residual: np.ndarray) -> _Sums:
    """Sums of one camera's corners, marker by marker: A^T A of a marker's four corners, summed where it belongs."""
    frame, marker = observations.frame[found.rows], observations.marker[found.rows]
    new = np.r_[True, (np.diff(frame) != 0) | (np.diff(marker) != 0)]
    sighting, first = np.cumsum(new) - 1, np.flatnonzero(new)
    k, w = found.own.shape[2], found.shared.shape[2]
    A, r = np.zeros((len(first), 4, 2, k + w)), np.zeros((len(first), 4, 2))  # a corner that is missing counts nothing
    corner = observations.corner[found.rows]
    A[sighting, corner, :, :k], A[sighting, corner, :, k:], r[sighting, corner] = found.own, found.shared, residual
    A = A.reshape(len(first), 8, -1)
    N, g = np.swapaxes(A, 1, 2) @ A, (np.swapaxes(A, 1, 2) @ r.reshape(len(first), 8, 1))[..., 0]
    frame, marker, own, steady = frame[first], marker[first], found.own_columns, k + found.steady
    edges = np.flatnonzero(np.r_[True, np.diff(frame) != 0])
    f = frame[edges]
    parts = [("local", np.ix_(f, own, own), np.add.reduceat(N[:, :k, :k], edges)), ("own", np.ix_(f, own), np.add.reduceat(g[:, :k], edges))]
    repeated: list[tuple[str, Any, np.ndarray]] = []
    if found.steady:
        parts.append(("cross", np.ix_(f, own, found.shared_columns[0, : found.steady]), np.add.reduceat(N[:, :k, k:steady], edges)))
    if steady < k + w:
        columns = found.shared_columns[marker, None, found.steady :]
        repeated.append(("cross", (frame[:, None, None], own[None, :, None], columns), N[:, :k, steady:]))
    order = np.argsort(marker, kind="stable")
    edges = np.flatnonzero(np.r_[True, np.diff(marker[order]) != 0])
    columns = found.shared_columns[marker[order][edges]]
    repeated.append(("shared", (columns[:, :, None], columns[:, None, :]), np.add.reduceat(N[order, k:, k:], edges)))
    repeated.append(("common", columns, np.add.reduceat(g[order, k:], edges)))
    return _Sums(tuple(parts), tuple(repeated))


def step(blocks: Blocks, unknowns: Unknowns, damping: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Steps of the shared unknowns (s,) and of each frame's own (F, l), scaled: the frames' eliminated first (Schur complement)."""
    diagonal = np.einsum("fii->fi", blocks.local)
    H = blocks.local + damping * diagonal[:, :, None] * np.eye(unknowns.local)
    solved = np.linalg.solve(H, np.concatenate([blocks.cross, blocks.own[..., None]], axis=-1))
    reduced, right = _reduced(blocks, solved)
    reduced += damping * np.diag(np.diag(blocks.shared))
    basis = unknowns.basis
    shared = basis @ np.linalg.solve(basis.T @ reduced @ basis, basis.T @ right) if basis.shape[1] else np.zeros(unknowns.shared)
    return shared, solved[..., -1] - solved[..., :-1] @ shared


def promised(blocks: Blocks, shared: np.ndarray, local: np.ndarray) -> float:
    """By how much the undamped steps of `step` lower the cost where it is as its linearisation has it.

    shared, local : the steps (s,), (frames, l), scaled, as `step` gives them
    """
    return float(blocks.common @ shared + (blocks.own * local).sum())


def reduce(blocks: Blocks) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(gain (F, l, s), reduced (s, s), right (s,)): the frames' own unknowns eliminated; own = ... - gain @ shared."""
    solved = np.linalg.solve(blocks.local, np.concatenate([blocks.cross, blocks.own[..., None]], axis=-1))
    return solved[..., :-1], *_reduced(blocks, solved)


def _reduced(blocks: Blocks, solved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    s = blocks.shared.shape[0]
    both = blocks.cross.reshape(blocks.own.size, s).T @ solved.reshape(blocks.own.size, s + 1)
    return blocks.shared - both[:, :-1], blocks.common - both[:, -1]
