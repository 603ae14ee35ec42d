"""A sensible rig.toml of two struts in a plane, from a few figures: one hinge, a plate with cubes on it, cameras that
look down on it.
"""

import numpy as np

from rig.planning.layout.layout_elements import Ring, camera_lines, check_layout, cube_ring_lines, toml_rows

APART, AWAY = (
    1.0,
    1.1,
)  # base joints either side of the middle, and the hinge's middle in front of them, over the radius
STROKE_SHARE = 0.45  # of the radius
UP = 0.06  # of the radius, by which cubes stand above the struts
SEEN = 0.75  # of the radius, how far from the middle cameras have to see


def two_strut_layout(
    radius: float,
    cameras: int = 3,
    width: int = 1280,
    height: int = 1024,
    cubes: int = 4,
    dictionary: str = "DICT_5X5_100",
    name: str = "planar2",
) -> str:
    """Text of a rig.toml of two struts.

    radius : m, half the distance of the base joints; cameras : how many, evenly around; width, height : px
    cubes : how many on the base and as many on the hinge's plate, each face with an identity of its own
    Raises RigError where the dictionary has too few identities or the figures make no rig.
    """
    check_layout(radius, cameras, cubes, dictionary)
    base = radius * APART * np.array([[-1.0, 0.0], [1.0, 0.0]])
    middle = np.array([0.0, AWAY * radius, 0.0])
    length = np.linalg.norm(middle[:2] - base, axis=1)
    half = STROKE_SHARE * radius / 2
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
    lines += camera_lines(middle + [0, 0, 0.2 * radius], SEEN * radius, cameras, width, height)
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
