"""The benchmark of masks: which rows are masked, what is counted, and that it goes on where it stood."""

import json

import numpy as np
import pytest

from tests.bench.masks import KINDS, MASKS, counted, figures, main, masks, recordings


def test_masks_take_none_halves_and_all_of_the_wild_rows():
    found = masks(np.array([3, 8, 20, 31]), np.random.default_rng(0))
    parts = {name: set(text.split(",")) - {""} for name, text in found.items()}
    assert tuple(parts) == MASKS and parts["none"] == set() and parts["all"] == {"3", "8", "20", "31"}
    assert parts["half"] | parts["the other half"] == parts["all"] and not parts["half"] & parts["the other half"]
    assert len(parts["another half"]) == 2 and parts["another half"] < parts["all"]


def test_any_beginning_has_all_kinds_and_no_two_are_alike():
    found = list(recordings(40, 1))
    assert {one.kind for one in found[: len(KINDS)]} == set(KINDS) and len({one.name for one in found}) == 40
    assert found == list(recordings(41, 1))[:40] and {one.strength for one in found} == {"none", "weak", "strong"}


def test_names_are_counted_over_masks_and_against_the_clean_recording():
    names = dict(zip(MASKS, (["a"], ["b"], ["b"], ["b"], ["a"])))
    line = {
        "kind": "arm",
        "same": 3,
        "as_clean": 2,
        "diagnoses": {"clean": {"names": ["a"]}, **{k: {"names": v} for k, v in names.items()}},
    }
    assert [reached for _, reached, _ in figures([line])] == ["3 of 5", "2 of 5"] * 2


def test_refusals_are_no_names_that_agree():
    refused = {"names": ["refused"], "refused": "it does not close"}
    found = {"clean": {"names": ["a"]}, **dict.fromkeys(MASKS, refused)}
    assert counted(found) == (0, 0)
    assert counted(found | {"all": {"names": ["a"]}}) == (1, 1)


@pytest.mark.slow
def test_a_campaign_goes_on_where_it_stood(tmp_path, capsys):
    out = tmp_path / "masks.json"
    words = ["--recordings", "20", "--only", "planar2/none", "--out", str(out)]
    main(words)
    (line,) = json.loads(out.read_text())["recordings"]
    assert line["same"] == line["as_clean"] == 5 and line["diagnoses"]["clean"]["names"] == []
    assert {"none", "all"} < set(line["diagnoses"]) and line["diagnoses"]["all"]["mask"].split(",") == list(
        line["wild"]
    )
    main([*words, "--backwards"])
    assert json.loads(out.read_text())["recordings"] == [line]
    assert capsys.readouterr().out.count("planar2/none") == 1
