"""A hexapod's own controller in conversation, as pairs of bytes: poses in mm and degrees for lengths, and back."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rig.driving.driving_clock import SimulatedClock
from rig.driving.emulators.move_trials_through_emulator_with_faults import emulated_driver_with_emulator_and_clock
from rig.driving.protocols.gcs import GCSHexapod
from rig.driving.protocols.protocol_interface_and_user_line_protocol import Segment
from rig.errors import ControllerFault, FileError, MotionError, PositionLost
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.mechanisms import hexapod
from rig.model.pose import pose
from rig.planning.layout import hexapod_layout_and_camera_placement
from tests.rig import scripted_wire
from tests.rig.driving.protocols.test_gcs import IDENTITY

AXES = "X Y Z U V W"
PIVOT = np.array([0.005, -0.003, 0.04])  # m
CONTROLLER = '\n[controller]\nprotocol = "{}"\nport = "none"\nmax_speed = 0.01\n'


def each(values, names="XYZUVW"):
    """An answer of a line per name: a blank before every line feed but the last."""
    return " \n".join(f"{name}={value}" for name, value in zip(names, values)).encode() + b"\n"


def hello(units=("MM",) * 3 + ("DEG",) * 3, pivot=1e3 * PIVOT):
    return [
        IDENTITY,
        (b"SAI?\n", b" \n".join(AXES.encode().split()) + b"\n"),
        (b"ERR?\n", b"0\n"),
        (b"PUN?\n", each(units)),
        (f"SVO? {AXES}\n".encode(), each([1] * 6)),
        (b"SPI?\n", each(pivot, "RST")),
    ]


def talk(design, script, what=None):
    clock, protocol = SimulatedClock(), GCSHexapod(design.mechanism, np.zeros(6), None, None)
    return scripted_wire.talk(protocol, script, clock, what)


def test_a_move_is_commanded_as_a_pose_about_the_pivot_point(design):
    """A turn about the pivot point, as the manual has it: that point, 5 mm off, stays where it is."""
    turn = Rotation.from_euler("XYZ", [3.0, -2.0, 5.0], degrees=True)
    shift = np.array([1e-3, 2e-3, -3e-3])
    T = design.mechanism.home * pose(shift + PIVOT - turn.apply(PIVOT), turn.as_rotvec())
    start, target = hexapod.home_values(design.mechanism), hexapod.inverse(T, design.mechanism)
    distance = max(np.linalg.norm(T.translation - design.mechanism.home.translation), np.abs(target - start).max())
    script = [
        *hello(),
        (f"VLS {1e3 * distance / 2.0:.6f}\nERR?\n".encode(), b"0\n"),
        (b"MOV X 1.000000 Y 2.000000 Z -3.000000 U 3.000000 V -2.000000 W 5.000000\nERR?\n", b"0\n"),
    ]
    segment = Segment(start, target, 2.0, np.abs(target - start) / 2, None)
    assert talk(design, script, lambda p: p.move(segment)).accepted
    read = [
        *hello(),
        (b"\x05", b"3F\n"),
        (f"POS? {AXES}\n".encode(), each(["1.000000", "2.000000", "-3.000000", "3.000000", "-2.000000", "5.000000"])),
        (b"ERR?\n", b"0\n"),
    ]
    np.testing.assert_allclose(talk(design, read, lambda p: p.state()).positions, target, atol=1e-8)


def test_a_velocity_that_it_refuses_moves_nothing(design):
    home = hexapod.home_values(design.mechanism)
    segment = Segment(home, home + 1e-3, 1.0, np.full(6, 1e-3), None)
    distance = 1e3 * np.linalg.norm(hexapod.forward(home + 1e-3, design.mechanism).translation - [0, 0, 0.45])
    refused = talk(design, [*hello(), (f"VLS {distance:.6f}\nERR?\n".encode(), b"8\n")], lambda p: p.move(segment))
    assert refused.accepted is False and "velocity out of limits" in refused.reason


def test_what_is_no_hexapods_controller_is_refused(design):
    with pytest.raises(ControllerFault, match="count in MM MM MM MM MM MM, .*MM MM MM DEG DEG DEG"):
        talk(design, hello(units=("MM",) * 6)[:4])


def test_a_pivot_point_that_another_program_sets_counts_from_then_on(driven_design):
    driver, emulator, clock = emulated_driver_with_emulator_and_clock(driven_design, "gcs-hexapod", (), 1)
    driver.open()
    home = driver.home().lengths
    target = home + 4e-3 * np.array([1, -1, 0.5, 0.2, -0.6, 1])
    driver.move(home)
    emulator.receive(b"SPI R 50 S -20 T 80\n")
    driver.move(target)
    np.testing.assert_allclose(emulator.machine.axes.at(clock.now()), target, atol=1e-7)
    emulator.receive(b"SPI R 0\n")  # while it is turned: refused, and found as an error
    with pytest.raises(ControllerFault, match="error 7"):
        driver.move(home)
    driver.move(home)
    np.testing.assert_allclose(emulator.machine.axes.at(clock.now()), home, atol=1e-7)


def test_a_work_frame_that_is_not_the_controllers_is_found_after_homing(driven_design):
    home = hexapod.home_values(driven_design.mechanism)
    driver, emulator, _ = emulated_driver_with_emulator_and_clock(driven_design, "gcs-hexapod", (), 1, home=home)
    emulator.platform.work = pose([0, 0, 0.44], [0, 0, 0])  # a work frame 10 mm below the platform at home
    driver.open()
    with pytest.raises(PositionLost, match=r"after homing the struts read .* \[controller\] home states"):
        driver.home()
    with pytest.raises(MotionError):
        driver.move(home + 1e-3)
    assert not emulator.machine.executed


def test_its_keys_in_rig_toml(tmp_path):
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=1)
    path = tmp_path / "rig.toml"

    def loaded(protocol, lines=""):
        path.write_text(text + CONTROLLER.format(protocol) + lines)
        return design_from_rig_toml.load_design(path)

    plain = loaded("gcs-hexapod")
    np.testing.assert_allclose(plain.controller.home, hexapod.home_values(plain.mechanism))
    stated = loaded("gcs-hexapod", "work = { position = [0, 0, 0.3], rotvec = [0, 0, 0.1] }\n")
    np.testing.assert_allclose(stated.controller.work.translation, [0, 0, 0.3])
    with pytest.raises(FileError, match="stated of protocol gcs-hexapod, hxp, symetrie, epics-hexapod"):
        loaded("gcs", "tool = { position = [0, 0, 0.3], rotvec = [0, 0, 0.1] }\n")
    with pytest.raises(FileError, match="'gcs-hexapod'"):
        loaded("gcs-hexpod")
