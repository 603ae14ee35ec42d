"""Denavit-Hartenberg rows of an arm's joint axes.

From the lines of its axes, and from a table in Craig's convention.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats
from rig.model.mechanisms.arm import link_transform
from rig.model.pose import pose

NEARLY_PARALLEL = 0.1  # rad; below it the common normal is far away, and Hayati's beta takes its place
SAME = 1e-13  # m, rad; two axes so near are one line
DECIMALS = 15  # of rows, m and rad


class PlacedRows(NamedTuple):
    """rows : (n, 5) theta, d, a, alpha, beta, rad and m; base, tool : RigidTransform, as of Arm"""

    rows: Floats
    base: RigidTransform
    tool: RigidTransform


def denavit_hartenberg_rows_of_joint_axes(points: Floats, directions: Floats, T_root_tip: RigidTransform) -> PlacedRows:
    """Denavit-Hartenberg rows (PlacedRows) of an arm's joint axes.

    Its joints turn about, or slide along, these lines while all joint values are 0.
    points : (n, 3) m, a point on each axis, where the origins of Hayati's rows are put; directions : (n, 3) of length
    1, about which a joint value is right-handed; both in the root's frame. T_root_tip : the tip's pose at 0
    Hayati's beta is not 0 only where an axis is nearly parallel to the next one, and not exactly.
    Raises ValueError for other shapes. Source: Denavit and Hartenberg 1955; Hayati 1983
    """
    points, directions = np.asarray(points, float), np.asarray(directions, float)
    if points.shape != directions.shape or points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise ValueError(f"expected points and directions (n, 3), got {points.shape} and {directions.shape}")
    tip = T_root_tip.as_matrix()
    base = _first_frame(points[0], directions[0])
    frame, rows = base.as_matrix(), list[Floats]()
    for point, direction in zip([*points[1:], tip[:3, 3]], [*directions[1:], tip[:3, 2]]):
        last = len(rows) == len(points) - 1
        inside = frame[:3, :3].T @ np.column_stack([point - frame[:3, 3], direction, tip[:3, 0]])
        row = _row(inside[:, 0], inside[:, 1], inside[:, 2] if last else np.array([1.0, 0.0, 0.0]), last)
        rows.append(np.round(row, DECIMALS) + 0.0)
        frame = frame @ link_transform(np.zeros(()), rows[-1])
    tool = RigidTransform.from_matrix(frame).inv() * T_root_tip
    return PlacedRows(np.array(rows), base, _identity_if_near(tool))


def _first_frame(point: Floats, direction: Floats) -> RigidTransform:
    """Frame 0: the root's own as far as joint 1's axis, its z, leaves it so."""
    sine = float(np.hypot(direction[0], direction[1]))
    if sine < SAME and direction[2] > 0:
        return _identity_if_near(pose([point[0], point[1], 0.0], [0.0, 0.0, 0.0]))
    about = np.array([-direction[1], direction[0], 0.0]) / sine if sine >= SAME else np.array([1.0, 0.0, 0.0])
    return pose(point, about * np.arctan2(sine, direction[2]))


def _identity_if_near(T: RigidTransform) -> RigidTransform:
    near = np.abs(T.translation).max() < SAME and T.rotation.magnitude() < SAME
    return RigidTransform.identity() if near else T


def _row(point: Floats, direction: Floats, x: Floats, last: bool) -> Floats:
    """Row (5,) from a frame to the next: its z along a line through a point (3,) m, of a direction (3,).

    x : (3,) to which the next frame's x is nearest of the two that there are; last : whether it is the tip's own, which
    is taken where any would do
    """
    sine = float(np.hypot(direction[0], direction[1]))
    if sine > np.sin(NEARLY_PARALLEL):
        normal = _nearest(np.array([-direction[1], direction[0]]) / sine, x)
        across = np.array([-normal[1], normal[0]])
        forward = float(direction[:2] @ across)
        d = float(point[2] - (point[:2] @ across) / forward * direction[2])
        a, alpha, beta = float(point[:2] @ normal), np.arctan2(-forward, direction[2]), 0.0
    else:
        d, a, normal = float(point[2]), float(np.hypot(point[0], point[1])), np.array([1.0, 0.0])
        if a >= SAME:
            normal = _nearest(point[:2] / a, x)
            a = float(point[:2] @ normal)
        elif last:
            normal, a = x[:2] / np.hypot(x[0], x[1]), 0.0
        else:
            a = 0.0
        u, v = (_zero_if_near(float(direction[:2] @ one)) for one in (normal, np.array([-normal[1], normal[0]])))
        alpha, beta = np.arctan2(-v, direction[2]), np.arctan2(u, np.hypot(v, direction[2]))
    return np.array([np.arctan2(normal[1], normal[0]), d, a, alpha, beta])


def _zero_if_near(value: float) -> float:
    return 0.0 if abs(value) < SAME else value


def _nearest(normal: Floats, x: Floats) -> Floats:
    """The direction (2,) or its opposite, whichever is nearer to x."""
    side = normal @ x[:2]
    return -normal if side < -1e-9 or (abs(side) <= 1e-9 and normal[1] < 0) else normal


def distal_rows_of_modified_rows(modified: Floats) -> PlacedRows:
    """PlacedRows of a table in Craig's (modified) convention.

    That is Rx(alpha) Tx(a) Rz(theta + q) Tz(d) for each row.
    modified : (n, 4) theta, d, a, alpha, rad and m. The first row's a and alpha are the base; a row here takes those of
    the next. Raises ValueError for another shape. Source: Craig, Introduction to Robotics, ch. 3
    """
    modified = np.asarray(modified, float)
    if modified.ndim != 2 or modified.shape[1] != 4 or not len(modified):
        raise ValueError(f"expected rows (n, 4), got {modified.shape}")
    rows = np.zeros((len(modified), 5))
    rows[:, :2] = modified[:, :2]
    rows[:-1, 2:4] = modified[1:, 2:]
    a, alpha = modified[0, 2:]
    base = RigidTransform.from_components([a, 0.0, 0.0], Rotation.from_rotvec([alpha, 0.0, 0.0]))
    return PlacedRows(rows, _identity_if_near(base), RigidTransform.identity())
