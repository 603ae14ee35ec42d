"""Simulation of a recording.

A secret machine is run under a plan, written as a folder; the truth is stored separately.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Booleans, Floats
from rig.formats.output_files import write_text
from rig.formats.rig_toml.mechanism_entries import write_kinematics_file
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.arm_hands_effect_places_and_tolerances import hand_names
from rig.model.base_and_link_tilt_sensors import SENSOR_AXES
from rig.model.design import Camera, Design, Instrument, MeasuringLimbs, quarter_turns_of_cubes
from rig.model.design_contradictions_and_cube_quarter_turns import rig_toml_with_turns
from rig.model.mechanisms import redundant_strut_best_six_legs_and_loop_closures
from rig.model.mechanisms.arm_kinematics_limits_and_loads import single_hand_arm_link_frames
from rig.model.mechanisms.mechanism_kinds_and_kinematics import has_links, is_redundant, require_axes
from rig.model.pose import exp, pose_to_vector, transform_points
from rig.planning.recording_plan import sensors_with_payload
from rig.planning.timed_plan_and_visiting_order import Plan
from rig.recording.corner_and_pose_csv_tables import DISTANCE, POSE_COLUMNS, Corners, write_corners, write_table
from rig.recording.recording_folder import LIMB, Sensors, sensors_with_gravity
from synthetic import random_true_machine_and_truth_file as worlds
from synthetic.marker_drawing_sensor_and_occlusion import is_occluded
from synthetic.random_true_machine_and_truth_file import world_with_remounted_cubes
from vision.marker_corner_prediction import (
    MarkerMap,
    Sightings,
    State,
    is_inside_image,
    marker_map,
    predict_sightings,
    sightings_facing_cameras_anywhere,
)

EXACT = Instrument("rig", "rig", 0.0, 0.0)  # where nobody says what measured the poses
STEEPEST = np.cos(np.radians(70))  # corners are written of markers seen no more obliquely


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """A recording before it is written.

    world : World; plan : Plan; sensors : Sensors as they truly were; log : Sensors as logged; run : MachineRun at the
        exposures
    """

    world: worlds.World
    plan: Plan
    sensors: Sensors
    log: Sensors
    run: motion_simulation.MachineRun

    def at_times(self, t: Floats) -> list[RigidTransform]:
        """[T_base_stage : RigidTransform (n,)] of what the simulated machine moves at other times t (n,) s, as the
        cameras log them: the platform last, alone but of a chain."""
        order = np.argsort(t, kind="stable")
        run = motion_simulation.simulate_machine_run(
            self.world.true, self.plan.commands, np.asarray(t)[order], self.world.effects, self.sensors
        )
        back = np.argsort(order)
        return [T[back] for T in poses_of_each_stage_and_platform(run)]

    def hand_pose_of_each_row(self) -> dict[str, RigidTransform]:
        """{name of a hand: T_base_platform (n,)} at the exposures; one without a name where there are not several."""
        names = hand_names(self.world.true.mechanism)
        if not names:
            return {"": self.run.T_base_platform}
        return dict(zip(names, (self.run.T_base_platform, *self.run.stages)))


class PictureWriter(Protocol):
    """What draws the images of a Simulation: `synthetic.image_simulation.Images`."""

    def write_pictures(
        self, simulation: Simulation, out: Path, seed: int, progress: Callable[[int, int], None] | None = None
    ) -> None:
        """Write every image into out/images. seed : of the noise; progress : called with (done, of) pictures."""
        ...


def poses_of_each_stage_and_platform(run: motion_simulation.MachineRun) -> list[RigidTransform]:
    """Poses T_base_stage (n,) of each stage of a Run, the platform last."""
    return [*run.stages, run.T_base_platform]


def simulate_world(
    world: worlds.World, plan: Plan, rng: np.random.Generator, known_sensors: Sensors | None = None
) -> Simulation:
    """Simulate a World under a plan.

    Cubes remounted, temperatures drawn, the machine run.
    known_sensors : Sensors as they truly are and as they are logged, in place of drawn temperatures and the plan's
        payload, or None
    """
    world = world_with_remounted_cubes(world, dict(plan.turned))
    if known_sensors is None:
        true, log = worlds.random_true_and_logged_temperatures(
            plan.commands.t[-1], rng, worlds.strut_count(require_axes(world.true.mechanism))
        )
        sensors, log = sensors_with_payload(plan, true), sensors_with_payload(plan, log)
    else:
        sensors = log = known_sensors
    sensors, log = (sensors_with_gravity(world.true.gravity, world.true.tilts, one) for one in (sensors, log))
    run = motion_simulation.simulate_machine_run(
        world.true,
        plan.commands,
        plan.t,
        world.effects,
        sensors,
        rates=motion_simulation.has_rolling_shutter(world.true, world.effects),
    )
    read = motion_simulation.commands_with_followers(world.true, plan.commands, plan.t, world.effects, sensors)
    plan = replace(plan, commands=read)
    if world.true.insitu is not None:
        log = _with_limbs(log, plan.t, run.T_base_platform, world.true.insitu, rng)
    if world.true.tilt_sensors:
        log = _with_readings(log, plan.t, _tilt_channels(world, plan, run, sensors, rng))
    return Simulation(world, plan, sensors, log, run)


def rms_length_conflict_of_actuated_struts(simulation: Simulation) -> float | None:
    """RMS length (m) of the conflict between driven struts.

    More than six give way to each other by it; it is over exposures and struts.
    None for six, and with followers
    """
    m, run = simulation.world.true.mechanism, simulation.run
    if not is_redundant(m) or m.followers:
        return None
    lengths = simulation.plan.commands.at(simulation.plan.t) + run.deviation
    return float(
        np.sqrt(
            np.mean(
                np.square(
                    redundant_strut_best_six_legs_and_loop_closures.incompatible_strut_length_component(
                        run.T_base_platform, lengths, m
                    )
                )
            )
        )
    )


def _with_limbs(log: Sensors, t: Floats, T: RigidTransform, limbs: MeasuringLimbs, rng: np.random.Generator) -> Sensors:
    """The log with the measuring limbs' readings at exposures t (n,) s, a row for each."""
    legs = transform_points(T, limbs.platform_joints) - limbs.base_joints
    read = np.linalg.norm(legs, axis=-1) - limbs.zeros + limbs.length_sigma * rng.normal(size=legs.shape[:2])
    return _with_readings(log, t, dict(zip(limbs.channels, read.T)))


def _with_readings(log: Sensors, t: Floats, readings: dict[str, Floats]) -> Sensors:
    """The log with readings {channel: (n,)} at exposures t (n,) s, a row for each."""
    rows = np.union1d(log.t, t)
    channels = {name: np.interp(rows, log.t, values) for name, values in log.channels.items()}
    return Sensors(rows, channels | {name: np.interp(rows, t, own) for name, own in readings.items()})


def _tilt_channels(
    world: worlds.World, plan: Plan, run: motion_simulation.MachineRun, sensors: Sensors, rng: np.random.Generator
) -> dict[str, Floats]:
    """{channel: (n,) rad} that tilt sensors show at the exposures, mounted to within what is stated."""
    m, out = world.true.mechanism, dict[str, Floats]()
    state = motion_simulation.motion_of_commands(world.true, plan.commands, plan.t, world.effects, sensors)
    lean = motion_simulation.base_lean_rotation_vectors(
        world.true, plan.commands, plan.t, run.T_base_platform, world.effects, sensors
    )
    platform = run.T_base_platform.rotation.as_matrix()
    links = (
        single_hand_arm_link_frames(state.lengths + run.deviation, m)[..., :3, :3]
        if has_links(m)
        else np.stack([platform] * 2, 1)
    )
    down = Rotation.from_rotvec(-lean * has_links(m)).apply(np.array(state.gravity_in_base()))
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    for sensor in world.true.tilt_sensors:
        off = Rotation.from_rotvec(sensor.mount_sigma * rng.normal(size=3))
        real = replace(sensor, mount=(Rotation.from_rotvec(sensor.mount) * off).as_rotvec())
        read = real.shown(links[:, sensor.link], down) + sensor.sigma * rng.normal(size=(len(plan.t), 2))
        out |= {f"tilt_{sensor.name}_{axis}_rad": own for axis, own in zip(SENSOR_AXES, read.T)}
    return out


def visible_marker_sightings_and_corners(
    simulation: Simulation, max_viewing_angle: float = STEEPEST
) -> tuple[Sightings, Floats]:
    """Visible markers' sightings and corners.

    Returns (Sightings, corners (k, 4, 2) px) facing a camera, inside its image, not occluded
    """
    world = simulation.world
    stated = real = marker_map(world.true)
    for effect in world.effects:
        real = effect.attach(real)
    parts = [_sight_of(simulation, stage, stated, real, max_viewing_angle) for stage in np.unique(real.stage).tolist()]
    found = Sightings(*(np.concatenate([getattr(f, name) for f, _ in parts]) for name in ("frame", "camera", "marker")))
    return found, np.concatenate([uv for _, uv in parts])


def _sight_of(
    simulation: Simulation, stage: int, stated: MarkerMap, real: MarkerMap, steepest: float
) -> tuple[Sightings, Floats]:
    """The same of the base's and the platform's markers (stage 0) or of those on a stage of a chain below the last (its
    number).
    """
    world, run = simulation.world, simulation.run
    body = _body(simulation, stage)
    state = State(
        world.true.cameras, body.T_base_platform, carried_camera_poses(world.true.cameras, run.T_base_platform)
    )
    found = sightings_facing_cameras_anywhere(state, real, steepest)
    found = found.take(real.stage[found.marker] == stage)
    uv = predict_sightings(found, state, stated, simulation.plan.t, world.effects, simulation.sensors, body)
    whole = is_inside_image(found, uv, state.cameras)
    found, uv = found.take(whole), uv[whole]
    clear = ~_covered(world.true, poses_of_each_stage_and_platform(run), body.T_base_platform, real, found)
    return found.take(clear), uv[clear]


def _body(simulation: Simulation, stage: int) -> motion_simulation.MachineRun:
    """The Run as markers on a stage of a chain have it: that stage's platform in the place of the last; the Run itself
    for stage 0.
    """
    run, t = simulation.run, simulation.plan.t
    if not stage:
        return run
    T = run.stages[stage - 1]
    if run.rate is None:
        return replace(run, T_base_platform=T)
    before, after = (
        simulation.at_times(t + step)[stage - 1] for step in (-motion_simulation.ABOUT, motion_simulation.ABOUT)
    )
    rate, curvature = motion_simulation.pose_rates_and_curvatures(T, before, after)
    return replace(run, T_base_platform=T, rate=rate, curvature=curvature)


def carried_camera_poses(cameras: tuple[Camera, ...], T_base_platform: RigidTransform) -> dict[int, RigidTransform]:
    """Poses {index: T_base_camera (F,)} of cameras carried by a platform.

    At poses (F,) of the platform.
    """
    return {i: T_base_platform * camera.pose for i, camera in enumerate(cameras) if camera.mount == "hand"}


def _covered(
    design: Design, stages: list[RigidTransform], T: RigidTransform, markers: MarkerMap, found: Sightings
) -> Booleans:
    """(k,) bool, whether a corner, an edge's middle or the middle of a marker is hidden. stages : of
    `poses_of_each_stage_and_platform`; T : (F,) of what carries them"""
    square = markers.corners[found.marker]
    points = np.concatenate(
        [square, (square + np.roll(square, -1, axis=1)) / 2, square.mean(axis=1, keepdims=True)], axis=1
    )
    matrix = T.as_matrix()[found.frame]
    on = markers.on_platform[found.marker]
    base = np.where(on[:, None, None], points @ np.swapaxes(matrix[:, :3, :3], 1, 2) + matrix[:, None, :3, 3], points)
    camera_positions = np.empty((len(found.frame), 3))
    moving = carried_camera_poses(design.cameras, stages[-1])
    for i, camera in enumerate(design.cameras):
        rows = found.camera == i
        camera_positions[rows] = moving[i].translation[found.frame[rows]] if i in moving else camera.pose.translation
    count = points.shape[1]
    blocked = is_occluded(
        design, stages, np.repeat(found.frame, count), np.repeat(camera_positions, count, axis=0), base.reshape(-1, 3)
    )
    return np.any(blocked.reshape(-1, count), axis=1)


def noisy_corners(simulation: Simulation, noise: float, rng: np.random.Generator) -> Corners:
    """Corners of a simulation with Gaussian noise (px) on each coordinate."""
    found, uv = visible_marker_sightings_and_corners(simulation)
    names = [camera.name for camera in simulation.world.true.cameras]
    order = np.lexsort((found.marker, found.camera, found.frame))
    found, uv = found.take(order), uv[order].reshape(-1, 2)
    ids = marker_map(simulation.world.stated).id
    return Corners(
        np.repeat(found.frame, 4),
        [names[i] for i in np.repeat(found.camera, 4)],
        np.repeat(ids[found.marker], 4),
        np.tile(np.arange(4), len(found.frame)),
        uv + noise * rng.normal(size=uv.shape),
        None,
    )


def write_recording(
    simulation: Simulation,
    out: Path,
    rig_toml_text: str,
    rng: np.random.Generator,
    noise: float = 0.0,
    images: PictureWriter | None = None,
    progress: Callable[[int, int], None] | None = None,
    corrupt_corners: Callable[[Corners], Corners] | None = None,
) -> None:
    """Write the recording folder of a simulation.

    It is as its owner would have it.
    out : folder; rig_toml_text : the owner's rig.toml; noise : px, to write corners; or images : what renders them
    progress : called with (done, of) pictures, or None; corrupt_corners : what happens to Corners (-> Corners) before
        they are written, or None
    """
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    plan, cameras, axes = simulation.plan, simulation.world.true.cameras, simulation.world.stated.mechanism.axes
    shown = {
        t: plan.origin.text(round(t, 6))
        for t in {*plan.commands.t.tolist(), *plan.t.tolist(), *simulation.log.t.tolist()}
    }
    write_text(out / "rig.toml", rig_toml_with_turns(rig_toml_text, quarter_turns_of_cubes(simulation.world.stated)))
    write_kinematics_file(out, simulation.world.stated.mechanism)
    write_table(
        out / "commands.csv",
        ("t", *axes),
        [
            f"{shown[t]}," + ",".join(f"{v:.7f}" for v in values)
            for t, values in zip(plan.commands.t, plan.commands.values)
        ],
    )
    write_table(
        out / "frames.csv",
        ("frame", "t", "camera", "image"),
        [
            f"{f},{shown[t]},{name}," + (f"images/{name}/{f:05d}.png" if images else "")
            for f, t in enumerate(plan.t)
            for name in ([c.name for c in cameras] or [""])
        ],
    )
    log = simulation.log
    if log.channels:
        digits = {name: 8 if LIMB.fullmatch(name) or name.endswith("_rad") else 3 for name in log.channels}
        write_table(
            out / "sensors.csv",
            ("t", *log.channels),
            [
                f"{shown[t]}," + ",".join(f"{values[i]:.{digits[name]}f}" for name, values in log.channels.items())
                for i, t in enumerate(log.t)
            ],
        )
    instrument, looks = simulation.world.stated.instrument, bool(cameras and simulation.world.stated.targets)
    if instrument is not None or not looks:
        _write_measured_poses(out / "poses.csv", simulation.hand_pose_of_each_row(), instrument or EXACT, rng)
    if not looks:
        return
    if images is None:
        seen = noisy_corners(simulation, noise, rng)
        write_corners(out / "corners.csv", corrupt_corners(seen) if corrupt_corners else seen)
    else:
        images.write_pictures(simulation, out, int(rng.integers(1 << 62)), progress)


def _write_measured_poses(
    path: Path, poses: dict[str, RigidTransform], instrument: Instrument, rng: np.random.Generator
) -> None:
    """Write poses.csv as an Instrument sees poses {hand: (n,)}, "" without a name, with its noise: whole, or positions,
    orientations or a wire's lengths alone.
    """
    parts = [_measured_columns(T, instrument, rng) for T in poses.values()]
    named = [*poses] != [""]
    write_table(
        path,
        ("frame", *(["hand"] if named else []), *parts[0][0]),
        [
            ",".join([str(f), *([name] if named else []), *(f"{x:.10f}" for x in rows[f])])
            for f in range(len(parts[0][1]))
            for name, (_, rows) in zip(poses, parts)
        ],
    )


def _measured_columns(
    T_base_platform: RigidTransform, instrument: Instrument, rng: np.random.Generator
) -> tuple[tuple[str, ...], Floats]:
    """(names, (n, k) figures) of what an Instrument sees of poses (n,), with its noise."""
    if instrument.kind == "distance":
        lengths = np.linalg.norm(T_base_platform.translation, axis=1) + instrument.position_sigma * rng.normal(
            size=len(T_base_platform)
        )
        return (DISTANCE,), lengths[:, None]
    seen = np.repeat(
        [instrument.position_sigma if instrument.kind == "pose" else 0.0, instrument.rotation_sigma or 0.0], 3
    )
    rows = pose_to_vector(T_base_platform * exp(seen * rng.normal(size=(len(T_base_platform), 6))))
    if instrument.kind == "direction":
        rows = Rotation.from_rotvec(rows[:, 3:]).as_matrix()[:, :, 2]
    whole = instrument.rotation_sigma is not None and instrument.kind == "pose"
    first, last = (3, 6) if instrument.kind == "orientation" else (0, 6 if whole else 3)
    return tuple(POSE_COLUMNS[first:last]), rows[:, first:last]


def true_corner_rows(simulation: Simulation) -> list[list[int | str | float]]:
    """True corners as rows [frame, camera, marker, corner, u, v] of every visible marker, for a truth file."""
    c = noisy_corners(simulation, 0.0, np.random.default_rng(0))
    return [
        [int(f), name, int(m), int(k), round(float(u), 5), round(float(v), 5)]
        for f, name, m, k, (u, v) in zip(c.frame, c.camera, c.marker, c.corner, c.uv)
    ]
