"""Where an arm stands in an instrument's frame, and where the target sits on its hand, before anything else is known."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.errors import NotEnoughData
from rig.mechanisms import arm as mechanism

ROUNDS = 200
LEAST = {"pose": 3, "position": 6, "distance": 10}


def placed(observations, arm, base, tool):
    """The Arm with its base and tool as the observations place them, where base and tool (bool) say that they are unknown.

    Linear solutions, good to what the arm's own errors leave; least squares goes on from there. With one place known, or with
    distances, what cannot be told in closed form stays as stated. Raises NotEnoughData for too few observations.
    """
    if not (base or tool):
        return arm
    if len(observations) < LEAST[observations.kind]:
        raise NotEnoughData(f"{len(observations)} observations of a {observations.kind} cannot place the instrument; "
                            f"it takes {LEAST[observations.kind]}")
    links = mechanism.forward(observations.q, replace(arm, base=RigidTransform.identity(), tool=RigidTransform.identity()))
    if observations.kind == "pose":
        return _from_poses(observations.value, links, arm, base, tool)
    if observations.kind == "position":
        return _from_positions(observations.value, links, arm, base, tool)
    return _from_distances(observations.value, links * arm.tool, arm) if base else arm


def _from_poses(measured, links, arm, base, tool):
    """measured = X links Z: rotations by the null vector of a linear system, then positions by linear least squares."""
    if not base:
        return replace(arm, tool=_mean(links.inv() * arm.base.inv() * measured))
    if not tool:
        return replace(arm, base=_mean(measured * (links * arm.tool).inv()))
    M, F = measured.rotation.as_matrix(), links.rotation.as_matrix()
    # M Z^T = X F for every pose, with row-major vec: (M kron 1) vec Z^T - (1 kron F^T) vec X = 0
    one = np.eye(3)
    rows = np.concatenate([np.einsum("mij,kl->mikjl", M, one).reshape(len(M), 9, 9),
                           -np.einsum("ij,mlk->mikjl", one, F).reshape(len(M), 9, 9)], axis=2).reshape(-1, 18)
    null = np.linalg.svd(rows, full_matrices=False)[2][-1]
    null = null * np.sign(np.linalg.det(null[9:].reshape(3, 3)))
    Z, X = _nearest(null[:9].reshape(3, 3).T), _nearest(null[9:].reshape(3, 3))
    turned = np.einsum("ij,mjk->mik", X, F)
    A = np.concatenate([turned, np.tile(one, (len(M), 1, 1))], axis=2).reshape(-1, 6)
    b = (measured.translation - links.translation @ X.T).ravel()
    t = np.linalg.lstsq(A, b)[0]
    return replace(arm, tool=_transform(Z, t[:3]), base=_transform(X, t[3:]))


def _from_positions(p, links, arm, base, tool):
    """p = X (F z + f): base and target point in turn, until neither moves."""
    F, f = links.rotation.as_matrix(), links.translation
    z, X, t = arm.tool.translation, arm.base.rotation.as_matrix(), arm.base.translation
    for _ in range(ROUNDS if tool and base else 1):
        before = z
        if base:
            X, t = _rigid(F @ z + f, p)
        if tool:
            turned = np.einsum("ij,mjk->mik", X, F)
            z = np.linalg.lstsq(turned.reshape(-1, 3), (p - t - f @ X.T).ravel())[0]
        if np.abs(z - before).max() < 1e-6:
            break
    return replace(arm, base=_transform(X, t), tool=_transform(arm.tool.rotation.as_matrix(), z))


def _from_distances(lengths, target, arm):
    """length^2 = |p|^2 - 2 p.w + |w|^2 is linear in the anchor w and its square; the base's rotation cannot be told and stays."""
    p = target.translation
    A = np.concatenate([-2 * p, np.ones((len(p), 1))], axis=1)
    w = np.linalg.lstsq(A, lengths**2 - (p**2).sum(axis=1))[0][:3]
    R = arm.base.rotation.as_matrix()
    return replace(arm, base=_transform(R, -R @ w))


def _rigid(a, b):
    """Rotation (3, 3) and translation (3,) that lead points a (m, 3) to b (m, 3) (Kabsch)."""
    R = _nearest((b - b.mean(axis=0)).T @ (a - a.mean(axis=0)))
    return R, b.mean(axis=0) - R @ a.mean(axis=0)


def _nearest(matrix):
    """The rotation nearest to a matrix (3, 3)."""
    U, _, V = np.linalg.svd(matrix)
    return U @ np.diag([1, 1, np.linalg.det(U @ V)]) @ V


def _transform(R, t):
    return RigidTransform.from_components(t, Rotation.from_matrix(R))


def _mean(T):
    return RigidTransform.from_components(np.median(T.translation, axis=0), T.rotation.mean())
