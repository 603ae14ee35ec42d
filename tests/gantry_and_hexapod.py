"""A hexapod on a gantry as a rig.toml has it, measured by an instrument or seen by cameras, for tests."""

import numpy as np

from rig.formats.rig_toml import design_from_rig_toml
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.planning.layout.hexapod_layout_and_camera_placement import cube_toml_lines

GANTRY = """[mechanism]
kind = "chain"

[[mechanism.stage]]   # a gantry of three slides, its carriage the hexapod's base
kind = "arm"
joints = [["prismatic", -1.5707963267948966, 0.0, 0.0, -1.5707963267948966],
          ["prismatic", -1.5707963267948966, 0.0, 0.0, -1.5707963267948966],
          ["prismatic", -1.5707963267948966, 0.0, 0.0, -1.5707963267948966]]
limits = [[-0.1, 0.1], [-0.1, 0.1], [-0.05, 0.05]]

"""
INSTRUMENT = '[instrument]\nbase = "rig"\ntool = "rig"\nposition_sigma = 1e-5\nrotation_sigma = 5e-5\n\n'


def carriage_cubes(edge=0.07, radius=0.3):
    """Text of three cubes on the carriage, between those on the base."""
    angles = 0.9 + np.pi / 4 + np.array([0, 2, 4]) * np.pi / 3
    return "".join(
        "\n".join(
            cube_toml_lines(
                f"C{k + 1}",
                "stage 1",
                "DICT_4X4_100",
                6 * (k + 8),
                edge,
                (radius * np.cos(a), radius * np.sin(a), edge / 2 + 0.005),
                (0, 0, a),
            )
        )
        + "\n"
        for k, a in enumerate(angles)
    )


def written(folder, seen=False, cameras=3, size=(1280, 1024), carriage=False):
    """Design of the rig.toml, written into a folder, of a hexapod on a gantry, seen by cameras or measured by an
    instrument.

    carriage : whether the gantry's carriage has cubes of its own
    """
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.25, cameras, *size)
    start, end, cameras = (text.index(word) for word in ("[mechanism]", "[actuator]", "[[camera]]"))
    stage = text[start:end].replace("[mechanism]", "[[mechanism.stage]]")
    rest = text[end:] + carriage * carriage_cubes() if seen else INSTRUMENT + text[end:cameras]
    (folder / "rig.toml").write_text(text[:start] + GANTRY + stage + rest)
    return design_from_rig_toml.load_design(folder / "rig.toml")
