"""A hexapod's own controller, which takes poses by a nominal geometry: driven, measured, calibrated, corrected.

A tracker measures. The machine at its struts is built otherwise. The struts' motion is the emulator's history, and
where the platform then stands is by kinematics of the tests' own.
"""

import re
import threading

import numpy as np
import pytest

from rig.cli.command_line import main
from rig.driving import emulators
from rig.driving.driving_clock import SystemClock
from rig.driving.emulators import emulator_opening_and_serving_over_terminal_or_tcp
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import Faults
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.pose import pose
from rig.recording.corner_and_pose_csv_tables import Poses, write_poses
from synthetic import random_true_machine_and_truth_file
from tests.calib.rigs_with_unmodelled_physics import measured_by
from tests.conftest import ROOT
from tests.truth import kinematics, rigid

SIGMA = (4e-6, 3e-5)  # m, rad, of the tracker
PAGE = (ROOT / "docs" / "controllers.md").read_text().split("\n## A hexapod's own controller\n")[1].split("\n## ")[0]
STATED = PAGE[PAGE.index("    [controller]") : PAGE.index("    rig run")]
CONTROLLER = "\n" + re.sub("^    ", "", STATED, flags=re.MULTILINE)
FAST = "max_speed = 5.0\nmax_acceleration = 500.0"
WORK_AND_TOOL = """work = { position = [0.01, -0.02, 0.3], rotvec = [0.0, 0.0, 0.3] }
tool = { position = [0.0, 0.01, 0.05], rotvec = [0.2, 0.0, 0.0] }
"""
FRAMES = {  # lines of [controller]; the pivot point that the controller has, mm; options of `rig correct`
    "home and a pivot point": ("", (5.0, -3.0, 40.0), ("--work", "0,0,0.45,0,0,0", "--pivot", "0.005,-0.003,0.04")),
    "work and tool": (WORK_AND_TOOL, (0, 0, 0), ("--work", "0.01,-0.02,0.3,0,0,0.3", "--tool", "0,0.01,0.05,0.2,0,0")),
}


class Bench:
    """An emulated controller in a thread, and the machine that it moves."""

    def __init__(self, folder, frames):
        self.folder, self._running = folder, True
        lines, pivot, self.options = FRAMES[frames]
        stated = CONTROLLER.replace("socket://192.168.1.20:50000", str(folder / "port"))
        stated = stated.replace("max_speed = 0.005", FAST).rstrip() + "\n"
        (folder / "rig.toml").write_text(measured_by(None, *SIGMA) + stated + lines)
        design = design_from_rig_toml.load_design(folder / "rig.toml")
        true = random_true_machine_and_truth_file.random_true_machine(design, np.random.default_rng(4)).true.mechanism
        ranges, height = design.mechanism.strut_range, design.mechanism.home.translation[2]
        self.machine = kinematics.SixStruts(
            true.base_joints, true.platform_joints, true.strut_zeros, ranges, float(height)
        )
        self.emulator = emulators.emulator_of_design(design, Faults((), np.random.default_rng(0)), SystemClock())
        self.emulator.platform.pivot = np.array(pivot) / 1e3
        wire = emulator_opening_and_serving_over_terminal_or_tcp.Terminal(folder / "port")
        self.emulator.greet = lambda: None  # the power is on, and the pivot point set
        self._thread = threading.Thread(
            target=emulator_opening_and_serving_over_terminal_or_tcp.serve_emulator,
            args=(self.emulator, wire, lambda: self._running, lambda name: None, lambda: None),
            daemon=True,
        )
        self._thread.start()

    def close(self):
        self._running = False
        self._thread.join()

    def run(self, plan, out, words=None):
        """(frames (n,), true poses (n, 4, 4)) of a run of a plan, and the emulator's lines in a trace.

        words : of the command, where a page states it
        """
        words = words or ["run", "rig.toml", "--plan", plan, "--out", out]
        assert main([*words, "--settle", "time:0", "--trace", f"{out}.trace", "--quiet"]) == 0
        origin = re.search(r'"wall": ?([\d.]+)', (self.folder / out / "journal.jsonl").read_text())[1]
        rows = np.loadtxt(self.folder / out / "visits.csv", delimiter=",", skiprows=1, usecols=(0, 1, 2))
        lengths = self.emulator.lengths_at(float(origin) + rows[:, 1:].mean(axis=1))
        return rows[:, 0].astype(int), self.machine.forward(lengths)


@pytest.fixture(params=FRAMES)
def bench(request, tmp_path):
    made = Bench(tmp_path, request.param)
    yield made
    made.close()


def commanded(path):
    """(n, 6) X .. W of the MOV lines of a trace."""
    rows = re.findall(r"MOV X (\S+) Y (\S+) Z (\S+) U (\S+) V (\S+) W ([-.\d]+)", path.read_text())
    return np.array(rows, float)


def table(path):
    return np.loadtxt(path, delimiter=",", skiprows=1)[:, 1:]


@pytest.mark.slow
def test_run_calibrated_and_corrected_it_comes_as_near_as_struts_driven_directly(bench, capsys, monkeypatch):
    """The commands of the page, in its order, with the instrument's poses and corrected ones between."""
    folder, rng = bench.folder, np.random.default_rng(7)
    monkeypatch.chdir(folder)
    run, calibrate, go = (line.split()[1:] for line in re.findall(r"^    (rig .*)$", PAGE, re.MULTILINE))
    frames, reached = bench.run("", "REC", run)
    noise = np.repeat(SIGMA, 3) * rng.standard_normal((len(frames), 6))
    rows = rigid.rows_of(rigid.displaced(reached, noise))
    seen = Poses(frames, pose(rows[:, :3], rows[:, 3:]), None)
    write_poses(folder / "REC" / "poses.csv", seen)
    assert main(calibrate) == 0

    moves = np.concatenate([rng.uniform(-0.02, 0.02, (12, 3)), rng.uniform(-0.08, 0.08, (12, 3))], axis=1)
    moves[:, 2] += bench.machine.height
    wanted = rigid.matrices(moves)
    write_poses(folder / "wanted.csv", Poses(np.arange(12), pose(moves[:, :3], moves[:, 3:]), None))
    kinds = ("--uncorrected",), (), ("--as", "gcs", *bench.options)
    for name, options in zip(("plain.csv", "lengths.csv", "moves.csv"), kinds):
        words = ["correct", folder / "calibration.json", "--poses", folder / "wanted.csv", "--out", folder / name]
        assert main([*map(str, words), *options]) == 0
    _, stood = bench.run(f"commands:{folder / 'lengths.csv'}", "corrected")
    _, before = bench.run(f"commands:{folder / 'plain.csv'}", "uncorrected")
    by_poses, uncorrected, by_lengths = (
        rigid.rms(rigid.errors(real, wanted))
        for real in (stood, before, bench.machine.forward(table(folder / "lengths.csv")))
    )
    with capsys.disabled():
        print(f"\nRMS m, rad: {uncorrected} uncorrected, {by_poses} by poses, {by_lengths} by lengths")
    for part in range(2):
        assert by_poses[part] <= 1.05 * by_lengths[part] and by_poses[part] < 0.1 * uncorrected[part]
    sent = commanded(folder / "corrected.trace")
    for row in table(folder / "moves.csv"):  # each of them as the command writes it for MOV
        assert np.abs(sent - row).max(axis=1).min() < 2e-4  # mm, degrees: a plan rounds lengths to 0.1 um

    assert main(go) == 0
    capsys.readouterr()
    sent = rigid.matrices(np.array(go[-1].split(","), float))
    now = bench.machine.forward(bench.emulator.lengths_at(SystemClock().now()))
    assert np.abs(rigid.errors(now, sent)).max() < 5e-5
