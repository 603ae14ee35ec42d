"""The notebooks run from top to bottom, and show what is stored in them, but for figures."""

import json
import re

import pytest

from docs.make.notebooks import executed
from tests.docs.told import ROOT

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
STATES = {
    "measure-and-calibrate": "times better",
    "diagnose": "backlash at strut 3",
    "certify": "With 80 % confidence, 80 % of poses",
}


def shown(tree):
    """What the cells of a notebook show, in order."""
    outputs = [out for cell in tree["cells"] if cell["cell_type"] == "code" for out in cell["outputs"]]
    return ["".join(out.get("text") or out["data"].get("text/html") or out["data"]["text/plain"]) for out in outputs]


def without_figures(text):
    """A text with # for each number, so that the last digits of another computer do not matter."""
    return re.sub(r"[-+]?\d[\d.]*(e[-+]?\d+)?", "#", text)


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_what_is_stored_in_it(path):
    now = shown(executed(path))
    assert any(STATES[path.stem] in text for text in now), now
    stored = shown(json.loads(path.read_text(encoding="utf-8")))
    assert [without_figures(text) for text in now] == [without_figures(text) for text in stored]


def test_all_notebooks_are_run_and_have_outputs():
    assert [path.stem for path in NOTEBOOKS] == sorted(STATES)
    for path in NOTEBOOKS:
        assert len(shown(json.loads(path.read_text(encoding="utf-8")))) >= 3
