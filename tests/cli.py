"""The commands in a process of their own, and what their pages link to."""

import subprocess
import sys
from html.parser import HTMLParser

RIG = [sys.executable, "-c", "import sys; from rig.cli import main; sys.exit(main())"]


def run(*arguments, ok=True):
    """A finished process of `rig` with arguments, whose end must be as expected and without a traceback."""
    done = subprocess.run([*RIG, *map(str, arguments)], capture_output=True, text=True, timeout=300)
    assert "Traceback" not in done.stderr, done.stderr
    assert (done.returncode == 0) == ok, done.stdout + done.stderr
    return done


class Links(HTMLParser):
    """outside : what a page loads from elsewhere."""

    def __init__(self):
        super().__init__()
        self.outside = []

    def handle_starttag(self, tag, attrs):
        self.outside += [v for k, v in attrs if k in ("src", "href") and not v.startswith("data:")]
