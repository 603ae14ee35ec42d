"""User's own protocol, camera and sensor classes, and the reader of sensors.

A user's own file, or the entry point of a package, gives them.

Both are programs and are run: only by what drives the controller or opens the camera, never by reading a rig.toml.

Sensors are read from a port, a line of numbers per reading, or by a program of the user's own.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Generator, Mapping
from functools import lru_cache, wraps
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, ParamSpec, TypeVar, cast

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.driving_clock import Clock
from rig.driving.serial_and_epics_ports_and_checksummed_frames import SerialPort
from rig.errors import FileError, NoAnswer, RigError
from rig.formats.local_and_remote_input_files import is_remote
from rig.formats.numbers_and_units import parse_numbers
from rig.formats.user_python_file_reading_and_running import (
    UserModule,
    line_in_file_of_error,
    line_of_class,
    load_user_module,
)
from rig.model.design import Design, SensorPort
from rig.model.protocol_port_and_user_program_name_checks import is_user_file_or_package

if TYPE_CHECKING:
    from rig.driving.request_and_answer_exchange_with_controller import Port

P = ParamSpec("P")
Steps = Generator[object, object, object]  # of a dialogue
T = TypeVar("T")
RECORDED = ("journal.jsonl", "frames.csv")  # files that make a folder a recording


def refuse_programs_of_untrusted_rig_toml(path: Path, design: Design) -> None:
    """Raise RigError where a rig.toml that is not trusted names programs to run.

    It is behind a URL or part of a recording.
    Whoever wrote that is not the operator of this machine.
    """
    sources = [design.controller.protocol if design.controller else "", *(c.source or "" for c in design.cameras)]
    sources += [design.sensors.port] if design.sensors else []
    programs = [stated for stated in sources if is_user_file_or_package(stated) or stated.startswith("command:")]
    if not programs:
        return
    if is_remote(path):
        raise RigError(f"{path} names a program ({programs[0]}) and is behind a URL: copy both to this computer first")
    found = [name for name in RECORDED if (path.parent / name).exists()]
    if found:
        raise RigError(
            f"{path} names a program ({programs[0]}) and is part of a recording ({found[0]} is there), from which no "
            "program is run: use the rig.toml of the rig itself"
        )


def load_user_class_and_its_file(
    file_or_package: str, base: type[T], group: str, class_description: str
) -> tuple[type[T], str]:
    """Load a user's class of "file:PATH" or "package:NAME", and the name of its file.

    group : of the package's entry points; class_description : the class is, for messages
    Returns (class derived from a base, the file that defines it)
    Raises FileError with the line where a file cannot be used, RigError for a package that is not there
    """
    kind, _, place = file_or_package.partition(":")
    module = _module(Path(place)) if kind == "file" else _package(place, group)
    found = module.classes(base)
    if len(found) != 1:
        names = ", ".join(one.__name__ for one in found)
        expected = f"class Mine({base.__name__}), from rig.driving.base"
        raise FileError(
            module.path,
            f"defines {f'several: {names}; expected one' if found else 'no'} {class_description}: {expected}",
            module.line(found[1]) if found else None,
        )
    return found[0], str(module.path)


def first_missing_member_of_user_class(kind: type[object], base: type[object], members: tuple[str, ...]) -> str | None:
    """First missing member of a user's class.

    The first of some members (methods or attributes) that it does not have of its own.

    None for none.
    """
    return next((name for name in members if getattr(kind, name, None) is getattr(base, name, None)), None)


def user_class_error(path: str, kind: type[object], message: str, field: str | None = None) -> FileError:
    """FileError at a class of a user's file.

    With the line of the class, or of a name in its body.
    """
    text = Path(path).read_text(encoding="utf-8")
    return FileError(path, f"{kind.__name__} {message}", line_of_class(text, kind.__name__, field))


def wrap_user_call_to_locate_errors(
    call: Callable[P, T], path: str, error_kind: type[RigError], owner: str
) -> Callable[P, T]:
    """Wrapped call of a user's method whose errors are located in the user's file.

    The same method, whose failures name the file and the line.

    Of a dialogue each of its steps.
    """

    def failure(error: Exception) -> RigError:
        line = line_in_file_of_error(error, path) or call.__code__.co_firstlineno
        return error_kind(f"{path}:{line}: {owner}.{call.__name__} fails: {type(error).__name__}: {error}")

    def dialogue(*given: P.args, **named: P.kwargs) -> Steps:
        try:
            return (yield from cast(Steps, call(*given, **named)))
        except RigError:
            raise
        except Exception as error:
            raise failure(error) from error

    def guarded(*given: P.args, **named: P.kwargs) -> T:
        try:
            return call(*given, **named)
        except RigError:
            raise
        except Exception as error:
            raise failure(error) from error

    return wraps(call)(cast(Callable[P, T], dialogue) if inspect.isgeneratorfunction(call) else guarded)


@lru_cache(16)
def _module(path: Path) -> UserModule:
    return load_user_module(path)


def _package(name: str, group: str) -> UserModule:
    found = [one for one in entry_points(group=group) if one.name == name]
    if not found:
        available = ", ".join(sorted(one.name for one in entry_points(group=group))) or "none"
        raise RigError(f"no installed package has {name!r} among its entry points {group}; there are {available}")
    try:
        loaded = found[0].load()
    except Exception as error:
        raise RigError(
            f"the entry point {name!r} of {group}, {found[0].value}, cannot be loaded: {type(error).__name__}: {error}"
        ) from error
    module = sys.modules.get(getattr(loaded, "__module__", ""))
    if module is None or module.__file__ is None:
        raise RigError(f"the entry point {name!r} of {group} is {loaded!r}, not a class in a module")
    path = Path(module.__file__)
    return UserModule(path, path.read_text(encoding="utf-8"), "", module)


WAIT = 2.0  # s for a line
LONGEST = 4096  # bytes
GROUP = "rig.sensors"  # of entry points


class SensorReader:
    """An open port with sensors. stated : SensorPort of the rig.toml; opener : makes the port, by default the one that
    it names
    """

    def __init__(self, stated: SensorPort, clock: Clock, opener: Callable[[], Port] | None = None) -> None:
        self._stated, self._clock = stated, clock
        self._port = opener() if opener else SerialPort(stated.port, stated.baudrate, clock)

    def read(self) -> dict[str, float]:
        """{channel: value} of a line that came after this call. Raises NoAnswer where none comes, or one that is not
        these channels.
        """
        stated, rest, end = self._stated, b"", self._clock.now() + WAIT
        self._port.read(self._clock.now())  # what came before is old
        if stated.ask:
            self._port.write(stated.ask.encode() + b"\n")
        skip = not stated.ask  # a line under way may have begun before
        while True:
            if self._clock.now() >= end:
                raise NoAnswer(f"the sensors at {stated.port} sent no line in {WAIT:g} s")
            rest += self._port.read(end)
            *lines, rest = rest.replace(b"\r", b"\n").split(b"\n")
            lines = [line for line in lines if line.strip()]
            if len(rest) > LONGEST:
                raise NoAnswer(f"the sensors at {stated.port} send no lines: {rest[:40]!r} ..")
            if lines and skip:
                lines, skip = lines[1:], False
            if lines:
                return self._values(lines[-1])

    def limbs(self) -> Floats:
        """(6,) m, what the measuring limbs read."""
        values = self.read()
        return np.array([values[f"m{i + 1}"] for i in range(6)])

    def close(self) -> None:
        """Let go of the port."""
        self._port.close()

    def _values(self, line: bytes) -> dict[str, float]:
        cells = line.decode("latin-1").replace(",", " ").replace(";", " ").split()
        try:
            values = parse_numbers(cells)
        except ValueError:
            values = []
        if len(values) != len(self._stated.channels) or not np.isfinite(values).all():
            raise NoAnswer(
                f"the sensors at {self._stated.port} sent {line[:80]!r}; [sensors] channels has "
                f"{len(self._stated.channels)} numbers"
            )
        return dict(zip(self._stated.channels, values))


class UserSensors:
    """Base class of sensors or an instrument of the user's own. channels : names as [sensors] states them."""

    def __init__(self, channels: tuple[str, ...]) -> None:
        self.channels = channels

    def read(self) -> Mapping[str, float]:
        """{channel: value} measured after this call."""
        raise NotImplementedError

    def close(self) -> None:
        """Let go of the device."""


class UserSensorReader(SensorReader):
    """Sensors that a class in a user's file or package reads; see SensorReader."""

    def __init__(self, stated: SensorPort) -> None:
        """Raises FileError or RigError where the program cannot be used."""
        kind, path = load_user_class_and_its_file(stated.port, UserSensors, GROUP, "sensors")
        if kind.read is UserSensors.read:
            raise user_class_error(path, kind, "lacks read, which returns {channel: value}")
        self._stated, self._path, self._owner = stated, path, kind.__name__
        self._user = wrap_user_call_to_locate_errors(kind, path, RigError, self._owner)(stated.channels)

    def read(self) -> dict[str, float]:
        found = wrap_user_call_to_locate_errors(self._user.read, self._path, NoAnswer, self._owner)()
        channels = self._stated.channels
        values = {name: float(found[name]) for name in channels if name in found}
        wrong = [name for name in channels if not np.isfinite(values.get(name, np.nan))]
        if wrong:
            raise NoAnswer(f"{self._path}: {self._owner}.read gave no number for {', '.join(wrong)}")
        return values

    def close(self) -> None:
        wrap_user_call_to_locate_errors(self._user.close, self._path, RigError, self._owner)()


def open_sensors_of_rig_toml(stated: SensorPort, clock: Clock) -> SensorReader:
    """The sensors of a rig.toml, opened.

    Raises LinkLost for a port, FileError or RigError for a program.
    """
    return UserSensorReader(stated) if is_user_file_or_package(stated.port) else SensorReader(stated, clock)
