"""Choose the configurations that determine a hexapod's geometry best, and compare with evenly spread ones."""

from pathlib import Path

import calib
import rig

Path("rig.toml").write_text(rig.new_rig_toml(rig.LayoutOptions(radius=0.3)))
design = rig.load_design("rig.toml")
for line in rig.plan(design, "sobol:20").lines():
    print(line)

result = calib.plan(design, calib.PlanOptions(count=20))
print(result)
print(result.lines()[1])
result.write(Path("plan.csv"))
