"""Good recordings of several rigs to make mistakes in: corners, poses of a platform, an arm under a tracker, images."""

import shutil
from pathlib import Path

import numpy as np

from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import Arm
from rig.planning import configuration_generators
from rig.planning import recording_plan as plan
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.recording.corner_and_pose_csv_tables import write_poses
from rig.recording.recording_folder import Poses
from synthetic import random_true_machine_and_truth_file, recording_simulation
from tests.calib import secret_arms
from tests.conftest import BENCH

RIGS = {  # radius, cameras, width, height, cubes, frames, noise px
    0: (0.3, 3, 1280, 1024, 4, 60, 0.04),
    1: (0.22, 2, 800, 600, 3, 45, 0.15),
    2: (0.55, 4, 1920, 1200, 5, 40, 0.08),
}
JOINTS = np.array(
    [
        [0.0, 0.1273, 0.0, np.pi / 2],
        [0.0, 0.0, -0.612, 0.0],
        [0.0, 0.0, -0.5723, 0.0],
        [0.0, 0.1639, 0.0, np.pi / 2],
        [0.0, 0.1157, 0.0, -np.pi / 2],
        [0.0, 0.0922, 0.0, 0.0],
    ]
)


def recorded(
    folder: Path, number: int = 0, effects: tuple = (), size: float = 1.0
) -> tuple[random_true_machine_and_truth_file.World, recording_simulation.Simulation]:
    """A good recording at corner level of one of the RIGS, with its World and Simulation."""
    radius, cameras, width, height, cubes, frames, noise = RIGS[number]
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(
        radius, cameras=cameras, width=width, height=height, cubes=cubes
    )
    folder.mkdir(parents=True)
    (folder / "rig.toml").write_text(text)
    design, rng = design_from_rig_toml.load_design(folder / "rig.toml"), np.random.default_rng(100 + number)
    secret = random_true_machine_and_truth_file.random_true_machine(design, rng, size, effects)
    strokes = design.mechanism.strut_range
    route = plan.plan_of_configurations(
        configuration_generators.sobol_configurations(strokes, frames, seed=number),
        strokes.mean(axis=1),
        plan.planned_axis_speeds(design),
    )
    done = recording_simulation.simulate_world(secret, route, rng)
    recording_simulation.write_recording(done, folder, text, rng, noise)
    return secret, done


def make(kind: str, folder: Path, number: int = 0) -> Path:
    """A good recording of a kind in a folder. number : which rig"""
    if kind == "images":
        shutil.copytree(BENCH / ("fit", "check")[number % 2], folder)
    elif kind == "arm":
        rng = np.random.default_rng(number)
        nominal = Arm(JOINTS, np.tile([-2 * np.pi, 2 * np.pi], (6, 1)))
        secret_arms.write(folder, nominal, secret_arms.tracked(secret_arms.secret(nominal, rng), nominal, 80, rng))
    else:
        _, done = recorded(folder, number)
        if kind == "poses":
            (folder / "corners.csv").unlink()
            with open(folder / "rig.toml", "a") as file:
                file.write('\n[instrument]\nbase = "rig"\ntool = "rig"\nposition_sigma = 2e-5\nrotation_sigma = 1e-4\n')
            write_poses(folder / "poses.csv", Poses(np.arange(len(done.plan.t)), done.run.T_base_platform, None))
    return folder
