"""Where an arm stands and its target sits, roughly and at once: hundreds of readings of the same data are compared by
what this leaves.

Source: rotations as calib.models.arm.instrument_placement.solve_rotation_placement; positions by Kabsch in turn with
    the target's place
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.models.arm.instrument_placement import nearest_rotation, rigid_transform, solve_rotation_placement
from rig.model.design import Arm
from rig.model.mechanisms import arm as mechanism

ROUNDS = 60
STILL = 1e-5  # m


def place_arm_roughly(q: np.ndarray, T: RigidTransform, alone: bool, arm: Arm, base: bool, tool: bool) -> Arm:
    """The Arm with its base and tool where poses T (m,) at angles q (m, n) rad put them. alone : of the poses positions
    alone are known.
    """
    if not (base or tool):
        return arm
    links = mechanism.forward(q, replace(arm, base=RigidTransform.identity(), tool=RigidTransform.identity()))
    if alone:
        return _from_positions(T.translation, links, arm, base, tool)
    if not base:
        return replace(arm, tool=_middle(links.inv() * arm.base.inv() * T))
    if not tool:
        return replace(arm, base=_middle(T * (links * arm.tool).inv()))
    F = links.rotation.as_matrix()
    X, Z, _ = solve_rotation_placement(T.rotation.as_matrix(), F)
    A = np.concatenate([X @ F, np.tile(np.eye(3), (len(F), 1, 1))], axis=2).reshape(-1, 6)
    t = np.linalg.lstsq(A, (T.translation - links.translation @ X.T).ravel())[0]
    return replace(arm, tool=rigid_transform(Z, t[:3]), base=rigid_transform(X, t[3:]))


def _from_positions(p: np.ndarray, links: RigidTransform, arm: Arm, base: bool, tool: bool) -> Arm:
    F, f = links.rotation.as_matrix(), links.translation
    z, X, t = arm.tool.translation, arm.base.rotation.as_matrix(), arm.base.translation
    for _ in range(ROUNDS if tool and base else 1):
        before = z
        if base:
            reached = F @ z + f
            X = nearest_rotation((p - p.mean(axis=0)).T @ (reached - reached.mean(axis=0)))
            t = p.mean(axis=0) - X @ reached.mean(axis=0)
        if tool:
            z = np.linalg.lstsq((X @ F).reshape(-1, 3), (p - t - f @ X.T).ravel())[0]
        if np.abs(z - before).max() < STILL:
            break
    return replace(arm, base=rigid_transform(X, t), tool=rigid_transform(arm.tool.rotation.as_matrix(), z))


def _middle(T: RigidTransform) -> RigidTransform:
    return RigidTransform.from_components(np.median(T.translation, axis=0), T.rotation.mean())
