"""A protocol, a camera and sensors of an installed package: their entry points are found, as its user states them."""

import os
import subprocess
import sys

import cv2
import numpy as np
import pytest

from rig.cli.command_line import main
from rig.driving.cameras import open_camera
from rig.driving.driving_clock import SimulatedClock
from rig.driving.emulators.move_trials_through_emulator_with_faults import emulated_driver_with_emulator_and_clock
from rig.driving.user_protocol_camera_sensor_classes_and_sensor_reader import open_sensors_of_rig_toml
from rig.errors import RigError
from rig.model.design import SensorPort
from rig.planning.layout import hexapod_layout_and_camera_placement
from tests.cli import RIG
from tests.conftest import ROOT
from tests.emulated_run import HEIGHT, WIDTH, controller_text
from tests.rig.driving.cameras.test_cameras import camera
from tests.rig.installed_package import GREY, install_acme_machine
from tests.rig.simulated_clock import SIZE, Ticking

SENSORS = '\n[sensors]\nport = "package:gauge"\nchannels = ["gauge", "air_temperature_C"]\n'


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Folder in which the package is installed."""
    pytest.importorskip("pip")
    return install_acme_machine(tmp_path_factory.mktemp("installed"))


@pytest.fixture
def installed(site, monkeypatch):
    """The package is installed in this process."""
    monkeypatch.syspath_prepend(site)
    yield
    for name in [name for name in sys.modules if name.partition(".")[0] == "acme_machine"]:
        del sys.modules[name]


def rig_toml(folder):
    """Path of a rig.toml that names the package's protocol, camera and sensors."""
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=1, width=WIDTH, height=HEIGHT)
    text = text.replace('shutter = "global"', 'shutter = "global"\nsource = "package:grey"')
    path = folder / "rig.toml"
    path.write_text(text + controller_text("package:acme", "none") + SENSORS)
    return path


def test_a_protocol_of_a_package_drives(installed, driven_design):
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(driven_design, "package:acme")
    driver.open()
    driver.home()
    goal = driver.lengths() + 1e-3
    driver.move(goal)
    np.testing.assert_allclose(emulator.machine.axes.at(clock.now()), goal, atol=1e-9)
    with pytest.raises(RigError, match=r"no installed package has 'acmee' among .* rig.protocols; there are acme"):
        emulated_driver_with_emulator_and_clock(driven_design, "package:acmee")


def test_a_camera_and_sensors_of_a_package_are_opened(installed):
    image = open_camera(camera("package:grey"), Ticking()).grab().image
    assert image.shape == SIZE[::-1] and (image == GREY).all()
    stated = SensorPort("package:gauge", 9600, "", ("gauge", "air_temperature_C"))
    assert open_sensors_of_rig_toml(stated, SimulatedClock()).read() == {"gauge": 0.0012, "air_temperature_C": 20.4}


def test_the_package_is_found_only_where_it_is_installed(tmp_path, capsys):
    assert main(["status", str(rig_toml(tmp_path)), "--port", "loop://"]) == 1
    assert "no installed package has 'acme' among its entry points rig.protocols" in capsys.readouterr().err


@pytest.mark.slow
def test_a_run_takes_protocol_camera_and_sensors_of_a_package(tmp_path, site):
    path = rig_toml(tmp_path)
    environment = os.environ | {"PYTHONPATH": f"{site}{os.pathsep}{ROOT}"}
    emulate = [*RIG, "emulate", str(path), "--tcp", "0"]
    with subprocess.Popen(emulate, stdout=subprocess.PIPE, text=True, env=environment) as emulator:
        try:
            port = emulator.stdout.readline().split()[1]
            for words in (
                ("home", str(path)),
                ("run", str(path), "--plan", "sobol:2", "--out", str(tmp_path / "rec"), "--settle", "time:0")
                + ("--exposure", "keep", "--no-measure"),
            ):
                done = subprocess.run(
                    [*RIG, *words, "--port", port], capture_output=True, text=True, env=environment, cwd=tmp_path
                )
                assert done.returncode == 0, done.stderr
        finally:
            emulator.terminate()
    images = sorted((tmp_path / "rec").rglob("*.png"))
    assert len(images) == 2 and all((cv2.imread(str(image), 0) == GREY).all() for image in images)
    header, *rows = (tmp_path / "rec" / "sensors.csv").read_text().splitlines()
    assert "gauge" in header and rows and all("0.0012" in row and "20.4" in row for row in rows)
