"""The commands in a process of their own or in this one, and what their pages link to."""

import io
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from html.parser import HTMLParser

from rig.cli.command_line import main

RIG = [sys.executable, "-c", "import sys; from rig.cli.command_line import main; sys.exit(main())"]


def run(*arguments, ok=True):
    """A finished command `rig` with arguments in this process, which imports and loads compiled code once for all of
    them; its end must be as expected and without a traceback.
    """
    words = [str(argument) for argument in arguments]
    printed, complaint = (io.TextIOWrapper(io.BytesIO(), "utf-8") for _ in range(2))
    with redirect_stdout(printed), redirect_stderr(complaint):
        try:
            status = main(words)
        except SystemExit as end:
            status = end.code
    printed.flush(), complaint.flush()
    out, error_text = (stream.buffer.getvalue().decode() for stream in (printed, complaint))
    return _as_expected(subprocess.CompletedProcess(words, status, out, error_text), ok)


def run_process(*arguments, ok=True):
    """The same in a process of its own, as its user starts it."""
    words = [*RIG, *map(str, arguments)]
    return _as_expected(subprocess.run(words, capture_output=True, text=True, timeout=300), ok)


def _as_expected(done, ok):
    assert "Traceback" not in done.stderr, done.stderr
    assert (done.returncode == 0) == ok, done.stdout + done.stderr
    return done


def command(capsys, *first):
    """A command of `rig` in this process, its words after the first ones: what it prints, or where it must fail what it
    complains of.
    """

    def given(*arguments, ok=True):
        capsys.readouterr()
        status = main([str(argument) for argument in (*first, *arguments)])
        out, complaint = capsys.readouterr()
        assert status == (0 if ok else 1), complaint
        return out if ok else complaint

    return given


class Links(HTMLParser):
    """outside : what a page loads from elsewhere."""

    def __init__(self):
        super().__init__()
        self.outside = []

    def handle_starttag(self, tag, attrs):
        self.outside += [v for k, v in attrs if k in ("src", "href") and not v.startswith("data:")]
