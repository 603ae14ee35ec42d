"""Process that draws what emulated cameras see, beside an emulated controller."""

import multiprocessing
import signal
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from rig.driving.cameras.camera_opening import USUAL
from rig.driving.clock import SystemClock
from rig.driving.emulators.emulator_opening import home_lengths
from rig.errors import RigError
from rig.formats.rig_toml import design_file
from rig.model.mechanism_kinds_and_hexapod_properties import require_struts
from synthetic import secret_machine
from synthetic.emulated_cameras import CameraServer, EmulatedCameras, HistoryFromFile
from synthetic.ideal_image_renderer import import_pyrender
from synthetic.image_simulation import Images, require_renderable

START_TIMEOUT = 300.0  # s for the process to be ready; compiling and OpenGL take some


class EmulatedCameraProcess:
    """A process that draws. name : host:port where it listens."""

    def __init__(self, design: Path, truth: Path | None, history: Path, address: tuple[str, int], seed: int) -> None:
        """truth : what rig simulate --truth wrote, or None for a rig that is as its rig.toml says. Raises RigError
        where it cannot start.
        """
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve_emulated_cameras,
            args=(str(design), truth and str(truth), str(history), address, seed, theirs),
            daemon=True,
        )
        self._process.start()
        theirs.close()
        try:
            good, name = (
                ours.recv()
                if ours.poll(START_TIMEOUT)
                else (False, f"the cameras were not ready in {START_TIMEOUT:g} s")
            )
        except EOFError:
            good, name = False, "the cameras' process ended before it was ready"
        self.name: str = name
        if not good:
            self.close()
            raise RigError(name)

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        self._process.join()


def _serve_emulated_cameras(
    design: str, truth: str | None, history: str, address: tuple[str, int], seed: int, pipe: Connection
) -> None:
    """The process: says (True, name) or (False, why) through the pipe, then draws until it is ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who interrupts the emulator ends this with it
    try:
        stated = design_file.load_design(design)
        secret = secret_machine.world_from_truth(Path(truth), stated) if truth else secret_machine.World(stated, stated)
        require_renderable(secret.effects)
        import_pyrender()
        clock, images = SystemClock(), Images(stated.sensor)
        home = home_lengths(require_struts(stated.mechanism))
        at_home = EmulatedCameras(secret, images, seed, lambda: (np.array([0.0, 1.0]), np.array([home, home])), clock)
        for camera in secret.true.cameras:  # what is compiled and loaded for the first pictures is not waited for later
            at_home.image(camera.name, 1.0, USUAL)
        server = CameraServer(
            EmulatedCameras(secret, images, seed, HistoryFromFile(Path(history)), clock), address, clock
        )
    except RigError as error:
        pipe.send((False, str(error)))
        return
    pipe.send((True, server.name))
    pipe.close()
    parent = multiprocessing.parent_process()
    server.serve(lambda: parent is None or parent.is_alive())
    server.close()
