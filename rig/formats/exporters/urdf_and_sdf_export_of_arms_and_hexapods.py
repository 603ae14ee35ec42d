"""URDF and SDF export of arms and hexapods.

URDF of an arm, and URDF and SDF of a hexapod.

A = Rz(theta + q) Tz(d) Tx(a) Rx(alpha) Ry(beta) turns about the z of the frame before it, or slides along it, so that
joint i's origin is what is fixed behind joint i - 1, times Rz(theta). Source: the URDF specification, <joint>; rpy are
turns about fixed axes x, y, z.

A strut's frame stands in its base joint: x along the cardan's first axis, which lies in the base plate, tangential,
(-y, x, 0) of the joint; y, the second, perpendicular to it and to the strut at home; tilted about y by a fixed angle,
z runs along the strut.

Strut 1 carries the platform; a simulator closes the loops at the tips of the others.

Joints l1 .. l6 are what is commanded, m; strut_N_turn and strut_N_tilt are the cardans, zero at home; platform_x, _y,
_z the ball of strut 1. Loops to close, as points that coincide: frame strut_N_tip of strut N and frame
platform_joint_N of the platform, N = 2 .. 6. Source: the URDF specification, <joint>

A slide l1 .. l6 is zero at home, as every joint of SDF is where its links stand: what is commanded is its position
plus the length commanded at home, of which its limits know. Masses are SDF's default, 1 kg for each link, until
somebody states them. Source: SDFormat 1.9 specification, <joint>
"""

from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.model.arm_hands_effect_places_and_tolerances import Coupling, Hand
from rig.model.mechanism_geometry_classes import Arm, Hexapod
from rig.model.pose import pose


def arm_urdf(arm: Arm, name: str = "arm") -> str:
    """URDF of an Arm.

    Links base, link_1 .. link_n, platform; joints named as commands.csv heads its columns.

    An Arm that has a base (frame of poses to its own) or a tool (its last frame to the platform) carries them as fixed
    joints. Of several hands each is a link of its name.
    """
    mounts = {branch.joint: branch.mount for branch in arm.branches}
    hands = arm.hands or (Hand("platform", len(arm.joints) - 1, arm.tool),)
    links = ["base", *[f"link_{i + 1}" for i in range(len(arm.joints))]]
    lines = [
        '<?xml version="1.0"?>',
        f"<robot name={quoteattr(name)}>",
        *[f"  <link name={quoteattr(link)}/>" for link in (*links, *(hand.name for hand in hands))],
    ]
    followed = {one.joint: one for one in arm.couplings}
    ends = [arm.base]  # of the base and of each link, in the frame in which a joint behind it is stated
    for i, (axis, (low, high), parent) in enumerate(zip(arm.axes, arm.limits, arm.parents.tolist())):
        theta, d, a, alpha, beta = arm.rows[i]
        kind = "prismatic" if arm.slides[i] else "revolute"
        behind = ends[parent + 1] * mounts.get(i, RigidTransform.identity())
        lines += [
            f'  <joint name="{axis}" type="{kind}">',
            f'    <parent link="{links[parent + 1]}"/>',
            f'    <child link="{links[i + 1]}"/>',
            f"    {urdf_origin_element(behind * pose([0, 0, 0], [0, 0, theta]))}",
            '    <axis xyz="0 0 1"/>',
            f'    <limit lower="{low:.12g}" upper="{high:.12g}" effort="0" velocity="0"/>',
            *([_mimic_element(followed[i], arm)] if i in followed else []),
            "  </joint>",
        ]
        ends.append(pose([a, 0, d], [alpha, 0, 0]) * pose([0, 0, 0], [0, beta, 0]))
    for hand in hands:
        lines += [
            f'  <joint name={quoteattr("tool" if not arm.hands else f"{hand.name}_tool")} type="fixed">',
            f'    <parent link="{links[hand.joint + 1]}"/>',
            f"    <child link={quoteattr(hand.name)}/>",
            f"    {urdf_origin_element(ends[hand.joint + 1] * hand.tool)}",
            "  </joint>",
        ]
    return "\n".join([*lines, "</robot>"]) + "\n"


def _mimic_element(coupling: Coupling, arm: Arm) -> str:
    by = f'multiplier="{coupling.multiplier:.16g}" offset="{coupling.offset:.16g}"'
    return f'    <mimic joint="{arm.axes[coupling.leader]}" {by}/>'


def urdf_origin_element(T: RigidTransform) -> str:
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


LEAST = 1e-9  # m or rad


@dataclass(frozen=True, slots=True, eq=False)
class Strut:
    """T_base_cross : at home, x and y its two axes; tilt : rad, about y from there to the strut; home : m, joint to
    joint; zero : m, of what is commanded, home less zero; limits : (2,) m, as commanded; T_platform_joint : unrotated
    to the platform"""

    T_base_cross: RigidTransform
    tilt: float
    home: float
    zero: float
    limits: Floats
    T_platform_joint: RigidTransform

    def T_base_strut(self) -> RigidTransform:
        """z along the strut, at home."""
        return self.T_base_cross * RigidTransform.from_rotation(Rotation.from_rotvec([0, self.tilt, 0]))


def simulator_strut_models(hexapod: Hexapod) -> list[Strut]:
    """The struts of a Hexapod as simulators model them.

    Universal joint, slide, ball joint.
    Raises RigError for a base joint on the z axis, or a strut along its cardan's first axis: no cardan is there.
    """
    found = []
    ends = hexapod.home.apply(hexapod.platform_joints)
    for i, (base, end) in enumerate(zip(hexapod.base_joints, ends)):
        along = (end - base) / np.linalg.norm(end - base)
        first = np.array([-base[1], base[0], 0.0])
        if np.linalg.norm(first) < LEAST:
            raise RigError(
                f"strut {i + 1}: its base joint lies on the z axis, so that a cardan's tangential axis has no direction"
            )
        first /= np.linalg.norm(first)
        second = np.cross(along, first)
        if np.linalg.norm(second) < LEAST:
            raise RigError(f"strut {i + 1} runs along its cardan's first axis at home")
        second /= np.linalg.norm(second)
        R = np.column_stack([first, second, np.cross(first, second)])
        inside = R.T @ along  # no y: the second axis is perpendicular to the strut
        found.append(
            Strut(
                RigidTransform.from_components(base, Rotation.from_matrix(R)),
                float(np.arctan2(inside[0], inside[2])),
                float(np.linalg.norm(end - base)),
                float(hexapod.strut_zeros[i]),
                np.array(hexapod.strut_range[i]),
                RigidTransform.from_translation(hexapod.platform_joints[i]),
            )
        )
    return found


HERE = RigidTransform.identity()
TURN = np.pi  # rad, to either side: what a joint may do, of which a rig.toml says nothing


def hexapod_urdf(hexapod: Hexapod, name: str = "hexapod") -> str:
    """URDF of a Hexapod.

    Links base, strut_N, strut_N_rod, platform; the loops are listed for the simulator.
    Raises RigError where no cardan can be.
    """
    all_struts = simulator_strut_models(hexapod)
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
        f"    {urdf_origin_element(T)}",
    ]
    if axis:
        lines += [
            f'    <axis xyz="{" ".join(map(str, axis))}"/>',
            f'    <limit lower="{limits[0]:.12g}" upper="{limits[1]:.12g}" effort="0" velocity="0"/>',
        ]
    return "\n".join([*lines, "  </joint>"])


def hexapod_sdf(hexapod: Hexapod, name: str = "hexapod") -> str:
    """SDF of a Hexapod.

    Links base, strut_N, strut_N_rod and platform, frames at home.
    Raises RigError where no cardan can be.
    """
    lines = [
        '<?xml version="1.0"?>',
        '<sdf version="1.9">',
        f"  <model name={quoteattr(name)}>",
        '    <link name="base"/>',
        f'    <link name="platform">{_pose(hexapod.home)}</link>',
        '    <joint name="ground" type="fixed"><parent>world</parent><child>base</child></joint>',
    ]
    for n, strut in enumerate(simulator_strut_models(hexapod), 1):
        lines += _strut(n, strut)
    return "\n".join([*lines, "  </model>", "</sdf>"]) + "\n"


def _strut(n: int, strut: Strut) -> list[str]:
    """Links and joints of one strut; a joint's frame is its child's link."""
    standing, R = strut.T_base_strut(), strut.T_base_cross.rotation.as_matrix()
    end = standing * RigidTransform.from_translation([0, 0, strut.home])
    low, high = strut.limits + strut.zero - strut.home
    axes = "".join(
        f'<axis{k or ""}><xyz expressed_in="__model__">{_figures(R[:, column])}</xyz></axis{k or ""}>'
        for column, k in ((0, ""), (1, 2))
    )
    return [
        f'    <link name="strut_{n}">{_pose(standing)}</link>',
        f'    <link name="strut_{n}_rod">{_pose(end)}</link>',
        f'    <joint name="strut_{n}_base" '
        f'type="universal"><parent>base</parent><child>strut_{n}</child>{axes}</joint>',
        f'    <joint name="l{n}" type="prismatic"><parent>strut_{n}</parent><child>strut_{n}_rod</child>'
        f"<axis><xyz>0 0 1</xyz><limit><lower>{low:.12g}</lower><upper>{high:.12g}</upper></limit></axis></joint>",
        f'    <joint name="strut_{n}_platform" type="ball"><pose '
        f'relative_to="strut_{n}_rod"/><parent>strut_{n}_rod</parent>'
        "<child>platform</child></joint>",
    ]


def _pose(T: RigidTransform) -> str:
    return f"<pose>{_figures(T.translation)} {_figures(roll_pitch_yaw(T.rotation))}</pose>"


def _figures(values: Floats) -> str:
    return " ".join(f"{value:.16g}" for value in values)
