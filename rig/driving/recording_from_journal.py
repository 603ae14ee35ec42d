"""Recording files written from a run's journal as it grows: commands.csv, frames.csv, sensors.csv.

The journal is the truth and these files follow from it; a run that goes on writes them anew first. Between a
departure and an arrival commands.csv has the way as the struts were commanded along it; where that is not known (a
move that another process saw the end of) they are taken to have moved evenly. All cameras of a frame share its time,
the middle of their exposures: the struts stand meanwhile, and the journal keeps each camera's own.
"""

import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from rig.driving.run_journal import (
    Arrival,
    Began,
    Departure,
    Ended,
    Exposed,
    Readings,
    Resumed,
    Row,
    sync_folder_to_disk,
)
from rig.errors import RigError
from rig.formats.output_files import write_text

APART = 1e-6  # s; rows of commands.csv lie at least so far apart


class GrowingRecording:
    """The files of a recording, kept up with its journal."""

    def __init__(self, folder: Path, axes: tuple[str, ...], rows: list[Row]) -> None:
        """Write the files anew from the journal's rows so far. axes : names of commands.csv's columns"""
        self.folder, self._axes = Path(folder), axes
        self._last_t = -np.inf
        self._at: tuple[float, ...] = ()  # before the first row: a journal begins with where the axes stand
        self._channels: tuple[str, ...] | None = None
        texts = {"commands.csv": ",".join(("t", *axes)) + "\n", "frames.csv": "frame,t,camera,image\n"}
        for row in rows:
            for name, line in self._lines(row):
                texts[name] = texts.get(name, "") + line
        for name, text in texts.items():
            write_text(self.folder / name, text)
        sync_folder_to_disk(self.folder)

    def add(self, row: Row) -> None:
        """Add what a row means to the files. Raises RigError where the disk takes no more."""
        for name, text in self._lines(row):
            handle = os.open(self.folder / name, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
            try:
                if os.write(handle, text.encode()) != len(text.encode()):
                    raise RigError(f"{self.folder / name}: the disk took only part of a line; is it full?")
            except OSError as error:
                raise RigError(f"{self.folder / name} cannot be written: {error.strerror}") from None
            finally:
                os.close(handle)

    def _lines(self, row: Row) -> list[tuple[str, str]]:
        """(file, text) of each line that a row adds."""
        if isinstance(row, Began | Resumed):
            return self._stand(row.t, row.position)
        if isinstance(row, Departure):
            return self._stand(row.t, row.start)
        if isinstance(row, Arrival):
            return self._way(row)
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
