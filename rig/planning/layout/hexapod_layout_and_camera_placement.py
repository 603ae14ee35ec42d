"""Hexapod layouts and camera placement for a new rig.toml.

From a few dimensions.
Also of two struts; cameras and cubes are placed in layouts.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.model.design import DICTIONARIES
from rig.model.pose import pose_to_vector

FACES = ("+x", "-x", "+y", "-y", "+z")
MARKER_SHARE = 0.8  # of a cube's edge
DISTANCE_SHARE = 4.4  # cameras from the middle of what they see, over how far that reaches
ELEVATION = 0.52  # rad above the middle
FILLED = 1.6  # times that reach what fills the image


class CubeRing(NamedTuple):
    """Placement of cubes around a body. centre : (3,) m; radius, edge : m, of the circle and of a cube; turn : rad, of
    the first cube
    """

    centre: Floats
    radius: float
    edge: float
    turn: float


def require_possible_layout(radius: float, cameras: int, cubes: int, dictionary: str) -> None:
    """Raise RigError unless a layout is possible.

    Its radius, counts, and enough markers for its cubes.
    """
    if not 0.01 <= radius <= 20:
        raise RigError(f"a radius of {radius:g} m makes no rig; expected 0.01 .. 20 m")
    if cameras < 1 or cubes < 1:
        raise RigError(f"expected at least one camera and one cube, got {cameras} and {cubes}")
    if 2 * cubes * len(FACES) > DICTIONARIES.get(dictionary, 0):
        raise RigError(
            f"{2 * cubes} cubes need {2 * cubes * len(FACES)} identities; {dictionary} has "
            f"{DICTIONARIES.get(dictionary, 0)}"
        )


def camera_ring_toml_lines(centre: Floats, reach: float, count: int, width: int, height: int) -> list[str]:
    """rig.toml lines of a ring of cameras around a centre (3,) m.

    They are even, with a field of view of `reach` m.

    width, height : px
    """
    distance = DISTANCE_SHARE * reach
    lines = []
    for i in range(count):
        around = 0.35 + 2 * np.pi * i / count
        eye = centre + distance * np.array(
            [np.cos(ELEVATION) * np.cos(around), np.cos(ELEVATION) * np.sin(around), np.sin(ELEVATION)]
        )
        lines += single_camera_toml_lines(
            f"cam{i}", camera_pose(eye, (centre - eye) / distance), np.arcsin(FILLED / DISTANCE_SHARE), (width, height)
        )
    return lines


def camera_pose(position: Floats, view_direction: Floats) -> RigidTransform:
    """Camera pose at a position (3,) m with a view direction (3,), level, OpenCV axes."""
    right = np.cross(view_direction, [0, 0, 1.0] if abs(view_direction[2]) < 0.999 else [0, 1.0, 0])
    right /= np.linalg.norm(right)
    return RigidTransform.from_components(
        position, Rotation.from_matrix(np.stack([right, np.cross(view_direction, right), view_direction], axis=1))
    )


def single_camera_toml_lines(
    name: str, pose: RigidTransform, half_angle: float, size: tuple[int, int], mount: str = "fixed"
) -> list[str]:
    """rig.toml lines of a single camera with a half angle of view (rad).
    pose : in the base, or of one in the hand in the platform; size : px
    """
    width, height = size
    focal = 0.5 * min(width, 1.25 * height) / np.tan(half_angle)
    position, rotvec = np.split(pose_to_vector(pose), 2)
    matrix = [[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]]
    where = "base" if mount == "fixed" else "platform"
    return [
        "",
        "[[camera]]",
        f'name = "{name}"',
        f"width = {width}",
        f"height = {height}",
        f"matrix = {toml_rows(matrix)}",
        "distortion = [-0.1, 0.08, 0.0, 0.0, 0.0]   # OpenCV k1 k2 p1 p2 k3",
        f"pose = {{ position = {toml_row(position)}, rotvec = {toml_row(rotvec)} }}   # camera in {where}, OpenCV axes",
        *([] if mount == "fixed" else [f'mount = "{mount}"']),
        'shutter = "global"',
    ]


def cube_toml_lines(
    name: str,
    body: str,
    dictionary: str,
    first_id: int,
    edge: float,
    centre: Iterable[float],
    rotation_vector: Iterable[float],
) -> list[str]:
    """rig.toml lines of a cube on a body, its marker ids from first_id on.
    edge : m; centre : (3,) m of its centre; rotation_vector : (3,) rotation vector, rad
    """
    faces = ", ".join(f'"{face}" = {first_id + k}' for k, face in enumerate(FACES))
    turned = ", ".join(f"{value:.6f}" if value else "0.0" for value in rotation_vector)
    return [
        "",
        "[[target]]",
        f'name = "{name}"',
        f'body = "{body}"',
        f"edge = {edge:.6g}   # m",
        f"marker = {MARKER_SHARE * edge:.6g}   # m",
        f'dictionary = "{dictionary}"',
        f"faces = {{ {faces} }}",
        f"pose = {{ position = {toml_row(centre)}, rotvec = [{turned}] }}   # cube in body",
    ]


def cube_ring_toml_lines(cubes: int, dictionary: str, platform_ring: CubeRing, base_ring: CubeRing) -> list[str]:
    """rig.toml lines of a ring of cubes.

    Rings on the platform and on the base, each face with its own marker id.
    """
    lines = []
    for k, (body, ring) in enumerate((("platform", platform_ring), ("base", base_ring))):
        for i in range(cubes):
            angle = ring.turn + 2 * np.pi * i / cubes
            place = ring.centre + ring.radius * np.array([np.cos(angle), np.sin(angle), 0.0])
            first = (k * cubes + i) * len(FACES)
            lines += cube_toml_lines(
                f"{body[0].upper()}{i + 1}", body, dictionary, first, ring.edge, place, (0, 0, angle)
            )
    return lines


def toml_row(values: Iterable[float]) -> str:
    """TOML array (row) of numbers."""
    return "[" + ", ".join(f"{value:.9g}" if value else "0.0" for value in map(float, values)) + "]"


def toml_rows(values: Iterable[Iterable[float]]) -> str:
    """TOML array of rows of numbers."""
    return "[" + ", ".join(toml_row(one) for one in values) + "]"


JOINT_PAIRS = (0.244, 0.733)  # rad, half the angle between the two joints of a pair on the base and on the platform
FOUR_PAIRS = (0.15, 0.65)  # rad, the same of seven or eight struts in four pairs
FOLLOWERS = {7: "3", 8: "3, 8"}  # without which six are left that hold the platform best at home
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
    legs: tuple[int, int] = (6, 0),
) -> str:
    """rig.toml text of the layout of a hexapod with cameras and cubes.

    radius : m, of the circle of base joints; cameras : how many, evenly around; width, height : px
    legs : how many struts, six to eight, those beyond six as followers; and how many measuring limbs beside them
    cubes : how many on the base and as many on the platform, each face with an identity of its own
    Raises RigError where the dictionary has too few identities or the figures make no rig.
    """
    require_possible_layout(radius, cameras, cubes, dictionary)
    struts, limbs = legs
    pairs, turns = (JOINT_PAIRS, 3) if struts == 6 else (FOUR_PAIRS, 4)
    base = _joints(radius, pairs[0], 0.0, turns)[:struts]
    platform = _joints(radius * PLATFORM_SHARE, pairs[1], 0.0, turns)[:struts]
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
        f"base_joints = {toml_rows(base)}   # m, base frame, strut 1..{struts}",
        f"platform_joints = {toml_rows(platform)}   # m, platform frame",
        f"strut_range = {toml_rows(np.stack([length - half, length + half], axis=1))}   # m, joint centre to "
        "joint centre",
        f"home = {{ position = {toml_row(home)}, rotvec = [0.0, 0.0, 0.0] }}   # platform in base",
        *([f"followers = [{FOLLOWERS[struts]}]   # released and read while it is measured"] if struts > 6 else []),
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
    lines += camera_ring_toml_lines(np.array([0, 0, 0.45 * home[2]]), radius, cameras, width, height)
    edge_platform, edge_base = 0.62 * radius / np.sqrt(cubes), 0.7 * radius / np.sqrt(cubes)
    lines += cube_ring_toml_lines(
        cubes,
        dictionary,
        CubeRing(np.array([0, 0, edge_platform / 2]), 0.45 * radius, edge_platform, 0.35),
        CubeRing(np.array([0, 0, edge_base / 2]), 1.25 * radius, edge_base, 0.9),
    )
    return "\n".join(lines) + "\n"


def _joints(radius: float, half_angle: float, turn: float, pairs: int = 3) -> Floats:
    angles = [turn + 2 * np.pi * k / pairs + side * half_angle for k in range(pairs) for side in (-1, 1)]
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
    require_possible_layout(radius, cameras, cubes, dictionary)
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
    lines += camera_ring_toml_lines(middle + [0, 0, 0.2 * radius], SEEN * radius, cameras, width, height)
    edge_platform, edge_base = (share * radius / np.sqrt(max(cubes, 2) / 2) for share in (0.3, 0.28))
    lines += cube_ring_toml_lines(
        cubes,
        dictionary,
        CubeRing(
            np.array([0, 0, UP * radius + edge_platform / 2]), 0.0 if cubes == 1 else 0.3 * radius, edge_platform, 0.35
        ),
        CubeRing(middle + [0, 0, UP * radius + edge_base / 2], 0.85 * radius, edge_base, 0.9),
    )
    return "\n".join(lines) + "\n"
