"""Lay out a new hexapod: joints, cameras and cubes, in millimetres and degrees."""

from pathlib import Path

import rig
from rig.formats.numbers_and_units import parse_length_and_angle_units

options = rig.LayoutOptions(
    radius=0.3,  # m, of the circle of base joints
    cameras=2,
    cubes=2,
    units=parse_length_and_angle_units("mm, deg"),
)
text = rig.new_rig_toml(options)
Path("rig.toml").write_text(text)
print("\n".join(text.splitlines()[:2]))

design = rig.load_design("rig.toml")  # in m and rad, whatever the file states
low, high = design.mechanism.strut_range[0]
print(f"a strut moves from {1e3 * low:.1f} to {1e3 * high:.1f} mm")
print("cameras:", ", ".join(camera.name for camera in design.cameras))
print("cubes:", ", ".join(f"{target.name} on the {target.body}" for target in design.targets))
