"""A secret machine: what its owner believes, and what it really is, drawn at random and kept apart."""

import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.effects.catalogue.effect_list import BY_NAME
from rig.effects.framework.effect import Effect
from rig.effects.texts.effect_text import Kinds
from rig.formats import machine_json
from rig.formats.output_files import write_text
from rig.model import mechanisms
from rig.model.design import Arm, Camera, Chain, Design, Hexapod, Planar2
from rig.model.pose import exp
from rig.recording.recording_folder import Sensors
from synthetic import secret_geometry

MOUNT = (3e-3, 5e-3)  # m, rad, of a camera's stated pose
FOCAL, CENTRE = 4e-4, 1.0  # of the focal length; px
DISTORTION = np.array([1e-3, 5e-3, 5e-5, 5e-5, 0.0])  # of k1 k2 p1 p2 k3
LIMB = 2e-4  # m, of a measuring limb's joints and zero
LOG_EVERY = 30.0  # s between rows of sensors.csv
LOG_NOISE = 0.03  # K


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """stated : Design as its owner believes it; true : Design as it is; effects : what is at work besides."""

    stated: Design
    true: Design
    effects: tuple = ()


def draw_machine(stated: Design, rng: np.random.Generator, size: float = 1.0, effects: Iterable[Effect] = ()) -> World:
    """World around a stated design. rng : numpy Generator; size : multiplies every deviation; effects : Effects at
    work.
    """
    m = secret_geometry.draw_geometry(stated, rng, size)
    true = replace(stated, mechanism=m, cameras=tuple(_camera(camera, rng, size) for camera in stated.cameras))
    limbs = stated.insitu
    if limbs is not None:
        n = len(limbs.channels)
        off = np.split(size * LIMB * rng.normal(size=7 * n), [3 * n, 6 * n])
        true = replace(
            true,
            insitu=replace(
                limbs,
                base_joints=limbs.base_joints + off[0].reshape(n, 3),
                platform_joints=limbs.platform_joints + off[1].reshape(n, 3),
                zeros=limbs.zeros + off[2],
            ),
        )
    return World(stated, true, tuple(effects))


def _camera(camera: Camera, rng: np.random.Generator, size: float) -> Camera:
    moved = camera.pose * exp(size * np.r_[MOUNT[0] * rng.normal(size=3), MOUNT[1] * rng.normal(size=3)])
    matrix = camera.matrix.copy()
    matrix[[0, 1], [0, 1]] *= 1 + size * FOCAL * rng.normal()
    matrix[:2, 2] += size * CENTRE * rng.normal(size=2)
    terms = np.zeros(len(camera.distortion))
    terms[: min(5, len(terms))] = (size * DISTORTION * rng.normal(size=5))[: len(terms)]
    return replace(camera, pose=moved, matrix=matrix, distortion=camera.distortion + terms)


def strut_count(mechanism: Hexapod | Planar2 | Arm | Chain) -> int:
    """How many struts a mechanism has: none for an arm."""
    return len(mechanism.axes) if mechanisms.kinematics_of(mechanism).AXIS == "strut" else 0


def draw_temperatures(duration: float, rng: np.random.Generator, struts: int = 6) -> tuple[Sensors, Sensors]:
    """(true Sensors, logged Sensors) over a duration (s): the room drifts by a kelvin or two, struts warm up by as much
    again.

    Channels ambient_temperature_C and, for so many struts, strut1_temperature_C ..; the log is the truth every
    LOG_EVERY s, with noise.
    """
    t = np.arange(0.0, duration + LOG_EVERY, LOG_EVERY)
    room = (
        20
        + rng.uniform(-1, 1)
        + rng.uniform(0.3, 1.2) * np.sin(2 * np.pi * t / rng.uniform(3000, 9000) + rng.uniform(0, 6.28))
    )
    true = {"ambient_temperature_C": room}
    for i in range(struts):
        true[f"strut{i + 1}_temperature_C"] = room + rng.uniform(1, 3) * (1 - np.exp(-t / rng.uniform(600, 2400)))
    log = {name: np.round(values + LOG_NOISE * rng.normal(size=len(t)), 3) for name, values in true.items()}
    return Sensors(t, true), Sensors(t, log)


def write_truth(path: Path, world: World, T_base_platform: RigidTransform, **more: Any) -> None:
    """Write the truth of a recording as JSON: the machine as it is, its effects, poses as row-major 4 x 4, and more."""
    tree = machine_json.machine_dict(world.true, world.effects)
    write_text(path, json.dumps({**tree, "poses": T_base_platform.as_matrix().reshape(-1, 16).tolist(), **more}) + "\n")


def world_from_truth(path: Path, stated: Design, kinds: Kinds = BY_NAME) -> World:
    """World of a truth file: the same machine and cameras again. kinds : effects that there are. Raises FileError for a
    file that is none.
    """
    return World(stated, *machine_json.load_machine(path, stated, kinds))
