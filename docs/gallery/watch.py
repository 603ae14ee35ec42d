"""Watch over a calibration by small visits, until one shows that a nut has worn."""

from pathlib import Path

import calib
import rig
import synthetic
from calib.drift.visit_history import History, calibration_file_sha256

Path("rig.toml").write_text(rig.new_rig_toml(rig.LayoutOptions(radius=0.3, cameras=3, cubes=3)))
first = synthetic.simulate("rig.toml", synthetic.SimulateOptions(plan="sobol:40", seed=1))
first.write("REC")
first.write_truth("machine.json")
calib.save("calibration.json", calib.calibrate(rig.load("REC")).calibration)

visits = []
for day, effects in enumerate([(), (), ("backlash:strut4:gap=80e-6",)]):
    options = synthetic.SimulateOptions(plan="sobol:12", seed=10 + day, machine=Path("machine.json"), effects=effects)
    synthetic.simulate("rig.toml", options).write(f"DAY{day}")
    visits.append(rig.load(f"DAY{day}"))

history = History(calibration_file_sha256(Path("calibration.json")))
result = calib.watch(calib.load("calibration.json"), visits, history)
print(result.verdict.line)
for visit in result.visits:
    print(visit.lines[0])
