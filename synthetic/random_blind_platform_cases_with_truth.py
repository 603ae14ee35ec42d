"""Blind cases of platforms, drawn at random, with their truth.

Rigs, protocols, image settings, unmodelled physics; written as recordings and truth.
"""

import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from rig.effects.catalogue.effect_list import ALL
from rig.effects.framework.effect_base_class import MOTION_STAGES, Effect
from rig.effects.framework.parameters_covariates_and_marker_table import Drawing, Markers, markers_with_replaced_columns
from rig.errors import RigError
from rig.formats.output_files import write_text
from rig.formats.rig_toml import design_from_rig_toml
from rig.model import machine_motion_simulation as motion_simulation
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.design import Camera, Design, Sensor
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_axes
from rig.model.pose import exp
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.planning.recording_plan import build_plan
from rig.planning.timed_plan_and_visiting_order import Plan
from rig.recording.corner_and_pose_csv_tables import Corners
from rig.recording.recording_folder import Sensors
from synthetic import random_true_machine_and_truth_file, unlisted_effects_and_corner_noise
from synthetic import recording_simulation as simulation
from synthetic.image_simulation import Images, is_renderable
from vision import opencv_lens_model as lens
from vision.marker_corner_prediction import marker_map


@dataclass(frozen=True, slots=True)
class Printing(Effect):
    """offsets (2 m) : m, each marker's shift in its plane, x right and y up, in the map's order
    scales (m) : its printed side over the stated, less 1"""

    place: str
    offsets: tuple[float, ...]
    scales: tuple[float, ...]
    name: ClassVar = "printing"
    stage: ClassVar = "targets"
    places: ClassVar = ("markers",)

    def attach(self, markers: Markers) -> Markers:
        tangent = np.zeros((len(markers.id), 6))
        tangent[:, :2] = np.reshape(self.offsets, (-1, 2))
        return markers_with_replaced_columns(
            markers,
            T_body_marker=markers.T_body_marker * exp(tangent),
            side=markers.side * (1 + np.asarray(self.scales)),
        )


def random_printing_errors(
    design: Design, rng: np.random.Generator, shift_sigma: float, relative_side_sigma: float
) -> Printing:
    """Printing errors of a design's markers drawn at random.

    Shifts (sigma m), and sides (sigma as a share).
    """
    count = len(marker_map(design).id)
    scales = relative_side_sigma * (rng.normal() + rng.normal(size=count))
    return Printing("markers", tuple((shift_sigma * rng.normal(size=2 * count)).tolist()), tuple(scales.tolist()))


IMAGE_KINDS = (
    "nothing",
    "one",
    "two",
)  # of what is hidden: a disturbance of corners has no picture, an effect out of the catalogue seldom one
IMAGE_FRAMES = 40  # of a recording by default
RESOLUTIONS = ((640, 512), (960, 768), (1280, 1024))  # px
LENSES = (
    "[-0.1, 0.08, 0.0, 0.0, 0.0]",
    "[-0.25, 0.1, 0.0004, -0.0003, 0.0]",
)  # OpenCV k1 k2 p1 p2 k3; the first is the layout's
BLUR, DEFOCUS, VIGNETTING, READ_NOISE = (0.4, 0.9), (0.0, 0.8), (0.0, 0.3), (0.5, 2.0)  # px, px, share, grey levels
PLACE, SIDE = (
    (1e-6, 5e-6),
    (2e-5, 1.2e-4),
)  # m of a marker's place, share of its side: standard deviations of how they are printed
CONTRAST = 180.0  # grey levels between black and white, about
SHARE = 25  # a marker's side is about so much of an image's width


@dataclass(frozen=True, slots=True)
class ImageSettings:
    """width, height : px; lens : as rig.toml has it; sensor : Sensor"""

    width: int
    height: int
    lens: str
    sensor: Sensor

    def seen_through(self, text: str) -> str:
        """Text of a rig.toml with this lens in place of the layout's."""
        return text.replace(f"distortion = {LENSES[0]}", f"distortion = {self.lens}")

    @property
    def images(self) -> Images:
        """How they are drawn: in one process, since cases run side by side."""
        return Images(self.sensor, processes=1)

    @property
    def noise(self) -> float:
        """px, what a corner is good for: the Cramer-Rao bound of two edges through blur and noise, and a quarter for
        the grey levels' rounding.
        """
        s, blur = self.sensor, float(np.hypot(self.sensor.blur, self.sensor.defocus / 2))
        grey = np.hypot(s.read_noise, 1 / np.sqrt(12))
        return float(1.25 * 2 * grey / CONTRAST * np.sqrt(2 * np.sqrt(np.pi) * blur / (self.width / SHARE)))


def random_image_settings(rng: np.random.Generator) -> ImageSettings:
    """Image settings (ImageSettings) drawn at random."""
    width, height = RESOLUTIONS[rng.integers(len(RESOLUTIONS))]
    sensor = Sensor(
        blur=float(rng.uniform(*BLUR)),
        defocus=float(rng.uniform(*DEFOCUS)),
        vignetting=float(rng.uniform(*VIGNETTING)),
        read_noise=float(rng.uniform(*READ_NOISE)),
    )
    return ImageSettings(width, height, LENSES[rng.integers(len(LENSES))], sensor)


def random_printing_errors_of_typical_size(design: Design, rng: np.random.Generator) -> Printing:
    """Printing errors of typical size of a design's markers, drawn at random.

    They are as large as printers make them.
    """
    place, side = (float(np.exp(rng.uniform(*np.log(ends)))) for ends in (PLACE, SIDE))
    return random_printing_errors(design, rng, place, side)


def renderable_effects(catalogue: list[type[Effect]]) -> list[type[Effect]]:
    """Effects of a catalogue that can be rendered in images."""
    return [kind for kind in catalogue if is_renderable(kind)]


KINDS = (
    "nothing",
    "one",
    "two",
    "foreign",
    "noise",
)  # of what is hidden: nothing, effects of the catalogue, one out of the catalogue, a disturbance
TIMES = {"nothing": 4, "one": 9, "two": 4, "foreign": 4, "noise": 2}  # a kind comes up in so many of 23 cases
WITHHELD = {
    "temperature": "no temperature is logged",
    "payload": "no load is put on",
    "reversals": "every pose is approached from one side",
    "motion": "no exposure while moving",
}
FRAMES = 380  # of a recording by default
TRIES = 20  # of drawing something that the rig survives
NOISE = (0.02, 0.08)  # px
WARP_POINTS = 12  # each way, at which the size of a lens's missing part is measured


@dataclass(frozen=True, slots=True, eq=False)
class DrawnCase:
    """One case before it is written.

    kind : of KINDS; simulation : Simulation with all hidden effects at work; text : the owner's rig.toml; noise : px
    disturbance : of out_of_catalogue.DISTURBANCES or None; plan : in words; rng : what draws the noise
    hidden : the effects that a diagnosis should find; image_settings : ImageSettings that it is drawn into images for,
        or None for corners
    """

    kind: str
    simulation: simulation.Simulation
    text: str
    noise: float
    disturbance: Callable[..., Corners] | None
    plan: str
    rng: np.random.Generator
    hidden: tuple[Effect, ...] = ()
    image_settings: ImageSettings | None = None


def random_case_kind_and_effect_numbers(
    seed: int, index: int, kinds: Sequence[str] = KINDS, catalogue: int = len(ALL)
) -> tuple[str, list[int], np.random.Generator]:
    """Kind and effect numbers of case `index` of a campaign, drawn at random.

    Returns (kind, their numbers in the catalogue, rng)
    """
    deck = np.concatenate([[k] * TIMES[name] for k, name in enumerate(KINDS) if name in kinds])
    shuffled = np.random.default_rng([seed, 1]).permutation(deck)
    kind = KINDS[shuffled[index % len(deck)]]
    before = sum({"one": 1, "two": 2}.get(KINDS[k], 0) for k in np.resize(shuffled, index))
    count = {"one": 1, "two": 2}.get(kind, 0)
    numbers = []
    for k in range(before, before + count):
        numbers.append(int(np.random.default_rng([seed, 2, k // catalogue]).permutation(catalogue)[k % catalogue]))
    return kind, numbers, np.random.default_rng([seed, 3, index])


def draw_case(
    seed: int,
    index: int,
    frames: int = FRAMES,
    withheld: Sequence[str] = (),
    kinds: Sequence[str] = KINDS,
    effects: Sequence[str] = (),
    images: bool = False,
) -> DrawnCase:
    """Blind case `index` of a campaign, drawn at random.

    effects : names of the catalogue's to use
    Raises RigError where nothing that the rig survives comes up in TRIES draws.
    """
    every = [e for e in ALL if not (e.instrumented or e.of_links)]
    catalogue = [e for e in every if e.name in effects] or every
    catalogue = (renderable_effects(catalogue) or renderable_effects(every)) if images else catalogue
    kind, numbers, rng = random_case_kind_and_effect_numbers(seed, index, kinds, len(catalogue))
    if len(numbers) == 2 and numbers[0] == numbers[1]:
        numbers[1] = (numbers[1] + 1) % len(catalogue)
    for _ in range(TRIES - 1):
        with suppress(RigError):
            return _drawn(kind, [catalogue[n] for n in numbers], rng, frames, withheld, images)
    return _drawn(kind, [catalogue[n] for n in numbers], rng, frames, withheld, images)


def _drawn(
    kind: str, hidden: list[type[Effect]], rng: np.random.Generator, frames: int, withheld: Sequence[str], images: bool
) -> DrawnCase:
    image_settings = random_image_settings(rng) if images else None
    text = (
        _rig(rng)
        if image_settings is None
        else image_settings.seen_through(_rig(rng, image_settings.width, image_settings.height))
    )
    with tempfile.TemporaryDirectory() as folder:
        write_text(Path(folder) / "rig.toml", text)
        design = design_from_rig_toml.load_design(Path(folder) / "rig.toml")
    plan = _protocol(frames, rng, withheld, images)
    route = build_plan(design, plan, int(rng.integers(1 << 30)), "reversals" in withheld)
    duration = float(route.t[-1])
    effects = [_effect(e, design, route, rng) for e in hidden]
    if len({(e.name, e.place) for e in effects}) < len(effects):
        raise RigError("the same effect twice at one place")
    if kind == "foreign":
        effects = [unlisted_effects_and_corner_noise.random_unlisted_effect(design, duration, rng)]
    slight = [] if image_settings is None else [random_printing_errors_of_typical_size(design, rng)]
    secret = random_true_machine_and_truth_file.random_true_machine(
        design, rng, float(rng.uniform(0.5, 1.5)), [*effects, *slight]
    )
    done = simulation.simulate_world(secret, route, rng)
    retained = {
        name: v for name, v in done.log.channels.items() if not ("temperature" in withheld and "temperature" in name)
    }
    disturbance = (
        unlisted_effects_and_corner_noise.DISTURBANCES[
            rng.integers(len(unlisted_effects_and_corner_noise.DISTURBANCES))
        ]
        if kind == "noise"
        else None
    )
    noise = _log(rng, *NOISE) if image_settings is None else image_settings.noise
    return DrawnCase(
        kind,
        replace(done, log=Sensors(done.log.t, retained)),
        text,
        noise,
        disturbance,
        plan,
        rng,
        tuple(effects),
        image_settings,
    )


def _rig(rng: np.random.Generator, width: int = 1280, height: int = 1024) -> str:
    """Text of the rig.toml of a random rig of a plausible size."""
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(
        _log(rng, 0.15, 0.6),
        cameras=int(rng.choice([2, 3, 3, 3, 4])),
        width=width,
        height=height,
        cubes=int(rng.integers(3, 6)),
    )
    joints = rng.choice(["cardan-cardan", "cardan-cardan", "cardan-ball"])
    return text.replace("screw_lead = 0.004", f"screw_lead = {rng.choice([0.002, 0.004, 0.005, 0.01])}").replace(
        '"cardan-cardan"', f'"{joints}"'
    )


def _protocol(frames: int, rng: np.random.Generator, withheld: Sequence[str], repeated: bool = False) -> str:
    """Text of a plan of about so many frames: configurations, ladders, loads, motion, repeats in a random order.

    again : whether ladders and repeats are always among them, where markers come back to the same pixels
    """
    parts = ["sobol", "sobol"]
    parts += ["ladder"] * ((repeated or rng.random() < 0.85) and "reversals" not in withheld)
    parts += ["payload"] * (rng.random() < 0.8 and "payload" not in withheld)
    parts += ["moving"] * (int(rng.integers(1, 4)) if not {"motion", "reversals"} & set(withheld) else 0)
    parts += ["repeat"] * (repeated or rng.random() < 0.3)
    share = {"sobol": 3.0, "ladder": 2.5, "payload": 1.5, "moving": 1.0, "repeat": 1.0}
    weights = np.array([share[part] for part in parts]) * rng.uniform(0.7, 1.3, len(parts))
    counts = frames * weights / weights.sum()
    each = {"ladder": 24, "payload": 3}  # frames for one of what the part counts
    written = [f"{part}:{max(1, round(count / each.get(part, 1)))}" for part, count in zip(parts, counts)]
    return ",".join(written[i] for i in rng.permutation(len(written)))


def _effect(kind: type[Effect], design: Design, route: Plan, rng: np.random.Generator) -> Effect:
    """An effect of the catalogue at a random place, its parameters drawn over their usual ranges."""
    place = str(rng.choice(kind.places))
    camera = design.cameras[rng.integers(len(design.cameras))]
    target = design.targets[rng.integers(len(design.targets))]
    axes = mechanisms.axis_place_texts(design.mechanism)
    place = {
        "axis": axes[rng.integers(len(axes))],
        "camera": str(Place("camera", camera.name)),
        "target": str(Place("target", target.name)),
        "marker": str(Place("marker", str(target.ids[rng.integers(len(target.ids))]))),
    }.get(place, place)
    sensors, _ = random_true_machine_and_truth_file.random_true_and_logged_temperatures(
        float(route.t[-1]),
        np.random.default_rng(0),
        random_true_machine_and_truth_file.strut_count(require_axes(design.mechanism)),
    )
    motion = motion_simulation.motion_of_commands(design, route.commands, route.t, (), sensors)
    reason = kind(place).needs(motion) if kind.stage in MOTION_STAGES else None
    if reason:
        raise RigError(f"{kind.name} {reason}")
    return kind.drawn(place, Drawing(design, route.t, motion, _displaced), rng)


def _displaced(effect: Effect, camera: Camera) -> float:
    """px RMS by which an effect of a camera moves corners all over its image."""
    u, v = np.meshgrid(
        np.linspace(0.05, 0.95, WARP_POINTS) * camera.width, np.linspace(0.05, 0.95, WARP_POINTS) * camera.height
    )
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    points = np.column_stack([(uv - camera.matrix[:2, 2]) / camera.matrix[[0, 1], [0, 1]], np.ones(len(uv))])
    real = effect.camera(camera)
    moved = effect.print_(camera, lens.project(points, real.matrix, real.distortion)) - lens.project(
        points, camera.matrix, camera.distortion
    )
    return float(np.sqrt(np.mean(moved**2)))


def write_recording(case: DrawnCase, folder: Path) -> None:
    """Write the recording of a blind case into a folder."""
    spoil, disturbance = None, case.disturbance
    if disturbance is not None:

        def spoil(corners: Corners) -> Corners:
            return disturbance(corners, case.simulation.world.stated, case.noise, case.rng)

    images = None if case.image_settings is None else case.image_settings.images
    simulation.write_recording(case.simulation, folder, case.text, case.rng, case.noise, images, corrupt_corners=spoil)


def simulated_corners(case: DrawnCase) -> Corners:
    """Corners simulated for a case, with the noise that corners of its images have."""
    return simulation.noisy_corners(case.simulation, case.noise, np.random.default_rng(0))


def write_truth(case: DrawnCase, path: Path, **more: object) -> None:
    """Write the truth of a blind case, with further entries, into a file."""
    disturbance = case.disturbance.__name__ if case.disturbance is not None else None
    hidden = replace(case.simulation.world, effects=case.hidden)
    random_true_machine_and_truth_file.write_truth(
        path,
        hidden,
        case.simulation.run.T_base_platform,
        kind=case.kind,
        disturbance=disturbance,
        noise_px=case.noise,
        plan=case.plan,
        **more,
    )


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
