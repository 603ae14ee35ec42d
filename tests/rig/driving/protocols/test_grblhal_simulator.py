"""grblHAL's own simulator with limit switches, driven by `rig` at a pseudo-terminal: from an alarm, through faults."""

import json
import os
import pty
import re
import select
import signal
import subprocess
import time
import tty
from contextlib import contextmanager

import numpy as np
import pytest

from rig.driving.run_journal import Arrival, Departure, Ended, read_journal_rows_and_valid_length
from rig.driving.run_steps_from_plan_and_progress_from_journal import steps_of_plan
from rig.formats.rig_toml import design_from_rig_toml
from rig.planning.recording_plan import build_plan
from tests.cli import RIG, run

SIMULATOR = "GRBLHAL_PLAIN_SIMULATOR"
SWITCH, PULL_OFF, TRAVEL = -41.0, 2.0, 100.0  # mm: of a switch from where it starts; $27; $130
PER_AXIS = {100: 250, 110: 12000, 120: 4000, 130: TRAVEL}  # steps/mm, mm/min, mm/s^2, mm
SETTINGS = ["$22=5", "$23=63", f"$27={PULL_OFF}", "$376=0", "$10=511", "$24=600", "$25=3000", "$44=63", "$45=0"]
PATIENCE = 90  # s
PLAN = ("--plan", "sobol:4", "--no-cameras", "--settle", "time:0.05")


class Simulator:
    """The simulator at a pseudo-terminal of its own. port : where it is driven; settings : its file of them"""

    def __init__(self, settings):
        ours, self.theirs = pty.openpty()
        tty.setraw(self.theirs)
        self.port = os.ttyname(self.theirs)
        self.process = subprocess.Popen(
            [os.environ[SIMULATOR], "-n", "-t", "1", "-b", os.devnull, "-e", str(settings)],
            stdin=ours,
            stdout=ours,
            stderr=subprocess.DEVNULL,
        )
        os.close(ours)

    def send(self, text, until=r"ok|error:.*|ALARM:.*"):
        """What it answers to a line or a byte, until a line matches. Nothing else may be driving it."""
        os.write(self.theirs, text)
        lines, rest, end = [], b"", time.monotonic() + PATIENCE
        while not any(re.fullmatch(until, line) for line in lines):
            assert select.select([self.theirs], [], [], max(end - time.monotonic(), 0))[0], f"no answer, after {lines}"
            *whole, rest = (rest + os.read(self.theirs, 4096)).split(b"\n")
            lines += [line.decode(errors="replace").strip() for line in whole]
        return lines

    def report(self):
        return next(line for line in self.send(b"\x87", "<.*>") if line.startswith("<"))

    def end(self):
        """As a power cut, once its settings are in their file."""
        self.process.kill()
        self.process.wait()
        os.close(self.theirs)


@pytest.fixture
def machine(tmp_path):
    """A function that starts the simulator, once more too, with settings that stay; rig.toml states its port."""
    if not os.environ.get(SIMULATOR):
        pytest.skip(f"{SIMULATOR} not set: `make test-grblhal` builds grblHAL's simulator and sets it")
    running = []

    def start(*settings, **controller):
        for old in running:
            old.end()
        running[:] = [Simulator(tmp_path / "settings")]
        if settings:
            running[0].send(b"", "GrblHAL .*")
            for line in settings:
                assert "ok" in running[0].send(line.encode() + b"\n"), line
            os.write(running[0].theirs, b"\x06")  # ends it, with its settings in the file
            running[0].process.wait(PATIENCE)
            return start(**controller)
        text = (tmp_path / "new.toml").read_text()
        home = design_from_rig_toml.load_design(tmp_path / "new.toml").mechanism.strut_range.mean()
        stated = {"zero": home + (SWITCH + TRAVEL) / 1e3, "max_speed": 0.05, **controller}
        text = re.sub(r"(?m)^(# port|homing|zero|tolerance) = .*\n", "", text)
        keys = "".join(f"{key} = {json.dumps(value)}\n" for key, value in stated.items())
        text = text.replace('protocol = "grblhal"', f'port = "{running[0].port}"\n{keys}protocol = "grblhal"')
        (tmp_path / "rig.toml").write_text(text)
        return running[0]

    run("new", "design", "--radius", "0.3", "--out", tmp_path / "new.toml")
    yield (
        lambda *more, **controller: start(
            *SETTINGS,
            *(f"${first + i}={value}" for first, value in PER_AXIS.items() for i in range(6)),
            *more,
            **controller,
        ),
        start,
    )
    for old in running:
        old.end()


@contextmanager
def is_moving(folder):
    """(process, its words) of a run within its second move, in a process of its own."""
    words = ["run", str(folder / "rig.toml"), *PLAN, "--out", str(folder / "rec")]
    journal = folder / "rec" / "journal.jsonl"
    with subprocess.Popen([*RIG, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        while (
            not journal.exists()
            or sum(isinstance(row, Departure) for row in read_journal_rows_and_valid_length(journal)[0]) < 2
        ):
            assert process.poll() is None
            time.sleep(0.01)
        yield process, words


def complete(out):
    """Whether a run reached each step of its plan, none of them twice."""
    rows, _ = read_journal_rows_and_valid_length(out / "journal.jsonl")
    steps = steps_of_plan(build_plan(design_from_rig_toml.load_design(out / "rig.toml"), PLAN[1]))
    assert isinstance(rows[-1], Ended) and rows[-1].reason == ""
    reached = [row.step for row in rows if isinstance(row, Arrival) and row.reached]
    return reached == list(range(len(steps)))


@pytest.mark.slow
def test_from_the_alarm_in_which_it_starts_the_first_run_completes(machine, tmp_path):
    simulator = machine[0]()
    assert simulator.report().startswith("<Alarm")
    assert "rig home ends that" in run("status", tmp_path / "rig.toml").stdout
    run("run", tmp_path / "rig.toml", *PLAN, "--out", tmp_path / "rec")
    assert complete(tmp_path / "rec")
    resumed = run("run", tmp_path / "rig.toml", *PLAN, "--out", tmp_path / "rec", "--resume")
    assert "<Idle" in simulator.report() and "is finished" in resumed.stdout


@pytest.mark.slow
def test_a_limit_switch_ends_a_run_and_no_run_homes_out_of_it_unasked(machine, tmp_path):
    simulator = machine[0]("$21=1")
    run("home", tmp_path / "rig.toml", "--unlock")  # in the alarm in which it starts, which no unlocking ends
    simulator.send(b"G53G1X-101F600\n", "ALARM:1")  # onto its own switch
    failed = run("run", tmp_path / "rig.toml", *PLAN, "--out", tmp_path / "rec", ok=False)
    assert "limit switch" in failed.stderr, failed.stderr
    assert "<Alarm" in simulator.report()
    run("home", tmp_path / "rig.toml")
    run("run", tmp_path / "rig.toml", *PLAN, "--out", tmp_path / "rec2")
    assert complete(tmp_path / "rec2")


@pytest.mark.slow
def test_limits_of_its_own_are_compared_before_anything_moves(machine, tmp_path):
    simulator = machine[0]("$20=1", "$130=50", "$110=600")
    output = run("run", tmp_path / "rig.toml", *PLAN, "--out", tmp_path / "rec", "--dry-run", ok=False)
    assert "the controller travels 50.000 mm ($130 .. with $20=1)" in output.stderr
    output = run("status", tmp_path / "rig.toml").stdout
    assert "$110" in output, output
    assert "MPos:0.000,0.000,0.000,0.000,0.000,0.000" in simulator.report()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_killed_in_a_move_a_run_is_resumed_and_no_move_made_twice(machine, tmp_path, seed):
    simulator = machine[0](max_speed=0.02)
    with is_moving(tmp_path) as (process, words):
        time.sleep(np.random.default_rng(seed).uniform(0, 0.8))
        process.send_signal(signal.SIGKILL)
    run(*words, "--resume")
    assert complete(tmp_path / "rec")
    assert "<Idle" in simulator.report()


@pytest.mark.slow
def test_a_power_cut_loses_the_position_until_it_is_homed(machine, tmp_path):
    start, restart = machine
    start(max_speed=0.01)
    with is_moving(tmp_path) as (process, words):
        restart(max_speed=0.01)  # a new one, which counts 0 where it stands, locked
        assert process.wait(PATIENCE) != 0
    resumed = run(*words, "--resume")
    assert "hom" in resumed.stdout + resumed.stderr
    assert complete(tmp_path / "rec")


@pytest.mark.slow
def test_a_power_cut_without_switches_is_not_forgotten(machine, tmp_path):
    start, restart = machine
    home = design_from_rig_toml.load_design(tmp_path / "new.toml").mechanism.strut_range.mean()
    start("$22=0", homing=False, zero=home, max_speed=0.01)
    with is_moving(tmp_path) as (process, words):
        restart(homing=False, zero=home, max_speed=0.01)
        assert process.wait(PATIENCE) != 0
    for _ in range(2):
        refused = run(*words, "--resume", ok=False)
        assert "--no-home" in refused.stderr, refused.stderr
    run(*words, "--resume", "--no-home")
    assert complete(tmp_path / "rec")


@pytest.mark.slow
def test_a_stop_from_elsewhere_holds_it_and_keeps_its_position(machine, tmp_path):
    simulator = machine[0](max_speed=0.01)
    with is_moving(tmp_path) as (process, words):
        run("stop", tmp_path / "rig.toml")
        assert process.wait(PATIENCE) != 0
    first = simulator.report()
    assert "<Idle" in first and "|H:1" in first
    time.sleep(0.3)
    assert re.search(r"MPos:[^|]*", simulator.report())[0] == re.search(r"MPos:[^|]*", first)[0]
    run(*words, "--resume")
    assert complete(tmp_path / "rec")
