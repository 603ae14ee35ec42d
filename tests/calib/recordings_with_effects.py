"""Recordings of secret machines with effects at work, for tests of the diagnosis."""

import numpy as np

from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.planning import recording_plan as plan
from rig.planning.layout.hexapod_layout_and_camera_placement import hexapod_layout_rig_toml
from rig.recording import recording_folder
from synthetic import random_true_machine_and_truth_file, recording_simulation

PLAN = "moving:12,sobol:40,ladder:10,moving:12,sobol:30"


def recorded(folder, design, effects, seed=5, route=PLAN, noise=0.04, logged=True):
    """Recording of a secret machine with effects (texts or Effects), its temperatures logged or not. noise : px"""
    rng = np.random.default_rng(seed)
    secret = random_true_machine_and_truth_file.random_true_machine(
        design, rng, 1.0, tuple(parse_effect(e) if isinstance(e, str) else e for e in effects)
    )
    recording_simulation.write_recording(
        recording_simulation.simulate_world(secret, plan.build_plan(design, route, seed), rng),
        folder,
        hexapod_layout_rig_toml(0.3),
        rng,
        noise,
    )
    if not logged:
        lines = [line.split(",") for line in (folder / "sensors.csv").read_text().splitlines()]
        columns = [i for i, name in enumerate(lines[0]) if "temperature" not in name]
        (folder / "sensors.csv").write_text("".join(",".join(line[i] for i in columns) + "\n" for line in lines))
    return recording_folder.load_recording(folder)
