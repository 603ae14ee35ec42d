"""What the driver adds to a command's way over a pseudo-terminal, to an emulator in another process and back."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from rig.driving.axis_driver import Driver
from rig.driving.driving_clock import SystemClock
from rig.driving.emulators.emulator_opening_and_serving_over_terminal_or_tcp import home_lengths
from rig.driving.protocols.protocol_interface_and_user_line_protocol import Segment
from rig.driving.serial_and_epics_ports_and_checksummed_frames import SerialPort
from rig.formats.rig_toml import design_from_rig_toml
from rig.planning.layout import hexapod_layout_and_camera_placement

COUNT = 300


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3)
        path.write_text(text + '\n[controller]\nprotocol = "grblhal"\nport = "set below"\nmax_speed = 0.01\n')
        zero = home_lengths(design_from_rig_toml.load_design(path).mechanism).tolist()
        path.write_text(path.read_text() + f"zero = {zero}\n")
        emulator = subprocess.Popen(
            [
                sys.executable,
                "-c",
                "from rig.cli.command_line import main; main()",
                "emulate",
                str(path),
                "--speed",
                "1000",
            ],
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            port = emulator.stdout.readline().split()[1]
            path.write_text(path.read_text().replace("set below", port))
            yield from _timed(design_from_rig_toml.load_design(path), port)
        finally:
            emulator.terminate()
            emulator.wait()


def _timed(design, port):
    clock = SystemClock()
    with Driver(design, clock) as driver:
        home = driver.home().lengths
        segment = Segment(np.zeros(6), np.full(6, 1e-6), 1e-4, np.full(6, 0.01), None)
        bare = SerialPort(port, 115200, clock)
        line = b"G53G1X0.0010Y0.0010Z0.0010A0.0010B0.0010C0.0010F1469.7\n"

        def exchange_line():
            bare.write(line)
            while not bare.read(clock.now() + 1).endswith(b"ok\r\n"):
                pass

        plain, ours = np.transpose(
            [
                (_time(exchange_line), _time(lambda: driver.link.run(driver._protocol.move(segment))))
                for _ in range(COUNT)
            ]
        )
        bare.close()
        whole = [_time(lambda k=k: driver.move(home + (k % 2) * 1e-6)) for k in range(COUNT // 3)]
    yield (
        "a move command's way there and back beyond the emulator's own, median",
        f"{1e3 * np.median(ours - plain):.3f} ms",
        "<= 1 ms",
    )
    yield "the emulator's and the pseudo-terminal's own", f"{1e3 * np.median(plain):.3f} ms", ""
    yield "a whole move of 1 um, checked before and read back after, median", f"{1e3 * np.median(whole):.2f} ms", ""


def _time(what):
    start = time.perf_counter()
    what()
    return time.perf_counter() - start
