"""Journal of a run, and the recording made from it.

One JSON object a line, numbered, with a check sum of its own. A last line that is cut off or whose sum is wrong was
being written when the machine went down: it was never reported, and is taken away before the file goes on. Any other
bad line is damage.

The journal is the truth and these files follow from it; a run that goes on writes them anew first. Between a
departure and an arrival commands.csv has the way as the struts were commanded along it; where that is not known (a
move that another process saw the end of) they are taken to have moved evenly. All cameras of a frame share its time,
the middle of their exposures: the struts stand meanwhile, and the journal keeps each camera's own.
"""

import json
import os
import zlib
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import ClassVar

import numpy as np

from rig.errors import FileError, RigError
from rig.formats.local_and_remote_input_files import BINARY
from rig.formats.output_files import write_text
from rig.formats.output_files.locks_of_files_and_folders import HeldLock, lock_open_file, sync_folder

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
    in journals of before it was
    """

    kind: ClassVar[str] = "exposed"
    t: float
    step: int
    frame: int
    sigma: tuple[float, ...]
    cameras: tuple[str, ...]
    images: tuple[str, ...]
    position: Lengths = ()


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


Row = Began | Resumed | Departure | Arrival | Exposed | Readings | CameraExposures | PositionUnknown | Remark | Ended
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
            self.rows, whole = read_journal(self.path)
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


def read_journal(path: Path) -> tuple[list[Row], int]:
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


APART = 1e-6  # s; rows of commands.csv lie at least so far apart


class GrowingRecording:
    """The files of a recording, kept up with its journal."""

    def __init__(self, folder: Path, axes: tuple[str, ...], rows: list[Row]) -> None:
        """Write the files anew from the journal's rows so far. axes : names of commands.csv's columns"""
        self.folder, self._axes = Path(folder), axes
        self._last_t = -np.inf
        self._at: tuple[float, ...] = ()  # before the first row: a journal begins with where the axes stand
        self._channels: tuple[str, ...] | None = None
        self._arrived, self._wall = 0.0, 0.0  # s, on the run's clock; s since 1970 at its t = 0
        texts = {"commands.csv": ",".join(("t", *axes)) + "\n", "frames.csv": "frame,t,camera,image\n"}
        for row in rows:
            for name, line in self._lines(row):
                texts[name] = texts.get(name, "") + line
        for name, text in texts.items():
            write_text(self.folder / name, text)
        sync_folder(self.folder)

    def add(self, row: Row) -> None:
        """Add what a row means to the files. Raises RigError where the disk takes no more."""
        for name, text in self._lines(row):
            handle = os.open(self.folder / name, os.O_WRONLY | os.O_APPEND | os.O_CREAT | BINARY, 0o644)
            try:
                if os.write(handle, text.encode()) != len(text.encode()):
                    raise RigError(f"{self.folder / name}: the disk took only part of a line; is it full?")
            except OSError as error:
                raise RigError(f"{self.folder / name} cannot be written: {error.strerror}") from None
            finally:
                os.close(handle)

    def _lines(self, row: Row) -> list[tuple[str, str]]:
        """(file, text) of each line that a row adds."""
        if isinstance(row, Began):
            self._wall = row.wall
        if isinstance(row, Began | Resumed):
            self._arrived = row.t
            return self._stand(row.t, row.position)
        if isinstance(row, Departure):
            return self._stand(row.t, row.start)
        if isinstance(row, Arrival):
            self._arrived = row.t
            return self._way(row)
        if isinstance(row, Exposed) and not row.cameras:
            return self._visit(row)
        if isinstance(row, Exposed):
            return [
                *self._command(row.t, self._at),
                (
                    "frames.csv",
                    "".join(
                        f"{row.frame},{row.t:.6f},{camera},{image}\n" for camera, image in zip(row.cameras, row.images)
                    ),
                ),
            ]
        if isinstance(row, Readings):
            return self._readings(row)
        return self._command(row.t, self._at) if isinstance(row, Ended) else []

    def _stand(self, t: float, position: tuple[float, ...]) -> list[tuple[str, str]]:
        """The struts stand at a position (m); where they were left elsewhere, they went there since."""
        self._at = position
        return self._command(t, position)

    def _way(self, row: Arrival) -> list[tuple[str, str]]:
        """Where a move went. row.position : m, the goal where it was reached"""
        start, goal = np.array(self._at), np.array(row.position)
        lines = [line for t, share in row.way for line in self._command(t, start + share * (goal - start))]
        self._at = row.position
        return lines + self._command(row.t, row.position)

    def _visit(self, row: Exposed) -> list[tuple[str, str]]:
        """A place that something else than cameras measures, with the time from which the struts stood there."""
        lines, axes = [("frames.csv", f"{row.frame},{row.t:.6f},,\n")], self._axes
        if not row.frame:
            read = (f"{axis}_read" for axis in axes)
            lines.append(
                ("visits.csv", ",".join(("frame", "from", "until", "utc_from", "utc_until", *axes, *read)) + "\n")
            )
        utc = [
            datetime.fromtimestamp(self._wall + t, UTC).isoformat(timespec="milliseconds")
            for t in (self._arrived, row.t)
        ]
        cells = [f"{value:.9f}" for value in (*self._at, *row.position)]
        lines.append(
            ("visits.csv", ",".join((str(row.frame), f"{self._arrived:.6f}", f"{row.t:.6f}", *utc, *cells)) + "\n")
        )
        return [*self._command(row.t, self._at), *lines]

    def _command(self, t: float, values: Iterable[float]) -> list[tuple[str, str]]:
        t = max(t, self._last_t + APART)
        self._last_t = t
        return [("commands.csv", f"{t:.6f}," + ",".join(f"{value:.9f}" for value in values) + "\n")]

    def _readings(self, row: Readings) -> list[tuple[str, str]]:
        lines = []
        if self._channels is None:
            self._channels = row.channels
            lines.append(("sensors.csv", ",".join(("t", *row.channels)) + "\n"))
        if row.channels != self._channels:
            raise RigError(
                f"sensors.csv has the channels {', '.join(self._channels)}; now {', '.join(row.channels)} were read"
            )
        return [*lines, ("sensors.csv", f"{row.t:.6f}," + ",".join(f"{value:.9g}" for value in row.values) + "\n")]
