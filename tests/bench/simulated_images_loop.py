"""The rig that is not there: rendered corners against exact projection, speed of simulation, the closed loop."""

import json
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import Sensor
from rig.planning import recording_plan as plan
from rig.planning.layout import hexapod_layout_and_camera_placement
from synthetic import random_true_machine_and_truth_file, recording_simulation, rig_meshes
from synthetic.ideal_image_renderer import SAMPLES
from synthetic.marker_drawing_sensor_and_occlusion import simulate_sensor_exposure
from tests.cli import RIG
from tests.conftest import ROOT
from tests.rig.effects.test_effects import SOME
from tests.synthetic.test_renderer import LENSES, drawn, edge_errors, wall


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3)
        (folder / "rig.toml").write_text(text)
        design = design_from_rig_toml.load_design(folder / "rig.toml")
        yield from _accuracy(design)
        yield from _speed(folder, design)
        yield from _corner_level(design, folder, text)
    yield from _closed_loop()


def _accuracy(design):
    tilts = np.radians([0, 10, 20, 30, 40, 50, 60, 65])
    errors = np.concatenate([_errors(wall(design, tilt, lens)) for lens in LENSES.values() for tilt in tilts]).reshape(
        -1, 2
    )
    figure = (
        f"rendered corners by edge lines against projection, {len(LENSES)} lenses, tilt to 65 deg, N = {len(errors)}"
    )
    yield figure + ": bias", f"{np.abs(errors.mean(axis=0)).max():.4f} px", "<= 0.01"
    yield figure + ": RMS per axis", f"{np.sqrt(np.mean(errors**2)):.4f} px", "<= 0.02"


def _errors(rig):
    """(k, 4, 2) px, corners by edge lines in a picture of a wall of markers less where they are."""
    picture, _, exact = drawn(rig)
    height, width = (size // SAMPLES for size in picture.shape)
    mean = picture.reshape(height, SAMPLES, width, SAMPLES).mean(axis=(1, 3))
    return edge_errors(mean.astype(float), exact, rig.cameras[0])


def _speed(folder, design):
    start = time.perf_counter()
    look = ["--images", "--blur", "0.5", "--read-noise", "1.5"]
    subprocess.run(
        [*RIG, "simulate", folder / "rig.toml", "--plan", "sobol:100", *look, "--out", folder / "rec"],
        check=True,
        capture_output=True,
    )
    seconds = time.perf_counter() - start
    yield (
        "rig simulate, 300 images of 1280 x 1024, eight cubes, struts, noise, PNG, start included",
        f"{300 / seconds:.1f} images/s",
        ">= 8",
    )
    from synthetic.ideal_image_renderer import Renderer

    renderer = Renderer(rig_meshes.rig_and_background_meshes(design), design)
    rng, sensor, parts = (
        np.random.default_rng(0),
        Sensor(blur=0.5, read_noise=1.5),
        {"draw": [], "lens": [], "sensor": [], "PNG": []},
    )
    pinhole = renderer.cameras["cam0"]
    picture = np.zeros((pinhole.size[1], pinhole.size[0], 3), np.uint8)
    for _ in range(8):
        marks = [time.perf_counter()]
        pinhole.bend(picture)
        marks.append(time.perf_counter())
        radiance = renderer.draw("cam0", design.mechanism.home)
        marks.append(time.perf_counter())
        image = simulate_sensor_exposure(radiance, sensor, rng, SAMPLES)
        marks.append(time.perf_counter())
        cv2.imwrite(str(folder / "x.png"), image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        marks.append(time.perf_counter())
        for key, spent in zip(("lens", "draw", "sensor", "PNG"), np.diff(marks)):
            parts[key].append(spent)
    renderer.close()
    medians = {key: 1e3 * np.median(values) for key, values in parts.items()}
    medians["draw"] -= medians["lens"]  # drawing ends with the lens
    yield (
        "where an image's time goes, one process, median of 8",
        ", ".join(f"{key} {value:.0f}" for key, value in medians.items()) + " ms",
        "",
    )


def _corner_level(design, folder, text):
    start = time.perf_counter()
    rng = np.random.default_rng(1)
    effects = tuple(parse_effect(f"{name}:{place}") for name, place in SOME.items() if name != "marker_swap")
    secret = random_true_machine_and_truth_file.random_true_machine(design, rng, effects=effects)
    done = recording_simulation.simulate_world(
        secret, plan.build_plan(design, "sobol:190,moving:154,payload:12", 1), rng
    )
    recording_simulation.write_recording(done, folder / "corners", text, rng, noise=0.04)
    count = f"{len(done.plan.t)} frames x 3 cameras at corner level, {len(effects)} effects at once"
    yield count, f"{time.perf_counter() - start:.1f} s", "<= 5 s"


def _closed_loop():
    subprocess.run(["sh", ".ci/demo"], cwd=ROOT, check=True, capture_output=True)
    loop = ROOT / "out" / "demo"
    found = {}
    for name in ("before", "after"):
        command = [*RIG, "verify", loop / "calibration.json", loop / name, "--wanted", loop / "wanted.csv", "--json"]
        found[name] = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)["wanted"]
    before, after = found["before"]["position"]["rms"], found["after"]["position"]["rms"]
    yield (
        "closed loop: pose error before / after, RMS, as measured",
        f"{before * 1e6:.0f} / {after * 1e6:.1f} um = {before / after:.0f} x",
        ">= 50 x",
    )
    ratio = [
        after / found["after"]["stated_uncertainty"]["position"],
        found["after"]["rotation"]["rms"] / found["after"]["stated_uncertainty"]["rotation"],
    ]
    yield (
        "closed loop: error after over its stated standard uncertainty",
        f"{ratio[0]:.2f} position, {ratio[1]:.2f} rotation",
        "<= 2",
    )
