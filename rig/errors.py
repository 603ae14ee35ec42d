"""Error classes (RigError).

Of what can go wrong with a machine, its physics or its files, with the numbers.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from os import PathLike
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rig.array_and_json_types import Floats, Integers, Json

SCHEME = r"(?:[a-z][a-z0-9+.-]*::)*[a-z][a-z0-9+.-]+:"  # of a URL, as fsspec chains them
FOLDED = re.compile(rf"^({SCHEME})/(?=[^/])")  # what pathlib makes of SCHEME//


def path_text_with_url_slashes(path: str | PathLike[str]) -> str:
    """Text of a path, with the slashes of a URL.

    As its user wrote it.

    With both slashes after the scheme where it is a URL.
    """
    return FOLDED.sub(r"\1//", str(path))


class RigError(Exception):
    """Anything a rig, its files or its physics refuse; the message is complete for a user."""

    def __reduce__(self) -> tuple[object, ...]:
        """What one process hands another of it, whatever the kind's constructor takes."""
        return _handed, (type(self), self.args, vars(self))


class FileError(RigError):
    """Outside data that cannot be used: names the file, the line and the column (both from 1), and the value.

    path : file as the user would name it; line, column : int or None where a whole file is meant
    value : the offending text or number, or None
    """

    def __init__(
        self,
        path: str | PathLike[str],
        message: str,
        line: int | None = None,
        column: int | None = None,
        value: object = None,
    ) -> None:
        self.path, self.line, self.column, self.value = path_text_with_url_slashes(path), line, column, value
        place = ":".join(str(part) for part in (self.path, line, column) if part is not None)
        super().__init__(f"{place}: {message}")


class NotConverged(RigError):
    """An iteration that ended without an answer.

    index : (k,) positions in the batch; lengths : (k, 6) m; residual : (k,) m, what was left
    """

    def __init__(self, message: str, index: Integers, lengths: Floats, residual: Floats) -> None:
        self.index, self.lengths, self.residual = index, lengths, residual
        super().__init__(message)


class Unreachable(RigError):
    """Wanted poses that the machine cannot take.

    index : (k,) positions in the batch; violations : one line of text per pose
    """

    def __init__(self, message: str, index: Sequence[int] | Integers, violations: list[str]) -> None:
        self.index, self.violations = index, violations
        super().__init__("\n".join([message, *(f"  {line}" for line in violations)]))


class NotEnoughData(RigError):
    """Too few observations to determine the requested result; states how many there are and are required."""


class MissingLibrary(RigError):
    """A system library that is not installed; states which package provides it."""


class MotionError(RigError):
    """A machine that did not execute its command, or whose state is unknown; its axes were commanded to stop."""


class LinkLost(MotionError):
    """The connection to a controller is lost or cannot be made; states port and reason."""


class NoAnswer(MotionError):
    """A controller that does not answer, or not readably; states the request and the answer."""


class ControllerFault(MotionError):
    """A controller that refuses, or an axis in error; states what the controller reported."""


class Stalled(MotionError):
    """Axes that stopped before their target; states their actual and target positions."""


class PositionLost(MotionError):
    """Axes that are not where they were left, or a controller that restarted: only homing or the operator
    settles it.
    """


class Stopped(MotionError):
    """A motion that was stopped on request."""


def _handed(kind: type[RigError], arguments: tuple[object, ...], attributes: Json) -> RigError:
    error = kind.__new__(kind, *arguments)
    vars(error).update(attributes)
    return error
