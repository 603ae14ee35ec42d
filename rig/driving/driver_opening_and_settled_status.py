"""Driver opening for a design, and settled status.

A driver is locked against other processes; status is settled once no axis moves.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

from rig.driving.clock import Clock, SystemClock
from rig.driving.controller_address_and_urgent_stop import ControllerAddress, StoppedController
from rig.driving.controller_lock import ControllerLock
from rig.driving.controller_status_and_limits import ControllerStatus
from rig.driving.protocols import protocol_of_controller
from rig.driving.request_and_answer_exchange_with_controller import Port
from rig.driving.serial_port import SerialPort, find_usb_port
from rig.driving.strut_driver import Driver
from rig.driving.user_protocol_camera_and_sensor_classes import require_own_rig_toml
from rig.errors import FileError, RigError
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import Controller, Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism, require_struts
from rig.model.protocol_and_port_names import port_problem


def design_with_controller_port(path: Path, port: str | None) -> Design:
    """Design of a rig.toml with a controller, its port replaced where one is given.

    Raises RigError for one without, and for one that names programs and is not the operator's own
    """
    design = design_from_rig_toml.load_design(path)
    require_own_rig_toml(path, design)
    if design.controller is None:
        raise RigError(f"{path} has no [controller], so there is nothing to drive: state its protocol and port there")
    if port and (problem := port_problem(port)):
        raise RigError(f"--port {problem}")
    return replace(design, controller=replace(design.controller, port=port, usb="")) if port else design


def address_of_controller(controller: Controller, mechanism: Mechanism) -> ControllerAddress:
    """Address of the Controller of a design, for a rig.toml that is no local file.

    Raises RigError for no port, and for a program of the user's own that cannot be used.
    """
    c = controller
    if not (c.port or c.usb):
        raise RigError("[controller] names no port")
    stop = protocol_of_controller(c, require_struts(mechanism)).urgent_stop
    return ControllerAddress(c.protocol, c.port, c.usb, c.baudrate, c.password, c.enable_password, stop)


@contextmanager
def open_driver(
    design: Design,
    trace: Path | None,
    print_line: Callable[[str], None],
    clock: Clock | None = None,
    stopped: StoppedController | None = None,
) -> Iterator[Driver]:
    """The open Driver of a design, which no other process drives meanwhile.

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
    return lambda: opened.pop() if opened else SerialPort(find_usb_port(c.port, c.usb), c.baudrate, clock)


def settled_status(
    driver: Driver, clock: Clock, timeout: float = 60.0, poll_interval: float = 0.05
) -> ControllerStatus:
    """Status once the axes have settled.

    A move that another process began is awaited.
    Raises RigError where they still move after so long.
    """
    status, end = driver.status(), clock.now() + timeout
    moved = status.activity == "moving"
    while status.activity == "moving":
        if clock.now() > end:
            driver.stop()
            raise RigError(f"the struts still moved {timeout:g} s after connecting; they were commanded to stop")
        clock.sleep(poll_interval)
        status = driver.status()
    if moved and status.known and status.activity == "idle" and not status.fault:
        driver.trust()  # it counted all the way, and nobody else commands it
    return status
