"""Ask why an arm is off: five lines from a recording of joint values and measured poses."""

from pathlib import Path

import calib
import rig
import synthetic

Path("rig.toml").write_text(rig.new_rig_toml(rig.LayoutOptions(arm="ur10")))
options = synthetic.SimulateOptions(plan="sobol:60", effects=("scale_error:joint2:scale=1e-3",), seed=1)
synthetic.simulate("rig.toml", options).write("REC")

for line in calib.why(Path("REC")).lines():
    print(line)
