"""Selection of the protocol, and user protocols.

The protocol is the one that rig.toml states; a user's own is loaded, checked, and guarded.
"""

import inspect
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import ParamSpec, cast

from rig.driving.protocols.epics import Epics, EpicsHexapod
from rig.driving.protocols.gcs import GCS, GCSHexapod
from rig.driving.protocols.grblhal import GrblHAL
from rig.driving.protocols.linuxcnc import LinuxCNC
from rig.driving.protocols.native_strut_protocol import Struts
from rig.driving.protocols.newport_hxp import HXP
from rig.driving.protocols.protocol_interface_and_user_line_protocol import (
    Dialogue,
    LineProtocol,
    Protocol,
    State,
    Verdict,
    user_protocol_state_problem,
)
from rig.driving.protocols.symetrie import Symetrie
from rig.driving.protocols.urscript import URScript
from rig.driving.user_protocol_camera_sensor_classes_and_sensor_reader import (
    first_missing_member_of_user_class,
    load_user_class_and_its_file,
    user_class_error,
    wrap_user_call_to_locate_errors,
)
from rig.errors import ControllerFault, FileError
from rig.formats.user_python_file_reading_and_running import literal_in_class_body, read_user_text_and_sha256
from rig.model.design import Controller
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Commanded, axis_units, require_hexapod
from rig.model.protocol_port_and_user_program_name_checks import is_user_file_or_package

P = ParamSpec("P")
GROUP = "rig.protocols"  # of entry points
RESULTS: dict[str, type[object]] = {
    "identity": tuple,
    "hello": str,
    "fence": bool,
    "state": State,
    **dict.fromkeys(("move", "home", "stop", "unlock"), Verdict),
}
PLAIN = ("move_line", "encode", "decode", "event")  # methods that ask nothing
TEXTS = ("name", "accepted", "refused", "stop_line")  # that a class must state


def protocol_of_controller(controller: Controller, mechanism: Commanded) -> Protocol:
    """The Protocol of a controller that drives a mechanism's axes.

    A program of the user's own is run for it.
    Raises ValueError for a protocol that there is not, FileError and RigError for a program that cannot be used
    """
    axis_count = len(mechanism.axes)
    if is_user_file_or_package(controller.protocol):
        return load_user_protocol(controller, axis_count)
    if controller.protocol == "grblhal":
        return GrblHAL(controller.axes or tuple("XYZABCUVW"[:axis_count]), axis_units(mechanism))
    if controller.protocol == "gcs":
        return GCS(controller.axes, axis_count)
    if controller.protocol == "gcs-hexapod":
        hexapod = require_hexapod(mechanism, "gcs-hexapod drives a hexapod, not a mechanism of kind {kind!r}")
        return GCSHexapod(hexapod, controller.zero, controller.work, controller.tool)
    if controller.protocol == "hxp":
        return HXP(controller, require_hexapod(mechanism, "hxp drives a hexapod, not a mechanism of kind {kind!r}"))
    if controller.protocol == "symetrie":
        hexapod = require_hexapod(mechanism, "symetrie drives a hexapod, not a mechanism of kind {kind!r}")
        return Symetrie(controller, hexapod)
    if controller.protocol == "struts":
        return Struts(axis_count, controller.watchdog)
    if controller.protocol == "linuxcnc":
        return LinuxCNC(
            controller.axes or tuple("XYZABCUVW"[:axis_count]),
            controller.kinematics,
            controller.password,
            controller.enable_password,
            axis_units(mechanism),
        )
    records = controller.axes or tuple(f"m{i + 1}" for i in range(axis_count))
    if controller.protocol == "epics":
        return Epics(records)
    if controller.protocol == "epics-hexapod":
        hexapod = require_hexapod(mechanism, "epics-hexapod drives a hexapod, not a mechanism of kind {kind!r}")
        return EpicsHexapod(records, controller, hexapod)
    if controller.protocol == "urscript":
        return URScript(controller, axis_count)
    raise ValueError(f"no protocol {controller.protocol!r}")


def load_user_protocol(controller: Controller, count: int) -> LineProtocol:
    """Load the user's protocol of `[controller] protocol`.

    It states "file:.." or "package:..".
    Raises FileError with the line.
    """
    kind, path = load_user_class_and_its_file(controller.protocol, LineProtocol, GROUP, "protocol")
    if "_guarded" not in vars(kind):
        _check(kind, path)
        _guard(kind, path)
    try:
        return kind(controller, count)
    except TypeError as error:
        raise user_class_error(path, kind, f"cannot be made with (controller, count): {error}", "__init__") from None


def _check(kind: type[LineProtocol], path: str) -> None:
    """Raise FileError for a class that lacks something, or has what no driver can use."""
    for name in TEXTS:
        if not isinstance(getattr(kind, name, None), str) or not getattr(kind, name):
            raise user_class_error(path, kind, f"lacks {name}, a text", name)
    if not isinstance(literal_in_class_body(read_user_text_and_sha256(Path(path))[0], "urgent_stop"), bytes):
        raise user_class_error(
            path,
            kind,
            'lacks urgent_stop, bytes as a literal (urgent_stop = b"!"), sent before all else',
            "urgent_stop",
        )
    move = "move_line" if first_missing_member_of_user_class(kind, LineProtocol, ("move",)) else "move"
    missing = first_missing_member_of_user_class(kind, LineProtocol, ("identity", "state", move))
    if missing:
        raise user_class_error(path, kind, f"lacks {missing}: {(getattr(LineProtocol, missing).__doc__ or '').strip()}")
    for name in (*RESULTS, "confirm", "limits"):
        call = vars(kind).get(name)
        if call is not None and not inspect.isgeneratorfunction(call):
            line = getattr(getattr(call, "__code__", None), "co_firstlineno", None)
            raise FileError(path, f"{kind.__name__}.{name} asks nothing: expected `yield from self.ask(..)`", line)


def _guard(kind: type[LineProtocol], path: str) -> None:
    for name in (*RESULTS, *PLAIN):
        call = vars(kind).get(name)
        if call is not None:
            guarded = wrap_user_call_to_locate_errors(call, path, ControllerFault, kind.__name__)
            expected = RESULTS.get(name)
            setattr(kind, name, guarded if expected is None else _checked(guarded, path, kind.__name__, expected))
    kind._guarded = True


def _checked(
    dialogue: Callable[P, Dialogue[object]], path: str, owner: str, expected: type[object]
) -> Callable[P, Dialogue[object]]:
    """A dialogue whose result is of the type that the driver needs. Raises ControllerFault otherwise."""

    @wraps(dialogue)
    def checked(*given: P.args, **named: P.kwargs) -> Dialogue[object]:
        found = yield from dialogue(*given, **named)
        problem = None if isinstance(found, expected) else f"gave {type(found).__name__}, not {expected.__name__}"
        if isinstance(found, State) and expected is State:
            problem = user_protocol_state_problem(found, cast(LineProtocol, given[0]).count)
        if problem:
            line = inspect.unwrap(dialogue).__code__.co_firstlineno
            raise ControllerFault(f"{path}:{line}: {owner}.{dialogue.__name__} {problem}")
        return found

    return checked
