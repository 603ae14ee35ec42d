"""Driver opening for a design, and settling before an exposure.

A driver is locked against other processes; status is settled once no axis moves. The platform settles for a time,
until images stop changing, until limb readings agree, or until an operator has measured it.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rig.array_and_json_types import Floats, Pixels
from rig.driving.axis_driver import Driver
from rig.driving.controller_address_and_urgent_stop import ControllerAddress, StoppedController
from rig.driving.controller_lock_and_stop_of_its_holder import ControllerLock
from rig.driving.controller_status_and_limits import ControllerStatus
from rig.driving.driving_clock import Clock, SystemClock
from rig.driving.protocols import protocol_of_controller
from rig.driving.request_and_answer_exchange_with_controller import Port
from rig.driving.serial_and_epics_ports_and_checksummed_frames import open_controller_port
from rig.driving.user_protocol_camera_sensor_classes_and_sensor_reader import refuse_programs_of_untrusted_rig_toml
from rig.errors import FileError, RigError
from rig.formats.numbers_and_units import parse_quantity
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import Controller, Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism, require_axes
from rig.model.protocol_port_and_user_program_name_checks import port_problem


def design_with_controller_port(path: Path, port: str | None) -> Design:
    """Design of a rig.toml, with the controller's port replaced where one is given.

    Raises RigError for one without, and for one that names programs and is not the operator's own
    """
    design = design_from_rig_toml.load_design(path)
    refuse_programs_of_untrusted_rig_toml(path, design)
    if design.controller is None:
        raise RigError(f"{path} has no [controller], so there is nothing to drive: state its protocol and port there")
    if port and (problem := port_problem(port)):
        raise RigError(f"--port {problem}")
    return replace(design, controller=replace(design.controller, port=port, usb="")) if port else design


def address_of_controller(controller: Controller, mechanism: Mechanism) -> ControllerAddress:
    """ControllerAddress of the Controller of a design.

    For a rig.toml that is no local file.
    Raises RigError for no port, and for a program of the user's own that cannot be used.
    """
    c = controller
    if not (c.port or c.usb):
        raise RigError("[controller] names no port")
    stop = protocol_of_controller(c, require_axes(mechanism)).urgent_stop
    return ControllerAddress(c.protocol, c.port, c.usb, c.baudrate, c.password, c.enable_password, stop, c.axes)


@contextmanager
def open_driver(
    design: Design,
    trace: Path | None,
    print_line: Callable[[str], None],
    clock: Clock | None = None,
    stopped: StoppedController | None = None,
) -> Iterator[Driver]:
    """Open the Driver of a design.

    No other process drives it meanwhile.
    print_line : takes a line of text
    stopped : the controller where it was sent its urgent stop: it is stopped before anything is asked of it
    Raises FileError for a trace that cannot be written, and what opening raises.
    """
    c, clock = design.driver(), clock or SystemClock()
    with ExitStack() as stack:
        if stopped is None:
            stack.enter_context(ControllerLock(c.port, c.usb))
        file = None
        if trace is not None:
            try:
                file = stack.enter_context(open(trace, "a", encoding="utf-8"))
            except OSError as error:
                raise FileError(trace, f"cannot be written: {error.strerror}") from None
        driver = Driver(design, clock, _opener(design, stopped, clock), file, print_line)
        if stopped is not None and file is not None:
            file.write(f"{stopped.t:.6f} > {stopped.sent!r}\n")
        stack.callback(driver.close)
        driver.open(stopped is not None)
        yield driver


def _opener(design: Design, stopped: StoppedController | None, clock: Clock) -> Callable[[], Port]:
    """Opens the controller's port: the one that is open already, once, and it anew after that."""
    c, opened = design.driver(), [] if stopped is None else [stopped.port]
    return lambda: opened.pop() if opened else open_controller_port(c.port, c.usb, c.baudrate, clock)


def await_settled_status(
    driver: Driver, clock: Clock, timeout: float = 60.0, poll_interval: float = 0.05
) -> ControllerStatus:
    """ControllerStatus once the axes have settled, which is awaited.

    So is a move that another process began.
    Raises RigError where they still move after so long.
    """
    status, end = driver.status(), clock.now() + timeout
    moved = status.activity == "moving"
    while status.activity == "moving":
        if clock.now() > end:
            driver.stop()
            raise RigError(f"the axes still moved {timeout:g} s after connecting; they were commanded to stop")
        clock.sleep(poll_interval)
        status = driver.status()
    if moved and status.known and status.activity == "idle" and not status.fault:
        driver.trust()  # it counted all the way, and nobody else commands it
    return status


BLOCK = 8  # px; means over blocks this wide are compared, so that noise of pixels does not count
NOISES = 8.0  # standard deviations of a block's mean between two images at rest; the most of 1e5 blocks stay within 5
LARGEST_NOISE = 1.0  # grey levels of a block's mean, above which it is no noise
LEAST = 0.5  # grey levels below which nothing has changed
PAIRS = 2  # successive pairs of images that must not differ
READINGS = 5  # of the limbs that must agree
EVERY = 0.05  # s between readings
MOST = 30.0  # s after which what has not settled is an error


class NotSettled(RigError):
    """The platform does not come to rest; states by how much it still moved."""


@dataclass(frozen=True, slots=True)
class Settling:
    """by : "time", "images", "limbs" or "ask"; amount : s to wait, or m that the limbs' readings may differ; unused for
    images and for an operator who is asked.
    """

    by: str
    amount: float

    def wait(
        self,
        clock: Clock,
        images: Callable[[], list[Pixels]] | None = None,
        limbs: Callable[[], Floats] | None = None,
        ask: Callable[[], tuple[float, ...]] | None = None,
    ) -> tuple[float, ...]:
        """Return once the platform rests. images : one of each camera; limbs : (6,) m readings; ask : an operator's
        reading of the place, once there is one; whichever `by` asks for.

        Returns the reading, () where there is none
        Raises NotSettled after MOST seconds, ValueError where what it goes by is not given.
        """
        if self.by == "ask" and ask is not None:
            return ask()
        if self.by == "time":
            clock.sleep(self.amount)
        elif self.by == "images" and images is not None:
            _by_images(clock, images)
        elif self.by == "limbs" and limbs is not None:
            _by_limbs(clock, limbs, self.amount)
        else:
            raise ValueError(f"settling by {self.by} takes {self.by} to look at")
        return ()


def parse_settling(text: str) -> Settling:
    """Settling parsed from text.

    "time:SECONDS", "images", "ask" or "limbs:LENGTH", as limbs:20um; a length without a unit is in m.
    Raises RigError for anything else.
    """
    by, _, amount = text.partition(":")
    try:
        value = parse_quantity(amount, "m" if by == "limbs" else "s") if amount else 0.0
    except ValueError:
        value = -1.0
    bare = by in ("images", "ask")
    if by not in ("time", "images", "limbs", "ask") or not 0 <= value < np.inf or bare == bool(amount):
        raise RigError(f'settling takes "time:SECONDS", "images", "ask" or "limbs:LENGTH", as limbs:20um, got {text!r}')
    return Settling(by, value)


def image_difference_relative_to_noise(first_image: Pixels, second_image: Pixels) -> float:
    """Difference of two images of a camera relative to noise.

    Above 1 the view has moved.
    """
    difference = np.abs(_blocks(first_image) - _blocks(second_image))
    noise = min(float(np.median(difference)) / 0.6745, LARGEST_NOISE)
    return float(difference.max()) / max(NOISES * noise, LEAST)


def _blocks(image: Pixels) -> Floats:
    """Means over blocks of an image, in 255ths of white."""
    grey = image if image.ndim == 2 else image[..., 1]  # green is most of what the eye calls grey
    height, width = (n - n % BLOCK for n in grey.shape)
    scale = 1.0 if image.dtype == np.uint8 else 1 / 257
    return grey[:height, :width].reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK).mean(axis=(1, 3)) * scale


def _by_images(clock: Clock, images: Callable[[], list[Pixels]]) -> None:
    start, before, still = clock.now(), images(), 0
    while still < PAIRS:
        now = images()
        most = max(image_difference_relative_to_noise(a, b) for a, b in zip(before, now))
        still, before = still + 1 if most <= 1 else 0, now
        if clock.now() - start > MOST and still < PAIRS:
            raise NotSettled(
                f"images still change after {MOST:g} s, {most:.1f} times the noise: does the "
                "platform move, or the light?"
            )


def _by_limbs(clock: Clock, limbs: Callable[[], Floats], tolerance: float) -> None:
    start = clock.now()
    last: list[Any] = []
    while True:
        last = [*last[1 - READINGS :], np.asarray(limbs(), float)]
        moved = np.ptp(last, axis=0)
        if len(last) == READINGS and (moved <= tolerance).all():
            return
        if clock.now() - start > MOST:
            raise NotSettled(
                f"limb {int(np.argmax(moved)) + 1} still moves by {moved.max() * 1e6:.2f} um after {MOST:g} s, "
                f"{tolerance * 1e6:.2f} um are allowed"
            )
        clock.sleep(EVERY)
