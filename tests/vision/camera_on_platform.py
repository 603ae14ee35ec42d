"""A hexapod whose platform carries its camera, which looks down on cubes on the base."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.planning.layout.hexapod_layout_and_camera_placement import cube_toml_lines, single_camera_toml_lines

WIDE, SIZE, EDGE = 0.62, (640, 512), 0.075  # rad to either side; px; m


def text():
    """Its rig.toml."""
    whole = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3)
    looks = RigidTransform.from_components([0.0, 0.0, -0.04], Rotation.from_rotvec([np.pi, 0, 0]))
    lines = single_camera_toml_lines("cam0", looks, WIDE, SIZE, "hand")
    for i in range(6):
        place = (0.13 * np.cos(i * np.pi / 3), 0.13 * np.sin(i * np.pi / 3), EDGE / 2 + 0.015 * (i % 3))
        lines += cube_toml_lines(f"B{i + 1}", "base", "DICT_5X5_100", 5 * i, EDGE, place, (0, 0, 0.4 * i))
    return whole[: whole.index("[[camera]]")] + "\n".join(lines) + "\n"
