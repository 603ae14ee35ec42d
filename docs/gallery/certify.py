"""Certify a calibrated arm: a limit for 95 % of all poses, with 95 % confidence."""

from pathlib import Path

import calib
import rig
import synthetic

Path("rig.toml").write_text(rig.new_rig_toml(rig.LayoutOptions(arm="ur10")))
first = synthetic.simulate("rig.toml", synthetic.SimulateOptions(plan="sobol:40", seed=1))
first.write("REC")
first.write_truth("machine.json")
later = synthetic.SimulateOptions(plan="sobol:60", seed=2, machine=Path("machine.json"))
synthetic.simulate("rig.toml", later).write("LATER")

calibration = calib.calibrate(rig.load("REC")).calibration
result = calib.certify(calibration, rig.load("LATER"))
print(result)
print(f"{1e6 * result.certificate.promise.position.upper:.0f} µm")

try:
    calib.certify(calibration, rig.load("REC"))
except rig.RigError as error:  # what was used in fitting is no evidence
    print(str(error).split(";")[0])
