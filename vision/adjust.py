"""Many frames -> camera poses, lenses and platform poses together: Gauss-Newton with the Schur complement over frames.

Unknowns are shared (each fixed camera's pose, each lens) or belong to one frame (the platform's pose, each moving camera's
pose). Targets are held as stated: those on the base fix the base frame, those on the platform the platform frame.
"""

from dataclasses import dataclass, replace

import numpy as np

from rig.errors import NotEnoughData, RigError
from rig.pose import exp, skew
from vision import lens
from vision.predict import State, base_points, by_camera, in_camera, predict

# What a stated lens is worth: standard deviations of its terms. Wide enough to leave to the images all that they can see,
# narrow enough that a term they cannot see stays where its owner put it.
FOCAL_PRIOR = 0.02  # of the focal length
CENTRE_PRIOR = 0.02  # of the image's width
TERM_PRIOR = {"k1": 0.1, "k2": 0.3, "p1": 0.005, "p2": 0.005, "k3": 0.3, "k4": 0.1, "k5": 0.1, "k6": 0.1,
              "s1": 0.005, "s2": 0.005, "s3": 0.005, "s4": 0.005, "tau_x": 0.01, "tau_y": 0.01}
POSE_SCALE = 1e-3  # m, rad; only conditions the equations
MAX_ITERATIONS = 30
CONVERGED = 1e-9  # relative decrease of the cost


@dataclass(frozen=True, slots=True, eq=False)
class Adjustment:
    """The optimum and what is known of it, for corners' covariance as given (scale it by what the residuals say).

    state : State; residuals : (n, 2) px, seen less predicted; whitened : (n, 2)
    platform_given_cameras : (F, 6, 6) covariance of each platform pose were the cameras known, tangent on the right
    platform_common : (F, 6, k) factor of what the shared unknowns' uncertainty adds, the same k draws for every frame
    shared_covariance : (s, s) of the shared unknowns in their own units, named by shared_names
    dof : observations and priors less unknowns; cost : sum of whitened squares
    """

    state: State
    residuals: np.ndarray
    whitened: np.ndarray
    platform_given_cameras: np.ndarray
    platform_common: np.ndarray
    shared_covariance: np.ndarray
    shared_names: list[tuple[str, str]]
    dof: int
    cost: float


@dataclass(frozen=True, slots=True)
class _Layout:
    """Which columns belong to whom."""

    pose_columns: dict[int, slice]  # shared columns of each fixed camera's pose
    lens_columns: dict[int, slice]
    local_columns: dict[int, slice]  # columns of each moving camera's pose within a frame's block
    shared: int
    local: int
    scale: np.ndarray
    prior: np.ndarray
    names: list


def adjust(observations, state, free=("poses", "lenses"), progress=None):
    """Cameras and poses that fit all corners best, weighted by the corners' covariance.

    observations : Observations, outliers taken out; state : State to start from
    free : which of "poses" (of fixed cameras) and "lenses" are adjusted; the rest is held and taken as known
    progress : called after each iteration with the cost, or None
    Without targets on the base the stated camera poses hold the base frame: their mean motion is held at zero.
    Returns Adjustment. Raises NotEnoughData where unknowns outnumber observations, RigError where no optimum is found.
    Source: Triggs et al., Bundle adjustment - a modern synthesis, 2000
    """
    if set(free) - {"poses", "lenses"}:
        raise ValueError(f"free takes 'poses' and 'lenses', got {free}")
    layout = _layout(observations, state, free)
    stated = state.cameras
    basis = _gauge(observations, state, layout)
    whitener = np.linalg.inv(np.linalg.cholesky(observations.covariance))
    groups = observations.groups()
    used = np.zeros((len(observations.frames), layout.local), bool)
    _mark_used(used, observations, layout)
    unknowns = int(used.sum()) + basis.shape[1]
    if 2 * len(observations) < int(used.sum()) + 6 * len(layout.pose_columns):
        raise NotEnoughData(f"{len(observations)} corners cannot determine {unknowns} unknowns")
    damping, cost, blocks = 0.0, None, None
    for _ in range(MAX_ITERATIONS):
        if blocks is None:
            residual, J = _linearise(observations, state, layout, whitener)
            offset = _lens_offset(state.cameras, stated, layout)
            cost = float((residual**2).sum() + (layout.prior * (offset / layout.scale) ** 2).sum())
            blocks = _normal(observations, layout, groups, J, residual, used, offset)
            if progress:
                progress(cost)
        shared, local = _solve(blocks, basis, layout, damping)
        moved = _move(state, layout, shared, local)
        new = _cost(observations, moved, stated, layout, whitener)
        if not new <= cost * (1 + 1e-12):
            damping = max(10 * damping, 1e-6)
            if damping > 1e8:
                raise RigError(f"the adjustment of {len(observations)} corners finds no way down from a cost of {cost:.6g}")
            continue
        done = cost - new <= CONVERGED * max(cost, 1.0)
        state, damping, blocks = moved, damping / 10 if damping > 1e-7 else 0.0, None
        if done:
            break
    else:
        raise RigError(f"the adjustment of {len(observations)} corners did not converge in {MAX_ITERATIONS} iterations")
    return _finish(observations, state, stated, layout, basis, whitener, groups, used)


def lens_prior(camera):
    """(4 + terms,) standard deviations that a stated lens is given."""
    focal = [FOCAL_PRIOR * camera.matrix[0, 0], FOCAL_PRIOR * camera.matrix[1, 1]]
    return np.array(focal + [CENTRE_PRIOR * camera.width] * 2 + [TERM_PRIOR[name] for name in lens.terms(camera.distortion)[4:]])


def _layout(observations, state, free):
    seen = set(observations.camera.tolist())
    pose_columns, lens_columns, local_columns, scale, prior, names = {}, {}, {}, [], [], []
    local = 6
    for i, camera in enumerate(state.cameras):
        if i not in seen:
            continue
        if i in state.moving:
            local_columns[i] = slice(local, local + 6)
            local += 6
        elif "poses" in free:
            pose_columns[i] = slice(len(scale), len(scale) + 6)
            scale += [POSE_SCALE] * 6
            prior += [0.0] * 6
            names += [(camera.name, part) for part in ("x", "y", "z", "rx", "ry", "rz")]
        if "lenses" in free:
            terms = lens.terms(camera.distortion)
            lens_columns[i] = slice(len(scale), len(scale) + len(terms))
            scale += lens_prior(camera).tolist()
            prior += [1.0] * len(terms)
            names += [(camera.name, term) for term in terms]
    return _Layout(pose_columns, lens_columns, local_columns, len(scale), local, np.array(scale), np.array(prior), names)


def _gauge(observations, state, layout):
    """(shared, k) basis of the shared motions that leave the base frame where it is."""
    if not observations.on_platform.all() or not layout.pose_columns or layout.local_columns:
        return np.eye(layout.shared)
    rows = np.zeros((6, layout.shared))
    for i, columns in layout.pose_columns.items():
        R = state.cameras[i].pose.rotation.as_matrix()
        rows[:3, columns.start : columns.start + 3] = R
        rows[3:, columns.start + 3 : columns.stop] = R
    _, _, vt = np.linalg.svd(rows * layout.scale)
    return vt[6:].T


def _mark_used(used, observations, layout):
    on = observations.on_platform
    used[np.unique(observations.frame[on]), :6] = True
    for i, columns in layout.local_columns.items():
        used[np.unique(observations.frame[observations.camera == i]), columns] = True


def _linearise(observations, state, layout, whitener):
    """Whitened residuals (n, 2) and Jacobian {camera: (rows, 2, local + 6 + lens)} in scaled units."""
    base = base_points(observations, state)
    R_platform = state.platform.rotation.as_matrix()
    residual, jacobians = np.empty((len(observations), 2)), {}
    for i, camera, rows in by_camera(observations, state):
        frame, on = observations.frame[rows], observations.on_platform[rows]
        moving = i in state.moving
        ahead = in_camera(base[rows], frame, state, i)
        uv, J_point, J_lens = lens.project_jacobian(ahead, camera.matrix, camera.distortion)
        residual[rows] = (whitener[rows] @ (observations.uv[rows] - uv)[..., None])[..., 0]
        J_point = whitener[rows] @ J_point
        R_camera = state.moving[i].rotation.as_matrix()[frame] if moving else camera.pose.rotation.as_matrix()
        turn = np.swapaxes(R_camera, -1, -2) @ R_platform[frame]
        J_local = np.zeros((len(frame), 2, 6))
        J_local[on, :, :3] = (J_point @ turn)[on]
        J_local[on, :, 3:] = -(J_local[on, :, :3] @ skew(observations.points[rows][on]))
        J_camera = np.concatenate([-J_point, J_point @ skew(ahead)], axis=-1)
        parts = [J_local * POSE_SCALE]
        if moving or i in layout.pose_columns:
            parts.append(J_camera * POSE_SCALE)
        if i in layout.lens_columns:
            parts.append(whitener[rows] @ J_lens * layout.scale[layout.lens_columns[i]])
        jacobians[i] = (rows.start, np.concatenate(parts, axis=-1))
    return residual, jacobians


def _columns(i, layout):
    """Local and shared column numbers behind a camera's Jacobian block."""
    local = list(range(6))
    shared = []
    if i in layout.local_columns:
        local += list(range(*layout.local_columns[i].indices(layout.local)))
    if i in layout.pose_columns:
        shared += list(range(*layout.pose_columns[i].indices(layout.shared)))
    if i in layout.lens_columns:
        shared += list(range(*layout.lens_columns[i].indices(layout.shared)))
    return np.array(local), np.array(shared, int)


def _normal(observations, layout, groups, jacobians, residual, used, offset):
    """Normal equations in blocks: local (F, l, l), cross (F, l, s), shared (s, s), and right sides (F, l), (s,)."""
    frames = len(observations.frames)
    H_local, H_cross = np.zeros((frames, layout.local, layout.local)), np.zeros((frames, layout.local, layout.shared))
    H_shared = np.diag(layout.prior)
    g_local, g_shared = np.zeros((frames, layout.local)), -layout.prior * offset / layout.scale
    for start, end in groups:
        i, f = observations.camera[start], observations.frame[start]
        first, J = jacobians[i]
        A = J[start - first : end - first].reshape(2 * (end - start), -1)
        r = residual[start:end].ravel()
        local, shared = _columns(i, layout) if A.shape[1] else None
        N, g = A.T @ A, A.T @ r
        k = len(local)
        H_local[f][np.ix_(local, local)] += N[:k, :k]
        H_cross[f][np.ix_(local, shared)] += N[:k, k:]
        H_shared[np.ix_(shared, shared)] += N[k:, k:]
        g_local[f, local] += g[:k]
        g_shared[shared] += g[k:]
    H_local[:, np.arange(layout.local), np.arange(layout.local)] += ~used  # unknowns that nothing sees stay put
    return H_local, H_cross, H_shared, g_local, g_shared


def _solve(blocks, basis, layout, damping):
    """Step of the shared unknowns (s,) and of each frame's (F, l), in scaled units."""
    H_local, H_cross, H_shared, g_local, g_shared = blocks
    diagonal = np.einsum("fii->fi", H_local)
    H = H_local + damping * diagonal[:, :, None] * np.eye(layout.local)
    solved = np.linalg.solve(H, np.concatenate([H_cross, g_local[..., None]], axis=-1))
    reduced = H_shared + damping * np.diag(np.diag(H_shared)) - np.einsum("fli,flj->ij", H_cross, solved[..., :-1], optimize=True)
    right = g_shared - np.einsum("fli,fl->i", H_cross, solved[..., -1])
    step = basis @ np.linalg.solve(basis.T @ reduced @ basis, basis.T @ right) if basis.shape[1] else np.zeros(layout.shared)
    return step, solved[..., -1] - solved[..., :-1] @ step


def _move(state, layout, shared, local):
    cameras = list(state.cameras)
    for i, columns in layout.pose_columns.items():
        cameras[i] = replace(cameras[i], pose=cameras[i].pose * exp(shared[columns] * POSE_SCALE))
    for i, columns in layout.lens_columns.items():
        step = shared[columns] * layout.scale[columns]
        matrix = cameras[i].matrix + np.array([[step[0], 0, step[2]], [0, step[1], step[3]], [0, 0, 0]])
        cameras[i] = replace(cameras[i], matrix=matrix, distortion=cameras[i].distortion + step[4:])
    moving = {i: T * exp(local[:, layout.local_columns[i]] * POSE_SCALE) if i in layout.local_columns else T
              for i, T in state.moving.items()}
    return State(tuple(cameras), state.platform * exp(local[:, :6] * POSE_SCALE), moving)


def _lens_offset(cameras, stated, layout):
    """(s,) how far the lenses have moved from what was stated, 0 for poses."""
    offset = np.zeros(layout.shared)
    for i, columns in layout.lens_columns.items():
        matrix = cameras[i].matrix - stated[i].matrix
        offset[columns] = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *(cameras[i].distortion - stated[i].distortion)]
    return offset


def _cost(observations, state, stated, layout, whitener):
    uv, ahead = predict(observations, state)
    if (ahead[:, 2] <= 0).any():
        return np.inf
    whitened = (whitener @ (observations.uv - uv)[..., None])[..., 0]
    offset = _lens_offset(state.cameras, stated, layout)
    return float((whitened**2).sum() + (layout.prior * (offset / layout.scale) ** 2).sum())


def _finish(observations, state, stated, layout, basis, whitener, groups, used):
    residual, J = _linearise(observations, state, layout, whitener)
    offset = _lens_offset(state.cameras, stated, layout)
    H_local, H_cross, H_shared, *_ = _normal(observations, layout, groups, J, residual, used, offset)
    gain = np.linalg.solve(H_local, H_cross)
    reduced = H_shared - np.einsum("fli,flj->ij", H_cross, gain, optimize=True)
    inner = np.linalg.inv(basis.T @ reduced @ basis) if basis.shape[1] else np.zeros((0, 0))
    factor = basis @ np.linalg.cholesky((inner + inner.T) / 2)
    given = np.linalg.inv(H_local)[:, :6, :6] * POSE_SCALE**2
    cost = float((residual**2).sum() + (layout.prior * (offset / layout.scale) ** 2).sum())
    shared = (factor * layout.scale[:, None]) @ (factor * layout.scale[:, None]).T
    dof = 2 * len(observations) + int(layout.prior.sum()) - int(used.sum()) - basis.shape[1]
    uv, _ = predict(observations, state)
    return Adjustment(state, observations.uv - uv, residual, given, (gain @ factor)[:, :6] * POSE_SCALE, shared, layout.names, dof, cost)
