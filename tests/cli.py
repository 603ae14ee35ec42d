"""The commands in a process of their own or in this one, and what their pages link to."""

import subprocess
import sys
from html.parser import HTMLParser

from rig.cli.command_line import main

RIG = [sys.executable, "-c", "import sys; from rig.cli.command_line import main; sys.exit(main())"]


def run(*arguments, ok=True):
    """A finished process of `rig` with arguments, whose end must be as expected and without a traceback."""
    done = subprocess.run([*RIG, *map(str, arguments)], capture_output=True, text=True, timeout=300)
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
