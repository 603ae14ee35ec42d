"""Poses that scatter more than is stated: of hexapods by one common factor, of arms as unexplained.

Arms whose poses scatter more than is stated of them, by machines of an independent truth: every command says check,
and its page why.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.report.diagnosis_report_verdict_and_folder import (
    diagnosis_report,
    diagnosis_verdict,
    summary_sentence,
)
from rig.cli import command_line
from rig.recording.recording_folder import load_recording
from rig.report.verdict_and_refutations_by_later_recordings import State
from tests.calib.diagnose_recording import diagnosis_of
from tests.truth import Case, draw, record, rows_of
from tests.truth.draw_machines import secret
from tests.truth.journey import journey, visits
from tests.truth.kinematics import Arm
from tests.truth.laws import stood
from tests.truth.rigid import displaced

STARS = 130
HELD = 1.0  # s about an exposure, in which its command stays


def telescope(seed: int) -> Case:
    """A mount of two axes, azimuth and elevation, that points all over the sky."""
    rng, case = np.random.default_rng([seed, 40]), draw(seed, "none", "none", "shuffled", "arm", 80)
    owner = Arm(
        np.array([[0, 0.3, 0, np.pi / 2], [0, 0, 1.0, 0]]),
        np.zeros(2, bool),
        np.zeros(2),
        np.array([[-2.5, 2.5], [0.2, 1.3]]),
        np.zeros(2),
    )
    machine, speeds = secret(owner, 3e-4, rng), np.full(2, 0.5)
    way = journey(visits("shuffled", owner.ranges, STARS, rng), owner.ranges.mean(axis=1), speeds, case.dwell)
    noise = rng.normal(size=(STARS, 6)) * np.repeat(case.sigma, 3)
    seen = rows_of(displaced(stood(machine, way, case.day, ()), noise))
    return replace(case, owner=owner, machine=machine, way=way, speeds=speeds, seen=seen)


CASES = {
    "telescope": lambda: telescope(3),
    "arm": lambda: draw(4, "none", "none", "shuffled", "arm", 100),
    "arm with play": lambda: draw(5, "backlash", "strong", "shuffled", "arm", 100),
}


@pytest.mark.parametrize(
    ("name", "times"),
    [
        ("telescope", 30),
        ("arm with play", 3),
        *(
            pytest.param(name, times, marks=pytest.mark.slow)
            for name, times in [
                ("telescope", 1),
                ("telescope", 3),
                ("arm", 1),
                ("arm", 3),
                ("arm", 30),
                ("arm with play", 30),
            ]
        ),
    ],
)
def test_scatter_beyond_the_stated_noise_is_no_all_clear(tmp_path, capsys, name, times):
    case = CASES[name]()
    rec = record(replace(case, sigma=(case.sigma[0] / times, case.sigma[1] / times)), tmp_path / "rec")
    assert command_line.main(["diagnose", str(rec), "--out", str(tmp_path / "found"), "--quiet"]) == 0
    capsys.readouterr()
    assert command_line.main(["calibrate", str(rec), "--out", str(tmp_path / "made.json"), "--json", "--quiet"]) == 0
    found, made = (
        json.loads((tmp_path / "found/diagnosis.json").read_text()),
        json.loads((tmp_path / "made.json").read_text()),
    )
    states = [found["verdict"]["state"], json.loads(capsys.readouterr().out)["verdict"]["state"]]
    pages = [(tmp_path / page).read_text(encoding="utf-8") for page in ("found/diagnosis.html", "made.html")]
    if times == 1:
        assert states == ["good", "good"] and found["unexplained"] is None
        assert not made["claim"].get("unexplained")
        return
    assert states == ["check", "check"]
    assert found["unexplained"]["place"] == "rig" and found["unexplained"]["magnitude"] > 2 * case.sigma[0] / times
    assert "no catalogued effect explains" in pages[0]
    assert made["claim"]["unexplained"] and "this calibration does not explain" in pages[1]


def hexapod(folder, times, jitter=0.0):
    """Report on a quiet hexapod that states its noise so many times too small; jitter : m, by which its fifth strut
    stands elsewhere than commanded, anew in every pose."""
    case = draw(11, "none", "none", "shuffled", "hexapod", 60)
    rec = load_recording(record(replace(case, sigma=(case.sigma[0] / times, case.sigma[1] / times)), folder))
    if jitter:
        rng, values = np.random.default_rng(2), rec.commands.values.copy()
        for t in rec.exposures.times()[1]:
            values[np.abs(rec.commands.t - t) < HELD, 4] += jitter * rng.normal()
        rec = replace(rec, commands=replace(rec.commands, values=values))
    return diagnosis_report(diagnosis_of(rec, ["scale_error", "vibration"]))


def test_noise_that_all_poses_exceed_alike_is_one_remark(tmp_path):
    report = hexapod(tmp_path / "rec", 2)
    assert not report.findings and report.unexplained is None
    assert sorted(report.noise_times) == ["position", "rotation"]
    for factor in report.noise_times.values():
        half = (factor.ci95[1] - factor.ci95[0]) / 2
        assert half < 0.4 and abs(factor.value - 2) < 1.6 * half  # three standard errors
    assert "times in position" in summary_sentence(report) and diagnosis_verdict(report).state is State.CHECK


def test_noise_as_stated_is_no_remark(tmp_path):
    report = hexapod(tmp_path / "rec", 1)
    assert not report.noise_times and not report.findings and diagnosis_verdict(report).state is State.GOOD


@pytest.mark.parametrize("times", [1, 2])
def test_a_strut_that_scatters_for_itself_is_found_whatever_noise_is_stated(tmp_path, times):
    report = hexapod(tmp_path / "rec", times, 1e-4)
    places = {f.place for f in report.findings}
    assert "strut 5" in places and places <= {"strut 5", "rig"} and bool(report.noise_times) == (times > 1)
