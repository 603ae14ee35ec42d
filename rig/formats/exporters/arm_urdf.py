"""URDF of an arm: a chain of revolute and prismatic joints.

A = Rz(theta + q) Tz(d) Tx(a) Rx(alpha) Ry(beta) turns about the z of the frame before it, or slides along it, so that
joint i's origin is what is fixed behind joint i - 1, times Rz(theta). Source: the URDF specification, <joint>; rpy are
turns about fixed axes x, y, z.
"""

from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.arrays import Floats
from rig.model.mechanism_geometry import Arm
from rig.model.pose import pose


def arm_urdf(arm: Arm, name: str = "arm") -> str:
    """URDF of an Arm: links base, link_1 .. link_n, platform; joints named as commands.csv heads its columns.

    An Arm that has a base (frame of poses to its own) or a tool (its last frame to the platform) carries them as fixed
    joints.
    """
    identity = RigidTransform.identity()
    links = ["base", *[f"link_{i + 1}" for i in range(len(arm.joints))], "platform"]
    lines = [
        '<?xml version="1.0"?>',
        f"<robot name={quoteattr(name)}>",
        *[f'  <link name="{link}"/>' for link in links],
    ]
    behind = getattr(arm, "base", identity)
    for i, (axis, (low, high), parent, child) in enumerate(zip(arm.axes, arm.limits, links, links[1:])):
        theta, d, a, alpha, beta = arm.rows[i]
        kind = "prismatic" if arm.slides[i] else "revolute"
        lines += [
            f'  <joint name="{axis}" type="{kind}">',
            f'    <parent link="{parent}"/>',
            f'    <child link="{child}"/>',
            f"    {origin_element(behind * pose([0, 0, 0], [0, 0, theta]))}",
            '    <axis xyz="0 0 1"/>',
            f'    <limit lower="{low:.12g}" upper="{high:.12g}" effort="0" velocity="0"/>',
            "  </joint>",
        ]
        behind = pose([a, 0, d], [alpha, 0, 0]) * pose([0, 0, 0], [0, beta, 0])
    lines += [
        '  <joint name="tool" type="fixed">',
        f'    <parent link="{links[-2]}"/>',
        '    <child link="platform"/>',
        f"    {origin_element(behind * getattr(arm, 'tool', identity))}",
        "  </joint>",
        "</robot>",
    ]
    return "\n".join(lines) + "\n"


def origin_element(T: RigidTransform) -> str:
    """URDF element <origin> of a RigidTransform T, m and rad."""
    numbers = [" ".join(f"{value:.16g}" for value in values) for values in (T.translation, roll_pitch_yaw(T.rotation))]
    return f'<origin xyz="{numbers[0]}" rpy="{numbers[1]}"/>'


def roll_pitch_yaw(rotation: Rotation) -> Floats:
    """Roll, pitch, yaw (3,) rad of a rotation, about the fixed axes x, y, z."""
    R = rotation.as_matrix()
    pitch = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    if np.hypot(R[0, 0], R[1, 0]) < 1e-9:  # roll and yaw turn about one axis: all of it is given to roll
        return np.array([np.arctan2(-R[2, 0] * R[0, 1], R[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])])
