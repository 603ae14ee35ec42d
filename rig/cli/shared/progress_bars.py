"""How far a command has come, and the time left: bars on a terminal, lines on the error output where they are asked
for.
"""

from __future__ import annotations

import sys
import threading
import time
from typing import Any, ClassVar

from rig.cli.shared.terminal_safe_output import unescaped_stream

EVERY = 5.0  # s between two lines, and before the first


class Progress:
    """Bars on a terminal, nothing in a pipe and nothing in the first second: called with (label, done, of).

    shown : for all commands of this process: "auto"; "lines", one every 5 s, into pipes as well; or "none"
    """

    shown: ClassVar[str] = "auto"

    def __init__(self, silent: float = 1.0, every: float = EVERY) -> None:
        """silent : s, from now, in which no bar is shown: who is quick needs none; every : s, between lines and before
        the first
        """
        self.bar: Any = None
        self.label: str | None = None
        self.timer: threading.Timer | None = None
        self.every, self.began = every, time.monotonic()
        self.from_then, self.said = self.began + silent, self.began

    def __call__(self, label: str, done: int, of: int) -> None:
        if self.shown == "none":
            return
        if self.shown == "lines":
            self._line(label, done, of)
            return
        from tqdm import tqdm

        if label != self.label:
            self.close()
            wait = max(self.from_then - time.monotonic(), 0.0)
            self.bar, self.label = (
                tqdm(total=of, desc=label, disable=None, leave=False, file=unescaped_stream(sys.stderr), delay=wait),
                label,
            )
            if wait and not self.bar.disable:  # a bar of its own accord shows only once something is done
                self.timer = threading.Timer(wait, _show, (self.bar,))
                self.timer.daemon = True
                self.timer.start()
        self.bar.update(done - self.bar.n)
        if done >= of:
            self.close()

    def _line(self, label: str, done: int, of: int) -> None:
        now = time.monotonic()
        if label != self.label:
            self.label, self.began = label, now
        if now - self.said >= self.every:
            self.said = now
            print(progress_line(label, done, of, now - self.began), file=sys.stderr, flush=True)

    def close(self) -> None:
        """Take the bar away."""
        if self.timer is not None:
            self.timer.cancel()
        if self.bar is not None:
            self.bar.close()
        self.bar, self.label, self.timer = None, None, None


def compilation_notice() -> None:
    """Say why nothing moves on for a while: a new installation, or a new version, compiles what is called for the first
    time.

    On a terminal, or where lines are asked for; in a pipe the first line on the error output stays the command's own
    """
    if Progress.shown == "lines" or Progress.shown == "auto" and sys.stderr.isatty():
        from tqdm import tqdm

        tqdm.write("compiling for this computer, once: up to a minute", file=unescaped_stream(sys.stderr))


def progress_line(label: str, done: int, of: int, gone: float) -> str:
    """How far a stage has come, as a line. gone : s since it began"""
    share = f"{label}: {done} of {of}, {100 * done // max(of, 1)} %"
    if not 0 < done < of or gone <= 0:
        return share
    left = gone * (of - done) / done
    return f"{share}, about {left / 60:.0f} min left" if left >= 120 else f"{share}, about {left:.0f} s left"


def _show(bar: Any) -> None:
    bar.delay = 0  # shown from here on, so there is something to clear
    bar.refresh()
