"""rig watch through the command line: quiet days, changes that are named, a plan, and what is no visit."""

import json

import numpy as np
import pytest

from calib.certification.claim_verification import Part, Verification
from calib.drift.drift_visits_page import Visit, last_visit_verdict
from calib.drift.machine_change_hypotheses_verdict_and_sentences import ALARM, SOMETHING, Suspect, Verdict
from calib.files import calibration_file
from rig.cli.command_line import main
from rig.formats import csv_and_parquet_tables_and_time_origin
from rig.report.verdict_refutations_and_result_display import REFUTED as CHANGED
from rig.report.verdict_refutations_and_result_display import Evidence
from tests.calib.daily_visits import changed, rig


@pytest.fixture(scope="module")
def watched(tmp_path_factory, design, rig_text):
    """(folder with calibration.json and three quiet visits, the Rig)."""
    base = tmp_path_factory.mktemp("watched")
    one, rng = rig(design, rig_text, 3, base / "calibrated"), np.random.default_rng(4)
    calibration_file.save(base / "calibration.json", one.calibration)
    for day in range(3):
        one.visit(base / f"day{day}", rng)
    return base, one


@pytest.fixture
def week(watched, tmp_path, capsys):
    """A history of three quiet visits, by the command."""
    base, _ = watched
    assert (
        main(
            [
                "watch",
                str(base / "calibration.json"),
                *(str(base / f"day{day}") for day in range(3)),
                "--history",
                str(tmp_path / "watch.json"),
                "--page",
                str(tmp_path / "watch.html"),
            ]
        )
        == 0
    )
    output = capsys.readouterr().out
    state, _, first = output.splitlines()[0].partition(": ")
    assert state != "bad" and first.startswith("the calibration is valid at visit 3")
    assert f"<strong>{state}</strong> The calibration is valid at visit 3" in (tmp_path / "watch.html").read_text()
    assert (
        output.count("the calibration is valid") == 2
        and output.count("nothing has changed") == 2
        and f"{ALARM:g} visits" in output
    )
    return tmp_path / "watch.json"


@pytest.mark.parametrize(
    "which, says, to_do",
    [
        ("camera", "THE MEASURING SYSTEM HAS CHANGED", "clamp the mount"),
        ("backlash", "IS NO LONGER VALID", "nut and bearings"),
        ("payload", "IS NO LONGER VALID", "payload_mass_kg"),
    ],
)
@pytest.mark.slow
def test_what_changed_is_named_with_what_to_do(watched, week, tmp_path, which, says, to_do, capsys):
    base, one = watched
    rng = np.random.default_rng(5)
    change = changed(which, one, rng)
    one.visit(tmp_path / "after", rng, change)
    assert (
        main(
            [
                "watch",
                str(base / "calibration.json"),
                str(tmp_path / "after"),
                "--history",
                str(week),
                "--page",
                str(tmp_path / "after.html"),
            ]
        )
        == CHANGED
    )
    page = (tmp_path / "after.html").read_text()
    assert f"something changed, likeliest {change.name}" in page.replace("Something", "something")
    assert "<strong>bad</strong>" in page and to_do in page
    output = capsys.readouterr().out
    assert (
        says in output
        and "since after" in output
        and change.name in output
        and to_do in output
        and "4 visits in" in output
    )
    one.visit(tmp_path / "later", rng, change)
    assert (
        main(["watch", str(base / "calibration.json"), str(tmp_path / "later"), "--history", str(week), "--json"])
        == CHANGED
    )
    printed = json.loads(capsys.readouterr().out)["visits"][0]
    assert printed["named"] == change.name and printed["number"] == 5 and printed["suspects"][0]["since"] == 4
    assert 0.99 < sum(one["odds"] for one in printed["suspects"]) <= 1.0001


@pytest.mark.slow
def test_what_has_no_name_is_said_to_have_none(watched, week, tmp_path, capsys):
    """Three struts' zeros and two nuts at once: none of the hypotheses alone explains that."""
    base, one = watched
    rng = np.random.default_rng(6)
    world = one.world
    for which in ("zero", "backlash", "zero", "zero", "backlash"):
        world = changed(which, type(one)(world, one.text, one.calibration, one.route), rng).world
    one.visit(tmp_path / "after", rng, changed("payload", type(one)(world, one.text, one.calibration, one.route), rng))
    assert main(["watch", str(base / "calibration.json"), str(tmp_path / "after"), "--history", str(week)]) == CHANGED
    output = capsys.readouterr().out
    assert "something changed, not identified" in output and "rig diagnose" in output


@pytest.mark.parametrize(
    "of_allowed, state, says",
    [
        (0.5, "check", "the calibration omits an effect, present from the beginning or since"),
        (1.3, "bad", "position error 40 um RMS where up to 30 um is claimed"),
    ],
)
def test_a_first_visit_that_disagrees_is_judged_by_the_claim(of_allowed, state, says):
    none = np.zeros(0)
    alarm = Verdict(90.0, 40, 0.0, (Suspect(SOMETHING, SOMETHING, 0, 1.0, none, none),), 1e-9, 1e-9)
    verification = Verification(40, Part(40e-6, 30e-6, of_allowed, 1.1, 50e-6), None)
    assert alarm.alarm
    found = last_visit_verdict([Visit("day0", alarm, (), 1.0, verification)], Evidence(""))
    assert found.state == state and says in found.why
    later = last_visit_verdict([Visit("day1", Verdict(90.0, 40, 9.0, alarm.suspects, 1e-9), (), 1.0)], Evidence(""))
    assert later.state == "bad" and "something changed" in later.why


def test_a_visit_is_planned_within_the_strokes_and_tells_more_than_an_even_one(watched, tmp_path, design, capsys):
    base, _ = watched
    out = tmp_path / "commands.csv"
    assert main(["watch", str(base / "calibration.json"), "--plan", "--count", "6", "--out", str(out)]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines() if line.startswith("  ")]
    assert len(rows) == 4 and all(float(row[-3]) < float(row[-2]) for row in rows)
    commands = csv_and_parquet_tables_and_time_origin.read_csv_table(out, ("frame",)).matrix(design.mechanism.axes)
    low, high = design.mechanism.strut_range.T
    assert commands.shape == (6, 6) and (commands > low).all() and (commands < high).all()


@pytest.mark.slow
def test_what_is_no_visit_is_refused_and_the_history_stays(watched, week, tmp_path, capsys):
    base, _ = watched
    cal, day = str(base / "calibration.json"), str(base / "day0")
    before = week.read_bytes()
    (tmp_path / "empty").mkdir()
    half = tmp_path / "half.json"
    half.write_text(week.read_text()[:4000])
    other = tmp_path / "other.json"
    other.write_text((base / "calibration.json").read_text().replace('"left_out": []', '"left_out": [999999]'))
    for words, says in (
        ([cal, day, "--history", str(week)], "are already in the history"),
        ([cal, str(base / "day9")], "no such folder"),
        ([cal, str(tmp_path / "empty")], "empty folder"),
        ([cal, day, "--history", str(half)], "cut off"),
        ([str(other), day, "--history", str(week)], "history of another calibration"),
        ([cal], "name the visits"),
        ([cal, day, "--out", str(tmp_path / "x")], "--out and --rig are for --plan"),
        ([cal, "--plan"], "--plan takes --out"),
        ([cal, day, day], "are already in the history"),
        ([str(week), day], "is no calibration"),
        ([cal, "--plan", "--count", "2", "--out", str(tmp_path / "x")], "--count takes 4"),
    ):
        assert main(["watch", *words]) == 1, words
        assert says in capsys.readouterr().err
    assert week.read_bytes() == before and not (tmp_path / "x").exists()
