"""Names of controller protocols, ports and user programs, and their checks.

It imports nothing that takes time.
"""

import re
from urllib.parse import urlsplit

PROTOCOLS = (
    "grblhal",
    "gcs",
    "gcs-hexapod",
    "hxp",
    "symetrie",
    "linuxcnc",
    "struts",
    "epics",
    "epics-hexapod",
    "urscript",
)
TURN = ("grblhal", "linuxcnc", "struts", "urscript")  # whose axes may be joints that turn
TAKE_POSES = (
    "gcs-hexapod",
    "hxp",
    "symetrie",
    "epics-hexapod",
)  # controllers of hexapods, with kinematics and frames of their own
MOTOR_RECORDS = ("epics", "epics-hexapod")  # whose axes are names of EPICS motor records
ANGLES = {"moving": "XYZ", "fixed": "xyz"}  # of U, V, W, in this order: SciPy's names of the axes that they turn about
STATE_ANGLES = ("hxp", "epics-hexapod")  # whose controllers may have either
USER_PROGRAMS = ("file", "package")  # KIND:PLACE of a protocol or camera of the user's own
USUAL_PORTS = {"ca": 5064, "xps": 5001, "ur": 30003}  # of URLs that name none
SHOWN = 80  # characters of a port's name that a message repeats
# of ports that are no device; pyserial knows others, which write files or search for devices
SCHEMES = ("socket", "rfc2217", "loop", *USUAL_PORTS)


def port_problem(port: str) -> str | None:
    """Problem with the name of a port, in words.

    None for a device (/dev/ttyUSB0, COM3) or an accepted URL.
    """
    scheme, stroke, _ = port.partition("://")
    if not port.isprintable():
        return f"{port[:SHOWN]!r} is not a port: it contains unprintable characters"
    if stroke and scheme.lower() not in SCHEMES:
        return f"{port[:SHOWN]!r} is not a port: it is a device (/dev/ttyUSB0, COM3) or " + ", ".join(
            f"{name}://.." for name in SCHEMES
        )
    if stroke:
        try:
            _ = urlsplit(port).port
        except ValueError as error:
            return f"{port[:SHOWN]!r} is not a port: {error}"
    return None


def is_motor_record_name(name: str) -> bool:
    """Whether a text may be the name of an EPICS motor record.

    Without a field.
    """
    return re.fullmatch(r"[A-Za-z0-9_:;\[\]{}-]{1,60}", name) is not None


def is_user_file_or_package(stated: str) -> bool:
    """Whether a stated text names a user's own file or package.

    Of a protocol, camera source or sensor port.
    "file:mine.py" or "package:NAME".
    """
    return stated.partition(":")[0] in USER_PROGRAMS
