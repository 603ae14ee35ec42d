"""Simulate a recording of a rig whose strut 3 has backlash, and read it back."""

from pathlib import Path

import rig
import synthetic

Path("rig.toml").write_text(rig.new_rig_toml(rig.LayoutOptions(radius=0.3, cameras=2, cubes=2)))
options = synthetic.SimulateOptions(plan="sobol:6", effects=("backlash:strut3:gap=40e-6",), seed=1)
made = synthetic.simulate("rig.toml", options)
print(made)
made.write("REC")  # rig.toml, commands.csv, frames.csv, sensors.csv, corners.csv
made.write_truth("truth.json")  # the secret machine, in a file of its own

recording = rig.load("REC")
print(f"{len(recording.commands.t)} rows of commands over {recording.commands.t[-1]:.1f} s")
print(f"{len(recording.corners.uv)} corners in {len(set(recording.exposures.frame.tolist()))} frames")
