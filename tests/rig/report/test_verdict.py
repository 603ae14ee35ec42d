"""The one judgement: good needs everything, bad is what was refuted; and what refutes a file is found again by its
content.
"""

import json

import pytest

from rig.cli.command_line import main
from rig.errors import FileError
from rig.formats.output_files import CommandOutputs
from rig.report.pages.page_templates_and_index_page import Page, read_page_summary, write_page
from rig.report.verdict_refutations_and_result_display import (
    BALANCE,
    NAME,
    Evidence,
    MissingEvidence,
    Refutation,
    State,
    Verdict,
    add_refutation,
    exit_status,
    judge_evidence,
    load_refutations,
    refutations_of_file,
    worst_state,
)

FINE = Evidence("12 times better", ("go on: `rig x`",), held_out=1.1)


def refutation(path, recording="ladder", state=State.BAD):
    from rig.formats.output_files.staged_folder_and_manifest import file_sha256_or_empty

    return Refutation(
        file_sha256_or_empty(path),
        path.name,
        "2026-01-02",
        "verify",
        recording,
        "position error 45 um where 3.4 um is claimed",
        state,
    )


def test_good_needs_everything():
    good = judge_evidence(FINE)
    assert (
        good.state == State.GOOD
        and good.why == "12 times better"
        and good.next == ("go on: `rig x`",)
        and exit_status(good) == 0
    )
    for doubt in (
        {"unexplained": ("strut 3 depends on direction",)},
        {"confounds": ("play and place cannot be separated",)},
        {"held_out": 1.3},
        {"missing": (MissingEvidence("no scale is certified", "certify it"),)},
    ):
        verdict = judge_evidence(
            Evidence(**({"statement": FINE.statement, "steps": FINE.steps, "held_out": 1.1} | doubt))
        )
        assert (
            verdict.state == State.CHECK and verdict.next[0] != FINE.steps[0] and len(verdict.why) > len(FINE.statement)
        )
        assert exit_status(verdict) == 0


def test_bad_is_what_was_refuted():
    for against in ({"refuted": ("refuted on 2026-01-02",)}, {"held_out": 13.0}):
        verdict = judge_evidence(Evidence("347 times better", **against))
        assert verdict.state == State.BAD and exit_status(verdict) == 3 and not verdict.why.startswith("347")
        assert (
            "rig diagnose" in verdict.next[0]
            and verdict.tree()["state"] == "bad"
            and verdict.tree()["next"] == verdict.next[0]
        )


def test_the_next_step_is_the_command_that_would_tell():
    assert judge_evidence(Evidence("x", confounds=("play and place",))).next == (BALANCE,)
    assert worst_state([State.GOOD, State.CHECK]) == State.CHECK and worst_state([]) == State.CHECK


def test_a_refuted_file_is_known_by_its_content(tmp_path):
    path = tmp_path / "calibration.json"
    path.write_text("{}")
    for recording in ("ladder", "other", "ladder"):
        with CommandOutputs("verify") as outputs:
            add_refutation(outputs.file(tmp_path / NAME, own=True), tmp_path, refutation(path, recording))
    assert [one.recording for one in refutations_of_file(path)] == ["other", "ladder"]
    assert (
        refutations_of_file(path)[0].line
        == "refuted on 2026-01-02 by other (rig verify): position error 45 um where 3.4 um is claimed"
    )
    path.write_text("{ }")
    assert refutations_of_file(path) == (), "another calibration has taken its place"


def test_an_index_shows_what_was_refuted_later(tmp_path, capsys):
    path = tmp_path / "calibration.json"
    path.write_text("{}")
    write_page(
        tmp_path / "calibration.html", Page("calibrate", "Calibration", Verdict(State.GOOD, "347 times better"), [])
    )
    with CommandOutputs("verify") as outputs:
        add_refutation(outputs.file(tmp_path / NAME, own=True), tmp_path, refutation(path))
    found = read_page_summary(tmp_path / "calibration.html")
    assert (
        found.state == State.BAD
        and found.why.startswith("refuted on 2026-01-02 by ladder")
        and found.why.endswith("347 times better")
    )
    assert main(["index", str(tmp_path)]) == 0 and capsys.readouterr().out.startswith("bad ")


@pytest.mark.parametrize(
    "text",
    ["[]", "{", '{"schema": "refutations/1", "refutations": [{"sha256": "a"}]}', '{"schema": "other/1"}', "null"],
)
def test_a_list_that_is_none_is_refused(tmp_path, text):
    (tmp_path / NAME).write_text(text)
    with pytest.raises(FileError, match=NAME):
        load_refutations(tmp_path)
    with pytest.raises(FileError):
        refutations_of_file(tmp_path / "calibration.json")


def test_states_of_a_list_are_checked(tmp_path):
    row = {
        "sha256": "a",
        "file": "c.json",
        "date": "2026",
        "command": "verify",
        "recording": "r",
        "finding": "x",
        "state": "excellent",
    }
    (tmp_path / NAME).write_text(json.dumps({"schema": "refutations/1", "refutations": [row]}))
    with pytest.raises(FileError, match="excellent"):
        load_refutations(tmp_path)
