"""Any bytes as a controller's answers, or as a host's requests: nothing crashes, nothing hangs, and nothing is moved
that was not told.
"""

import re
from contextlib import suppress

import numpy as np

from rig.driving.driving_clock import SimulatedClock
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import EmulatedMachine, Faults, MovingAxes
from rig.driving.emulators.native_strut_protocol import Struts as EmulatedStruts
from rig.driving.protocols.gcs import GCS
from rig.driving.protocols.grblhal import GrblHAL
from rig.driving.protocols.linuxcnc import LinuxCNC
from rig.driving.protocols.native_strut_protocol import Struts
from rig.driving.protocols.protocol_interface_and_user_line_protocol import Segment
from rig.driving.request_and_answer_exchange_with_controller import Link
from rig.errors import MotionError

MAKE = {
    "grblhal": lambda: GrblHAL("XYZABC"),
    "gcs": lambda: GCS((), 6),
    "struts": lambda: Struts(6, 1.0),
    "linuxcnc": lambda: LinuxCNC("XYZABC", "joint", "EMC", "EMCTOO"),
}
MOVES = re.compile(rb"G53G1|\$H|MOV |FRF \d|MOVE |\d HOME\*|SET MDI|SET HOME")
LONGEST = 2000.0  # s on the simulated clock for one dialogue; more is a hang
SEGMENT = Segment(np.zeros(6), np.full(6, 1e-3), 0.1, np.full(6, 0.01), np.full(6, 0.1))
DIALOGUES = (
    lambda p: p.state(),
    lambda p: p.fence(),
    lambda p: p.hello(),
    lambda p: p.move(SEGMENT),
    lambda p: p.stop(),
    lambda p: p.unlock(),
)
TELLING = 3  # the dialogue among them that moves, once


class Noise:
    """A Port: answers each write with the next piece of some bytes, then
    with silence.
    """

    def __init__(self, data, clock):
        self.pieces = [data[i : i + 64] for i in range(0, len(data), 64)]
        self.clock, self.sent, self.pending = clock, b"", b""

    def write(self, data):
        self.sent += data
        if self.pieces:
            self.pending += self.pieces.pop(0)

    def read(self, until):
        data, self.pending = self.pending, b""
        if not data:
            self.clock.sleep(until - self.clock.now())
        return data

    def close(self):
        pass


def answers(protocol, data):
    """Bytes as answers of a controller; the first chooses what it was asked."""
    clock = SimulatedClock()
    port = Noise(data[1:], clock)
    which = data[0] % len(DIALOGUES) if data else 0
    speaks = MAKE[protocol]()
    link = Link(speaks, lambda: port, clock, timeout=0.1)
    link.connect(0)
    with suppress(MotionError):  # an answer that cannot be read is said to be one
        link.run(DIALOGUES[which](speaks))
    assert len(MOVES.findall(port.sent)) <= (which == TELLING), port.sent
    assert clock.now() < LONGEST


def requests(data):
    """Bytes as requests to a controller of our own protocol that may move: only a sound frame moves it."""
    clock, faults = SimulatedClock(), Faults()
    machine = EmulatedMachine(
        MovingAxes(0.0, np.zeros(6), np.full(6, 0.01), np.full(6, 0.1)), np.zeros(6), np.zeros(6), faults, known=True
    )
    emulator = EmulatedStruts(machine, faults, clock, np.array([[-0.1, 0.1]] * 6))
    emulator.receive(data)
    emulator.due()
    assert not machine.executed
    assert machine.axes.until <= clock.now() or b"HOME" in data
