"""The page of a diagnosis: whole without a network, it says what the diagnosis says, and it draws what gives an effect
away.
"""

import re
from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import LackOfFit
from calib.diagnosis.problems.covariate_functions_smoothed_temperatures_and_repeats import repeatability_of_pairs
from calib.diagnosis.problems.platform import platform_recording_evidence as platform
from calib.diagnosis.report.diagnosis_json_entries import AlternativeEntry, NotTestedEntry
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report, repeatability_entry
from calib.diagnosis.report.residual_figures_and_finding_contributions import (
    closure_and_corner_residuals,
    effect_residual_figures,
    residuals_without_effects,
)
from calib.diagnosis.report.rig_and_arm_outline_figures import MARKS, rig_outline_figure
from rig.effects.catalogue.effect_list import ALL, BY_NAME
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.planning import recording_plan as plan
from rig.recording import recording_folder
from rig.recording.corner_and_pose_csv_tables import write_poses
from synthetic import random_true_machine_and_truth_file, recording_simulation
from tests.calib.diagnose_recording import diagnosis_of, page_text

HIDDEN = "backlash:strut3:gap=8e-5"


@pytest.fixture(scope="module")
def diagnosed(design, rig_text, tmp_path_factory):
    """(Recording, Diagnosis) of a rig with a backlash, asked for two effects alone."""
    return make(design, rig_text, tmp_path_factory.mktemp("rec"), HIDDEN, ["backlash", "scale_error"])


def make(design, rig_text, folder, text, only):
    rng = np.random.default_rng(4)
    done = recording_simulation.simulate_world(
        random_true_machine_and_truth_file.random_true_machine(design, rng, 1.0, (parse_effect(text),)),
        plan.build_plan(design, "sobol:14,ladder:1,payload:2,moving:6", 1),
        rng,
    )
    recording_simulation.write_recording(done, folder, rig_text, rng, noise=0.03)
    found = recording_folder.load_recording(folder)
    return found, diagnosis_of(found, only)


def made(folder, found, diagnosis):
    """(page, its text) of a recording's diagnosis."""
    page_text(folder / "page.html", found, diagnosis)
    return text_of(folder / "page.html")


@pytest.mark.slow
def test_a_diagnosis_and_its_parts_print_as_a_line_each(diagnosed, tmp_path):
    found, diagnosis = diagnosed
    assert repr(diagnosis).startswith(f"<Diagnosis: {found.name}, ") and "backlash at strut 3" in repr(diagnosis)
    fit = diagnosis.selection.fit
    parts = (diagnosis.evidence, diagnosis.evidence.point, diagnosis.selection, diagnosis.selection.problem, fit)
    for one in (diagnosis, *parts, fit.refined, fit.refined.model, fit.refined.model.linear, *diagnosis.findings):
        assert len(repr(one)) < 800 and "\n" not in repr(one)
    report = diagnosis_report(diagnosis)
    assert {one.effect for one in report.detectable} == {"backlash", "scale_error"}
    assert "What this recording would have shown" in made(tmp_path, found, diagnosis)[1]


def text_of(path):
    page = path.read_text(encoding="utf-8")
    return page, re.sub(
        r"<[^>]*>", " ", re.sub(r'src="[^"]*"|<style>.*?</style>|<script>.*?</script>', "", page, flags=re.DOTALL)
    )


@pytest.mark.slow
def test_the_page_says_what_was_found(diagnosed, tmp_path):
    found, diagnosis = diagnosed
    page, text = made(tmp_path, found, diagnosis)
    gap = diagnosis_report(diagnosis).findings[0].parameters["gap"]
    assert (
        f"Backlash at strut 3, gap {gap.value * 1e6:.3g} µm (95 %: {gap.ci95[0] * 1e6:.3g} to {gap.ci95[1] * 1e6:.3g})"
        in text
    )
    assert (
        BY_NAME["backlash"].action_at("strut 3") in text
        and "How sure" in text
        and "What remains" in text
        and "noise of a corner" in text
    )
    assert (
        page.count('<svg class="figure"') == 8
    )  # the rig, three of what gives it away, what remains of struts and of cameras, two of its sketch
    assert not re.search(r'(src|href)="(?!data:)', page) and "@import" not in page and "default-src 'none'" in page
    assert page.index("<strong>check</strong>") < page.index("<h1>") < page.index("What to do next")


@pytest.mark.slow
def test_without_a_finding_nothing_is_claimed(diagnosed, tmp_path):
    found, diagnosis = diagnosed
    still = diagnosis_of(found, ["missed_steps strut 1"])
    assert "Nothing is unmodelled" in made(tmp_path, found, replace(still, left=[]))[1]
    left = [
        LackOfFit(Place("strut", "3"), 4e-5, "m", ("history",), 1e-9, 80.0),
        LackOfFit(Place("camera", "cam1"), 0.2, "px", ("image position",), 1e-9, 70.0),
    ]
    text = made(tmp_path, found, replace(still, left=left))[1]
    assert "There is something at strut 3 that no catalogued effect explains, 40 µm, correlated with history." in text
    assert "image position" in text and "below 1 in a million" in text
    assert "Backlash" not in text and "backlash" not in text


def test_alternatives_and_what_was_not_asked_are_listed(diagnosed, tmp_path):
    found, diagnosis = diagnosed
    report = diagnosis_report(diagnosis)
    finding = replace(
        report.findings[0], cannot_be_told_from=(AlternativeEntry("hysteresis", "strut 3", 1.25, 0.999, "a <ladder>"),)
    )
    report = replace(report, findings=(finding,), not_asked=(NotTestedEntry("thermal_expansion", "no channel"),))
    page_text(tmp_path / "page.html", found, diagnosis, report)
    page, text = text_of(tmp_path / "page.html")
    assert "a &lt;ladder&gt;" in page and "1.2" in text and "thermal expansion" in text and "no channel" in text
    assert "This recording alone cannot distinguish the backlash" in text


def test_how_well_poses_repeat_is_in_metres_where_the_misfit_is_in_pixels(diagnosed, tmp_path):
    found, diagnosis = diagnosed
    poses = np.zeros((20, 6)), np.tile([3e-6 * np.sqrt(2), 0, 0, 0, 0, 0], (20, 1))
    repeats = repeatability_of_pairs(np.zeros((20, 2), int), poses, (np.ones((20, 6)), np.ones((20, 6))))
    seen = replace(diagnosis, shown_in="corners", repeats=repeats)
    assert diagnosis.misfits["corners"].unit == "px"
    assert "3.0 µm (20 pairs)" in made(tmp_path, found, seen)[1]
    assert repeatability_entry(seen)["mean_m"] == pytest.approx(3e-6)


def test_taking_an_effect_away_brings_its_residual_back(diagnosed):
    _, diagnosis = diagnosed
    refined = diagnosis.selection.fit.refined
    (after, corners), (before, _) = residuals_without_effects(refined), residuals_without_effects(refined, (0,))
    bare, _ = closure_and_corner_residuals(diagnosis.selection.before.refined.model)
    rms = np.sqrt((np.stack([before, bare, after]) ** 2).mean(axis=1))[:, 2]
    assert rms[0] == pytest.approx(rms[1], rel=0.1) and rms[2] < 0.6 * rms[0]  # m, of strut 3
    assert np.sqrt((corners**2).mean()) == pytest.approx(0.03, rel=0.1)  # px


@pytest.mark.parametrize(
    "text",
    [
        "compliance:rig:stiffness=3e6",
        "screw_coupling:rig:gain=0.9",
        "vibration:rig:amplitude=5e-5,frequency=3.3",
        "time_offset:clock:offset=0.03",
        "creep:rig:fraction=0.01,time_constant=5",
        "warm_up:strut2:amplitude=1e-4",
        "cyclic_error:strut4:amplitude=3e-5",
        "thermal_expansion:rig:coefficient=2e-5",
        "base_expansion:rig:coefficient=1e-4",
        "clock_drift:clock:rate=1e-4",
        "camera_bump:cam1:motion=1e-3/0/0/0/0/0,time=100",
        "focal_drift:cameras:per_kelvin=4e-4",
        "edge_bias:cameras:bias=0.2",
        "print_scale:markers:scale=3e-3",
        "rolling_shutter:cam0:row_time=3e-5",
        "refraction:cam1:thickness=2e-2",
        "face_misplacement:4:offset=5e-4/0/0",
        "cube_misplacement:P2:motion=5e-4/0/0/0/0/0",
    ],
)
def test_every_diagnostic_plot_can_be_drawn(text, diagnosed):
    _, diagnosis = diagnosed
    refined = diagnosis.selection.fit.refined
    effect = parse_effect(text)
    drawn = effect_residual_figures(replace(refined, point=refined.point.with_effects((effect,))), 0).split("<svg ")[1:]
    assert drawn and all("aria-label=" in one and re.search(r'd="M[0-9]|<rect class="fill', one) for one in drawn)
    if len(drawn) == 3:  # what it explains lies along the axis, and is more than nothing
        low, high = (float(v) for v in re.search('data-x="([^ ]+) ([^ ]+)', drawn[2]).groups())
        assert low < high and len(set(re.findall(r"M([\d.]+) [\d.]+h", drawn[2]))) > 1


def test_what_is_only_significant_comes_after_what_matters(diagnosed, tmp_path):
    found, diagnosis = diagnosed
    report = diagnosis_report(diagnosis)
    strong = report.findings[0]
    slight = replace(
        strong,
        effect="hysteresis",
        place="strut 5",
        evidence=replace(strong.evidence, heldout_before=1.001e-5, heldout_after=1e-5),
    )
    report = replace(report, findings=(slight, strong))
    assert [f.matters for f in report.findings] == [False, True] and report.mattering == [strong]
    page_text(tmp_path / "page.html", found, diagnosis, report)
    text = text_of(tmp_path / "page.html")[1]
    assert text.index("1. backlash at strut 3") < text.index("but negligible") < text.index("hysteresis at strut 5,")
    assert "1 more is significant" in text


def test_marks_are_on_the_parts_that_are_pointed_at(diagnosed):
    point = diagnosed[1].selection.fit.refined.point
    places = ["strut 3", "camera cam1", "marker 4", "target P2", "clock"]
    drawn = rig_outline_figure(point, places)
    assert {int(c) for c in re.findall(r'class="outline marked c(\d)"', drawn)} == set(MARKS[:4])
    assert re.findall(rf'class="said over c{MARKS[0]}"[^>]*>([^<]*)<', drawn) == ["3"] and ">clock</text>" in drawn
    assert "marked" not in rig_outline_figure(point, []).replace("marked: nothing", "")


def test_every_effect_says_what_to_do():
    assert all(kind.action_at(place).endswith(".") for kind in ALL for place in ("strut 1", "joint 1"))


def test_poses_alone_make_a_page(diagnosed, tmp_path, monkeypatch):
    found, diagnosis = diagnosed
    monkeypatch.setattr(
        platform, "remove_corners_far_from_prediction", lambda point: point
    )  # there are no corners that could be out of reach
    k = diagnosis.selection.fit.refined.point
    for name in ("rig.toml", "commands.csv", "frames.csv", "sensors.csv"):
        (tmp_path / name).write_bytes((found.folder / name).read_bytes())
    covariance = np.tile(np.diag([5e-6**2] * 3 + [3e-5**2] * 3), (len(k.frames), 1, 1))
    write_poses(tmp_path / "poses.csv", recording_folder.Poses(k.frames, k.T, covariance))
    alone = recording_folder.load_recording(tmp_path)
    text = made(tmp_path, alone, diagnosis_of(alone, ["backlash"]))[1]
    assert "Backlash at strut 3" in text and re.search(r"corners\s+none", text)
