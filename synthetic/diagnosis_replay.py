"""Replay of a diagnosed recording: the same commands simulated with and without the effects found."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from rig.effects.catalogue.effect_list import BY_NAME
from rig.effects.texts.effect_notation import Kinds
from rig.errors import FileError, RigError
from rig.model import motion_simulation
from rig.planning.plan_construction_and_table import Plan
from rig.recording import recording_folder
from rig.recording.recording_folder import Sensors
from synthetic import secret_machine
from synthetic.recording_simulation import Simulation

KINDS = ("with", "without")


def replay_diagnosis(folder: Path, kinds: Kinds = BY_NAME) -> dict[str, Simulation]:
    """{"with", "without": Simulation} that replay a diagnosis folder, with and without the effects found.

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
        run = motion_simulation.run_machine(
            part.true,
            plan.commands,
            t,
            part.effects,
            sensors,
            rates=motion_simulation.has_rolling_shutter(part.true, part.effects),
        )
        out[kind] = Simulation(part, plan, sensors, sensors, run)
    return out
