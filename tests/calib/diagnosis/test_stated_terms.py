"""What an operator says beforehand: assumed terms stay and are told, those seen before have to stand, masked frames are
never looked at.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import NotTested, StatedTerms
from calib.diagnosis.problems.evidence_interface_and_requested_effects import (
    RequestedEffects,
    require_assumed_effects_testable,
)
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report
from calib.diagnosis.report.diagnosis_sentences_and_table_rows import evidence_sentence
from rig.cli import command_line
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect_and_place
from rig.errors import NotEnoughData, RigError
from rig.recording.frame_selection_and_content_hashes import remove_frames
from tests.calib.diagnose_recording import diagnosis_of
from tests.calib.recordings_with_effects import recorded

STRUT_2, STRUT_4 = ("backlash", "strut 2"), ("backlash", "strut 4")


@pytest.fixture(scope="module")
def quiet(tmp_path_factory, design):
    return recorded(tmp_path_factory.mktemp("quiet"), design, [], route="sobol:30,ladder:1")


@pytest.fixture(scope="module")
def loose(tmp_path_factory, design):
    return recorded(tmp_path_factory.mktemp("loose"), design, ["backlash:strut2:gap=100e-6"], route="sobol:30,ladder:1")


def places(found):
    return [(f.effect, f.place, f.said) for f in found.findings]


@pytest.mark.slow
def test_what_is_assumed_stays_and_is_said_to_be_so(quiet):
    assert places(diagnosis_report(diagnosis_of(quiet, ["backlash"]))) == []
    report = diagnosis_report(diagnosis_of(quiet, ["creep"], given=StatedTerms((STRUT_2,))))
    assert places(report) == [(*STRUT_2, "assumed")]
    gap = report.findings[0].parameters["gap"]
    assert gap.value < 15e-6 and gap.ci95[0] <= gap.value <= gap.ci95[1]
    assert (
        "would not have shown it independently" in evidence_sentence(report.findings[0]) and report.findings[0].matters
    )


@pytest.mark.slow
def test_what_was_seen_before_has_to_stand(loose):
    report = diagnosis_report(diagnosis_of(loose, ["backlash"], given=StatedTerms((), (STRUT_4, STRUT_2))))
    assert places(report) == [(*STRUT_2, "seen before")]
    assert report.findings[0].parameters["gap"].value == pytest.approx(100e-6, rel=0.05)
    report = diagnosis_report(diagnosis_of(loose, ["backlash"], given=StatedTerms((STRUT_2,))))
    assert places(report) == [(*STRUT_2, "assumed")] and "shows it independently as well" in evidence_sentence(
        report.findings[0]
    )


def test_what_cannot_be_assumed_is_refused(design):
    assert parse_effect_and_place("backlash strut2", design) == STRUT_2 and parse_effect_and_place(
        "vibration", design
    ) == ("vibration", "rig")
    for text, message in (
        ("backlash strut 9", "no strut '9'"),
        ("backlash", "cannot sit at ''"),
        ("backlsh strut 2", "is 'backlash' meant"),
        ("marker_swap marker 8", "searched for first"),
    ):
        with pytest.raises(RigError, match=message):
            parse_effect_and_place(text, design)
    with pytest.raises(RigError, match="backlash strut 2 cannot be both assumed and excluded"):
        RequestedEffects.of(None, ["backlash"], StatedTerms((STRUT_2,)))
    with pytest.raises(
        RigError,
        match="backlash at strut 2 is assumed, but this recording cannot be tested for it: nothing was commanded",
    ):
        require_assumed_effects_testable(StatedTerms((STRUT_2,)), [], [NotTested("backlash", "nothing was commanded")])


def test_masked_frames_are_gone_from_everything(quiet):
    frames, _ = quiet.exposures.times()
    c = quiet.corners
    spoilt = replace(quiet, corners=replace(c, uv=np.where(np.isin(c.frame, [3, 7, 8, 9])[:, None], np.nan, c.uv)))
    retained = remove_frames(spoilt, "3, 7-9")
    assert retained.exposures.times()[0].tolist() == [f for f in frames if f not in (3, 7, 8, 9)]
    assert (
        np.isfinite(retained.corners.uv).all()
        and len(retained.corners.camera) == len(retained.corners.uv)
        and retained.commands is quiet.commands
    )
    for text, message in (
        ("a", "takes frames"),
        ("9-7", "from small to large"),
        ("3,99999999999999999", "has no frame 9999"),
        ("3,", "takes frames"),
    ):
        with pytest.raises(RigError, match=message):
            remove_frames(quiet, text)
    with pytest.raises(NotEnoughData, match="leaves none"):
        remove_frames(quiet, f"0-{frames[-1]}")


@pytest.mark.slow
def test_the_same_words_on_the_page(loose, tmp_path, capfd):
    call = ["diagnose", str(loose.folder), "--out", str(tmp_path / "first"), "--only", "backlash", "--mask", "3,7-9"]
    assert command_line.main(call) == 0
    second_command = [
        "diagnose",
        str(loose.folder),
        "--out",
        str(tmp_path / "again"),
        "--only",
        "backlash",
        "--from",
        str(tmp_path / "first"),
        "--assume",
        "creep rig",
    ]
    assert command_line.main(second_command) == 0
    assert "[seen before]" in capfd.readouterr().out
    tree = json.loads((tmp_path / "again" / "diagnosis.json").read_text())
    assert {f["effect"]: f["said"] for f in tree["findings"]} == {"backlash": "seen before", "creep": "assumed"}
    page = (tmp_path / "again" / "diagnosis.html").read_text()
    assert "--assume creep rig" in page and "(seen before)" in page and f"--from {tmp_path / 'first'}" in page
    assert "--mask 3,7-9" in (tmp_path / "first" / "diagnosis.html").read_text()
    (tmp_path / "first" / "diagnosis.json").write_text('{"schema": "calibration/1"}')
    assert command_line.main([*second_command, "--force"]) == 1 and "is no diagnosis" in capfd.readouterr().err
