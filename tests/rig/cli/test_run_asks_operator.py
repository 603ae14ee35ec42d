"""`rig run --settle ask` at an emulated controller: somebody answers at a pseudo-terminal, or on the run's page."""

import fcntl
import http.client
import os
import pty
import re
import select
import signal
import subprocess
import termios
import time

import numpy as np
import pytest

from rig.driving.run_journal import Ended, Exposed, read_journal_rows_and_valid_length
from rig.recording import recording_folder
from tests.cli import RIG, run
from tests.emulated_run import EmulatedRig

INSTRUMENT = '\n[instrument]\nbase = "free"\ntool = "free"\nposition_sigma = 2e-5\nrotation_sigma = 1e-4\n'
ASK = ("--plan", "sobol:3", "--no-cameras", "--settle", "ask")


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    made = EmulatedRig(tmp_path_factory.mktemp("asked"))
    yield made.folder / "rig.toml"
    made.close()


def take_terminal():
    """Make standard input the terminal of this process, which heeds Ctrl-C whatever started the tests."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    signal.signal(signal.SIGINT, signal.SIG_DFL)


class Operator:
    """`rig run` at a pseudo-terminal of its own. shown : all that it has shown"""

    def __init__(self, *words):
        self._terminal, its_end = pty.openpty()
        self._process = subprocess.Popen(
            [*RIG, *map(str, words)],
            stdin=its_end,
            stdout=its_end,
            stderr=its_end,
            start_new_session=True,
            preexec_fn=take_terminal,
        )
        os.close(its_end)
        self.shown = ""

    def sees(self, pattern, seconds=60):
        """The match of a pattern in what is shown since the last one, waited for."""
        end = time.monotonic() + seconds
        while (found := re.search(pattern, self.shown)) is None:
            assert time.monotonic() < end, self.shown
            if select.select([self._terminal], [], [], 0.1)[0]:
                self.shown += os.read(self._terminal, 65536).decode()
        self.shown = self.shown[found.end() :]
        return found

    def types(self, text):
        os.write(self._terminal, text.encode())

    def ends(self):
        """Exit status, once it has ended."""
        status = self._process.wait(60)
        os.close(self._terminal)
        return status


def exposed(out):
    return [row for row in read_journal_rows_and_valid_length(out / "journal.jsonl")[0] if isinstance(row, Exposed)]


def press(address, path):
    """Status of a POST from the page at an address."""
    port, token = re.search(r":(\d+)/\?token=(\S+)", address).groups()
    connection = http.client.HTTPConnection("127.0.0.1", int(port), timeout=10)
    connection.request(
        "POST", f"{path}{'&' if '?' in path else '?'}token={token}", headers={"Origin": f"http://127.0.0.1:{port}"}
    )
    answer = connection.getresponse()
    answer.read()
    connection.close()
    return answer.status


def test_enter_goes_on_and_a_reading_becomes_a_pose(rig, tmp_path):
    """Ctrl-C while it waits ends the run, which is resumed at the place that it waited at."""
    out = tmp_path / "rec"
    at = Operator("run", rig, *ASK, "--out", out)
    at.sees(r"frame 0 stands at \S+ \S+ \S+ m, \S+ \S+ \S+ rad by the nominal model \(struts .* m\); press Enter")
    at.types("0.01 0.02\n")
    at.sees(r"no reading: 2 figures; expected .*frame 0 stands")
    at.types("0.01 0.02 0.44 0.001 0.002 0.003\n")
    at.sees("frame 1 stands")
    at.types("\x03")
    assert at.ends() == 128 + signal.SIGINT
    assert (
        isinstance(read_journal_rows_and_valid_length(out / "journal.jsonl")[0][-1], Ended) and len(exposed(out)) == 1
    )
    again = Operator("run", rig, *ASK, "--out", out, "--resume")
    again.sees("frame 1 stands")
    again.types("\n")
    again.sees(r"frame 2 stands at .* after x y z rx ry rz \(m, rad\)")
    again.types("0.03 0.02 0.44 0.001 0.002 0.003\n")
    again.sees(r"3 visits in .*visits.csv, readings in .*poses.csv; state \[instrument\]")
    assert again.ends() == 0
    (out / "rig.toml").write_text((out / "rig.toml").read_text() + INSTRUMENT)
    read = recording_folder.load_recording(out)
    assert read.poses.frame.tolist() == [0, 2]
    np.testing.assert_allclose(read.poses.T_base_platform.translation, [[0.01, 0.02, 0.44], [0.03, 0.02, 0.44]])
    assert [len(row.reading) for row in exposed(out)] == [6, 0, 6]


def test_somebody_answers_and_stops_on_the_page(rig, tmp_path):
    out = tmp_path / "rec"
    at = Operator("run", rig, *ASK, "--out", out, "--page")
    page = at.sees(r"http://127\S+")[0]
    at.sees("frame 0 stands")
    assert press(page, "/answer?frame=1&reading=") == press(page, "/answer?reading=") == 409
    assert press(page, "/answer?frame=0&reading=0.01+0.02+0.44") == 200
    at.sees("frame 1 stands")
    assert press(page, "/answer?frame=0&reading=") == 409, "a second click is no answer to the next question"
    assert press(page, "/stop") == 200
    at.sees("stopped from the page")
    assert at.ends() not in (0, None)
    assert (out / "poses.csv").read_text() == "frame,x,y,z\n0,0.0100000000,0.0200000000,0.4400000000\n"
    assert len(exposed(out)) == 1


def test_a_table_that_somebody_else_wrote_is_not_written_over(rig, tmp_path):
    out = tmp_path / "rec"
    at = Operator("run", rig, *ASK, "--out", out)
    at.sees("frame 0 stands")
    at.types("\x03")
    at.ends()
    (out / "poses.csv").write_text("frame,x,y,z,rx,ry,rz\n")
    again = Operator("run", rig, *ASK, "--out", out, "--resume")
    again.sees("poses.csv is not what the journal's readings make")
    assert again.ends() == 1 and (out / "poses.csv").read_text() == "frame,x,y,z,rx,ry,rz\n"


def test_nobody_who_could_answer_is_an_error_before_anything_moves(rig, tmp_path):
    done = run("run", rig, *ASK, "--out", tmp_path / "rec", ok=False)
    assert "a terminal in the foreground, or --page" in done.stderr and not (tmp_path / "rec").exists()
