"""Calibrate a hexapod from a recording, and save what was found."""

from pathlib import Path

import calib
import rig
import synthetic

Path("rig.toml").write_text(rig.new_rig_toml(rig.LayoutOptions(radius=0.3, cameras=3, cubes=3)))
synthetic.simulate("rig.toml", synthetic.SimulateOptions(plan="sobol:40", seed=1)).write("REC")

result = calib.calibrate(rig.load("REC"))
print(result)
calib.save("calibration.json", result.calibration)

ratio, low, high = result.calibration.claim.ratio
print(f"{ratio:.0f} times better all over the workspace, with 95 % confidence {low:.0f} to {high:.0f} times")
