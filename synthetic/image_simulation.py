"""Simulation of a recording's images.

Exposures in time are rendered, with rolling shutter, by several processes.
"""

import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, Json
from rig.compute import parallel_map_and_dask_cluster
from rig.compute.worker_processes import process_map, worker_count
from rig.effects.catalogue.effect_list import BY_NAME
from rig.effects.framework.effect_base_class import Effect
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import Kinds
from rig.errors import FileError, RigError
from rig.formats.output_files import write_bytes
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.design import Camera, Sensor
from rig.planning.timed_plan_and_visiting_order import Plan
from rig.recording import recording_folder
from rig.recording.recording_folder import Sensors
from synthetic import random_true_machine_and_truth_file, rig_meshes
from synthetic.ideal_image_renderer import SAMPLES, Renderer, import_pyrender_without_viewer
from synthetic.marker_drawing_sensor_and_occlusion import simulate_sensor_exposure
from synthetic.recording_simulation import Simulation, carried_camera_poses, poses_of_each_stage_and_platform
from vision.marker_corner_prediction import State, marker_map, predict_sightings, sightings_facing_cameras_anywhere

BLEND = (
    0.25  # px; pictures of a rolling shutter lie no farther apart than this, and rows are blended between two of them
)
MOST = 33  # pictures for one exposure of a rolling shutter


@dataclass(frozen=True, slots=True)
class Images:
    """sensor : Sensor; background : "plain" or "cluttered"; compression : of the PNG, 0..9; processes : 0 for one per
    core.
    """

    sensor: Sensor
    background: str = "plain"
    compression: int = 1
    processes: int = 0

    def write_pictures(
        self, simulation: Simulation, out: Path, seed: int, progress: Callable[[int, int], None] | None = None
    ) -> None:
        """Draw every image of a simulation into out/images: see `render_images`."""
        render_images(simulation, out, self, seed, progress)


def render_images(
    simulation: Simulation, out: Path, images: Images, seed: int, progress: Callable[[int, int], None] | None = None
) -> None:
    """Render all images of a simulation into out/images.

    seed : of the noise
    Raises MissingLibrary where there is no OpenGL, RigError for an effect that the renderer cannot draw
    """
    require_renderable(simulation.world.effects)
    import_pyrender_without_viewer()
    world, plan = simulation.world, simulation.plan
    for camera in world.true.cameras:
        (out / "images" / camera.name).mkdir(parents=True, exist_ok=True)
    # camera by camera, since a process that changes camera makes a new framebuffer
    work = [(f, i) for i in range(len(world.true.cameras)) for f in range(len(plan.t))]
    cluster = None if images.processes else parallel_map_and_dask_cluster.current_cluster()
    if cluster is not None:
        cluster.map(partial(_draw_on_worker, simulation, out, images, seed), work, progress)
        return
    count = min(images.processes or worker_count(), len(work))
    if count <= 1:
        _start(simulation, out, images, seed)
        for done, item in enumerate(work, 1):
            _draw(item)
            if progress:
                progress(done, len(work))
        _state.pop("renderer").close()
        return
    before = os.environ.get("LP_NUM_THREADS")
    os.environ["LP_NUM_THREADS"] = "1"  # each process draws with one thread
    try:
        process_map(count, "spawn", _draw, work, progress, _start, (simulation, out, images, seed))
    finally:
        os.environ.pop("LP_NUM_THREADS") if before is None else os.environ.update(LP_NUM_THREADS=before)


def require_renderable(effects: Iterable[Effect]) -> None:
    """Require that effects can be rendered in images.

    Raises RigError for effects that act on corners alone.
    """
    for effect in effects:
        if not is_renderable(type(effect)):
            raise RigError(f"{effect.name} is not drawn into images, only into corners: simulate with --corners")


def is_renderable(kind: type[Effect]) -> bool:
    """Whether an effect of a kind can be rendered in images.

    It does not act on corners alone, and markers stay flat.
    """
    return kind.bend is Effect.bend and kind.print_ is Effect.print_ and kind.flat


_state: Json = {}  # of a drawing process: what it was started with
_painter: list[ThreadPoolExecutor] = []  # of a worker of a cluster: the one thread that draws
_opening = threading.Lock()


def _start(simulation: Simulation, out: Path | None, images: Images, seed: int) -> None:
    _state.clear()
    _state.update(simulation=simulation, out=out, images=images, seed=seed)


def _draw_on_worker(simulation: Simulation, out: Path, images: Images, seed: int, item: tuple[int, int]) -> None:
    """`_draw` by a worker of a cluster, whatever that has drawn before. OpenGL belongs to the thread that began it, so
    that one draws all.
    """

    def draw() -> None:
        if _state.get("out") != out:
            if "renderer" in _state:
                _state.pop("renderer").close()
            os.environ["LP_NUM_THREADS"] = "1"
            _start(simulation, out, images, seed)
        _draw(item)

    with _opening:
        if not _painter:
            _painter.append(ThreadPoolExecutor(1))
    _painter[0].submit(draw).result()


def _prepare() -> None:
    """Make this process's scene, renderer and poses; here and not at its start, so that what fails is told to the
    caller.
    """
    simulation, images, seed = _state["simulation"], _state["images"], _state["seed"]
    design = simulation.world.true
    for effect in simulation.world.effects:
        design = replace(design, cameras=tuple(effect.camera(camera) for camera in design.cameras))
    markers = marker_map(design)
    for effect in simulation.world.effects:
        markers = effect.attach(markers)
    parts = rig_meshes.rig_and_background_meshes(design, images.background, np.random.default_rng(seed), markers)
    cv2.setNumThreads(1)
    _state.update(design=design, renderer=Renderer(parts, design), exposures=_exposures())


def _draw(item: tuple[int, int]) -> None:
    """Draw and write the image of (frame, camera index)."""
    f, i = item
    if "renderer" not in _state:
        _prepare()
    images, camera = _state["images"], _state["design"].cameras[i]
    image = _exposed(f, i, images.sensor)
    path = _state["out"] / "images" / camera.name / f"{f:05d}.png"
    write_bytes(path, cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, images.compression])[1].tobytes())


def _exposed(f: int, i: int, sensor: Sensor) -> Floats:
    """The image of (frame, camera index) by a sensor."""
    seed, exposures = _state["seed"], _state["exposures"]
    rng = np.random.default_rng([seed & 0xFFFFFFFF, seed >> 32, f, i])
    pictures = [
        _picture(_state["design"].cameras[i], i, f, shift, [T[f] for T in stages]) for shift, stages in exposures
    ]
    radiance = sum(pictures[1:], pictures[0]) / np.float32(len(exposures))
    return simulate_sensor_exposure(radiance, sensor, rng, SAMPLES)


def render_image(simulation: Simulation, frame: int, camera: int, images: Images, seed: int) -> Floats:
    """Image of one frame by one camera.

    It is rendered in this process, uint8 or uint16 (12 bits).
    simulation : Simulation, possibly another of the same world each time; images : Images; seed : of the noise
    Raises what `render_images` raises
    """
    if "renderer" in _state and _state["simulation"].world is not simulation.world:
        _state.pop("renderer").close()
    if "renderer" not in _state:
        require_renderable(simulation.world.effects)
        _start(simulation, None, images, seed)
        _prepare()
    _state.update(simulation=simulation, images=images, seed=seed)
    _state["exposures"] = _exposures()  # of this simulation, so it has to stand there
    return _exposed(frame, camera, images.sensor)


def _exposures() -> list[tuple[float, list[RigidTransform]]]:
    """[(s before or after the middle of the exposure, where what moves stands at all frames)] of the pictures that make
    an image.
    """
    simulation, shifts = _state["simulation"], _sub_exposures(_state["images"].sensor)
    return [
        (
            shift,
            poses_of_each_stage_and_platform(simulation.run)
            if shift == 0
            else simulation.at_times(simulation.plan.t + shift),
        )
        for shift in shifts
    ]


def _sub_exposures(sensor: Sensor) -> list[float]:
    """Seconds before and after the middle of the exposure at which pictures are taken and averaged."""
    if sensor.exposure <= 0 or sensor.exposures <= 1:
        return [0.0]
    return (((np.arange(sensor.exposures) + 0.5) / sensor.exposures - 0.5) * sensor.exposure).tolist()


def _picture(camera: Camera, i: int, f: int, shift: float, stages: list[RigidTransform]) -> Floats:
    """Radiance seen by a camera, the exposure shifted (s), what moves at stages; rows of a rolling shutter at their own
    times.
    """
    s = _state["simulation"]
    t = s.plan.t[f] + shift
    row_time = _row_time(camera, s.world.effects)
    if not row_time:
        return _view(camera, t, stages)
    first, last = -camera.height / 2 * row_time, (camera.height / 2 - 1) * row_time
    steps = min(MOST, 1 + int(np.ceil(_travel(i, s.at_times(np.array([t + first, t + last]))[-1]) / BLEND)))
    if steps == 1:
        return _view(camera, t, stages)
    moments = t + np.linspace(first, last, steps)
    poses = s.at_times(moments)
    pictures = np.stack([_view(camera, moment, [T[k] for T in poses]) for k, moment in enumerate(moments)])
    rows = np.arange(camera.height * SAMPLES)
    place = (rows // SAMPLES) / max(camera.height - 1, 1) * (steps - 1)
    low = np.minimum(place.astype(int), steps - 2)
    share = (place - low).astype(np.float32)[:, None]
    return (1 - share) * pictures[low, rows] + share * pictures[low + 1, rows]


def _row_time(camera: Camera, effects: Iterable[Effect]) -> float:
    """s from one row to the next, as stated and by effects."""
    stated = (camera.row_time or 0.0) if camera.shutter == "rolling" else 0.0
    return stated + sum((float(effect.late(camera, np.array(camera.height / 2 + 1.0))) for effect in effects), 0.0)


def _view(camera: Camera, t: float, stages: list[RigidTransform]) -> Floats:
    """Radiance seen by a camera at time t (s), its mount and focal length as the effects have them then."""
    sensors = _state["simulation"].sensors

    def channel(*names: str) -> Floats:
        return np.array([sensors.at([t], *names)[0]])

    mount, focal = np.zeros(6), 1.0
    for effect in _state["simulation"].world.effects:
        mount = mount + effect.mount(camera, np.array([t]), channel)[0]
        focal *= float(effect.focal(camera, np.array([t]), channel)[0])
    return _state["renderer"].draw(camera.name, stages[-1], mount if mount.any() else None, focal, stages[:-1])


def _travel(i: int, T: RigidTransform) -> float:
    """px that the fastest corner in view of camera i moves between two poses (2,)."""
    design = _state["design"]
    state, markers = State(design.cameras, T, carried_camera_poses(design.cameras, T)), marker_map(design)
    found = sightings_facing_cameras_anywhere(state, markers)
    found = found.take((found.camera == i) & (found.frame == 0))
    if not len(found.frame):
        return 0.0
    later = replace(found, frame=np.ones_like(found.frame))
    return float(np.abs(predict_sightings(later, state, markers) - predict_sightings(found, state, markers)).max())


KINDS = ("with", "without")


def simulations_with_and_without_effects_found(folder: Path, kinds: Kinds = BY_NAME) -> dict[str, Simulation]:
    """Simulate a diagnosed recording's commands with and without the effects found.

    kinds : effects that there are

    Returns {with, without: Simulation}
    Raises FileError for a folder that holds no diagnosed recording, RigError where nothing was commanded
    """
    path = folder / "machine.json"
    if not path.exists():
        raise FileError(
            path, "no such file; --from requires a folder that `rig diagnose` wrote from a commanded recording"
        )
    found = recording_folder.load_recording(folder)
    if found.commands is None:
        raise RigError(f"{folder}: there are no commands, so no motion can be simulated")
    secret = random_true_machine_and_truth_file.load_world_from_truth_file(path, found.design, kinds)
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
