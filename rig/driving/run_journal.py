"""Journal of a run, written row by row.

Rows are on disk before what follows them.
One JSON object a line, numbered, with a check sum of its own. A last line that is cut off or whose sum is wrong was
being written when the machine went down: it was never reported, and is taken away before the file goes on. Any other
bad line is damage.
"""

import json
import os
import zlib
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import ClassVar

from rig.errors import FileError, RigError
from rig.formats.local_and_remote_input_files import BINARY
from rig.formats.output_files.atomic_file_writing_and_process_locks import HeldLock, lock_open_file, sync_folder

Lengths = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Began:
    """The first row. t : s, run's clock; wall : s since 1970 at t = 0; steps : how many; sha256 : of rig.toml and plan;
    position : m, or rad
    """

    kind: ClassVar[str] = "began"
    t: float
    wall: float
    steps: int
    sha256: str
    position: Lengths


@dataclass(frozen=True, slots=True)
class Resumed:
    """Another process goes on. position : m, read before anything moved; found : what that says of the last move, in
    words.
    """

    kind: ClassVar[str] = "resumed"
    t: float
    position: Lengths
    found: str


@dataclass(frozen=True, slots=True)
class Departure:
    """A move is about to be sent. step : of the plan, from 0; start, goal : m"""

    kind: ClassVar[str] = "departure"
    t: float
    step: int
    start: Lengths
    goal: Lengths


@dataclass(frozen=True, slots=True)
class Arrival:
    """The struts stand again. position : m, read back; reached : whether that is the goal; way : (s, share of the way)
    passed between.
    """

    kind: ClassVar[str] = "arrival"
    t: float
    step: int
    position: Lengths
    reached: bool
    way: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Exposed:
    """A frame, whose images are on disk; a visit that other instruments measure where there are no cameras.

    t : s, middle of the exposure; sigma : s, of each camera's; images : in the folder; position : m, read back, empty
    in journals of before it was, and in motion; times : s, middle of each camera's exposure in motion, empty at rest;
    reading : of an operator, x y z and rx ry rz or not (m, rad), empty for none
    """

    kind: ClassVar[str] = "exposed"
    t: float
    step: int
    frame: int
    sigma: tuple[float, ...]
    cameras: tuple[str, ...]
    images: tuple[str, ...]
    position: Lengths = ()
    times: tuple[float, ...] = ()
    reading: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class PositionReports:
    """Positions that the controller reported during a move. t : s of the row; times : s, middle between request and
    answer; widths : s between these; positions : m, read back
    """

    kind: ClassVar[str] = "position_reports"
    t: float
    times: tuple[float, ...]
    widths: tuple[float, ...]
    positions: tuple[Lengths, ...]


@dataclass(frozen=True, slots=True)
class Readings:
    """Sensors as read. channels : names as in sensors.csv; values : as many"""

    kind: ClassVar[str] = "readings"
    t: float
    channels: tuple[str, ...]
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class CameraExposures:
    """Exposures that cameras were set to. cameras : names; seconds : as many"""

    kind: ClassVar[str] = "exposures"
    t: float
    cameras: tuple[str, ...]
    seconds: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class PositionUnknown:
    """Where the axes stand is not known until the run is resumed, which takes homing or the operator's word. reason :
    in words
    """

    kind: ClassVar[str] = "position_unknown"
    t: float
    reason: str


@dataclass(frozen=True, slots=True)
class Remark:
    """A message shown to the operator."""

    kind: ClassVar[str] = "remark"
    t: float
    text: str


@dataclass(frozen=True, slots=True)
class Ended:
    """The run is over. reason : "" where every step was done."""

    kind: ClassVar[str] = "ended"
    t: float
    reason: str


Row = (
    Began
    | Resumed
    | Departure
    | Arrival
    | Exposed
    | PositionReports
    | Readings
    | CameraExposures
    | PositionUnknown
    | Remark
    | Ended
)
KINDS = {row.kind: row for row in Row.__args__}


class Journal:
    """The open journal of a run; one process at a time. rows : all so far; torn : bytes of a torn last line that was
    taken away.
    """

    _lock: HeldLock | None = None

    def __init__(self, path: Path) -> None:
        """Open the journal at a path, made if it is not there. Raises RigError where another process has it, FileError
        where it is damaged.
        """
        self.path = Path(path)
        new = not self.path.exists()
        self._file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_APPEND | BINARY, 0o644)
        try:
            try:
                self._lock = lock_open_file(self._file, self.path)
            except OSError:
                raise RigError(f"{self.path} is being written by another run; end that one first") from None
            self.rows, whole = read_journal_rows_and_valid_length(self.path)
            self.torn = os.fstat(self._file).st_size - whole
            if self.torn:
                os.ftruncate(self._file, whole)
            if new or self.torn:
                os.fsync(self._file)
                sync_folder(self.path.parent)
        except BaseException:
            self.close()
            raise

    def append(self, row: Row) -> None:
        """Put a row on disk; when this returns it is there to stay. Raises RigError where the disk takes no more."""
        text = journal_line(len(self.rows), row)
        try:
            if os.write(self._file, text) != len(text):
                raise RigError(f"{self.path}: the disk took only part of a row; is it full?")
            os.fsync(self._file)
        except OSError as error:
            raise RigError(f"{self.path} cannot be written: {error.strerror}") from None
        self.rows.append(row)

    def close(self) -> None:
        """Let go of the file."""
        os.close(self._file)
        if self._lock is not None:
            self._lock.close()

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def journal_line(number: int, row: Row) -> bytes:
    """Line of the journal for a row.

    number : of the row, from 0
    """
    body = json.dumps({"row": number, "kind": row.kind, **asdict(row)})
    return f'{body[:-1]}, "crc": "{zlib.crc32(body.encode()):08x}"}}\n'.encode()


def read_journal_rows_and_valid_length(path: Path) -> tuple[list[Row], int]:
    """Rows read from a journal and their length in bytes.

    A torn last line follows those bytes.
    Raises FileError for damage, with the line.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror}") from None
    rows: list[Row] = []
    at = 0
    while at < len(data):
        end = data.find(b"\n", at)
        row = _row(data[at:end], len(rows)) if end >= 0 else None
        if row is None:
            if end >= 0 and end + 1 < len(data):
                raise FileError(
                    path, "is damaged: its check sum or its number is wrong, and rows follow", len(rows) + 1
                )
            break
        rows.append(row)
        at = end + 1
    return rows, at


def _row(text: bytes, number: int) -> Row | None:
    """The row that a line holds, None where it is not what was written as row `number`."""
    head, mark, tail = text.rpartition(b', "crc": "')
    body = head + b"}"
    if not mark or tail != f'{zlib.crc32(body):08x}"}}'.encode():
        return None
    tree = json.loads(body)
    if tree.pop("row") != number or tree["kind"] not in KINDS:
        return None
    kind = KINDS[tree.pop("kind")]
    return kind(**{field.name: _tuples(tree[field.name]) for field in fields(kind) if field.name in tree})


def _tuples(value: object) -> object:
    return tuple(_tuples(part) for part in value) if isinstance(value, list) else value
