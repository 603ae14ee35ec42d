"""Measure the platform's poses from corners in images, with their covariance."""

from pathlib import Path

import numpy as np

import rig
import synthetic
import vision

Path("rig.toml").write_text(rig.new_rig_toml(rig.LayoutOptions(radius=0.3, cameras=3, cubes=3)))
made = synthetic.simulate("rig.toml", synthetic.SimulateOptions(plan="sobol:10", seed=1))
made.write("REC")

result = vision.measure(rig.load("REC"))
print(result)
found = result.measurement.T_base_platform
true = made.simulation.run.T_base_platform
error = 1e3 * np.linalg.norm(found.translation - true.translation, axis=1)
print(f"against simulated truth: {np.sqrt(np.mean(error**2)):.3f} mm RMS, {error.max():.3f} mm at most")
