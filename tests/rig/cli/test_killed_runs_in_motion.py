"""kill -9 at random instants of a run that exposes in motion: it is resumed to its end, and no frame is without a
position.
"""

import shutil

import numpy as np
import pytest

from rig.driving.run_journal import (
    Arrival,
    Ended,
    Exposed,
    PositionReports,
    Resumed,
    read_journal_rows_and_valid_length,
)
from rig.driving.run_steps_from_plan_and_progress_from_journal import steps_of_plan
from rig.formats.rig_toml import design_from_rig_toml
from rig.planning.recording_plan import build_plan
from rig.recording import recording_folder
from tests.emulated_run import EmulatedRig, runner

PLAN, SPEED = "sobol:2", 250  # mm/s
SAME = 2e-6  # m; the controller is told micrometres


@pytest.fixture
def emulated(tmp_path):
    import calib.api.execute_plan_at_machine  # noqa: F401  (so that forked runners need not)

    made = EmulatedRig(tmp_path)
    yield made
    made.close()


def started(folder, out, resume=False):
    words = ["run", folder / "rig.toml", "--plan", PLAN, "--in-motion", SPEED, "--interval", "0.03", "--no-measure"]
    words += ["--exposure", "keep", "--out", out, *(["--resume"] if resume else [])]
    return runner(list(map(str, words)), folder / "log")


def check(folder, out):
    rows, _ = read_journal_rows_and_valid_length(out / "journal.jsonl")
    assert isinstance(rows[-1], Ended) and rows[-1].reason == "", (folder / "log").read_text()
    planned = steps_of_plan(build_plan(design_from_rig_toml.load_design(out / "rig.toml"), PLAN))
    reached = [row.step for row in rows if isinstance(row, Arrival) and row.reached]
    assert reached == list(range(len(planned))), "every place is reached, and none twice"
    frames = [row for row in rows if isinstance(row, Exposed)]
    assert [row.frame for row in frames] == list(range(len(frames))) and len(frames) > 3
    reported = -np.inf
    for k, row in enumerate(rows):
        if isinstance(row, PositionReports):
            reported = row.times[-1]
        elif isinstance(row, Exposed):
            assert all((out / image).stat().st_size for image in row.images)
            at_goal = next(later.reached for later in rows[k:] if isinstance(later, Arrival))
            assert reported >= row.t or at_goal, "where the struts were is reported, or they had arrived"
    found = recording_folder.load_recording(out)
    low, high = found.design.mechanism.strut_range.T
    assert ((found.commanded()[2] >= low - SAME) & (found.commanded()[2] <= high + SAME)).all()
    return any("broken off" in row.found or "was done" in row.found for row in rows if isinstance(row, Resumed))


def campaign(emulated, folder, count, rng):
    """Of `count` runs that were killed in motion and resumed, how many in the middle of a move."""
    in_a_move = 0
    for k in range(count):
        out = folder / f"rec{k}"
        process = started(folder, out)
        while process.is_alive() and not (out / "position_reports.csv").exists():
            process.join(0.002)
        process.join(rng.uniform(0, 1.0))
        process.kill()
        process.join()
        process = started(folder, out, True)
        process.join(120)
        assert process.exitcode == 0, (folder / "log").read_text()
        in_a_move += check(folder, out)
        shutil.rmtree(out)
    return in_a_move


@pytest.mark.slow
def test_twenty_runs_killed_in_motion_are_resumed(emulated, tmp_path):
    assert campaign(emulated, tmp_path, 20, np.random.default_rng(2)) > 5
