"""User's own protocol, camera and sensor classes.

A user's own file, or the entry point of a package, gives them.

Both are programs and are run: only by what drives the controller or opens the camera, never by reading a rig.toml.
"""

import inspect
import sys
from collections.abc import Callable, Generator
from functools import lru_cache, wraps
from importlib.metadata import entry_points
from pathlib import Path
from typing import ParamSpec, TypeVar, cast

from rig.errors import FileError, RigError
from rig.formats.local_and_remote_input_files import is_remote
from rig.formats.user_python_file import UserModule, line_of_class, line_within, run_user_file
from rig.model.design import Design
from rig.model.protocol_and_port_names import is_user_program

P = ParamSpec("P")
Steps = Generator[object, object, object]  # of a dialogue
T = TypeVar("T")
RECORDED = ("journal.jsonl", "frames.csv")  # files that make a folder a recording


def require_own_rig_toml(path: Path, design: Design) -> None:
    """Raise RigError where a rig.toml that names programs is behind a URL or a part of a recording.

    Whoever wrote that is not the operator of this machine.
    """
    sources = [design.controller.protocol if design.controller else "", *(c.source or "" for c in design.cameras)]
    sources += [design.sensors.port] if design.sensors else []
    programs = [stated for stated in sources if is_user_program(stated) or stated.startswith("command:")]
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


def load_user_class(stated: str, base: type[T], group: str, what: str) -> tuple[type[T], str]:
    """Load a user's class of "file:PATH" or "package:NAME".

    group : of the package's entry points; what : the class is, for messages
    Returns (class derived from a base, the file that defines it)
    Raises FileError with the line where a file cannot be used, RigError for a package that is not there
    """
    kind, _, place = stated.partition(":")
    module = _module(Path(place)) if kind == "file" else _package(place, group)
    found = module.classes(base)
    if len(found) != 1:
        names = ", ".join(one.__name__ for one in found)
        expected = f"class Mine({base.__name__}), from rig.driving.base"
        raise FileError(
            module.path,
            f"defines {f'several: {names}; expected one' if found else 'no'} {what}: {expected}",
            module.line(found[1]) if found else None,
        )
    return found[0], str(module.path)


def missing_member(kind: type[object], base: type[object], members: tuple[str, ...]) -> str | None:
    """Missing member of a user's class.

    The first of some members (methods or attributes) that it does not have of its own.

    None for none.
    """
    return next((name for name in members if getattr(kind, name, None) is getattr(base, name, None)), None)


def fail_at_class(path: str, kind: type[object], message: str, field: str | None = None) -> FileError:
    """FileError at a class of a user's file, or at a name in its body.

    With the line.
    """
    text = Path(path).read_text(encoding="utf-8")
    return FileError(path, f"{kind.__name__} {message}", line_of_class(text, kind.__name__, field))


def guard_call(call: Callable[P, T], path: str, error_kind: type[RigError], owner: str) -> Callable[P, T]:
    """Guarded call of a user's method.

    The same method, whose failures name the file and the line.

    Of a dialogue each of its steps.
    """

    def failure(error: Exception) -> RigError:
        line = line_within(error, path) or call.__code__.co_firstlineno
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
    return run_user_file(path)


def _package(name: str, group: str) -> UserModule:
    found = [one for one in entry_points(group=group) if one.name == name]
    if not found:
        there = ", ".join(sorted(one.name for one in entry_points(group=group))) or "none"
        raise RigError(f"no installed package has {name!r} among its entry points {group}; there are {there}")
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
