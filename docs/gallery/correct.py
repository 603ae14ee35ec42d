"""Correct the commands for wanted poses, and see on the simulated machine what that gains."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

import calib
import rig
import synthetic

Path("rig.toml").write_text(rig.new_rig_toml(rig.LayoutOptions(radius=0.3, cameras=2, cubes=2)))
first = synthetic.simulate("rig.toml", synthetic.SimulateOptions(plan="sobol:40", seed=1))
first.write("REC")
first.write_truth("machine.json")
calibration = calib.calibrate(rig.load("REC")).calibration

home = rig.load_design("rig.toml").mechanism.home
moves = np.array([[0.02, 0.0, 0.0], [0.0, -0.03, 0.01], [0.01, 0.01, -0.02]])  # m
wanted = home * RigidTransform.from_translation(moves)
print(calib.correct(calibration, wanted))

for uncorrected in (True, False):
    result = calib.correct(calibration, wanted, calib.CorrectOptions(uncorrected=uncorrected))
    result.write(Path("commands.csv"))
    options = synthetic.SimulateOptions(plan="commands:commands.csv", machine=Path("machine.json"))
    reached = synthetic.simulate("rig.toml", options).simulation.run.T_base_platform
    miss = 1e3 * np.linalg.norm(reached.translation - wanted.translation, axis=1)
    print("nominal" if uncorrected else "corrected", "commands: off by", *(f"{size:.3f} mm" for size in miss))

try:
    calib.correct(calibration, home * RigidTransform.from_translation([0.0, 0.0, 0.3]))
except rig.RigError as error:
    print(str(error).split(";")[0])
