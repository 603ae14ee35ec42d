"""Images of emulated cameras, sensors, and the process that serves them.

Images are rendered of the pose that it has, by a process of their own.
"""

import json
import multiprocessing
import queue
import signal
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.cameras.camera_opening_with_folder_and_emulator_sources import USUAL
from rig.driving.driving_clock import Clock, SystemClock
from rig.driving.emulators.emulator_opening_and_serving_over_terminal_or_tcp import home_lengths
from rig.errors import RigError
from rig.formats.rig_toml import design_from_rig_toml
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_axes
from rig.model.pose import transform_points
from rig.planning.timed_plan_and_visiting_order import Plan
from rig.recording.recording_folder import Commands, Sensors
from synthetic import random_true_machine_and_truth_file
from synthetic import random_true_machine_and_truth_file as worlds
from synthetic.ideal_image_renderer import import_pyrender_without_viewer
from synthetic.image_simulation import Images, render_image, require_renderable
from synthetic.random_true_machine_and_truth_file import World, world_with_remounted_cubes
from synthetic.recording_simulation import Simulation

LONGEST = 24 * 3600.0  # s that the temperatures lasts; beyond it remains unchanged
SOON, LATE = (
    0.02,
    20.0,
)  # s between looks at the history for what the struts did up to a moment, and until that is given up
StrutHistory = Callable[[], tuple[Floats, Floats]]


@dataclass(frozen=True, slots=True, eq=False)
class Temperatures:
    """true, log : Sensors, as it truly is and as thermometers have it."""

    true: Sensors
    log: Sensors


class EmulatedCameras:
    """What cameras and sensors of a world show. images : Images; seed : of temperatures and noise
    strut_history : the struts' history so far, (k,) s and (k, n) m, straight between; it is waited for until it
        reaches the moment of asking."""

    def __init__(self, world: World, images: Images, seed: int, strut_history: StrutHistory, clock: Clock) -> None:
        self._clock = clock
        self.world, self._images, self._seed, self._strut_history, self._count = (
            world_with_remounted_cubes(world, {}),
            images,
            seed,
            strut_history,
            0,
        )
        self._temperatures = Temperatures(
            *worlds.random_true_and_logged_temperatures(
                LONGEST, np.random.default_rng(seed), len(world.true.mechanism.axes)
            )
        )
        self._start: float | None = None

    def image(self, name: str, t: float, exposure: float) -> Floats:
        """The image of a camera exposed at t (s, the history's clock) for so long (s; USUAL gives the stated
        brightness).

        Raises RigError for a camera that there is not, and where nobody says where the struts stood.
        """
        names = [camera.name for camera in self.world.true.cameras]
        if name not in names:
            raise RigError(f"no camera {name!r}; there are {', '.join(names)}")
        sensor = replace(self._images.sensor, gain=self._images.sensor.gain * exposure / USUAL)
        self._count += 1
        return render_image(
            self._now(t), 0, names.index(name), replace(self._images, sensor=sensor), self._seed + self._count
        )

    def pose(self, t: float) -> Floats:
        """(4, 4) T_base_platform as it truly is at t (s)."""
        return self._now(t).run.T_base_platform.as_matrix()[0]

    def sensors(self, t: float) -> dict[str, float]:
        """{channel: value} as thermometers and measuring limbs read at t (s)."""
        now = self._now(t)
        log = {
            name: float(np.interp(now.plan.t[0], self._temperatures.log.t, values))
            for name, values in self._temperatures.log.channels.items()
        }
        limbs = self.world.true.insitu
        if limbs is None:
            return log
        self._count += 1
        noise = limbs.length_sigma * np.random.default_rng([self._seed, self._count]).normal(size=len(limbs.channels))
        legs = transform_points(now.run.T_base_platform, limbs.platform_joints)[0] - limbs.base_joints
        read = np.linalg.norm(legs, axis=-1) - limbs.zeros + noise
        return log | dict(zip(limbs.channels, read.tolist()))

    def _now(self, t: float) -> Simulation:
        """The machine at t (s), after all that its struts have done."""
        times, lengths = self._strut_history()
        while times[-1] < t:  # where they stand at t is not known before
            if self._clock.now() > t + LATE:
                raise RigError(
                    f"the strut motion is known up to {t - times[-1]:.1f} s before the exposure, and no "
                    f"further for {LATE:g} s"
                )
            self._clock.sleep(SOON)
            times, lengths = self._strut_history()
        self._start = float(times[0]) if self._start is None else self._start
        past = times < t
        at = np.array([np.interp(t, times, column) for column in lengths.T])
        commands = Commands(np.r_[times[past], t] - self._start, np.vstack([lengths[past], at]))
        when, warmth = np.array([t - self._start]), self._temperatures.true
        plan = Plan(commands, when, np.array([(0.0, 0.0)]))
        loaded = replace(warmth, channels={**warmth.channels, "payload_mass_kg": np.zeros(len(warmth.t))})
        run = motion_simulation.simulate_machine_run(
            self.world.true,
            commands,
            when,
            self.world.effects,
            loaded,
            rates=motion_simulation.has_rolling_shutter(self.world.true, self.world.effects),
        )
        return Simulation(self.world, plan, loaded, self._temperatures.log, run)


class HistoryFromFile:
    """The history that an emulator writes as it happens (rig.driving.emulators.TrueCommandsLog), read on from where it
    was left.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._at, self._rest = Path(path), 0, ""
        self._rows: list[list[float]] = []

    def __call__(self) -> tuple[Floats, Floats]:
        """((k,) s, (k, n) m) so far. Raises RigError where there is nothing yet."""
        with open(self._path, encoding="utf-8") as file:
            file.seek(self._at)
            text = file.read()
            self._at = file.tell()
        *lines, self._rest = (self._rest + text).split("\n")
        for line in lines:
            if line and not line.startswith("t,"):
                row = [float(cell) for cell in line.split(",")]
                if len(self._rows) > 1 and row[1:] == self._rows[-1][1:] == self._rows[-2][1:]:
                    self._rows.pop()  # struts that go on standing need no more rows
                self._rows.append(row)
        if not self._rows:
            raise RigError(f"{self._path} does not yet state the strut positions")
        rows = np.array(self._rows)
        return rows[:, 0], rows[:, 1:]


LONGEST_REQUEST = 200  # bytes of a request
LOOK = 0.2  # s between looks at whether to go on


class CameraServer:
    """Listens at an address (host, port; 0: any). Requests are taken, and the exposure's moment with them, while a
    picture is being drawn; pictures are drawn one after the other in the thread that calls `serve`: OpenGL wants
    that."""

    def __init__(self, cameras: EmulatedCameras, address: tuple[str, int], clock: Clock) -> None:
        self._cameras, self._clock = cameras, clock
        try:
            self._listening = socket.create_server(address)
        except OSError as error:
            raise RigError(f"cannot listen at {address[0]}:{address[1]}: {error}") from None
        self.name = "{}:{}".format(*self._listening.getsockname()[:2])
        self._requests: queue.Queue[tuple[socket.socket, str, float]] = queue.Queue()
        threading.Thread(target=self._accept, daemon=True).start()

    def serve(self, going: Callable[[], bool]) -> None:
        """Answer while going() says so."""
        while going():
            try:
                caller, line, t = self._requests.get(timeout=LOOK)
            except queue.Empty:
                continue
            try:
                data = self._reply(line.split(), t)
            except RigError as error:
                data = json.dumps({"error": str(error)}).encode() + b"\n"
            try:
                caller.sendall(data)
            except OSError:
                caller.close()  # who asked is gone

    def close(self) -> None:
        """Listen no longer."""
        self._listening.close()

    def _accept(self) -> None:
        while True:
            try:
                caller = self._listening.accept()[0]
            except OSError:
                return  # closed
            caller.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=self._listen, args=(caller,), daemon=True).start()

    def _listen(self, caller: socket.socket) -> None:
        """Take a caller's requests as they come, until he hangs up or sends what is none."""
        with caller, caller.makefile("rb") as stream:
            try:
                while (line := stream.readline(LONGEST_REQUEST)).endswith(b"\n"):
                    self._requests.put((caller, line.decode("latin-1"), self._clock.now()))
            except OSError:
                return  # the line broke; there is nobody to answer

    def _reply(self, words: list[str], t: float) -> bytes:
        if words == ["sensors"]:
            return (",".join(f"{value:.9g}" for value in self._cameras.sensors(t).values()) + "\n").encode()
        if len(words) != 3 or words[0] != "expose":
            raise RigError(f"expected `expose CAMERA SECONDS` or `sensors`, got {' '.join(words)!r}")
        try:
            exposure = float(words[2])
        except ValueError:
            exposure = np.nan
        if not 0 < exposure < 100:
            raise RigError(f"an exposure of {words[2]} s is not valid")
        image = self._cameras.image(words[1], t, exposure)
        eight = image.dtype == np.uint8
        head = {
            "width": image.shape[1],
            "height": image.shape[0],
            "bits": 8 if eight else 12,
            "age": self._clock.now() - t,
        }
        return json.dumps(head).encode() + b"\n" + image.astype("u1" if eight else "<u2").tobytes()


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
        stated = design_from_rig_toml.load_design(design)
        secret = (
            random_true_machine_and_truth_file.load_world_from_truth_file(Path(truth), stated)
            if truth
            else random_true_machine_and_truth_file.World(stated, stated)
        )
        require_renderable(secret.effects)
        import_pyrender_without_viewer()
        clock, images = SystemClock(), Images(stated.sensor)
        home = home_lengths(require_axes(stated.mechanism))
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
