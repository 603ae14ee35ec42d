"""kill -9 at random instants of a run: what was reported is there, no place is gone to twice unnoticed, and every run
is resumed to its end.
"""

import shutil

import numpy as np
import pytest

from rig.driving.run_journal import Departure, Ended, Exposed, Resumed, read_journal_rows_and_valid_length
from rig.driving.run_steps_from_plan_and_progress_from_journal import steps_of_plan
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import PROTOCOLS
from rig.planning.recording_plan import build_plan
from rig.recording import recording_folder
from tests.emulated_run import EmulatedRig, runner

PLAN = "sobol:6"
SAME = 2e-6  # m; the controller is told micrometres


@pytest.fixture
def emulated(tmp_path, request):
    import calib.api.execute_plan_at_machine  # noqa: F401  (so that forked runners need not)

    made = EmulatedRig(tmp_path, getattr(request, "param", "grblhal"))
    yield made
    made.close()


def words(folder, out, resume=False):
    return [
        "run",
        str(folder / "rig.toml"),
        "--plan",
        PLAN,
        "--settle",
        "time:0.01",
        "--exposure",
        "keep",
        "--no-measure",
        "--out",
        str(out),
        *(["--resume"] if resume else []),
    ]


def finished(folder, out, resume, log):
    process = runner(words(folder, out, resume), log)
    process.join(120)
    assert process.exitcode == 0, log.read_text()


def killed(folder, out, after, log):
    """Whether a run was killed so long (s) after it had begun to move, and not already over."""
    size = (folder / "told.csv").stat().st_size
    process = runner(words(folder, out), log)
    while process.is_alive() and (folder / "told.csv").stat().st_size == size and not (out / "commands.csv").exists():
        process.join(0.001)
    process.join(after)
    was = process.is_alive()
    process.kill()
    process.join()
    return was


def reported(log):
    """Frames that a run said it had exposed, by what its terminal shows."""
    return max(
        [int(line[1:].split("/")[0]) for line in log.read_text().splitlines() if line.startswith("[") and "/" in line]
        or [0]
    )


def check(emulated, out, before, log, seen):
    """What must hold of a run that was killed and resumed. seen : frames reported before it was killed"""
    rows, _ = read_journal_rows_and_valid_length(out / "journal.jsonl")
    design = design_from_rig_toml.load_design(out / "rig.toml")
    planned = steps_of_plan(build_plan(design, PLAN))
    assert isinstance(rows[-1], Ended) and rows[-1].reason == "", log.read_text()
    frames = [row for row in rows if isinstance(row, Exposed)]
    assert len(frames) >= seen
    assert [row.step for row in frames] == [k for k, step in enumerate(planned) for _ in range(step.frames)]
    commanded, goals = emulated.commanded_goals()[before:], [row.goal for row in rows if isinstance(row, Departure)]
    broken = sum(
        any(word in row.found for word in ("broken off", "somebody", "homed"))
        for row in rows
        if isinstance(row, Resumed)
    )
    assert len(commanded) <= len(planned) + broken, "a place was gone to twice, and the journal does not say so"
    apart = [min(np.abs(np.subtract(move, goal)).max() for goal in goals) for move in commanded]
    assert max(apart, default=0.0) < SAME, "a move that the journal does not have"
    for goal in (step.goal for step in planned[1:]):
        assert any(np.abs(np.subtract(move, goal)).max() < SAME for move in commanded)
    found = recording_folder.load_recording(out)
    np.testing.assert_allclose(found.commanded()[2], [planned[row.step].goal for row in frames], atol=2e-9)


def campaign(emulated, folder, count, rng):
    """How many of `count` runs were killed before their end; each is resumed and checked."""
    log = folder / "log"
    whole = folder / "whole"
    finished(folder, whole, False, log)
    duration, hit = read_journal_rows_and_valid_length(whole / "journal.jsonl")[0][-1].t, 0
    while hit < count:
        out, log = folder / "rec", folder / "log"
        shutil.rmtree(out, ignore_errors=True)
        log.unlink(missing_ok=True)
        before = len(emulated.commanded_goals())
        if not killed(folder, out, rng.uniform(0, duration), log):
            continue
        hit += 1
        seen = reported(log)
        while rng.random() < 0.3 and (out / "journal.jsonl").exists():  # and killed once more while it resumes
            process = runner(words(folder, out, True), log)
            process.join(rng.uniform(0, 0.5 * duration))
            process.kill()
            process.join()
        finished(folder, out, (out / "journal.jsonl").exists(), log)
        check(emulated, out, before, log, seen)
    return hit


@pytest.mark.parametrize(
    "emulated",
    [pytest.param(p, marks=[pytest.mark.slow] * (p not in ("grblhal", "gcs-hexapod"))) for p in PROTOCOLS],
    indirect=True,
)
def test_a_killed_run_is_resumed(emulated, tmp_path):
    assert campaign(emulated, tmp_path, 2, np.random.default_rng(11)) == 2


@pytest.mark.slow
def test_two_hundred_killed_runs_are_resumed(emulated, tmp_path):
    assert campaign(emulated, tmp_path, 200, np.random.default_rng(12)) == 200
