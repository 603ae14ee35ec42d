"""EPICS motor records that hold the coordinates of a hexapod's pose, of a soft IOC in another process."""

from dataclasses import replace

import numpy as np
import pytest

from rig.driving.axis_driver import Driver
from rig.driving.emulators.emulator_opening_and_serving_over_terminal_or_tcp import home_lengths
from rig.errors import ControllerFault, FileError
from rig.formats.rig_toml import design_from_rig_toml
from rig.model import mechanisms
from rig.planning.layout import hexapod_layout_and_camera_placement
from tests.rig.driving.protocols.test_newport_hxp import turn
from tests.rig.driving.test_channel_access_port import MOTORS, SoftIoc

pytest.importorskip("caproto", reason="EPICS takes the package caproto: pip install 'rig[epics]'")
CONTROLLER = """
[controller]
protocol = "epics-hexapod"
port = "ca://127.0.0.1:{port}"
axes = {motors}
max_speed = 0.005
max_acceleration = 0.1
timeout = 5.0
{more}
"""
TURN = {"moving": turn("x", 4) @ turn("y", -3) @ turn("z", 5), "fixed": turn("z", 5) @ turn("y", -3) @ turn("x", 4)}
VALUES = np.array([3.0, -2.0, 1.0, 4.0, -3.0, 5.0])  # mm and degrees


@pytest.fixture(scope="module")
def ioc():
    made = SoftIoc(("mm", "cm", "mm", "deg", "mrad", "degrees"))
    yield made
    made.kill()


def design(folder, port, more=""):
    path = folder / "rig.toml"
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3)
    path.write_text(text + CONTROLLER.format(port=port, motors=MOTORS, more=more))
    return design_from_rig_toml.load_design(path)


def lengths_of(hexapod, rotation, shift):
    """(6,) m of the struts with the platform turned by (3, 3) and shifted by (3,) m from home, by hand."""
    home = hexapod.home
    joints = home.rotation.as_matrix() @ (hexapod.platform_joints @ rotation.T + shift).T
    return np.linalg.norm(joints.T + home.translation - hexapod.base_joints, axis=1)


def readings(ioc):
    """(6,) mm and degrees."""
    found = np.array([float(word) for word in ioc.ask("GET " + " ".join(f"{m}.RBV" for m in MOTORS))[1:]])
    return found * [1, 10, 1, 1, 180 / np.pi / 1e3, 1]


@pytest.mark.slow
@pytest.mark.parametrize("angles", ["moving", "fixed"])
def test_lengths_are_commanded_as_a_pose_in_each_records_unit_and_read_back(ioc, tmp_path, angles):
    stated, reports = design(tmp_path, ioc.port, f'angles = "{angles}"'), []
    hexapod = stated.mechanism
    target = lengths_of(hexapod, TURN[angles], VALUES[:3] / 1e3)
    with Driver(stated) as driver:
        driver.home()
        np.testing.assert_allclose(driver.lengths(), home_lengths(hexapod), atol=1e-9)
        arrived = driver.move(target, report=reports.append)
        assert driver.limits() is None and not driver.limit_warnings()
        status = driver.status()
    np.testing.assert_allclose(readings(ioc), VALUES, atol=1e-6)
    np.testing.assert_allclose(arrived.lengths, target, atol=1e-8)
    assert (status.activity, status.fault) == ("idle", "")
    shares = []
    for report in reports:
        T = hexapod.home.inv() * mechanisms.hexapod.forward(report.lengths, hexapod)
        shares.append(T.translation / (VALUES[:3] / 1e3))
    shares = np.array(shares)
    is_moving = shares[(shares.min(axis=1) > 0.2) & (shares.max(axis=1) < 0.8)]
    assert len(is_moving) and np.ptp(is_moving, axis=1).max() < 0.1, "the coordinates change together"
    fastest = np.abs(target - home_lengths(hexapod)).max()
    assert arrived.ended - arrived.start_time > 0.95 * fastest / 0.005


def test_a_limit_of_a_coordinate_keeps_all_at_rest(ioc, tmp_path):
    stated = design(tmp_path, ioc.port)
    with Driver(stated) as driver:
        driver.home()
        before = readings(ioc)
        ioc.ask("PUT RIG:m6.HLM=2")
        try:
            with pytest.raises(ControllerFault, match=r"RIG:m6: 5 is outside LLM -60 .. HLM 2"):
                driver.move(lengths_of(stated.mechanism, turn("z", 5), np.zeros(3)))
        finally:
            ioc.ask("PUT RIG:m6.HLM=60")
    np.testing.assert_allclose(readings(ioc), before, atol=1e-9)


def test_records_in_other_units_and_angles_of_others_are_refused(ioc, tmp_path):
    stated = design(tmp_path, ioc.port)
    axes = (*stated.controller.axes[3:], *stated.controller.axes[:3])
    made = Driver(replace(stated, controller=replace(stated.controller, axes=axes)))
    with pytest.raises(ControllerFault, match="RIG:m4.EGU is 'deg'; it must be one of m, .*nm"):
        made.open()
    made.close()
    text = (tmp_path / "rig.toml").read_text()
    (tmp_path / "rig.toml").write_text(text.replace("epics-hexapod", "epics") + 'angles = "fixed"\n')
    with pytest.raises(FileError, match="angles are stated of protocol hxp, epics-hexapod"):
        design_from_rig_toml.load_design(tmp_path / "rig.toml")
