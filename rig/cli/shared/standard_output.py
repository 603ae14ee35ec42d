"""Standard output whose reader may close it early, as `head` does: a command that writes files finishes them all the
same.
"""

import os
from collections.abc import Callable
from typing import Any, TextIO


class StandardOutput:
    """A stream that stands for standard output while a command runs.

    stream : what it prints to; writes_files : whether the command writes files by now. Once the reader has closed the
    pipe, printing is discarded where it does (`closed` is true from then on); where it does not, BrokenPipeError is
    raised, since nobody is left to work for.
    """

    def __init__(self, stream: TextIO, writes_files: Callable[[], bool]) -> None:
        self.stream, self.writes_files, self.closed_by_reader = stream, writes_files, False

    def write(self, text: str) -> int:
        """Print a text; its length."""
        self._attempt(lambda: self.stream.write(text))
        return len(text)

    def flush(self) -> None:
        """Print what waits in the buffer."""
        self._attempt(self.stream.flush)

    def _attempt(self, action: Callable[[], object]) -> None:
        try:
            action()
        except BrokenPipeError:
            if not self.writes_files():
                raise
            discard_output(self.stream)
            self.closed_by_reader = True

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


def discard_output(stream: TextIO) -> None:
    """Let everything that is printed to a stream from now on, what waits in its buffer included, go nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)
