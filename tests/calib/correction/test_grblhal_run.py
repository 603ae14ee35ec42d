"""grblHAL's own simulator, built with a plug-in: its motors stand and run where `rig correct` commands them."""

import os
import pty
import re
import select
import subprocess
import time
import tty
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from calib.api.correct import CorrectOptions, correct
from calib.files import calibration_file
from rig.errors import Unreachable
from rig.model.mechanisms import hexapod
from rig.recording.recording_folder import Sensors
from tests.calib.controllers_in_c import wanted
from tests.calib.correction.test_grblhal_kinematics import OUT_OF_STROKE, SINGULAR, pose_words, poses_of

SIMULATOR, CALIBRATION = "GRBLHAL_SIMULATOR", "GRBLHAL_CALIBRATION"
STEPS_PER_MM = 5000
AHEAD = 8  # lines
LONGEST = 0.5, 0.1  # mm, degrees, of a segment
STEP = 1e-3 / STEPS_PER_MM  # m
SAME = 1e-6  # m, beyond a step
PATIENCE, POLL_PERIOD = 60, 0.2  # s, for an answer, and for a report until it is asked for another


def why_not():
    """Why there is nothing to run here, or None."""
    missing = [name for name in (SIMULATOR, CALIBRATION) if not os.environ.get(name)]
    if missing:
        return (
            f"{' and '.join(missing)} not set: grblHAL's simulator, built by its own instructions with the plug-in of "
            "`rig export --format grblhal-kins`, and the calibration.json of which that was exported"
        )
    return None


class Simulator:
    """The simulator at a pseudo-terminal, in real time."""

    def __init__(self, program, folder):
        self.ours, theirs = pty.openpty()
        tty.setraw(theirs)
        self.process = subprocess.Popen(
            [program, "-n", "-t", "1", "-b", os.devnull, "-e", str(folder / "settings")],
            stdin=theirs,
            stdout=theirs,
            stderr=subprocess.DEVNULL,
            cwd=folder,
        )
        os.close(theirs)
        self.rest, self.pending = b"", False
        self.until("GrblHAL ")

    def close(self):
        self.process.kill()
        self.process.wait()
        os.close(self.ours)

    def read(self, patience=PATIENCE):
        """The next line that it writes; "" for none within so many seconds."""
        end = time.monotonic() + patience
        while b"\n" not in self.rest:
            if not select.select([self.ours], [], [], max(end - time.monotonic(), 0))[0]:
                return ""
            self.rest += os.read(self.ours, 4096)
        line, _, self.rest = self.rest.partition(b"\n")
        return line.decode(errors="replace").strip() or self.read(patience)

    def until(self, *ends):
        """Its lines up to one that begins with any of these."""
        lines = [self.read()]
        while not lines[-1].startswith(ends):
            assert lines[-1], f"no answer, after {lines}"
            lines.append(self.read())
        return lines

    def status_line(self):
        """The next line that it writes; one report is asked for, again after a while, as it may be dropped."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            if not self.pending:
                self.send("?")
            line = self.read(POLL_PERIOD)
            self.pending = bool(line) and not line.startswith("<")
            if line:
                return line
        raise AssertionError(f"no report within {PATIENCE} s")

    def send(self, text):
        os.write(self.ours, text.encode("latin-1"))

    def command(self, line):
        """What it answers to a line."""
        self.send(line + "\n")
        return self.until("ok", "error:", "ALARM:")

    def at_rest(self):
        """A report of motors at rest, asked for after all that was asked for before has been read."""
        line = ""
        while not line.startswith(("<Idle", "<Alarm")):
            while self.read(POLL_PERIOD):
                pass
            self.pending = False
            line = self.status_line()
        return line

    def motors(self):
        """(6,) m, where its motors are at rest."""
        return motors_of(self.at_rest())

    def pose(self):
        """(6,) mm and degrees, where it reports the platform at rest."""
        return np.array(re.search(r"\|MPos:([-\d.,]+)", self.at_rest())[1].split(","), float)

    def stream(self, goals, every):
        """({line: motors (6,) m at its end}, [(line, motors (6,) m)] on the way) of lines to poses (n, 6).

        every : after so many lines it waits until the motors are at rest
        """
        ends, path = {}, []
        for i, goal in enumerate(goals):
            rests = i % every == 0
            self.send(f"N{i}{line_to(goal)}\n" + "G4P0\n" * rests)
            left = 1 + rests
            while left:
                line = self.status_line()
                assert not line.startswith(("error:", "ALARM:", "[MSG:")), line
                left -= line == "ok"
                if running := re.match(r"<Run.*\|Ln:(\d+)", line):
                    path.append((int(running[1]), motors_of(line)))
            if rests:
                ends[i] = self.motors()
        return ends, path


def line_to(goal):
    """G-code of a line to a pose (6,) mm and degrees."""
    return "G1" + "".join(f"{axis}{value:.6f}" for axis, value in zip("XYZABC", goal))


def motors_of(report):
    """(6,) m, where a report states that the motors are."""
    return np.array(re.search(r"\|KPos:([-\d.,]+)", report)[1].split(","), float) / 1e3


@pytest.fixture
def running(tmp_path):
    """(Calibration, Simulator) with sensors at their medians, high accelerations and fine steps."""
    reason = why_not()
    if reason:
        pytest.skip(reason)
    path = Path(os.environ[CALIBRATION])
    simulator = Simulator(os.environ[SIMULATOR], tmp_path)
    try:
        made = "".join(line for line in simulator.command("$I") if line.startswith("[KINEMATICS:rigkins of "))
        assert sha256(path.read_bytes()).hexdigest()[:12] in made, f"it has {made or 'no rigkins'}, not that of {path}"
        values = {100: STEPS_PER_MM, 110: 12000, 120: 4000}
        motors = [f"${first + i}={value}" for first, value in values.items() for i in range(6)]
        for line in ["$376=0", "$10=511", *motors]:
            assert simulator.command(line) == ["ok"]
        assert simulator.command("G21G90G94G1F6000") == ["ok"]
        yield calibration_file.load(path), simulator
    finally:
        simulator.close()


def commanded(calibration, words):
    """(n, 6) m that `rig correct` commands for poses (n, 6), mm and degrees, at the sensors' medians."""
    sensors = None
    if calibration.physics is not None:
        sensors = Sensors(np.zeros(1), {name: np.array([row[0]]) for name, row in calibration.physics.channels.items()})
    return correct(calibration, poses_of(words), CorrectOptions(sensors)).values


def segments(start, goals):
    """(words (k, 6), line (k,) of each) at the ends of the segments of lines from start through goals (n, 6)."""
    words, lines = [], []
    for i, (begin, end) in enumerate(zip(np.r_[start[None], goals], goals)):
        shift, turn = np.linalg.norm(end[:3] - begin[:3]), np.abs(end[3:] - begin[3:]).max()
        count = max(int(np.ceil(max(shift / LONGEST[0], turn / LONGEST[1]))), 1)
        words.append(begin + np.arange(1, count + 1)[:, None] / count * (end - begin))
        lines += [i] * count
    return np.concatenate(words), np.array(lines)


def off_the_segments(ends, line_of, lines, lengths):
    """(n,) m, how far lengths (n, 6) are from the nearest segment between ends (k, 6) of their lines, or of one of the
    AHEAD before: a report names the line whose steps are prepared, some ahead of the motors.
    """
    off = []
    for line, position in zip(lines, lengths):
        near = np.flatnonzero((line_of >= line - AHEAD) & (line_of <= line + 1) & (np.arange(len(ends)) > 0))
        begin, segment = ends[near - 1], ends[near] - ends[near - 1]
        share = ((position - begin) * segment).sum(axis=1) / np.maximum((segment**2).sum(axis=1), 1e-30)
        here = begin + np.clip(share, 0.0, 1.0)[:, None] * segment
        off.append(np.abs(position - here).max(axis=1).min())
    return np.array(off)


@pytest.mark.slow
def test_a_thousand_lines_end_and_run_where_rig_correct_commands(design, running, capsys):
    calibration, simulator = running
    nominal = calibration.correction.nominal
    zero = hexapod.home_values(nominal)
    corners = np.array([pose_words(T).astype(float) for T in wanted(design, 101, fill=0.25)])
    shares = np.arange(1, 11)[:, None] / 10
    goals = np.round([one + share * (next - one) for one, next in zip(corners, corners[1:]) for share in shares], 6)
    words, line_of = segments(simulator.pose(), goals)
    ends, path = simulator.stream(goals, every=9)
    done = commanded(calibration, words)
    last = np.flatnonzero(np.diff(line_of, append=len(goals)))
    worst = max(np.abs(zero + motors - done[last[i]]).max() for i, motors in ends.items())
    lines, motors = (np.array(column) for column in zip(*[row for row in path if row[0]]))  # the first is from home
    along = off_the_segments(done, line_of, lines, zero + motors).max()
    with capsys.disabled():
        print(f"\ngrblHAL: 1000 lines, steps of {STEP:.2g} m: {worst:.2g} m at {len(ends)} ends,", end=" ")
        print(f"{along:.2g} m at {len(path)} on the way")
    assert worst < SAME + STEP / 2 and along < SAME + STEP and len(path) > 500
    assert np.abs(done[last] - hexapod.inverse(poses_of(goals), nominal)).max() > 1e-4  # without it they are elsewhere


@pytest.mark.slow
def test_lines_beyond_a_range_or_too_near_a_singularity_are_refused(running):
    """The platform turns about its normal until `rig correct`, or the Jacobian's least singular value, forbids it."""
    calibration, simulator = running
    fitted, nominal = calibration.correction.fitted, calibration.correction.nominal
    level = pose_words(hexapod.forward(hexapod.home_values(nominal), nominal)).astype(float)
    scale = np.r_[1, 1, 1, np.full(3, np.linalg.norm(fitted.platform_joints, axis=1).mean())]
    singular = np.linalg.svd(hexapod.jacobian(poses_of([level])[0], fitted) / scale, compute_uv=False)[-1]
    expected = 0
    for turn in range(1, 180):
        goal = level + [0, 0, 0, 0, 0, turn]
        try:
            commanded(calibration, goal[None])
        except Unreachable:
            expected = OUT_OF_STROKE
        least = np.linalg.svd(hexapod.jacobian(poses_of([goal])[0], fitted) / scale, compute_uv=False)[-1]
        if not expected and least < 0.1 * singular:
            expected = SINGULAR
        if expected:
            break
        assert simulator.command(line_to(goal)) == ["ok"]
    assert expected and simulator.command("G4P0") == ["ok"]
    before = simulator.motors()
    answer = simulator.command(line_to(goal))
    assert answer[-1] == "ALARM:2" and answer[0].startswith("[MSG:Warning: pose refused: ")
    simulator.until("[MSG:Reset to continue]")
    simulator.send("\x18")
    simulator.until("GrblHAL ")
    assert simulator.command("$X")[-1] == "ok" and np.array_equal(simulator.motors(), before)
    assert f"[RIG:refusals=1,refused={expected}," in simulator.command("$RIG")[0]
    assert simulator.command("G21G90G94G1F6000")[-1] == "ok" and simulator.command(line_to(level)) == ["ok"]
