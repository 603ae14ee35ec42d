"""genhexkins' own kinematics from HAL settings alone, for tests: what LinuxCNC would make of an export."""

import re

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation


def settings(text):
    """{pin: value} of the setp lines."""
    return {pin: float(value) for pin, value in re.findall(r"^setp (\S+) (\S+)$", text, re.M)}


def vectors(pins, name):
    return np.array([[pins[f"genhexkins.{name}.{i}.{axis}"] for axis in "xyz"] for i in range(6)])


def joints(pins, position, rpy):
    """(6,) machine units: joint positions at a pose, the screw's correction included."""
    R = Rotation.from_euler("xyz", rpy).as_matrix()
    strut = position + vectors(pins, "platform") @ R.T - vectors(pins, "base")
    length = np.linalg.norm(strut, axis=1)
    lead = pins["genhexkins.screw-lead"]
    if lead:
        u, nb1, na1 = strut / length[:, None], vectors(pins, "base-n"), vectors(pins, "platform-n") @ R.T
        nb3, na2 = np.cross(u, np.cross(nb1, u)), np.cross(na1, u)
        nb3, na2 = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (nb3, na2))
        length = length + lead * np.arcsin((nb3 * na2).sum(axis=1)) / (2 * np.pi)
    return length


def forward(text, commands, start, unit):
    """RigidTransform (n,) of motor commands (n, 6) m by its Newton iteration, pose as x y z and roll pitch yaw, in
    machine units.

    start : RigidTransform to begin at; unit : machine units per m
    """
    pins, out = settings(text), []
    offsets = np.array([pins[f"offset.{i}.offset"] for i in range(6)])
    scale = np.r_[np.full(3, unit), np.ones(3)]
    for command in commands:
        wanted = command * unit - offsets  # offset.N.out = joint + offset is the motor's command
        x = np.r_[start.translation, start.rotation.as_euler("xyz")] * scale
        for _ in range(120):
            left = joints(pins, x[:3], x[3:]) - wanted
            if np.abs(left).max() < pins["genhexkins.convergence-criterion"]:
                break
            step = 1e-6 * scale
            J = np.stack(
                [
                    (joints(pins, *np.split(x + d, [3])) - joints(pins, *np.split(x - d, [3]))) / (2 * d.sum())
                    for d in np.diag(step)
                ],
                axis=1,
            )
            x = x - np.linalg.solve(J, left)
        out.append(x / scale)
    out = np.array(out)
    return RigidTransform.from_components(out[:, :3], Rotation.from_euler("xyz", out[:, 3:]))
