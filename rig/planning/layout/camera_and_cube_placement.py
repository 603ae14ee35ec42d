"""Placement of cameras and cubes in a layout, as lines of a rig.toml."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.arrays import Floats
from rig.errors import RigError
from rig.model.design import DICTIONARIES
from rig.model.pose import pose_to_vector

FACES = ("+x", "-x", "+y", "-y", "+z")
MARKER_SHARE = 0.8  # of a cube's edge
DISTANCE_SHARE = 4.4  # cameras from the middle of what they see, over how far that reaches
ELEVATION = 0.52  # rad above the middle
FILLED = 1.6  # times that reach what fills the image


class Ring(NamedTuple):
    """Where cubes stand around a body. centre : (3,) m; radius, edge : m, of the circle and of a cube; turn : rad, of
    the first cube
    """

    centre: Floats
    radius: float
    edge: float
    turn: float


def check_layout(radius: float, cameras: int, cubes: int, dictionary: str) -> None:
    """Raise RigError for an impossible layout, or a dictionary with too few markers for its cubes."""
    if not 0.01 <= radius <= 20:
        raise RigError(f"a radius of {radius:g} m makes no rig; expected 0.01 .. 20 m")
    if cameras < 1 or cubes < 1:
        raise RigError(f"expected at least one camera and one cube, got {cameras} and {cubes}")
    if 2 * cubes * len(FACES) > DICTIONARIES.get(dictionary, 0):
        raise RigError(
            f"{2 * cubes} cubes need {2 * cubes * len(FACES)} identities; {dictionary} has "
            f"{DICTIONARIES.get(dictionary, 0)}"
        )


def camera_ring_lines(centre: Floats, reach: float, count: int, width: int, height: int) -> list[str]:
    """rig.toml lines of a ring of cameras evenly around a centre (3,) m, with a field of view of `reach` m.
    width, height : px
    """
    distance = DISTANCE_SHARE * reach
    lines = []
    for i in range(count):
        around = 0.35 + 2 * np.pi * i / count
        eye = centre + distance * np.array(
            [np.cos(ELEVATION) * np.cos(around), np.cos(ELEVATION) * np.sin(around), np.sin(ELEVATION)]
        )
        lines += single_camera_lines(
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


def single_camera_lines(
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


def cube_lines(
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


def cube_ring_lines(cubes: int, dictionary: str, platform_ring: Ring, base_ring: Ring) -> list[str]:
    """rig.toml lines of rings of cubes on the platform and on the base, each face with its own marker id."""
    lines = []
    for k, (body, ring) in enumerate((("platform", platform_ring), ("base", base_ring))):
        for i in range(cubes):
            angle = ring.turn + 2 * np.pi * i / cubes
            place = ring.centre + ring.radius * np.array([np.cos(angle), np.sin(angle), 0.0])
            first = (k * cubes + i) * len(FACES)
            lines += cube_lines(f"{body[0].upper()}{i + 1}", body, dictionary, first, ring.edge, place, (0, 0, angle))
    return lines


def toml_row(values: Iterable[float]) -> str:
    """TOML array (row) of numbers."""
    return "[" + ", ".join(f"{value:.9g}" if value else "0.0" for value in map(float, values)) + "]"


def toml_rows(values: Iterable[Iterable[float]]) -> str:
    """TOML array of rows of numbers."""
    return "[" + ", ".join(toml_row(one) for one in values) + "]"
