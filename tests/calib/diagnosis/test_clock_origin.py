"""No verdict and no page depends on where the owner's clock counts from; moments are reported by that clock."""

import json
import re

import numpy as np
import pytest

from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report
from rig.effects.catalogue.effect_list import ALL
from rig.recording import recording_folder
from synthetic import random_blind_platform_cases_with_truth
from tests.calib.diagnose_recording import diagnosis_of, page_text
from tests.calib.recordings_with_effects import recorded
from tests.shifted_clock import ORIGINS, counted_from

CLOCKED = ["clock_drift", "time_offset", "vibration", "missed_steps"]  # what a wrong origin is taken for


def verdicts(folder, tmp_path, only, origins=ORIGINS):
    """{origin: tree of diagnosis.json}."""
    return {
        origin: diagnosis_report(
            diagnosis_of(recording_folder.load_recording(counted_from(folder, tmp_path / origin, origin)), only)
        ).tree()
        for origin in origins
    }


def assert_same(trees):
    """The same findings with the same figures to 1e-6 of their intervals, moments later by the origin."""
    trees = json.loads(json.dumps(trees))
    first = trees.pop("0")
    for origin, tree in trees.items():
        assert tree["start_s"] == first["start_s"] + float(origin)
        assert [(f["effect"], f["place"]) for f in tree["findings"]] == [
            (f["effect"], f["place"]) for f in first["findings"]
        ]
        for a, b in zip(first["findings"], tree["findings"]):
            for name, p in a["parameters"].items():
                moment = name in ("time", "since")
                ends = np.asarray(p.get("ci95", [0.0, 0.0]), float)
                slack = (
                    1e-6 * np.abs(ends[1] - ends[0]).max() + 1e-12 + (1e-6 if moment else 0.0)
                )  # a float at 1.7e9 is good to 2.4e-7 s
                if p["unit"] or name != "depends_on":
                    np.testing.assert_allclose(
                        b["parameters"][name]["value"],
                        np.asarray(p["value"]) + (float(origin) if moment else 0.0),
                        rtol=0,
                        atol=slack,
                    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "kind"),
    [("clock_drift:clock:rate=4e-4", "clock_drift"), ("missed_steps:strut2:jump=1.2e-4,time=150", "missed_steps")],
)
def test_a_verdict_does_not_depend_on_the_origin(tmp_path, design, text, kind):
    recorded(tmp_path / "rec", design, [text], route="moving:8,sobol:36,moving:8")
    trees = verdicts(tmp_path / "rec", tmp_path, [kind], (ORIGINS[0], ORIGINS[-1]))
    assert [f["effect"] for f in trees["0"]["findings"]] == [kind]
    assert_same(trees)


@pytest.mark.slow
def test_no_page_depends_on_the_origin(tmp_path, design):
    texts = [
        "missed_steps:strut2:jump=1.2e-4,time=150",
        "missed_steps:strut2:jump=1.2e-4,time=60",
        "camera_bump:cam1:motion=1e-3/0/0/0/0/0,time=100",
    ]
    recorded(tmp_path / "rec", design, texts, route="moving:8,sobol:36,moving:8")
    pages = []
    for origin in (ORIGINS[0], ORIGINS[-1]):
        found = recording_folder.load_recording(counted_from(tmp_path / "rec", tmp_path / origin, origin))
        diagnosed = diagnosis_of(found, ["missed_steps strut 2", "camera_bump camera cam1"])
        page_text(tmp_path / "page.html", found, diagnosed)
        pages.append(cells((tmp_path / "page.html").read_text(encoding="utf-8")))
    here, later = pages
    moments = [i for i, (a, b) in enumerate(zip(here, later)) if a != b]
    assert len(here) == len(later) and len(moments) == 2 + 2 * len(
        texts
    )  # the recording's name, twice; each moment and where it may lie
    for i in moments[2:]:
        by = np.array([[float(x) for x in re.findall(r"[\d.]+", page[i])] for page in pages])
        np.testing.assert_allclose(by[1] - by[0], float(ORIGINS[-1]), rtol=0, atol=1.0)


def cells(page):
    """The texts of a page, one for each element, without what it carries to run."""
    page = re.sub(r"<style>.*?</style>|<script.*?</script>", "", page, flags=re.DOTALL)
    return [text for text in re.split(r"<[^>]*>", page) if text.strip()]


@pytest.mark.slow
@pytest.mark.parametrize("kind", [effect.name for effect in ALL])
def test_no_verdict_of_the_catalogue_depends_on_the_origin(tmp_path, kind):
    case = random_blind_platform_cases_with_truth.draw_case(11, 1, 160, [], ["one"], [kind])
    random_blind_platform_cases_with_truth.write_recording(case, tmp_path / "rec")
    assert_same(verdicts(tmp_path / "rec", tmp_path, sorted({kind, *CLOCKED})))
