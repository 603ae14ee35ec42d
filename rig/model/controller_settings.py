"""Settings of the controller that drives a rig's axes: the [controller] of a rig.toml, in metres and seconds."""

from dataclasses import dataclass

from rig.arrays import Floats

PROTOCOLS = ("grblhal", "gcs", "linuxcnc", "struts")
SHOWN = 80  # characters of a port's name that a message repeats
SCHEMES = (
    "socket",
    "rfc2217",
    "loop",
)  # of ports that are no device; pyserial knows others, which write files or search for devices


def port_problem(port: str) -> str | None:
    """Problem with the name of a port, in words; None for a device (/dev/ttyUSB0, COM3) or an accepted URL."""
    scheme, stroke, _ = port.partition("://")
    if not port.isprintable():
        return f"{port[:SHOWN]!r} is no port: it holds characters that cannot be printed"
    if stroke and scheme.lower() not in SCHEMES:
        return f"{port[:SHOWN]!r} is no port: it is a device (/dev/ttyUSB0, COM3) or " + ", ".join(
            f"{name}://.." for name in SCHEMES
        )
    return None


@dataclass(frozen=True, slots=True, eq=False)
class Controller:
    """What drives the axes.

    protocol : one of PROTOCOLS; baudrate : bits per second; port : device, or URL socket://, rfc2217://, loop://;
    usb : serial number or hardware id by which to find the port again, or ""; axes : the controller's names of the
        axes, in the mechanism's
    order, () for the protocol's own
    homing : whether the controller can home; without, the position that it reads at the start is believed
    zero : (n,) m, an axis's length where the controller reads 0; home : (n,) m, lengths after homing, or None where not
        stated
    max_speed : (n,) m/s; max_acceleration : (n,) m/s^2, None for what the controller itself allows
    tolerance : m, of a read-back; max_step : m, largest change of one axis in a move, None for any; margin : smallest
    share that the Jacobian's least singular value may have of its value at home
    timeout, home_timeout : s, for an answer and for homing; watchdog : s of silence after which a controller that can
        shall stop
    kinematics : "joint" (an axis word is an axis) or "world" (the controller has the inverse kinematics and is sent
        poses)
    password, enable_password : of linuxcncrsh
    """

    protocol: str
    port: str
    baudrate: int
    usb: str
    axes: tuple[str, ...]
    homing: bool
    zero: Floats
    home: Floats | None
    max_speed: Floats
    max_acceleration: Floats | None
    tolerance: float
    max_step: float | None
    margin: float
    timeout: float
    home_timeout: float
    watchdog: float
    kinematics: str
    password: str
    enable_password: str
