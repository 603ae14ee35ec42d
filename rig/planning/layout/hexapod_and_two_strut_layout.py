"""rig.toml layouts of a hexapod or of two struts in a plane, with cameras and cubes, from a few dimensions."""

import numpy as np

from rig.arrays import Floats
from rig.planning.layout.camera_and_cube_placement import (
    Ring,
    camera_ring_lines,
    check_layout,
    cube_ring_lines,
    toml_row,
    toml_rows,
)

JOINT_PAIRS = (0.244, 0.733)  # rad, half the angle between the two joints of a pair on the base and on the platform
LIMB_PAIRS = (0.35, 0.62)  # rad, the same of measuring limbs beside the struts
PLATFORM_SHARE = 0.67  # of the base's radius
HEIGHT_SHARE = 1.5  # home height over the base's radius
STROKE_SHARE = 0.33  # of the base's radius


def hexapod_layout_rig_toml(
    radius: float,
    cameras: int = 3,
    width: int = 1280,
    height: int = 1024,
    cubes: int = 4,
    dictionary: str = "DICT_5X5_100",
    name: str = "hexapod",
    limbs: int = 0,
) -> str:
    """rig.toml text of the layout of a hexapod with cameras and cubes.

    radius : m, of the circle of base joints; cameras : how many, evenly around; width, height : px
    limbs : how many measuring limbs stand beside the struts
    cubes : how many on the base and as many on the platform, each face with an identity of its own
    Raises RigError where the dictionary has too few identities or the figures make no rig.
    """
    check_layout(radius, cameras, cubes, dictionary)
    base = _joints(radius, JOINT_PAIRS[0], 0.0)
    platform = _joints(radius * PLATFORM_SHARE, JOINT_PAIRS[1], 0.0)
    home = np.array([0, 0, HEIGHT_SHARE * radius])
    length = np.linalg.norm(platform + home - base, axis=1)
    half = STROKE_SHARE * radius / 2
    lines = [
        'schema = "rig/1"',
        f'name = "{name}"',
        "",
        "[environment]",
        "gravity = [0.0, 0.0, -9.80665]   # m/s^2, base frame",
        "",
        "[mechanism]",
        'kind = "hexapod"',
        f"base_joints = {toml_rows(base)}   # m, base frame, strut 1..6",
        f"platform_joints = {toml_rows(platform)}   # m, platform frame",
        f"strut_range = {toml_rows(np.stack([length - half, length + half], axis=1))}   # m, joint centre to "
        "joint centre",
        f"home = {{ position = {toml_row(home)}, rotvec = [0.0, 0.0, 0.0] }}   # platform in base",
        "",
        "[actuator]",
        "screw_lead = 0.004   # m per revolution",
        'joints = "cardan-cardan"',
        f"max_speed = {0.17 * radius:.4g}   # m/s",
        "",
        "[platform]",
        f"mass = {450 * radius**3:.4g}   # kg",
        f"centre_of_mass = [0.0, 0.0, {0.07 * radius:.4g}]   # m, platform frame",
        f"payload_centre_of_mass = [0.0, 0.0, {0.4 * radius:.4g}]",
    ]
    if limbs:
        lines += [
            "",
            "[insitu]",
            f"base_joints = {toml_rows(_limb_joints(radius * 1.1, LIMB_PAIRS[0], limbs))}   # m, base frame, "
            f"limb 1..{limbs}",
            "platform_joints = "
            f"{toml_rows(_limb_joints(radius * PLATFORM_SHARE * 0.9, LIMB_PAIRS[1], limbs))}   # m, platform "
            "frame",
            f"length_sigma = 1e-6   # m, of one reading (sensors.csv, m1..m{limbs})",
        ]
    lines += camera_ring_lines(np.array([0, 0, 0.45 * home[2]]), radius, cameras, width, height)
    edge_platform, edge_base = 0.62 * radius / np.sqrt(cubes), 0.7 * radius / np.sqrt(cubes)
    lines += cube_ring_lines(
        cubes,
        dictionary,
        Ring(np.array([0, 0, edge_platform / 2]), 0.45 * radius, edge_platform, 0.35),
        Ring(np.array([0, 0, edge_base / 2]), 1.25 * radius, edge_base, 0.9),
    )
    return "\n".join(lines) + "\n"


def _joints(radius: float, half_angle: float, turn: float) -> Floats:
    angles = [turn + 2 * np.pi * k / 3 + side * half_angle for k in range(3) for side in (-1, 1)]
    return radius * np.array([[np.cos(a), np.sin(a), 0.0] for a in angles])


def _limb_joints(radius: float, half_angle: float, count: int) -> Floats:
    """(count, 3) m of measuring limbs: three pairs as struts have them; those beyond six stand inside, each pair turned
    on from the last.
    """
    rounds = [_joints(radius * 0.8**k, half_angle, k * (half_angle + 0.5)) for k in range((count + 5) // 6)]
    return np.concatenate(rounds)[:count]


APART, AWAY = (
    1.0,
    1.1,
)  # base joints either side of the middle, and the hinge's middle in front of them, over the radius
TWO_STRUT_STROKE_SHARE = 0.45  # of the radius
UP = 0.06  # of the radius, by which cubes stand above the struts
SEEN = 0.75  # of the radius, how far from the middle cameras have to see


def two_strut_layout_rig_toml(
    radius: float,
    cameras: int = 3,
    width: int = 1280,
    height: int = 1024,
    cubes: int = 4,
    dictionary: str = "DICT_5X5_100",
    name: str = "planar2",
) -> str:
    """rig.toml text of the layout of two struts with cameras and cubes.

    radius : m, half the distance of the base joints; cameras : how many, evenly around; width, height : px
    cubes : how many on the base and as many on the hinge's plate, each face with an identity of its own
    Raises RigError where the dictionary has too few identities or the figures make no rig.
    """
    check_layout(radius, cameras, cubes, dictionary)
    base = radius * APART * np.array([[-1.0, 0.0], [1.0, 0.0]])
    middle = np.array([0.0, AWAY * radius, 0.0])
    length = np.linalg.norm(middle[:2] - base, axis=1)
    half = TWO_STRUT_STROKE_SHARE * radius / 2
    lines = [
        'schema = "rig/1"',
        f'name = "{name}"',
        "",
        "[environment]",
        "gravity = [0.0, -9.80665, 0.0]   # m/s^2, base frame",
        "",
        "[mechanism]",
        'kind = "planar2"',
        f"base_joints = {toml_rows(base)}   # m, in the plane z = 0; the hinge is on the left of 1 -> 2",
        f"strut_range = {toml_rows(np.stack([length - half, length + half], axis=1))}   # m, joint centre to "
        "joint centre",
        "",
        "[actuator]",
        "screw_lead = 0.004   # m per revolution",
        f"max_speed = {0.17 * radius:.4g}   # m/s",
        "",
        "[platform]",
        f"mass = {200 * radius**3:.4g}   # kg",
    ]
    lines += camera_ring_lines(middle + [0, 0, 0.2 * radius], SEEN * radius, cameras, width, height)
    edge_platform, edge_base = (share * radius / np.sqrt(max(cubes, 2) / 2) for share in (0.3, 0.28))
    lines += cube_ring_lines(
        cubes,
        dictionary,
        Ring(
            np.array([0, 0, UP * radius + edge_platform / 2]), 0.0 if cubes == 1 else 0.3 * radius, edge_platform, 0.35
        ),
        Ring(middle + [0, 0, UP * radius + edge_base / 2], 0.85 * radius, edge_base, 0.9),
    )
    return "\n".join(lines) + "\n"
