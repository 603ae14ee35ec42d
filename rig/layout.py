"""A sensible rig.toml from a few figures: a hexapod, cubes where cameras see them, cameras where they see the cubes."""

from collections.abc import Iterable

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.design import DICTIONARIES
from rig.errors import RigError
from rig.pose import vector

JOINT_PAIRS = (0.244, 0.733)  # rad, half the angle between the two joints of a pair on the base and on the platform
LIMB_PAIRS = (0.35, 0.62)  # rad, the same of measuring limbs beside the struts
PLATFORM_SHARE = 0.67  # of the base's radius
HEIGHT_SHARE = 1.5  # home height over the base's radius
STROKE_SHARE = 0.33  # of the base's radius
FACES = ("+x", "-x", "+y", "-y", "+z")
MARKER_SHARE = 0.8  # of a cube's edge
DISTANCE_SHARE = 4.4  # cameras from the middle of the rig, over the base's radius
ELEVATION = 0.52  # rad above the middle of the rig


def layout(radius: float, cameras: int = 3, width: int = 1280, height: int = 1024, cubes: int = 4, dictionary: str = "DICT_5X5_100",
           name: str = "hexapod", limbs: bool = False) -> str:
    """Text of a rig.toml.

    radius : m, of the circle of base joints; cameras : how many, evenly around; width, height : px
    limbs : whether six measuring limbs stand beside the struts
    cubes : how many on the base and as many on the platform, each face with an identity of its own
    Raises RigError where the dictionary has too few identities or the figures make no rig.
    """
    if not 0.01 <= radius <= 20:
        raise RigError(f"a radius of {radius:g} m makes no rig; expected 0.01 .. 20 m")
    if cameras < 1 or cubes < 1:
        raise RigError(f"expected at least one camera and one cube, got {cameras} and {cubes}")
    if 2 * cubes * len(FACES) > DICTIONARIES.get(dictionary, 0):
        raise RigError(f"{2 * cubes} cubes need {2 * cubes * len(FACES)} identities; {dictionary} has {DICTIONARIES.get(dictionary, 0)}")
    base = _joints(radius, JOINT_PAIRS[0], 0.0)
    platform = _joints(radius * PLATFORM_SHARE, JOINT_PAIRS[1], 0.0)
    home = np.array([0, 0, HEIGHT_SHARE * radius])
    length = np.linalg.norm(platform + home - base, axis=1)
    half = STROKE_SHARE * radius / 2
    lines = ['schema = "rig/1"', f'name = "{name}"', "", "[environment]", "gravity = [0.0, 0.0, -9.80665]   # m/s^2, base frame", "",
             "[mechanism]", 'kind = "hexapod"', f"base_joints = {_rows(base)}   # m, base frame, strut 1..6",
             f"platform_joints = {_rows(platform)}   # m, platform frame",
             f"strut_range = {_rows(np.stack([length - half, length + half], axis=1))}   # m, joint centre to joint centre",
             f"home = {{ position = {_row(home)}, rotvec = [0.0, 0.0, 0.0] }}   # platform in base", "",
             "[actuator]", "screw_lead = 0.004   # m per revolution", 'joints = "cardan-cardan"', f"max_speed = {0.17 * radius:.4g}   # m/s", "",
             "[platform]", f"mass = {450 * radius**3:.4g}   # kg", f"centre_of_mass = [0.0, 0.0, {0.07 * radius:.4g}]   # m, platform frame",
             f"payload_centre_of_mass = [0.0, 0.0, {0.4 * radius:.4g}]"]
    if limbs:
        lines += ["", "[insitu]", f"base_joints = {_rows(_joints(radius * 1.1, LIMB_PAIRS[0], 0.0))}   # m, base frame, limb 1..6",
                  f"platform_joints = {_rows(_joints(radius * PLATFORM_SHARE * 0.9, LIMB_PAIRS[1], 0.0))}   # m, platform frame",
                  "length_sigma = 1e-6   # m, of one reading (sensors.csv, m1..m6)"]
    lines += _cameras(radius, home, cameras, width, height)
    edge_platform, edge_base = 0.62 * radius / np.sqrt(cubes), 0.7 * radius / np.sqrt(cubes)
    number = 0
    for body, circle, edge, turn in (("platform", 0.45 * radius, edge_platform, 0.35), ("base", 1.25 * radius, edge_base, 0.9)):
        for i in range(cubes):
            lines += _cube(f"{body[0].upper()}{i + 1}", body, dictionary, number, edge, circle, turn + 2 * np.pi * i / cubes)
            number += len(FACES)
    return "\n".join(lines) + "\n"


def _joints(radius: float, half_angle: float, turn: float) -> np.ndarray:
    angles = [turn + 2 * np.pi * k / 3 + side * half_angle for k in range(3) for side in (-1, 1)]
    return radius * np.array([[np.cos(a), np.sin(a), 0.0] for a in angles])


def _cameras(radius: float, home: np.ndarray, count: int, width: int, height: int) -> list[str]:
    middle = np.array([0, 0, 0.45 * home[2]])
    distance = DISTANCE_SHARE * radius
    focal = 0.5 * min(width, 1.25 * height) / np.tan(np.arcsin(1.6 * radius / distance))
    lines = []
    for i in range(count):
        around = 0.35 + 2 * np.pi * i / count
        eye = middle + distance * np.array([np.cos(ELEVATION) * np.cos(around), np.cos(ELEVATION) * np.sin(around), np.sin(ELEVATION)])
        ahead = (middle - eye) / distance
        right = np.cross(ahead, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        pose = RigidTransform.from_components(eye, Rotation.from_matrix(np.stack([right, np.cross(ahead, right), ahead], axis=1)))
        position, rotvec = np.split(vector(pose), 2)
        matrix = [[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]]
        lines += ["", "[[camera]]", f'name = "cam{i}"', f"width = {width}", f"height = {height}", f"matrix = {_rows(matrix)}",
                  "distortion = [-0.1, 0.08, 0.0, 0.0, 0.0]   # OpenCV k1 k2 p1 p2 k3",
                  f"pose = {{ position = {_row(position)}, rotvec = {_row(rotvec)} }}   # camera in base, OpenCV axes", 'shutter = "global"']
    return lines


def _cube(name: str, body: str, dictionary: str, first: int, edge: float, circle: float, angle: float) -> list[str]:
    faces = ", ".join(f'"{face}" = {first + k}' for k, face in enumerate(FACES))
    position = [circle * np.cos(angle), circle * np.sin(angle), edge / 2]
    return ["", "[[target]]", f'name = "{name}"', f'body = "{body}"', f"edge = {edge:.6g}   # m", f"marker = {MARKER_SHARE * edge:.6g}   # m",
            f'dictionary = "{dictionary}"', f"faces = {{ {faces} }}",
            f"pose = {{ position = {_row(position)}, rotvec = [0.0, 0.0, {angle:.6f}] }}   # cube in body"]


def _row(values: Iterable[float]) -> str:
    return "[" + ", ".join(f"{value:.9g}" if value else "0.0" for value in map(float, values)) + "]"


def _rows(values: Iterable[Iterable[float]]) -> str:
    return "[" + ", ".join(_row(row) for row in values) + "]"
