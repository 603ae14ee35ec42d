"""The campaign of truth: one machine through the command line, and its summary."""

import json

import pytest

from docs.make.results import SCHEMA
from tests.bench.truth import main, trials
from tests.bench.truth_summary import share, summary


def test_shares_are_those_of_the_books():
    assert share(0, 10) == [0.0, 0.0, 0.3085]
    assert share(5, 10) == [0.5, 0.1871, 0.8129]
    assert share(10, 10) == [1.0, 0.6915, 1.0]


@pytest.mark.slow
def test_a_campaign_goes_on_where_it_stood(tmp_path, capsys):
    out = tmp_path / "truth.json"
    words = [
        "--seed",
        "3",
        "--ways",
        "planar2",
        "--effects",
        "backlash",
        "--strengths",
        "weak",
        "--plans",
        "shuffled",
        "--out",
        str(out),
    ]
    main(["--machines", "1", *words])
    first = json.loads(out.read_text())
    main(["--machines", "2", *words])
    both = json.loads(out.read_text())
    assert both["machines"][0] == first["machines"][0] and len(both["machines"]) == 2
    assert "planar2/backlash/weak" in capsys.readouterr().out
    line = first["machines"][0]
    assert line["covered"] == (line["claim"][1] <= line["true"] <= line["claim"][2])
    assert summary(both["machines"])["all"]["n"] == 2
    assert both["command"] == (
        "python -m tests.bench truth --machines 2 --seed 3 --ways planar2 --effects backlash --strengths weak "
        "--plans shuffled"
    )
    assert both["schema"] == SCHEMA and " of 2, " in both["figures"][0]["reached"]


def test_unknown_names_are_refused(capsys):
    with pytest.raises(SystemExit):
        main(["--effects", "rust"])
    assert "rust" in capsys.readouterr().err


def test_any_beginning_of_a_campaign_is_of_all_ways():
    found = list(
        trials(
            40,
            1,
            ["plain", "arm"],
            ["none", "backlash", "compliance"],
            ["none", "weak", "strong"],
            ["sobol", "shuffled"],
        )
    )
    assert {t.method for t in found[:2]} == {"plain", "arm"}
    assert not any(t.method == "arm" and t.effect == "compliance" for t in found)
    assert len({t.name for t in found}) == 40
