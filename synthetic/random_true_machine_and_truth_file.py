"""True machine of a simulation, drawn at random, and its truth file.

Drawn at random: geometry, cameras, temperatures, remounted cubes.
"""

import json
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.effects.catalogue.effect_list import ALL, BY_NAME
from rig.effects.framework.effect_base_class import Effect
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import Kinds
from rig.errors import RigError
from rig.formats import machine_geometry_and_effects_json_file
from rig.formats.output_files import write_text
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.design import Camera, Design, quarter_turns_of_cubes
from rig.model.design_contradictions_and_cube_quarter_turns import design_with_turned_cubes
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Commanded,
    has_links,
    has_stages,
    has_struts,
    is_parallel,
)
from rig.model.mechanisms.user_kinematics_file_mechanism import with_random_parameters
from rig.model.pose import exp, pose
from rig.recording.recording_folder import Sensors

JOINT = 3e-4  # m, standard deviation of a joint's coordinate from where the owner has it
OF_TOLERANCE = 0.6  # standard deviation of a kinematics file's parameters, of their tolerances
ZERO = 3e-4  # m, of a strut's zero
ROW = np.array([1e-3, 3e-4, 3e-4, 1e-3, 0.0])  # rad, m, m, rad, rad: of an arm's theta, d, a, alpha, beta
ASKEW = 1e-4  # rad, greatest of axes that are parallel by design
BRANCH = np.repeat([3e-4, 1e-3], 3)  # m, rad, of how a branch is mounted on its link
STOOD = (3e-3, 5e-3)  # m, rad, of where an arm that cameras see stands, and of its hand
AWAY, HAND = 1.0, 0.1  # m, of where an instrument stands and of its target on the hand, where nobody knows


def random_true_geometry(stated: Design, rng: np.random.Generator, size: float) -> Commanded:
    """True geometry of a stated design's mechanism drawn at random.

    size : multiplies every deviation.
    Raises RigError for a kind that cannot be simulated
    """
    m = stated.mechanism
    if has_struts(m):
        drawn = {
            name: array + size * (ZERO if name == "strut_zeros" else JOINT) * rng.normal(size=array.shape)
            for name, array in m.geometry_arrays.items()
        }
        return replace(m, **drawn)  # type: ignore[arg-type]
    if is_parallel(m):  # of a kinematics file
        return with_random_parameters(m, rng, size * OF_TOLERANCE)
    if has_links(m):
        return _arm(m, stated, rng, size)
    if has_stages(m):
        stages = tuple(
            random_true_geometry(replace(stated, mechanism=stage, cameras=()), rng, size) for stage in m.stages
        )
        return replace(m, stages=stages)  # type: ignore[arg-type]
    raise RigError(f"a mechanism of kind {m.kind!r} cannot be simulated; {', '.join(mechanisms.ALL)} can")


def _arm(m: Arm, stated: Design, rng: np.random.Generator, size: float) -> Arm:
    rows = m.rows + size * ROW * rng.normal(size=m.rows.shape)
    flat = np.abs(np.cos(m.rows[:, 3])) > 0.999
    rows[flat, 3:] = m.rows[flat, 3:] + size * ASKEW * rng.uniform(-1, 1, (flat.sum(), 2))
    ends, instrument = [m.base, m.tool], stated.instrument
    if (
        instrument is None and stated.cameras and stated.targets
    ):  # where it stands among the cubes, and how its hand holds them
        ends = [end * exp(size * np.repeat(STOOD, 3) * rng.normal(size=6)) for end in ends]
    for k, (place, far) in enumerate(zip(m.placements, (AWAY, HAND))):
        if instrument is not None and getattr(instrument, place) == "free":
            ends[k] = pose(far * rng.uniform(-1, 1, 3), rng.normal(size=3))
    if not m.hands:
        return replace(m, joints=rows, base=ends[0], tool=ends[1])
    free = instrument is not None and instrument.tool == "free"
    seen = instrument is None and stated.cameras and stated.targets
    off = [size * np.repeat(STOOD, 3) * rng.normal(size=6) * bool(seen) for _ in m.hands]
    tools = [
        pose(HAND * rng.uniform(-1, 1, 3), rng.normal(size=3)) if free else hand.tool * exp(move)
        for hand, move in zip(m.hands, off)
    ]
    branches = tuple(replace(b, mount=b.mount * exp(size * BRANCH * rng.normal(size=6))) for b in m.branches)
    hands = tuple(replace(hand, tool=tool) for hand, tool in zip(m.hands, tools))
    return replace(m, joints=rows, base=ends[0], branches=branches, hands=hands)


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
    effects: tuple[Any, ...] = ()


def random_true_machine(
    stated: Design, rng: np.random.Generator, size: float = 1.0, effects: Iterable[Effect] = ()
) -> World:
    """Secret machine (World) drawn at random around a stated design.

    size : multiplies every deviation
    """
    m = random_true_geometry(stated, rng, size)
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


def strut_count(mechanism: Commanded) -> int:
    """Number of struts of a mechanism.

    None for an arm.
    """
    return len(mechanism.axes) if mechanisms.kinematics_of(mechanism).AXIS == "strut" else 0


def random_true_and_logged_temperatures(
    duration: float, rng: np.random.Generator, struts: int = 6
) -> tuple[Sensors, Sensors]:
    """True and logged temperatures drawn at random over a duration (s).

    Channels ambient_temperature_C and, for so many struts, strut1_temperature_C ..; the log is the truth every
    LOG_EVERY s, with noise.

    Returns (true Sensors, logged Sensors)
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


def write_truth(path: Path, world: World, T_base_platform: RigidTransform, **more: object) -> None:
    """Write the truth file of a recording (JSON).

    The machine, its effects and its poses.
    """
    tree = machine_geometry_and_effects_json_file.machine_dict(world.true, world.effects)
    write_text(path, json.dumps({**tree, "poses": T_base_platform.as_matrix().reshape(-1, 16).tolist(), **more}) + "\n")


def load_world_from_truth_file(path: Path, stated: Design, kinds: Kinds = BY_NAME) -> World:
    """World read from a truth file.

    The same machine and cameras.
    kinds : known effects
    """
    return World(stated, *machine_geometry_and_effects_json_file.load_machine(path, stated, kinds))


SEAT = np.repeat([1e-4, 1e-3], 3)  # m, rad, by which a cube that is put back sits off


def world_with_remounted_cubes(world: World, quarters: Mapping[str, int]) -> World:
    """The World with cubes remounted at quarters {cube: quarter turns}, with the small errors of remounting.

    Raises RigError for a cube that there is not
    """
    stated = design_with_turned_cubes(world.stated, quarters)
    stands = quarter_turns_of_cubes(stated)
    if not stands:
        return world
    own = zlib.crc32(
        np.array([np.round(camera.matrix, 6) for camera in world.true.cameras]).tobytes()
    )  # a truth file has the same

    displaced = next(kind for kind in ALL if kind.view == "targets")  # all markers of a target moved together
    motion = displaced.parameters[0].name

    def off(name: str, quarter: int) -> Effect:
        rng = np.random.default_rng([own, zlib.crc32(name.encode()), quarter])
        return displaced(str(Place("target", name)), **{motion: tuple((SEAT * rng.normal(size=6)).tolist())})

    return World(
        stated,
        design_with_turned_cubes(world.true, stands),
        (*world.effects, *(off(name, quarter) for name, quarter in stands.items())),
    )
