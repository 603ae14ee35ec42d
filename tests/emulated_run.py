"""A rig that is run in tests: an emulated controller at a pseudo-terminal, cameras that answer at once, and runners
that can be killed.
"""

import json
import multiprocessing
import os
import socket
import threading
from pathlib import Path

from rig.driving import emulators
from rig.driving.driving_clock import SystemClock
from rig.driving.emulators import emulator_opening_and_serving_over_terminal_or_tcp
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import Faults
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.protocol_port_and_user_program_name_checks import MOTOR_RECORDS
from rig.planning.layout import hexapod_layout_and_camera_placement

WIDTH, HEIGHT = 64, 48
CONTROLLER = """
[controller]
protocol = "{protocol}"
port = "{port}"
max_speed = 5.0
max_acceleration = 500.0
"""


def controller_text(protocol: str, port: object) -> str:
    """[controller] of a rig.toml."""
    names = [f"m{k}" for k in range(1, 7)]
    return CONTROLLER.format(protocol=protocol, port=port) + (f"axes = {names}\n" if protocol in MOTOR_RECORDS else "")


def cameras(listening: socket.socket) -> None:
    """Answer as an emulator's cameras do, with images of one grey."""
    while True:
        caller = listening.accept()[0]
        threading.Thread(target=_answer, args=(caller,), daemon=True).start()


def _answer(caller: socket.socket) -> None:
    with caller, caller.makefile("rb") as lines:
        for _ in lines:
            head = json.dumps({"width": WIDTH, "height": HEIGHT, "bits": 8, "age": 0.0}).encode() + b"\n"
            caller.sendall(head + bytes([90]) * (WIDTH * HEIGHT))


def _emulate(folder: str, protocol: str, pipe) -> None:
    """The process of the emulator: every move that it was told is written down with its goal, as it is told."""
    import numpy as np

    listening = socket.create_server(("127.0.0.1", 0))
    threading.Thread(target=cameras, args=(listening,), daemon=True).start()
    link = Path(folder) / "port"
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(
        0.3, cameras=1, width=WIDTH, height=HEIGHT
    ).replace('shutter = "global"', f'shutter = "global"\nsource = "emulator:127.0.0.1:{listening.getsockname()[1]}"')
    (Path(folder) / "rig.toml").write_text(text + controller_text(protocol, link))
    clock = SystemClock()
    made = emulators.emulator_of_design(
        design_from_rig_toml.load_design(Path(folder) / "rig.toml"), Faults((), np.random.default_rng(0)), clock
    )
    wire = emulator_opening_and_serving_over_terminal_or_tcp.Terminal(link)
    goals_file = open(Path(folder) / "told.csv", "w", encoding="utf-8")  # noqa: SIM115
    count = 0

    def record() -> None:
        nonlocal count
        for move in made.machine.executed[count:]:
            goals_file.write(",".join(f"{value:.6f}" for value in move.target) + "\n")
            goals_file.flush()
            count += 1

    pipe.send(True)
    emulator_opening_and_serving_over_terminal_or_tcp.serve_emulator(
        made, wire, lambda: True, lambda name: None, record
    )


class EmulatedRig:
    """An emulator in a process of its own, in a folder with rig.toml, port and told.csv (the goals of all moves that it
    carried out).
    """

    def __init__(self, folder: Path, protocol: str = "grblhal") -> None:
        self.folder = folder
        context = multiprocessing.get_context("fork")
        ours, theirs = context.Pipe()
        self._process = context.Process(target=_emulate, args=(str(folder), protocol, theirs), daemon=True)
        self._process.start()
        assert ours.poll(60) and ours.recv()

    def commanded_goals(self) -> list[tuple[float, ...]]:
        """Goals of the moves carried out so far, m."""
        return [tuple(map(float, line.split(","))) for line in (self.folder / "told.csv").read_text().splitlines()]

    def close(self) -> None:
        self._process.kill()
        self._process.join()


def runner(arguments: list[str], log: Path) -> multiprocessing.Process:
    """`rig` with arguments in a forked process, what it says appended to a log; it can be killed."""
    process = multiprocessing.get_context("fork").Process(target=_run, args=(arguments, str(log)))
    process.start()
    return process


def _run(arguments: list[str], log: str) -> None:
    import sys

    from rig.cli.command_line import main

    handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(handle, 1)
    os.dup2(handle, 2)
    sys.stdout = os.fdopen(1, "w", buffering=1)
    sys.stderr = os.fdopen(2, "w", buffering=1)
    os._exit(main(arguments))


class RigInThread:
    """An emulated rig in this process, whose controller a test may put into any state. emulator : its controller

    controller : lines added to [controller]
    """

    def __init__(self, folder: Path, controller: str = "") -> None:
        import numpy as np

        self.folder, self._running = folder, True
        listening = socket.create_server(("127.0.0.1", 0))
        threading.Thread(target=cameras, args=(listening,), daemon=True).start()
        text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(
            0.3, cameras=1, width=WIDTH, height=HEIGHT
        ).replace(
            'shutter = "global"', f'shutter = "global"\nsource = "emulator:127.0.0.1:{listening.getsockname()[1]}"'
        )
        self.path = folder / "rig.toml"
        self.path.write_text(text + controller_text("grblhal", folder / "port") + controller)
        self.design = design_from_rig_toml.load_design(self.path)
        self.emulator = emulators.emulator_of_design(self.design, Faults((), np.random.default_rng(0)), SystemClock())
        wire = emulator_opening_and_serving_over_terminal_or_tcp.Terminal(folder / "port")
        self._thread = threading.Thread(
            target=emulator_opening_and_serving_over_terminal_or_tcp.serve_emulator,
            args=(self.emulator, wire, lambda: self._running, lambda name: None, lambda: None),
            daemon=True,
        )
        self._thread.start()

    def run(self, out: Path, plan: str = "sobol:2", notices: list[str] | None = None, **options) -> int:
        """A run of a plan, which measures nothing, as `rig run` makes it."""
        from calib.api.execute_plan_at_machine import RunOptions, plan_run

        settings = {"settle": "time:0", "exposure": "keep", "measure": False} | options
        planned = plan_run(self.design, self.path, plan, RunOptions(**settings))
        return planned.carry_out(out, notice=(notices if notices is not None else []).append)

    def close(self) -> None:
        self._running = False
        self._thread.join()
