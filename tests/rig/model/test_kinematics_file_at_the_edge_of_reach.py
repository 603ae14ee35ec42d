"""Five bars, of which no travel is all within reach: near its edge derivatives exist, and nothing beyond it counts."""

import numpy as np

import calib
from rig.model import mechanisms
from rig.model.pose import pose
from rig.recording import recording_folder

FILE = '''"""Five bars: two cranks, two rods, a point."""

import numpy as np

from rig.model.mechanisms import Axis, Parameter

axes = (Axis("left", "rad", 0.6, 3.3), Axis("right", "rad", -0.3, 2.6))
parameters = (
    Parameter("pivots", [[-0.1, 0.0], [0.1, 0.0]], "m", 5e-4),
    Parameter("cranks", [0.2, 0.2], "m", 5e-4),
    Parameter("rods", [0.3, 0.3], "m", 5e-4),
    Parameter("zeros", [0.0, 0.0], "rad", 2e-3),
)
freedoms = ("x", "y")
home = (0.0, 0.35, 0.0, 0.0, 0.0, 0.0)


def inverse(pose, p):
    d = pose[..., None, :2, 3] - p["pivots"]
    r = np.sqrt((d**2).sum(axis=-1))
    cosine = (p["cranks"] ** 2 + r**2 - p["rods"] ** 2) / (2 * p["cranks"] * r)
    return np.arctan2(d[..., 1], d[..., 0]) + np.array([1.0, -1.0]) * np.arccos(cosine) - p["zeros"]
'''
RIG = """schema = "rig/1"
[mechanism]
kind = "file:fivebar.py"
[instrument]
base = "rig"
tool = "rig"
position_sigma = 8e-6
"""
LEFT, RIGHT, CRANK, ROD = np.array([-0.1, 0.0]), np.array([0.1, 0.0]), 0.2, 0.3


def point_of_cranks(left, right, rods):
    """(2,) m, where two circles about the cranks' ends cross, the upper one."""
    a = LEFT + CRANK * np.array([np.cos(left), np.sin(left)])
    b = RIGHT + CRANK * np.array([np.cos(right), np.sin(right)])
    apart = np.linalg.norm(b - a)
    along = (rods[0] ** 2 - rods[1] ** 2 + apart**2) / (2 * apart)
    u = (b - a) / apart
    return a + along * u + np.sqrt(rods[0] ** 2 - along**2) * np.array([-u[1], u[0]])


def cranks_of_point(p):
    """(2,) rad of the stated machine, elbows outwards."""
    out = []
    for pivot, side in ((LEFT, 1), (RIGHT, -1)):
        r = np.linalg.norm(p - pivot)
        cosine = (CRANK**2 + r**2 - ROD**2) / (2 * CRANK * r)
        out.append(np.arctan2(p[1], p[0] - pivot[0]) + side * np.arccos(cosine))
    return np.array(out)


def recorded(folder):
    """Recording of a machine whose left rod is 0.8 mm longer than stated."""
    rng = np.random.default_rng(1)
    q = np.array([cranks_of_point(p) for p in rng.uniform([-0.12, 0.24], [0.12, 0.42], (60, 2))])
    seen = [point_of_cranks(*one, (ROD + 8e-4, ROD)) + rng.normal(0, 8e-6, 2) for one in q]
    (folder / "fivebar.py").write_text(FILE)
    (folder / "rig.toml").write_text(RIG)
    (folder / "frames.csv").write_text("frame,t,camera,image\n" + "".join(f"{i},{10 * i + 5},,\n" for i in range(60)))
    rows = [f"{10 * i + wait},{a:.12f},{b:.12f}\n" for i, (a, b) in enumerate(q) for wait in (4, 6)]
    (folder / "commands.csv").write_text("t,left,right\n" + "".join(rows))
    (folder / "poses.csv").write_text(
        "frame,x,y,z\n" + "".join(f"{i},{x:.9f},{y:.9f},0.0\n" for i, (x, y) in enumerate(seen))
    )
    return recording_folder.load_recording(folder)


def test_a_machine_whose_travel_is_not_all_within_reach_is_calibrated(tmp_path):
    recording = recorded(tmp_path)
    calibrated = calib.calibrate(recording)
    assert calibrated.calibration.held_out.after.mean[0] < 3 * 8e-6
    names = [name for name in recording.design.mechanism.stated.names]
    fitted = calibrated.calibration.correction.fitted.parameters
    rods = [k for k, name in enumerate(names) if "rods" in name]
    assert abs(fitted[rods[0]] - ROD - 8e-4) < 4e-4


def test_derivatives_exist_up_to_the_edge_of_reach(tmp_path):
    mechanism = recorded(tmp_path).design.mechanism
    kinematics = mechanisms.kinematics_of(mechanism)
    edge = np.array([LEFT[0] + (CRANK + ROD) * np.cos(1.1), (CRANK + ROD) * np.sin(1.1)])
    near = edge * (1 - 1e-4)
    J = kinematics.jacobian(pose([*near, 0.0], [0.0, 0.0, 0.0]), mechanism)
    plain = [(cranks_of_point(near + s) - cranks_of_point(near - s)) / 2e-9 for s in np.eye(2) * 1e-9]
    assert np.abs(J[:, :2] - np.transpose(plain)).max() < 1e-3 * np.abs(J).max()
