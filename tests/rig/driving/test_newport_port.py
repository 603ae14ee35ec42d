"""Newport's function calls over TCP: an emulated HXP with several callers, each answered in its own connection."""

import re
import socket
import threading
from dataclasses import replace

import numpy as np
import pytest

from rig.driving.axis_driver import Driver
from rig.driving.driving_clock import SystemClock
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import Faults
from rig.driving.emulators.emulator_opening_and_serving_over_terminal_or_tcp import (
    emulator_of_design,
    home_lengths,
    serve_emulator,
    tcp_server_for_emulator,
)
from rig.errors import LinkLost, Stopped

STEP = np.array([3.0, -2.0, 2.5, 1.0, 2.0, -3.0]) * 1e-3  # m


class Served:
    """An emulator at a TCP port, in a thread. design : whose controller it is, with its port"""

    def __init__(self, design):
        stated = replace(design.controller, protocol="hxp", max_speed=np.full(6, 0.1), max_acceleration=np.full(6, 5.0))
        design = replace(design, controller=stated)
        self.emulator = emulator_of_design(design, Faults((), np.random.default_rng(0)), SystemClock())
        wire = tcp_server_for_emulator(self.emulator, ("127.0.0.1", 0))
        self.design = replace(design, controller=replace(stated, port=wire.name))
        self.address = re.fullmatch(r"xps://(.*):(\d+)", wire.name).groups()
        self._running = True
        words = self.emulator, wire, lambda: self._running, lambda name: None, lambda: None
        self._thread = threading.Thread(target=serve_emulator, args=words, daemon=True)
        self._thread.start()
        self._wire = wire

    def close(self):
        self._running = False
        self._thread.join()
        self._wire.close()  # which may be closed again

    def caller(self):
        return socket.create_connection(self.address, timeout=10)


@pytest.fixture
def served(driven_design):
    made = Served(driven_design)
    yield made
    made.close()


def asked(caller, call):
    """What a controller answers on a connection, whole."""
    caller.sendall(call.encode())
    answer = b""
    while not answer.endswith(b",EndOfAPI"):
        answer += caller.recv(4096)
    return answer.decode()


def test_a_rig_is_homed_moved_and_stopped_over_three_connections(served):
    home = home_lengths(served.design.mechanism)
    with Driver(served.design) as driver:
        assert not driver.status().known
        driver.home()
        driver.move(home + STEP)
        np.testing.assert_allclose(served.emulator.machine.axes.at(SystemClock().now()), home + STEP, atol=1e-6)
        stops = threading.Thread(target=driver.stop)

        def begin_to_stop(report):
            if not stops.ident and np.abs(report.lengths - home - STEP).max() > 1e-4:
                stops.start()

        with pytest.raises(Stopped):
            driver.move(home, speed=0.002, report=begin_to_stop)
        stops.join()
        stood = driver.lengths()
        assert np.abs(stood - home).max() > 1e-3 and driver.status().controller_text == "group state 10"
        driver.move(home)


def test_a_move_is_answered_at_its_end_and_its_connection_takes_no_other_call_until_then(served):
    with served.caller() as moves, served.caller() as reads:
        assert asked(reads, "GroupStatusGet(HEXAPOD,int *)") == "0,0,EndOfAPI"
        assert asked(moves, "GroupInitialize (HEXAPOD)") == "0,,EndOfAPI"
        assert asked(moves, "GroupHomeSearch (HEXAPOD)") == "0,,EndOfAPI"
        assert asked(reads, "Nonsense(HEXAPOD)").startswith("-4,")
        moves.sendall(b"HexapodMoveAbsolute (HEXAPOD,Work,0,0,9,0,0,0)FirmwareVersionGet (char *)")
        while asked(reads, "GroupStatusGet(HEXAPOD,int *)") != "0,44,EndOfAPI":
            pass
        assert asked(reads, "GroupMoveAbort(HEXAPOD)") == "0,,EndOfAPI"
        answers = b""
        while answers.count(b"EndOfAPI") < 2:
            answers += moves.recv(4096)
        assert answers.startswith(b"-27,,EndOfAPI0,HXP")


def test_a_controller_that_is_gone_ends_the_run_and_one_that_never_was_is_named(served):
    with Driver(served.design) as driver:
        driver.home()
        served.close()
        with pytest.raises(LinkLost, match="connection lost|cannot be written to"):
            driver.link.run(driver.link.protocol.state())
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    gone = replace(served.design, controller=replace(served.design.controller, port=f"xps://127.0.0.1:{port}"))
    with pytest.raises(LinkLost, match=f"cannot open xps://127.0.0.1:{port}"):
        Driver(gone).open()
