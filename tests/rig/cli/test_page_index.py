"""Pages that commands write find each other: an index with every verdict, kept up to date; and a recording in three
dimensions.
"""

import json
import os
import re

import numpy as np
import pytest

from calib.report.pose_and_effect_figures import (
    FACTORS,
    effect_with_size_scaled,
    pose_displacements_by_effect_at_several_sizes,
)
from rig.cli.command_line import main
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.formats.output_files import MANIFEST, CommandOutputs
from rig.planning import recording_plan as plan
from rig.report.pages.page_templates_and_index_page import (
    Page,
    list_pages_below_folder,
    read_page_summary,
    write_index_page,
    write_page,
)
from rig.report.pages.project_stages_and_files_without_pages import list_project_files, local_date_and_time_text
from rig.report.verdict_refutations_and_result_display import State, Verdict
from tests.conftest import ROOT

BENCH = ROOT / "tests" / "data" / "bench"


def page(path, state=State.GOOD, why="fine", kind="measure"):
    path.parent.mkdir(parents=True, exist_ok=True)
    write_page(path, Page(kind, path.stem, Verdict(state, why), []))


def test_an_index_lists_pages_with_their_verdicts_and_is_kept_up_to_date(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    page(tmp_path / "measured" / "report.html", State.CHECK, 'a "b" & <c>')
    (tmp_path / "mine.html").write_text("<title>mine</title>")
    (tmp_path / "half.html").write_bytes(b"\xff\xfe")
    assert main(["index"]) == 0 and 'a "b" & <c>' in capsys.readouterr().out
    index = (tmp_path / "index.html").read_text()
    assert 'href="measured/report.html"' in index and "a &quot;b&quot; &amp; &lt;c&gt;" in index and "mine" not in index
    assert read_page_summary(tmp_path / "index.html").state == State.CHECK and [
        found.why for found in list_pages_below_folder(tmp_path)
    ] == ['a "b" & <c>']
    assert main(["view", str(BENCH / "check"), "--page", "view.html"]) == 0
    assert (
        'href="index.html">All pages' in (tmp_path / "view.html").read_text()
        and 'href="view.html"' in (tmp_path / "index.html").read_text()
    )
    (tmp_path / "index.html").write_text((tmp_path / "index.html").read_text() + "<!-- a word of mine -->")
    assert main(["view", str(BENCH / "check"), "--page", "again.html"]) == 0
    assert "a word of mine" in (tmp_path / "index.html").read_text(), "what its owner changed stays"


def test_an_index_states_the_latest_calibration_and_what_was_found_since(tmp_path):
    def written(t, *details):
        page(*details)
        os.utime(details[0], (t, t))

    day = 86400.0
    written(1 * day, tmp_path / "old.html", State.BAD, "worse than nominal", "calibrate")
    written(2 * day, tmp_path / "verified.html", State.BAD, "beyond the claim; twice", "verify")
    written(3 * day, tmp_path / "calibration.html", State.GOOD, "0.01 mm RMS", "calibrate")
    written(4 * day, tmp_path / "found" / "diagnosis.html", State.CHECK, "backlash at strut 3", "diagnose")
    (tmp_path / "rig.toml").write_text("")
    for name, command in (("rec", "simulate"), ("measured", "measure")):
        with CommandOutputs(command) as outputs:
            (outputs.folder(tmp_path / name) / "frames.csv").write_text("frame,t,camera,image\n")
    with CommandOutputs("correct") as outputs:
        outputs.file(tmp_path / "commands.csv").write_text("l1\n")
    write_index_page(tmp_path / "index.html", tmp_path)
    found, index = read_page_summary(tmp_path / "index.html"), (tmp_path / "index.html").read_text()
    dates = [local_date_and_time_text(k * day) for k in range(5)]
    assert found.state == State.CHECK, "what a later calibration replaced does not count"
    assert found.why.split("; ") == [
        f"calibrated {dates[3]}: good",
        "not verified since",
        "not certified since",
        f"diagnosed {dates[4]}: check",
    ]
    story = index[index.index("<h2>Design") :]
    order = [
        "rig.toml",
        "<h2>Recording",
        "made by <code>rig simulate",
        "<h2>Calibration",
        "old.html",
        "calibration.html",
    ]
    order += ["<h2>Correction", "commands.csv", "<h2>Verification", "verified.html", "<h2>Diagnosis"]
    places = [story.index(text) for text in order]
    assert places == sorted(places) and 'href="measured"' not in index and "<h2>Certificate" not in index
    written(5 * day, tmp_path / "verified.html", State.BAD, "beyond the claim", "verify")
    write_index_page(tmp_path / "index.html", tmp_path)
    found = read_page_summary(tmp_path / "index.html")
    assert found.state == State.BAD and f"verified {local_date_and_time_text(5 * day)}: bad" in found.why


def test_a_folder_with_an_unreadable_manifest_is_left_out_of_the_index(tmp_path):
    for name in ("sound", "broken"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "rig.toml").write_text("")
    (tmp_path / "broken" / MANIFEST).write_text("{")
    assert [file.path.parent.name for file in list_project_files(tmp_path, 3)] == ["sound"]


def test_an_index_is_refused_where_it_cannot_be(tmp_path, capsys):
    assert main(["index", str(tmp_path / "typo")]) == 1 and "no such folder" in capsys.readouterr().err
    (tmp_path / "index.html").write_text("mine")
    assert main(["index", str(tmp_path)]) == 1 and (tmp_path / "index.html").read_text() == "mine"
    assert "was not made by `rig index`" in capsys.readouterr().err


def staged(path):
    """What the page's view in three dimensions shows."""
    return json.loads(re.search('id="stage-data">(.*?)</script>', path.read_text())[1])


def test_a_recording_is_shown_in_three_dimensions_with_what_an_effect_does(tmp_path, capsys):
    out = tmp_path / "view.html"
    assert (
        main(
            [
                "view",
                str(BENCH / "check"),
                "--page",
                str(out),
                "--effect",
                "backlash:strut3:gap=8e-5",
                "--effect",
                "focal_drift:cameras:per_kelvin=4e-4",
            ]
        )
        == 0
    )
    shown = staged(out)
    assert len(shown["frames"]) == len(shown["poses"]) == 6 and len(shown["base"]) == 6
    (effect,) = shown["effects"]
    assert effect["name"] == "backlash at strut 3" and effect["sizes"][0] == "none" and "gap 80 µm" in effect["sizes"]
    sizes = [float(np.abs(one).max()) for one in effect["shifts"]]
    assert sizes[0] == 0 < sizes[1] < sizes[2] < sizes[3] and "does not move the platform" in out.read_text()
    for words, says in ((["--effect", "backlsh:strut3"], "backlsh"), (["--out", "x.png"], "--out is for --frame")):
        assert (
            main(["view", str(BENCH / "check"), "--page", str(tmp_path / "no.html"), *words]) == 1
            and says in capsys.readouterr().err
        )
    assert main(["view", str(BENCH / "check"), "--frame", "1", "--effect", "backlash:strut3:gap=1e-5"]) == 1
    assert (
        main(["view", str(tmp_path / "typo"), "--page", str(tmp_path / "no.html")]) == 1
        and not (tmp_path / "no.html").exists()
    )


def test_an_effect_played_is_its_own_model_at_its_sizes(design):
    done = plan.build_plan(design, "sobol:6", 1)
    effect = parse_effect("scale_error:strut2:scale=1e-3")
    shown = pose_displacements_by_effect_at_several_sizes(design, done.commands, done.t, (effect,), 0)
    assert np.allclose(shown.shifts[3], 2 * shown.shifts[2], rtol=0.01, atol=1e-9) and len(shown.sizes) == len(FACTORS)
    assert effect_with_size_scaled(parse_effect("compliance:rig:stiffness=3e6"), 2.0).stiffness == pytest.approx(
        1.5e6
    ), "half as stiff is twice as much"
