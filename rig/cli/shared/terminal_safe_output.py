"""Standard output and error on which outside text (names of files, what a controller answers) can be read and does
nothing else.
"""

import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from typing import Any, TextIO, cast

from rig.formats.printable_text import escape_unprintable


class Escaped:
    """A stream to which control characters are written as escapes, and what its encoding lacks too.

    stream : where it goes; controls : the same for those of the project's own displays that move a terminal's cursor
    """

    def __init__(self, stream: TextIO) -> None:
        self.controls = stream

    def write(self, text: str) -> int:
        """Print a text, escaped; its length."""
        shown = escape_unprintable(text)
        encoding = getattr(self.controls, "encoding", None) or "utf-8"
        self.controls.write(shown.encode(encoding, "backslashreplace").decode(encoding))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.controls, name)


@contextmanager
def escaped_output() -> Iterator[None]:
    """Within it standard output and error are Escaped; a process may have been started without them."""
    with ExitStack() as stack:
        if sys.stdout is not None:
            stack.enter_context(redirect_stdout(cast(TextIO, Escaped(unescaped_stream(sys.stdout)))))
        if sys.stderr is not None:
            stack.enter_context(redirect_stderr(cast(TextIO, Escaped(unescaped_stream(sys.stderr)))))
        yield


def unescaped_stream(stream: TextIO) -> TextIO:
    """The stream beneath an Escaped one, for displays that draw; any other as it is."""
    beneath: TextIO = getattr(stream, "controls", stream)
    return beneath
