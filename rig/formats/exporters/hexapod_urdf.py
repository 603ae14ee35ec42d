"""A hexapod as URDF: a tree, since URDF holds no loops. Strut 1 carries the platform; a simulator closes the loops at
the tips of the others.

Joints l1 .. l6 are what is commanded, m; strut_N_turn and strut_N_tilt are the cardans, zero at home; platform_x, _y,
_z the ball of strut 1.
Loops to close, as points that coincide: frame strut_N_tip of strut N and frame platform_joint_N of the platform, N = 2
.. 6.
Source: the URDF specification, <joint>
"""

from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.formats.exporters.arm_urdf import origin
from rig.formats.exporters.simulator_struts import simulator_struts
from rig.model.design import Hexapod

HERE = RigidTransform.identity()
TURN = np.pi  # rad, to either side: what a joint may do, of which a rig.toml says nothing


def hexapod_urdf(hexapod: Hexapod, name: str = "hexapod") -> str:
    """URDF of a Hexapod: links base, strut_N, strut_N_rod, platform, and frames as links without a body. Raises
    RigError where no cardan can be.
    """
    all_struts = simulator_struts(hexapod)
    links, joints = ["base", "ball_x", "ball_y", "platform"], []
    for n, strut in enumerate(all_struts, 1):
        links += [f"strut_{n}_cross", f"strut_{n}", f"strut_{n}_rod", f"strut_{n}_tip", f"platform_joint_{n}"]
        slide = RigidTransform.from_rotation(
            Rotation.from_rotvec([0, strut.tilt, 0])
        ) * RigidTransform.from_translation([0, 0, strut.zero])
        joints += [
            _joint(
                f"strut_{n}_turn", "revolute", "base", f"strut_{n}_cross", strut.T_base_cross, (1, 0, 0), (-TURN, TURN)
            ),
            _joint(f"strut_{n}_tilt", "revolute", f"strut_{n}_cross", f"strut_{n}", HERE, (0, 1, 0), (-TURN, TURN)),
            _joint(f"l{n}", "prismatic", f"strut_{n}", f"strut_{n}_rod", slide, (0, 0, 1), tuple(strut.limits)),
            _joint(f"strut_{n}_end", "fixed", f"strut_{n}_rod", f"strut_{n}_tip", HERE),
        ]
        joints += (
            []
            if n == 1
            else [_joint(f"platform_end_{n}", "fixed", "platform", f"platform_joint_{n}", strut.T_platform_joint)]
        )
    at_home = RigidTransform.from_rotation(all_struts[0].T_base_strut().rotation.inv() * hexapod.home.rotation)
    joints += [
        _joint("platform_x", "revolute", "strut_1_tip", "ball_x", at_home, (1, 0, 0), (-TURN, TURN)),
        _joint("platform_y", "revolute", "ball_x", "ball_y", HERE, (0, 1, 0), (-TURN, TURN)),
        _joint("platform_z", "revolute", "ball_y", "platform_joint_1", HERE, (0, 0, 1), (-TURN, TURN)),
        _joint("platform_end_1", "fixed", "platform_joint_1", "platform", all_struts[0].T_platform_joint.inv()),
    ]
    lines = [
        '<?xml version="1.0"?>',
        "<!-- loops to close: strut_N_tip and platform_joint_N coincide, N = 2 .. 6 -->",
        f"<robot name={quoteattr(name)}>",
    ]
    return "\n".join([*lines, *(f'  <link name="{link}"/>' for link in links), *joints, "</robot>"]) + "\n"


def _joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    T: RigidTransform,
    axis: tuple[int, ...] = (),
    limits: tuple[float, ...] = (),
) -> str:
    lines = [
        f'  <joint name="{name}" type="{kind}">',
        f'    <parent link="{parent}"/>',
        f'    <child link="{child}"/>',
        f"    {origin(T)}",
    ]
    if axis:
        lines += [
            f'    <axis xyz="{" ".join(map(str, axis))}"/>',
            f'    <limit lower="{limits[0]:.12g}" upper="{limits[1]:.12g}" effort="0" velocity="0"/>',
        ]
    return "\n".join([*lines, "  </joint>"])
