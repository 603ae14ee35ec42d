"""Simulation of a diagnosed recording: its commands simulated with and without the effects found."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from rig.effects.catalogue.effect_list import BY_NAME
from rig.effects.texts.effect_text_and_dict import Kinds
from rig.errors import FileError, RigError
from rig.model import motion_simulation
from rig.planning.plan_construction_and_table import Plan
from rig.recording import recording_folder
from rig.recording.recording_folder import Sensors
from synthetic import secret_machine
from synthetic.recording_simulation import Simulation

KINDS = ("with", "without")


def simulate_diagnosed_recording(folder: Path, kinds: Kinds = BY_NAME) -> dict[str, Simulation]:
    """Simulate a diagnosed recording's commands with and without the effects found: {with, without: Simulation}.

    kinds : effects that there are

    Raises FileError for a folder that holds no diagnosed recording, RigError where nothing was commanded
    """
    path = folder / "machine.json"
    if not path.exists():
        raise FileError(
            path, "no such file; --from takes a folder that `rig diagnose` wrote from a commanded recording"
        )
    found = recording_folder.load_recording(folder)
    if found.commands is None:
        raise RigError(f"{folder}: nothing was commanded, so there is no motion to simulate")
    secret = secret_machine.world_from_truth(path, found.design, kinds)
    _, t = found.exposures.times()
    sensors = found.sensors or Sensors(np.array([found.commands.t[0]]), {})
    plan = Plan(found.commands, t, np.array([(0.0, 0.0)]), found.origin)
    out = {}
    for kind in KINDS:
        part = secret if kind == "with" else replace(secret, effects=())
        run = motion_simulation.simulate_machine_run(
            part.true,
            plan.commands,
            t,
            part.effects,
            sensors,
            rates=motion_simulation.has_rolling_shutter(part.true, part.effects),
        )
        out[kind] = Simulation(part, plan, sensors, sensors, run)
    return out
