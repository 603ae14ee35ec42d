"""Standard output whose reader leaves early: files are finished, and a command that only prints ends."""

import os
import pty
import subprocess
import sys

import pytest

from tests.cli import RIG


@pytest.mark.slow
def test_a_reader_that_closes_standard_output_loses_no_results(tmp_path, recording_folder):
    """As `| head` does: the files are complete, the error output says what happened, and the status is that of a
    command that did its work.
    """
    out = tmp_path / "measured"
    process = subprocess.Popen(
        [sys.executable, "-u", *RIG[1:], "measure", str(recording_folder), "--out", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    process.stdout.close()
    complaint = process.stderr.read()
    process.stderr.close()
    assert process.wait(timeout=300) == 0 and "standard output was closed" in complaint and "Traceback" not in complaint
    assert {"poses.csv", "corners.csv", "report.html"} <= {path.name for path in out.iterdir()}


def test_a_file_on_standard_output_is_escaped_where_that_is_a_terminal():
    """Elsewhere every byte stays as it is."""
    text = "title \x1b]0;x\x07 \u202e name\tand a line\n"
    code = f"from rig.formats.output_files import STANDARD_OUTPUT, write_text; write_text(STANDARD_OUTPUT, {text!r})"
    assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, check=True).stdout == text.encode()
    ours, terminal = pty.openpty()
    subprocess.run([sys.executable, "-c", code], stdout=terminal, check=True)
    assert os.read(ours, 1000).split() == b"title \\x1b]0;x\\x07 \\u202e name and a line".split()
    os.close(terminal)
    os.close(ours)


def test_a_command_that_only_prints_ends_when_nobody_reads(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-u", *RIG[1:], "effects"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    process.stdout.close()
    complaint = process.stderr.read()
    process.stderr.close()
    assert process.wait(timeout=300) == 1 and complaint == ""
