"""What an emulator's struts were truly told, written as it happens, in the form of commands.csv."""

from pathlib import Path

from rig.driving.emulators.controller_emulator import Emulator
from rig.errors import FileError


class History:
    """Appends rows t, l1..ln to a file up to now whenever `record` is called; t is the clock's."""

    def __init__(self, emulator: Emulator, path: Path) -> None:
        """Raises FileError where the file is there already or cannot be written."""
        try:
            self._file = path.open("x", encoding="utf-8")
        except OSError as error:
            raise FileError(path, f"cannot be written: {error.strerror}") from None
        self._emulator, self._done = emulator, emulator.now
        count = len(emulator.lengths_at(self._done))
        self._file.write(",".join(["t", *(f"l{i + 1}" for i in range(count))]) + "\n")

    def record(self) -> None:
        """Write what happened since the last time."""
        now = self._emulator.now
        t, lengths = self._emulator.path(self._done)
        rows = [(one, row) for one, row in zip(t, lengths) if self._done <= one < now]
        rows.append((now, self._emulator.lengths_at(now)))
        if len(rows) == 1 and now - self._done < 0.1:
            return  # standing still needs no more
        self._file.write("".join(f"{one:.6f}," + ",".join(f"{value:.9f}" for value in row) + "\n" for one, row in rows))
        self._file.flush()
        self._done = now + 1e-6

    def close(self) -> None:
        """Write the rest, and close."""
        self.record()
        self._file.close()
