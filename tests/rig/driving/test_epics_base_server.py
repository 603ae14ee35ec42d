"""Channel Access with a server of EPICS base, which shares no code with the client here."""

import socket
import subprocess
import sys

import pytest

from rig.driving.driving_clock import SystemClock
from rig.driving.protocols.epics import Epics
from rig.driving.request_and_answer_exchange_with_controller import Link
from rig.driving.serial_and_epics_ports_and_checksummed_frames import (
    ChannelAccessPort,
    encode_numbered_frame,
    last_valid_frame_in_line,
)
from rig.errors import ControllerFault
from tests.conftest import ROOT

pytest.importorskip("caproto", reason="EPICS takes the package caproto: pip install 'rig[epics]'")
pytest.importorskip("softioc", reason="an IOC of EPICS base takes the package softioc: pip install softioc")
RECORDS = tuple(f"RIG:m{k}" for k in range(1, 7))


@pytest.fixture
def url():
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    words = [sys.executable, "-m", "tests.soft_base_ioc", str(port)]
    process = subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=ROOT
    )
    try:
        assert "ready\n" in iter(process.stdout.readline, "")
        yield f"ca://127.0.0.1:{port}"
    finally:
        process.kill()
        process.communicate()


def asked(port, text):
    """Words of an answer."""
    clock, out = SystemClock(), b""
    port.write(encode_numbered_frame(">", 1, text))
    end = clock.now() + 5
    while not out.endswith(b"\n") and clock.now() < end:
        out += port.read(end)
    return last_valid_frame_in_line("<", out.decode()).text.split()


@pytest.mark.slow
def test_records_of_epics_base_are_read_written_and_told_from_motor_records(url):
    port = ChannelAccessPort(url, SystemClock())
    assert asked(port, "GET RIG:m3.VAL RIG:m3.EGU RIG:m3.RTYP RIG:m3.SEVR") == ["OK", "1.5", "mm", "ao", "0.0"]
    assert asked(port, "PUT RIG:m1.VAL=2.5 RIG:m2.VAL=-1.25") == ["OK", "2.5", "-1.25"]
    while (followed := asked(port, "GET RIG:r1.VAL RIG:r2.VAL")) != ["OK", "2.5", "-1.25"]:
        assert followed[0] == "OK"
    assert asked(port, "GET RIG:m1.DMOV")[0] == "ERR"
    assert asked(port, "GET RIG:nothing.VAL")[0] == "ERR"
    port.close()
    protocol = Epics(RECORDS)
    link = Link(protocol, lambda: ChannelAccessPort(url, SystemClock()), SystemClock(), timeout=5.0)
    link.connect(0)
    with pytest.raises(ControllerFault, match="RIG:m1 is a record of type 'ao', not a motor record"):
        link.run(protocol.hello())
    link.close()
