"""Hold a calibration against a recording of another day."""

from pathlib import Path

import calib
import rig
import synthetic

Path("rig.toml").write_text(rig.new_rig_toml(rig.LayoutOptions(arm="ur10")))
first = synthetic.simulate("rig.toml", synthetic.SimulateOptions(plan="sobol:40", seed=1))
first.write("REC")
first.write_truth("machine.json")  # the next day it is the same machine
later = synthetic.SimulateOptions(plan="sobol:20", seed=2, machine=Path("machine.json"))
synthetic.simulate("rig.toml", later).write("LATER")

calibration = calib.calibrate(rig.load("REC")).calibration
print(calib.verify(calibration, rig.load("LATER")))
