"""Emulated Universal Robots controller, driven by URScript.

movej and stopj as scripts, state on request, in packets over TCP.
A movej that states its blend radius r is taken for a homing, as the protocol sends it.
"""

import re
import socket
import time

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.driving_clock import Clock
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import EmulatedMachine, Faults
from rig.driving.emulators.emulator_base_true_command_log_and_user_emulators import LineEmulator
from rig.driving.emulators.tcp_servers_of_emulators import TcpServer
from rig.driving.protocols.urscript import NORMAL, PLAYING, PROTECTIVE_STOP, RUNNING, STOPPED, URScript
from rig.driving.universal_robots_real_time_interface_port import SCHEME, packet, robot_state_line

PERIOD = 0.008  # s between packets
FAULT = 9  # the safety mode that only switching off and on ends
SCRIPT = re.compile(
    r"(?:(\d+) )?(state|stopj\(\d+(?:\.\d+)?\)|movej\(\[([^\]]*)\](?:, a=([\d.]+))?, v=([\d.]+)(, r=0)?\))"
)


class UniversalRobot(LineEmulator):
    """See LineEmulator."""

    protocol = URScript
    _started = 0.0  # s, when it was last switched on

    def __init__(self, machine: EmulatedMachine, faults: Faults, clock: Clock, limits: Floats) -> None:
        super().__init__(machine, faults, clock, limits)
        self.buffer = 4096  # a connection of TCP drops nothing
        self.greet()

    @property
    def modes(self) -> tuple[int, int, int]:
        """Robot mode, safety mode, program state."""
        safety = FAULT if self.machine.deaf else PROTECTIVE_STOP if self.fault else NORMAL
        return RUNNING, safety, PLAYING if self.activity in ("moving", "homing") else STOPPED

    def packet(self) -> bytes:
        """The state as a packet of the real-time interface."""
        return packet(self.now - self._started, self.modes, self.positions.tolist())

    def greet(self) -> None:
        self._started = self.now

    def answer(self, text: str) -> str | None:
        found = SCRIPT.fullmatch(text)
        if found is None:
            return None  # a script that cannot be understood is shown at the pendant
        number = found[1] or "0"
        yes, no = f"{number} sent", f"{number} no"
        if found[2] == "state":
            return f"{number} {robot_state_line(self.now - self._started, self.modes, self.positions.tolist())}"
        if found[2].startswith("stopj"):
            return self.stop(yes)
        if found[6]:
            return self.home(yes, no)
        target = np.fromstring(found[3], sep=",")
        if target.shape != (len(self.limits),):
            return f"{no} {len(target)} joint positions"
        far = np.abs(target - self.positions).max()
        return self.move(target, float(far) / float(found[5]), yes, no)


class RealTimeServer(TcpServer):
    """See TcpServer. robot : whose state every caller is sent"""

    scheme = SCHEME

    def __init__(self, robot: UniversalRobot, address: tuple[str, int]) -> None:
        super().__init__(address)
        self._robot, self._due = robot, 0.0

    def wait(self, seconds: float) -> bytes:
        data = b"".join(data for _, data in self._received(min(seconds, self._due - time.monotonic())))
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + PERIOD
            self._send_packets()
        return data

    def send(self, data: bytes) -> None:
        """A robot answers no script."""

    def _take(self, caller: socket.socket) -> None:
        caller.setblocking(False)
        super()._take(caller)

    def _send_packets(self) -> None:
        data = self._robot.packet()
        for caller in list(self._callers):
            try:
                sent = caller.send(data)
            except OSError:
                sent = 0
            if sent < len(data):  # a part of a packet would spoil all that follow
                self._drop(caller)
