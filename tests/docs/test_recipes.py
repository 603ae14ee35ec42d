"""The recipes of cameras and controllers: every rig.toml in them loads, the files are safe drivers, the script runs."""

import re
import shutil
import subprocess
import sys
import tomllib

import cv2
import numpy as np
import pytest
import tomlkit

from rig.driving.cameras.opencv_uvc_gstreamer_and_network_cameras import gstreamer_pipeline_problem
from rig.driving.emulators.protocol_conformance_checks_against_emulator import (
    check_protocol_conformance,
    protocol_conformance_design,
)
from rig.formats.rig_toml.design_from_rig_toml import load_design
from rig.planning.layout.hexapod_layout_and_camera_placement import hexapod_layout_rig_toml
from tests.conftest import ROOT

PAGE = (ROOT / "docs" / "cameras.md").read_text(encoding="utf-8")
RECIPES = ROOT / "docs" / "recipes"
CAMERAS = re.findall(r"^```toml\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
CONTROLLERS = re.findall(
    r"^    (\[controller\]\n(?:    .*\n)+)", (ROOT / "docs" / "controller-recipes.md").read_text(), re.MULTILINE
)


def stated(folder, camera=None, controller=None):
    """A rig.toml with what a recipe states of its camera or controller."""
    document = tomlkit.parse(hexapod_layout_rig_toml(0.3, cameras=1))
    if camera:
        document["camera"][0].update(camera)
    if controller:
        document["controller"] = controller
    path = folder / "rig.toml"
    path.write_text(tomlkit.dumps(document))
    return path


def test_the_page_has_all_recipes():
    assert len(CAMERAS) == 7 and len(CONTROLLERS) == 3


@pytest.mark.parametrize("text", CAMERAS)
def test_the_lines_of_a_camera_load(tmp_path, text):
    (table,) = tomllib.loads(text)["camera"]
    (camera,) = load_design(stated(tmp_path, table)).cameras
    assert camera.source == table["source"] and (camera.width, camera.height) == (table["width"], table["height"])
    kind, _, pipeline = camera.source.partition(":")
    assert kind != "gstreamer" or gstreamer_pipeline_problem(pipeline) is None


@pytest.mark.parametrize("text", CONTROLLERS)
def test_the_lines_of_a_controller_load(tmp_path, text):
    table = tomllib.loads(text)["controller"]
    for recipe in RECIPES.glob("*.py"):
        shutil.copy(recipe, tmp_path)
    assert load_design(stated(tmp_path, controller=table)).driver().port == table["port"]


@pytest.mark.parametrize("name", ["klipper", "duet"])
def test_a_controller_of_a_recipe_greets_homes_and_moves(name):
    first = next(check_protocol_conformance(protocol_conformance_design(None), f"file:{RECIPES / name}.py"))
    assert first.problem == ""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["klipper", "duet"])
def test_a_controller_of_a_recipe_is_driven_safely(name):
    checks = list(check_protocol_conformance(protocol_conformance_design(None), f"file:{RECIPES / name}.py", 100))
    assert checks and [(check.name, check.problem) for check in checks if check.problem] == []


def tried(folder, source, size):
    path = stated(folder, {"width": size[0], "height": size[1], "source": source})
    done = subprocess.run(
        [sys.executable, RECIPES / "try_cameras.py", path], cwd=folder, capture_output=True, text=True, timeout=120
    )
    assert not done.returncode, done.stderr
    assert len(done.stdout.splitlines()) == 3 and done.stdout.startswith(f"cam0: ({size[1]}, {size[0]}")
    return cv2.imread(str(folder / "cam0.png"))


def test_the_script_tries_cameras(tmp_path):
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((48, 64), 90, np.uint8))
    assert (tried(tmp_path, f"command:cat {tmp_path}/grey.png", (64, 48)) == 90).all()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("gst-launch-1.0") is None, reason="gst-launch-1.0 is not installed")
def test_gstreamer_gives_images_as_a_program(tmp_path):
    source = next(line for line in PAGE.splitlines() if "gst-launch-1.0 -q" in line).split('"')[1]
    assert "v4l2src" in source
    image = tried(tmp_path, source.replace("v4l2src", "videotestsrc pattern=red"), (320, 240))
    np.testing.assert_allclose(image[100, 100], [0, 0, 255], atol=3)
