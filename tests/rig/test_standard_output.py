"""Standard output whose reader leaves early: files are finished, and a command that only prints ends."""

import subprocess
import sys

from tests.cli import RIG


def test_a_reader_that_closes_standard_output_loses_no_results(tmp_path, recording_folder):
    """As `| head` does: the files are complete, the error output says what happened, and the status is that of a command that did its work."""
    out = tmp_path / "measured"
    process = subprocess.Popen([sys.executable, "-u", *RIG[1:], "measure", str(recording_folder), "--out", str(out)],
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    process.stdout.close()
    complaint = process.stderr.read()
    process.stderr.close()
    assert process.wait(timeout=300) == 0 and "standard output was closed" in complaint and "Traceback" not in complaint
    assert {"poses.csv", "corners.csv", "report.html"} <= {path.name for path in out.iterdir()}


def test_a_command_that_only_prints_ends_when_nobody_reads(tmp_path):
    process = subprocess.Popen([sys.executable, "-u", *RIG[1:], "effects"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    process.stdout.close()
    complaint = process.stderr.read()
    process.stderr.close()
    assert process.wait(timeout=300) == 1 and complaint == ""
