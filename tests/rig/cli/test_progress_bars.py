"""Bars: from the first second on a terminal, through every stage; nothing where all is quick, nothing in a pipe."""

import io
import time

from rig.cli.shared.escaped_output_progress_error_table_and_refutations import Progress


class Terminal(io.StringIO):
    """A standard error that somebody looks at."""

    def isatty(self):
        return True


def terminal(monkeypatch):
    """A Terminal in the place of standard error, from within a test: between fixtures and tests pytest puts its own
    there.
    """
    found = Terminal()
    monkeypatch.setattr("sys.stderr", found)
    return found


def until(shown):
    """Wait, a second at the most, until shown() holds."""
    end = time.monotonic() + 1
    while not shown() and time.monotonic() < end:
        time.sleep(0.001)
    return shown()


def test_a_stage_that_does_not_come_forward_is_shown(monkeypatch):
    screen = terminal(monkeypatch)
    progress = Progress(silent=0.005)
    progress("fitting", 0, 5)
    assert until(lambda: "fitting" in screen.getvalue())
    progress.close()
    assert screen.getvalue().endswith("\r")  # and taken away


def test_stages_after_the_first_second_are_shown_at_once(monkeypatch):
    screen = terminal(monkeypatch)
    progress = Progress(silent=0.0)
    for label in ("locating", "adjusting", "cross-validating configurations"):
        progress(label, 0, 2)
        assert label in screen.getvalue()
        progress(label, 2, 2)
    assert progress.bar is None


def test_what_is_quick_shows_nothing(monkeypatch):
    screen = terminal(monkeypatch)
    progress = Progress(silent=60.0)
    for label in ("locating", "adjusting"):
        for done in range(3):
            progress(label, done, 2)
    progress.close()
    assert screen.getvalue() == ""


def test_a_pipe_gets_nothing(monkeypatch):
    pipe = io.StringIO()
    monkeypatch.setattr("sys.stderr", pipe)
    progress = Progress(silent=0.0)
    progress("fitting", 0, 5)
    progress("fitting", 3, 5)
    progress.close()
    assert pipe.getvalue() == ""
