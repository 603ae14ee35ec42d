"""What `rig check` says of set-ups with nothing wrong: cameras roughly stated, lenses missing, few frames, noise.

python -m tests.bench accusations        100 set-ups and 100 designs of `rig new design`, some seconds each
"""

import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.api.recording_check_combination_and_view import check
from rig.checks import Mistake
from rig.checks.design_value_camera_and_image_mistakes_and_all_file_checks import (
    mistakes_found_without_looking_at_images,
)
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import Camera
from rig.model.pose import exp
from rig.planning import recording_plan as plan
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.recording import recording_folder
from rig.recording.recording_folder import Recording
from synthetic import random_true_machine_and_truth_file, recording_simulation
from synthetic.api import SimulateOptions, simulate
from synthetic.recording_simulation import PictureWriter
from vision.checks import find_corner_mistakes

SETUPS = 100
MOVED = (0.2, np.radians(10.0))  # m, rad by which cameras may stand from where they are stated
SIZES = ((800, 600), (1280, 1024), (1920, 1200))
DESIGN_SIZES = ((640, 480), *SIZES)
DESIGNS = 100
FIRST_DESIGN = 9300  # seeds that no mending of a check was tried on
ROUGH = re.compile(
    r"rig.toml: (camera \w+: it stands |the lens is not as stated)"
)  # what is true of such cameras, and spoils nothing
TRUE = re.compile(
    r"corners show too little of the platform|rig.toml: camera \w+ is unused: corners.csv has no corner of it"
)  # what is true of a design with few cubes and cameras


@dataclass(frozen=True, slots=True)
class Setup:
    """One set-up. words : it, in words; found : what was said of it"""

    words: str
    found: tuple[Mistake, ...]

    @property
    def accused(self) -> tuple[Mistake, ...]:
        """What was said that is not so."""
        return tuple(
            one for one in self.found if not TRUE.match(one.what) and (one.spoils or not ROUGH.match(one.what))
        )

    @property
    def wrong(self) -> tuple[Mistake, ...]:
        """What was said that is not so of cameras and lenses that are as stated."""
        return tuple(one for one in self.found if not TRUE.match(one.what))


def drawn_recording(
    number: int, folder: Path, frames: int | None = None, images: PictureWriter | None = None
) -> tuple[str, Recording, float]:
    """(a set-up of a number in words, its recording, written to a folder, px that its corners scatter): rough cameras,
    in every second one lenses that nobody stated.
    frames : how many, None drawn; images : what draws its images, all of SIZES' smallest, in place of corners
    """
    rng = np.random.default_rng((28, number))
    width, height = SIZES[rng.integers(1 if images else len(SIZES))]
    count, cubes, radius = int(rng.integers(2, 6)), int(rng.integers(3, 6)), float(rng.uniform(0.15, 0.6))
    frames = int(rng.choice([4, 6, 10, 24, 60])) if frames is None else frames
    noise, lensless = float(np.exp(rng.uniform(np.log(0.03), np.log(0.3)))), number % 2 == 0
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(
        radius, cameras=count, width=width, height=height, cubes=cubes
    )
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rig.toml").write_text(text)
    stated = design_from_rig_toml.load_design(folder / "rig.toml")
    secret = random_true_machine_and_truth_file.random_true_machine(stated, rng, float(rng.uniform(0.5, 3.0)))
    cameras = tuple(_real(camera, rng, lensless, min(1.0, radius / 0.3)) for camera in secret.true.cameras)
    secret = replace(secret, true=replace(secret.true, cameras=cameras))
    done = recording_simulation.simulate_world(secret, plan.build_plan(stated, f"sobol:{frames}", number), rng)
    recording_simulation.write_recording(done, folder, text, rng, noise, images)
    words = (
        f"{number}: radius {radius:.2f} m, {count} cameras {width}x{height}, {cubes} cubes, {frames} frames, "
        f"noise {noise:.2f} px" + (", no lens stated" if lensless else "")
    )
    return words, recording_folder.load_recording(folder), noise


def setup(number: int, folder: Path, frames: int | None = None) -> Setup:
    """The Setup of a number, see `drawn_recording`."""
    words, read, _ = drawn_recording(number, folder, frames)
    assert read.corners is not None
    return Setup(
        words,
        (*mistakes_found_without_looking_at_images(read), *find_corner_mistakes(read, read.corners, thorough=True)),
    )


def design_setup(seed: int, folder: Path) -> Setup:
    """The Setup of a seed that is a design as `rig new design` writes it and its own recording, as `rig simulate` does.

    Cameras, cubes, sizes and few frames are drawn; what `rig check` says of it is found.
    """
    rng = np.random.default_rng((29, seed))
    width, height = DESIGN_SIZES[rng.integers(len(DESIGN_SIZES))]
    cameras, cubes, frames = (int(n) for n in rng.integers((1, 1, 3), (6, 6, 21)))
    radius = round(float(np.exp(rng.uniform(np.log(0.05), np.log(1.5)))), 3)
    folder.mkdir(parents=True, exist_ok=True)
    rig = folder / "rig.toml"
    rig.write_text(
        hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(
            radius, cameras=cameras, width=width, height=height, cubes=cubes
        )
    )
    simulate(rig, SimulateOptions(f"sobol:{frames}", seed=seed)).write(folder / "rec")
    words = f"seed {seed}: radius {radius:g} m, {cameras} cameras {width}x{height}, {cubes} cubes, {frames} frames"
    return Setup(words, check(folder / "rec").found)


def _real(camera: Camera, rng: np.random.Generator, lensless: bool, size: float) -> Camera:
    """The camera as it is: elsewhere, by MOVED at most, and where lensless with a lens of its own."""
    direction, turn = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    pose = camera.pose * exp(np.r_[rng.uniform(0, MOVED[0] * size) * direction, rng.uniform(0, MOVED[1]) * turn])
    if not lensless:
        return replace(camera, pose=pose)
    matrix = camera.matrix.copy()
    matrix[[0, 1], [0, 1]] *= rng.uniform(0.96, 1.04)
    matrix[:2, 2] += rng.uniform(-0.02, 0.02, 2) * camera.width
    terms = np.zeros(max(5, len(camera.distortion)))
    terms[:5] = rng.uniform(-0.25, 0.1), rng.uniform(0.0, 0.1), *rng.uniform(-1e-3, 1e-3, 2), 0.0
    return replace(camera, pose=pose, matrix=matrix, distortion=terms)


def rows() -> Iterator[tuple[str, str, str]]:
    """Set-ups and designs with nothing wrong of which something is said that is not so."""
    accused, rough, words = 0, 0, list[str]()
    for number in range(SETUPS):
        with tempfile.TemporaryDirectory() as folder:
            found = setup(number, Path(folder))
        accused += bool(found.accused)
        rough += bool(found.found) and not found.accused
        words += [f"  {found.words}: {one.what}" for one in found.accused]
    print("\n".join(words) or "  nobody is accused")
    yield "set-ups with nothing wrong that are accused of something", f"{accused} of {SETUPS}", "0 of 100"
    yield "where it is said, truly, that a camera's place or lens is not as stated", f"{rough} of {SETUPS}", ""
    designs = list[Setup]()
    for seed in range(FIRST_DESIGN, FIRST_DESIGN + DESIGNS):
        with tempfile.TemporaryDirectory() as folder:
            designs.append(design_setup(seed, Path(folder)))
    print(
        "\n".join(f"  {found.words}: {one.what}" for found in designs for one in found.wrong)
        or "  no design is accused"
    )
    wrong = sum(bool(found.wrong) for found in designs)
    yield "designs as stated that are accused of something, lenses too", f"{wrong} of {DESIGNS}", "0 of 100"
