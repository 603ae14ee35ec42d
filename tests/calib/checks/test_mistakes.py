"""What users do wrong is named as what it is, in the first line; what is good is left in peace."""

import contextlib
import io
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from rig.checks import Mistake, sort_mistakes, unit_and_convention_mistakes
from rig.cli import command_line
from rig.effects.catalogue.edge_bias import EdgeBias
from rig.effects.catalogue.print_scale import PrintScale
from rig.effects.catalogue.time_offset import TimeOffset
from rig.recording import recording_folder
from rig.recording.recording_folder import Commands
from tests.calib.checks.cases import Case, time
from tests.calib.checks.good import make, recorded
from tests.calib.checks.matrix import CASES
from tests.conftest import BENCH

QUICK = (
    "lengths in mm",
    "struts in another order",
    "frames in ms",
    "frames an hour late",
    "u and v exchanged",
    "camera poses exchanged",
    "gravity upwards",
    "temperatures in Kelvin",
    "an unused camera",
    "edge and marker exchanged",
    "ids off by one",
    "poses inverted",
    "arm: joint 3 with the other sign",
    "arm: joint 2 from another zero",
    "arm: poses shifted by one",
    "an image twice",
    "base joints 10 % large",
    "arm: poses in cm",
)
LEAST = 55  # of the matrix, named as what they are


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A function of (kind, which rig) that gives the folder of a good recording, made once."""
    made: dict[tuple[str, int], Path] = {}

    def of(kind: str, number: int = 0) -> Path:
        if (kind, number) not in made:
            made[kind, number] = make(kind, tmp_path_factory.mktemp("good") / f"{kind}{number}", number)
        return made[kind, number]

    return of


def run_in_process(*words: object) -> tuple[int, str]:
    """(exit status, what a command prints) of `rig` in this process."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        status = command_line.main([str(word) for word in words])
    return status, out.getvalue()


def first_line(case: Case, good, number: int, folder: Path) -> str:
    """What `rig check` says first of a good recording with one mistake made in it."""
    shutil.copytree(good(case.kind, number), folder)
    case.spoil(folder)
    return run_in_process("check", folder)[1].splitlines()[0].replace(f"{folder}/", "")


@pytest.mark.parametrize("case", [case for case in CASES if case.name in QUICK], ids=lambda case: case.name)
def test_a_mistake_is_named_first(case, good, tmp_path):
    assert re.search(case.says, first_line(case, good, 0, tmp_path / "rec"))


@pytest.mark.parametrize("late", [2.5, -3.0])
def test_a_clocks_shift_is_stated_with_the_range_that_serves_as_well(late, good, tmp_path):
    """Frames within dwells leave a range of shifts; the true one lies in it."""
    case = Case(
        "late",
        "corners",
        time("frames.csv", 1, late),
        r"clock is ([\d.]+) s (behind|ahead of) the commands' \(\+-([\d.]+) s\)",
    )
    found = re.search(case.says, line := first_line(case, good, 0, tmp_path / "rec"))
    assert found, line
    size, room = float(found[1]), float(found[3])
    assert (found[2] == "ahead of") == (late > 0) and 0.5 < room < 2 and abs(size - abs(late)) <= room


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 1])
def test_the_whole_matrix(number, good, tmp_path):
    """Of more than sixty mistakes nearly all are named as what they are, and none passes without a word."""
    lines = {case.name: first_line(case, good, number, tmp_path / str(k)) for k, case in enumerate(CASES)}
    missed = {case.name: lines[case.name] for case in CASES if not re.search(case.says, lines[case.name])}
    assert len(CASES) >= 60 and not [name for name, line in lines.items() if line.startswith("nothing")]
    assert len(CASES) - len(missed) >= max(LEAST, 0.92 * len(CASES)), missed


@pytest.mark.parametrize("kind", ["corners", "images", "poses", "arm"])
def test_good_recordings_are_left_in_peace(kind, good):
    assert run_in_process("check", good(kind)) == (0, "nothing wrong or unlikely was found\n")


@pytest.mark.parametrize(
    "effect",
    [
        PrintScale("markers", 0.005),
        TimeOffset("clock", 0.02),
        pytest.param(EdgeBias("cameras", 0.5), marks=pytest.mark.slow),
    ],
    ids=lambda e: e.name,
)
def test_effects_are_no_mistakes(effect, tmp_path):
    recorded(tmp_path / "rec", 0, (effect,))
    assert run_in_process("check", tmp_path / "rec") == (0, "nothing wrong or unlikely was found\n")


@pytest.mark.slow
def test_measure_refuses_what_is_spoilt_and_does_it_anyway(good, tmp_path):
    folder = tmp_path / "rec"
    shutil.copytree(good("corners"), folder)
    next(case for case in CASES if case.name == "markers 1.5 % small").spoil(folder)
    status, text = run_in_process("measure", folder, "--out", tmp_path / "out")
    assert status == 1 and "scale of print" in text.splitlines()[0] and not (tmp_path / "out" / "poses.csv").exists()
    status, text = run_in_process("measure", folder, "--out", tmp_path / "out", "--anyway")
    assert status == 0 and "scale of print" in text.splitlines()[0] and (tmp_path / "out" / "poses.csv").exists()


@pytest.mark.slow
@pytest.mark.parametrize("command", ["measure", "diagnose"])
def test_a_wrong_dictionary_is_named_before_anything_is_measured(command, good, tmp_path):
    folder = tmp_path / "rec"
    shutil.copytree(good("images"), folder)
    next(case for case in CASES if case.name == "another dictionary for one cube").spoil(folder)
    status, text = run_in_process(command, folder, "--out", tmp_path / "out")
    assert (
        status == 1
        and "wrong dictionary: the markers of P2 are of DICT_5X5" in text.splitlines()[0]
        and not (tmp_path / "out").exists()
    )


@pytest.mark.slow
def test_exchanged_faces_are_said_first_and_the_diagnosis_goes_on(good, tmp_path):
    """It sets markers right by where they are seen, and names the swap."""
    folder = tmp_path / "rec"
    shutil.copytree(good("corners"), folder)
    next(case for case in CASES if case.name == "faces +x and -x exchanged").spoil(folder)
    status, text = run_in_process(
        "diagnose", folder, "--out", tmp_path / "out", "--only", "backlash", "--only", "marker_swap"
    )
    assert (
        status == 0
        and "are exchanged" in text.splitlines()[0]
        and re.search("^marker_swap at marker", text, re.MULTILINE)
    )


def test_one_struts_zero_is_no_unit_of_all(design):
    """Taken for inches from home, the other five alone would be so as well."""
    middle, span = design.mechanism.strut_range.mean(axis=1), np.ptp(design.mechanism.strut_range, axis=1)
    q = middle + 0.4 * span * np.random.default_rng(0).uniform(-1, 1, (40, 6)) - 0.6 * span * (np.arange(6) == 3)
    mistakes = [
        one.what for one in unit_and_convention_mistakes.command_unit_mistakes(Commands(np.arange(40.0), q), design)
    ]
    assert len(mistakes) == 1 and "lengths of strut 4 alone lie outside strut_range" in mistakes[0]
    assert (
        "in millimetres"
        in next(
            unit_and_convention_mistakes.command_unit_mistakes(Commands(np.arange(40.0), middle * 1e3 + 0 * q), design)
        ).what
    )


def test_an_unlikely_thing_is_a_remark(good, tmp_path):
    folder = tmp_path / "rec"
    shutil.copytree(good("corners"), folder)
    next(case for case in CASES if case.name == "camera poses exchanged").spoil(folder)
    status, text = run_in_process("measure", folder, "--out", tmp_path / "out")
    assert status == 0 and "cameras are exchanged" in text.splitlines()[0]


def test_measuring_says_first_how_well(good, tmp_path):
    text = run_in_process("measure", good("corners"), "--out", tmp_path / "out")[1]
    assert text.splitlines()[0].startswith("good: 60 of 60 frames solved")
    assert "hardly separable (" not in text and "hardly separable (" in (tmp_path / "out" / "report.html").read_text()


def test_what_spoils_is_said_before_what_is_likely():
    a, b, c = Mistake("a", "", False, 0.9), Mistake("b", "", True, 0.2), Mistake("c", "", True, 0.8)
    assert sort_mistakes([a, b, c, a]) == (c, b, a)


def test_a_recording_is_only_read(good, tmp_path):
    folder = good("corners")
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    run_in_process("check", folder)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    assert np.isfinite(recording_folder.load_recording(folder).corners.uv).all()


def test_corners_are_checked_by_one_thread_in_each_product(monkeypatch):
    from threadpoolctl import threadpool_info, threadpool_limits

    import calib
    from calib.api import recording_check_combination_and_view as api

    threads = []

    def search(*_, **__):
        threads.extend(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")
        return ()

    monkeypatch.setattr(api, "find_corner_mistakes", search)
    with threadpool_limits(2):
        calib.check(BENCH / "fit")
    assert threads and set(threads) == {1}


def test_an_edge_bias_is_not_tried_where_it_cannot_explain(monkeypatch):
    from vision.checks import corner_and_lens_convention_trials as trials

    monkeypatch.setattr(trials, "measure_trial", lambda *_: pytest.fail("a trial was measured"))
    first = trials.Trial(20.0, None, None, None)
    assert trials.least_misfit_with_edge_bias(first, 0.04) == 19.0
