"""The platform as a device: plans of Bluesky's RunEngine move an emulated controller to corrected poses."""

import asyncio
import re
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest

from calib.api.bluesky_platform_device import PosePlatform, bluesky_platform
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.machine_correction import Correction
from calib.files.calibration_file import save
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import parse_fault_orders
from rig.driving.emulators.move_trials_through_emulator_with_faults import emulated_driver_with_emulator_and_clock
from rig.errors import ControllerFault, MissingLibrary, MotionError, RigError, Stopped, Unreachable
from rig.model import mechanisms
from rig.model.pose import pose, pose_difference, pose_to_vector
from synthetic import random_true_machine_and_truth_file
from tests.conftest import ROOT
from tests.emulated_run import EmulatedRig

PAGE = (ROOT / "docs" / "operating.md").read_text().split("\n## From Bluesky\n")[1].split("\n## ")[0]
EXAMPLE = re.search(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)[1]
WANTED = [0.003, -0.002, 0.452, 0.01, 0.0, 0.04]


def calibration_of(design):
    """(Calibration, the machine that it is of) of one that is not quite as stated."""
    fitted = random_true_machine_and_truth_file.random_true_machine(design, np.random.default_rng(4)).true.mechanism
    correction = Correction(design.mechanism, fitted, (None,) * 6)
    none = np.eye(42) * 1e-12, np.zeros(6), (0,), (), None, {"inputs_sha256": {}}
    return Calibration(correction, *none), fitted


@pytest.fixture
def homed(driven_design):
    """(driver, emulator, clock) of a rig that is homed."""
    made = emulated_driver_with_emulator_and_clock(driven_design, "struts", (), 1)
    made[0].open()
    made[0].home()
    return made


def platform(driver, design, **options):
    made = PosePlatform(driver, calibration_of(design)[0], **options)
    made.name = "platform"
    return made


def values(reading, kind):
    return [reading[f"platform-{kind}-{column}"]["value"] for column in ("x", "y", "z", "rx", "ry", "rz")]


def test_a_pose_is_commanded_corrected_and_read_back(homed, driven_design):
    driver, emulator, clock = homed
    device = platform(driver, driven_design, measure=lambda: pose([0, 0, 0.4], [0, 0, 0.1]))
    before = asyncio.run(device.read())
    assert values(before, "commanded") == values(before, "reached")
    asyncio.run(device.move(WANTED))
    truly = mechanisms.hexapod.forward(emulator.machine.axes.at(clock.now()), calibration_of(driven_design)[1])
    assert np.abs(pose_difference(truly, pose(WANTED[:3], WANTED[3:]))).max() < 1e-5
    reading = asyncio.run(device.read())
    np.testing.assert_allclose(values(reading, "commanded"), WANTED, atol=1e-12)
    np.testing.assert_allclose(values(reading, "reached"), pose_to_vector(truly), atol=1e-6)
    np.testing.assert_allclose(values(reading, "measured"), [0, 0, 0.4, 0, 0, 0.1], atol=1e-12)
    assert asyncio.run(device.describe()).keys() == reading.keys()
    place = asyncio.run(device.locate())
    np.testing.assert_allclose([place["setpoint"], place["readback"]], [WANTED, values(reading, "reached")], atol=1e-9)


@pytest.mark.parametrize("wanted, kind", [([0.0] * 5, ValueError), ([0.0, 0.0, 0.9, 0.0, 0.0, 0.0], Unreachable)])
def test_what_cannot_be_gone_to_moves_nothing(homed, driven_design, wanted, kind):
    driver, emulator, _ = homed
    device = platform(driver, driven_design)
    before = asyncio.run(device.read())
    with pytest.raises(kind):
        asyncio.run(device.move(wanted))
    assert not emulator.machine.executed
    assert values(asyncio.run(device.read()), "commanded") == values(before, "commanded")


@pytest.mark.parametrize(
    "refuse",
    [
        lambda driver, emulator: setattr(emulator, "limits", emulator.limits * 0),
        lambda driver, emulator: setattr(driver, "controller", replace(driver.controller, margin=1.0)),
        lambda driver, emulator: emulator.power_cycle(),
    ],
    ids=["by the controller", "by the driver", "since the position is lost"],
)
def test_a_refused_move_leaves_the_pose_that_was_commanded_before(homed, driven_design, refuse):
    driver, emulator, _ = homed
    device = platform(driver, driven_design)
    first = [0.0, 0.0, 0.451, 0.0, 0.0, 0.01]
    asyncio.run(device.move(first))
    refuse(driver, emulator)
    with pytest.raises(RigError):
        asyncio.run(device.move(WANTED))
    assert len(emulator.machine.executed) == 1
    reading, place = asyncio.run(device.read()), asyncio.run(device.locate())
    np.testing.assert_allclose(values(reading, "commanded"), first, atol=1e-12)
    np.testing.assert_allclose(place["setpoint"], first, atol=1e-12)
    if driver.status().known:  # else what it reads is not where it stands
        np.testing.assert_allclose(place["readback"], first, atol=1e-5)


def test_a_move_that_is_stopped_on_its_way_was_commanded(homed, driven_design):
    driver, emulator, _ = homed
    device = platform(driver, driven_design)
    emulator.faults.orders += parse_fault_orders("stall")
    with pytest.raises(MotionError):
        asyncio.run(device.move(WANTED))
    place = asyncio.run(device.locate())
    np.testing.assert_allclose(place["setpoint"], WANTED, atol=1e-12)
    assert np.abs(np.subtract(place["readback"], WANTED)).max() > 1e-4


@pytest.mark.parametrize("success", [False, True])
def test_a_stop_ends_the_move(homed, driven_design, success):
    driver, emulator, clock = homed
    device = platform(driver, driven_design)
    stopping = threading.Thread(target=lambda: asyncio.run(device.stop(success)))

    def begin_to_stop():
        stopping.start()
        while not driver.link._stop.is_set():  # the stop is on its way, past the move that waits
            pass

    clock.action_time, clock.action = clock.now() + 0.1, begin_to_stop
    if success:
        asyncio.run(device.move(WANTED))
    else:
        with pytest.raises(Stopped):
            asyncio.run(device.move(WANTED))
    stopping.join()
    off = mechanisms.hexapod.forward(emulator.machine.axes.at(clock.now()), driven_design.mechanism)
    assert np.linalg.norm(off.translation - WANTED[:3]) > 1e-3 and emulator.machine.axes.until <= clock.now()


def test_without_ophyd_async_its_extra_is_named_and_another_rig_is_refused(homed, driven_design, monkeypatch):
    calibration, fitted = calibration_of(driven_design)
    monkeypatch.setitem(sys.modules, "ophyd_async.core", None)
    with pytest.raises(MissingLibrary, match=r"pip install 'rig\[bluesky\]'"):
        bluesky_platform(homed[0], calibration)
    other = Calibration(Correction(fitted, fitted, (None,) * 6), *[None] * 6)
    with pytest.raises(RigError, match="of another rig than the driver's rig.toml"):
        bluesky_platform(homed[0], other)


@pytest.mark.slow
def test_the_example_of_the_page_runs_in_the_run_engine(tmp_path, monkeypatch):
    """And so do a plan with a reading per pose and an aborted one."""
    pytest.importorskip("bluesky"), pytest.importorskip("ophyd_async")
    from bluesky import RunEngine
    from bluesky.plan_stubs import abs_set, sleep
    from bluesky.plans import list_scan
    from bluesky.utils import FailedStatus

    from rig.driving.driver_opening_and_settling import design_with_controller_port, open_driver

    emulated = EmulatedRig(tmp_path, "struts")
    monkeypatch.chdir(tmp_path)
    design = design_with_controller_port(tmp_path / "rig.toml", None)
    calibration, fitted = calibration_of(design)
    save(tmp_path / "calibration.json", calibration)
    documents = []
    exec(EXAMPLE.replace("print)\n", "collect)\n"), {"collect": lambda *one: documents.append(one)})
    events = [document for kind, document in documents if kind == "event"]
    poses = [[0.0, 0.0, 0.45, 0.0, 0.0, 0.0], [0.005, 0.0, 0.452, 0.0, 0.0, 0.05]]
    assert [kind for kind, _ in documents] == ["start", "descriptor", "event", "event", "stop"]
    for event, wanted, goal in zip(events, poses, emulated.commanded_goals(), strict=True):
        data = {key: {"value": value} for key, value in event["data"].items()}
        np.testing.assert_allclose(values(data, "commanded"), wanted, atol=1e-12)
        np.testing.assert_allclose(values(data, "reached"), wanted, atol=2e-5)
        truly = mechanisms.hexapod.forward(np.array(goal), fitted)
        assert np.abs(pose_difference(truly, pose(wanted[:3], wanted[3:]))).max() < 1e-5

    with open_driver(design, None, print) as driver:
        device = bluesky_platform(driver, calibration, share=0.001)
        engine = RunEngine(call_returns_result=False)

        def aborted():
            yield from abs_set(device, [0.0, 0.0, 0.45, 0.0, 0.0, 0.0], group="go")
            yield from sleep(0.2)
            raise ControllerFault("the plan fails while the platform moves")

        with pytest.raises((ControllerFault, FailedStatus)):
            engine(aborted())
        stopped = driver.lengths()
        assert driver.status().activity == "idle"
        assert np.abs(stopped - np.array(emulated.commanded_goals()[-1])).max() > 1e-4
        np.testing.assert_allclose(driver.lengths(), stopped, atol=1e-9)
        with pytest.raises(FailedStatus):
            engine(list_scan([], device, [[0.0, 0.0, 0.9, 0.0, 0.0, 0.0]]))
        before = asyncio.run(device.locate())["setpoint"]
        monkeypatch.setattr(driver, "controller", replace(driver.controller, max_step=1e-6))
        with pytest.raises(FailedStatus):
            engine(list_scan([], device, [[0.0, 0.0, 0.44, 0.0, 0.0, 0.0]]))
        assert asyncio.run(device.locate())["setpoint"] == before
    emulated.close()
