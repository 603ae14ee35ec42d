"""Recording made from a run's journal.

It is kept up with the journal's rows line by line.
The journal is the truth and these files follow from it; a run that goes on writes them anew first. Between a
departure and an arrival commands.csv has the way as the struts were commanded along it; where that is not known (a
move that another process saw the end of) they are taken to have moved evenly. All cameras of a frame share its time,
the middle of their exposures: the struts stand meanwhile, and the journal keeps each camera's own.

Of exposures in motion frames.csv has each camera's own time. The way of a move is then fitted to the positions that the
controller reported; where these follow no trapezoid, or the move did not arrive, the reports themselves are the way.
position_reports.csv has them all. frames.csv has the frames of a move once its way is known: those of a move without an
end, of a run that was killed and not resumed, are in the journal alone. A camera's clock may be behind: commands.csv
of such a run begins so much earlier, with the struts where they stood.
"""

import os
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import ELSEWHERE
from rig.driving.run_journal import (
    Arrival,
    Began,
    Departure,
    Ended,
    Exposed,
    Lengths,
    PositionReports,
    PositionUnknown,
    Readings,
    Resumed,
    Row,
)
from rig.errors import RigError
from rig.formats.local_and_remote_input_files import BINARY, read_bytes
from rig.formats.output_files import write_text
from rig.formats.output_files.atomic_file_writing_and_process_locks import sync_folder
from rig.recording.corner_and_pose_csv_tables import POSE_COLUMNS

READINGS = "poses.csv"  # of an operator
APART = 1e-6  # s; rows of commands.csv lie at least so far apart


class GrowingRecording:
    """The files of a recording, kept up with its journal."""

    def __init__(
        self, folder: Path, axes: tuple[str, ...], rows: list[Row], in_motion: bool = False, asked: bool = False
    ) -> None:
        """Write the files anew from the journal's rows so far. axes : names of commands.csv's columns; in_motion :
        whether cameras expose during moves; asked : whether an operator's readings become poses.csv

        Raises RigError for a poses.csv that somebody else wrote where readings would be
        """
        self.folder, self._axes, self._in_motion = Path(folder), axes, in_motion
        self._last_t = -np.inf
        self._at: tuple[float, ...] = ()  # before the first row: a journal begins with where the axes stand
        self._channels: tuple[str, ...] | None = None
        self._reported: list[tuple[float, Lengths]] = []  # (s, m) during the move under way
        self._reports_begun = self._readings_begun = False
        self._frames_in_motion: list[tuple[str, str]] = []  # (file, text) of those of the move under way
        self._arrived, self._wall = 0.0, 0.0  # s, on the run's clock; s since 1970 at its t = 0
        texts = {"commands.csv": ",".join(("t", *axes)) + "\n", "frames.csv": "frame,t,camera,image\n"}
        for row in rows:
            for name, line in self._lines(row):
                texts[name] = texts.get(name, "") + line
        if asked or READINGS in texts:
            self._require_own_readings(texts.get(READINGS, ""))
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
            early = [row.t - ELSEWHERE] if isinstance(row, Began) and self._in_motion else []
            return [*self._end_of_move(), *(line for t in (*early, row.t) for line in self._stand(t, row.position))]
        if isinstance(row, Departure):
            return self._stand(row.t, row.start)
        if isinstance(row, Arrival):
            self._arrived = row.t
            return self._lines_of_move(row)
        if isinstance(row, PositionReports):
            return self._reports(row)
        if isinstance(row, Exposed) and not row.cameras:
            return self._visit(row)
        if isinstance(row, Exposed):
            return self._frame(row)
        if isinstance(row, Readings):
            return self._readings(row)
        if isinstance(row, PositionUnknown):
            return self._end_of_move()
        return [*self._end_of_move(), *self._command(row.t, self._at)] if isinstance(row, Ended) else []

    def _stand(self, t: float, position: tuple[float, ...]) -> list[tuple[str, str]]:
        """The struts stand at a position (m); where they were left elsewhere, they went there since."""
        self._at = position
        return self._command(t, position)

    def _lines_of_move(self, row: Arrival) -> list[tuple[str, str]]:
        """Where a move went. row.position : m, the goal where it was reached"""
        if row.way:
            self._reported.clear()
        start, goal = np.array(self._at), np.array(row.position)
        lines = [line for t, share in row.way for line in self._command(t, start + share * (goal - start))]
        lines += self._end_of_move()
        self._at = row.position
        return lines + self._command(row.t, row.position)

    def _frame(self, row: Exposed) -> list[tuple[str, str]]:
        """A frame of cameras: at rest with the command, in motion held back until the way of the move is known."""
        times = row.times or (row.t,) * len(row.cameras)
        lines = [f"{row.frame},{t:.6f},{name},{image}\n" for t, name, image in zip(times, row.cameras, row.images)]
        if row.times:
            self._frames_in_motion.append(("frames.csv", "".join(lines)))
            return []
        return [*self._command(row.t, self._at), ("frames.csv", "".join(lines))]

    def _reports(self, row: PositionReports) -> list[tuple[str, str]]:
        """Reports of the move under way, which become its way where no better one is known."""
        head = () if self._reports_begun else ("t", "width", *self._axes)
        self._reports_begun = True
        self._reported += zip(row.times, row.positions)
        lines = [",".join(head) + "\n"] if head else []
        lines += [
            f"{t:.6f},{width:.6f}," + ",".join(f"{value:.9f}" for value in position) + "\n"
            for t, width, position in zip(row.times, row.widths, row.positions)
        ]
        return [("position_reports.csv", "".join(lines))]

    def _end_of_move(self) -> list[tuple[str, str]]:
        """Reports that no better way is known for as the way, the last as the place; then the frames of the move."""
        lines = [line for t, position in self._reported for line in self._command(t, position)]
        if self._reported:
            self._at = self._reported[-1][1]
        lines += self._frames_in_motion
        self._reported.clear()
        self._frames_in_motion.clear()
        return lines

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
        return [*self._command(row.t, self._at), *lines, *self._reading(row)]

    def _reading(self, row: Exposed) -> list[tuple[str, str]]:
        """An operator's reading of a place as a row of poses.csv."""
        if not row.reading:
            return []
        head = "" if self._readings_begun else ",".join(("frame", *POSE_COLUMNS[: len(row.reading)])) + "\n"
        self._readings_begun = True
        return [(READINGS, head + ",".join((str(row.frame), *(f"{value:.10f}" for value in row.reading))) + "\n")]

    def _require_own_readings(self, text: str) -> None:
        """Raise RigError where poses.csv is there and is not what the journal's readings make, or its beginning."""
        path = self.folder / READINGS
        if path.exists() and not text.encode().startswith(read_bytes(path)):
            raise RigError(
                f"{path} is not what the journal's readings make: somebody wrote into it; move it elsewhere, resume, "
                "and join its rows once the run is over"
            )

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
