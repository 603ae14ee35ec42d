"""The port of Universal Robots: a robot that takes nothing, one that sends nothing, and one that is let go."""

import socket
import time

import pytest

from rig.driving import universal_robots_real_time_interface_port
from rig.driving.driving_clock import SystemClock
from rig.driving.universal_robots_real_time_interface_port import UniversalRobotsPort, packet
from rig.errors import LinkLost


@pytest.fixture
def connected(monkeypatch):
    """(port, the robot's end of its connection), patient for a tenth of a second."""
    monkeypatch.setattr(universal_robots_real_time_interface_port, "PATIENCE", 0.1)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = UniversalRobotsPort(f"ur://127.0.0.1:{listening.getsockname()[1]}", SystemClock())
        robot, _ = listening.accept()
        robot.settimeout(5.0)
        with robot:
            yield port, robot
            port.close()


def test_a_robot_that_takes_nothing_is_lost(connected):
    with pytest.raises(LinkLost, match="cannot be written to: timed out"):
        connected[0].write(b"1 " + b"x" * (1 << 25) + b"\n")


def test_a_robot_that_pauses_is_read_on(connected):
    port, robot = connected
    port.write(b"1 state\n")
    time.sleep(0.3)  # longer than it is waited for at once
    robot.sendall(2 * packet(1.0, (7, 1, 1), [0.0] * 6))
    assert port.read(SystemClock().now() + 5.0).startswith(b"1 state 1.000 7 1 1 ")


def test_closing_ends_the_connection_at_once(connected):
    port, robot = connected
    port.close()
    assert robot.recv(1) == b""
