"""Ask which physics the model omits: strut 3 of this simulated rig has 80 µm of backlash."""

from pathlib import Path

import calib
import rig
import synthetic

Path("rig.toml").write_text(rig.new_rig_toml(rig.LayoutOptions(radius=0.3, cameras=2, cubes=2)))
options = synthetic.SimulateOptions(plan="sobol:24,ladder", effects=("backlash:strut3:gap=80e-6",), seed=3)
synthetic.simulate("rig.toml", options).write("REC")

result = calib.diagnose(rig.load("REC"), calib.DiagnoseOptions(only=("backlash",)))  # all effects without `only`
print(result)
finding = result.report.findings[0]
gap, evidence = finding.parameters["gap"], finding.evidence
print(f"{finding.effect} at {finding.place}: {1e6 * gap.value:.0f} µm")
before, after = 1e6 * evidence.heldout_before, 1e6 * evidence.heldout_after
print(f"held-out error: {before:.1f} µm without it, {after:.1f} µm with it")
print(finding.action)
