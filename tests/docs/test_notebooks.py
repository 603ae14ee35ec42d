"""The notebooks run from top to bottom, and what a cell ends with shows itself."""

import ast
import json
import os
from pathlib import Path

import pytest

from tests.docs.told import ROOT

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


def executed(path: Path) -> list[str]:
    """What the cells of a notebook show, in order."""
    names: dict = {}
    shown = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] != "code":
            continue
        assert cell["outputs"] == [], "kept without outputs"
        *body, last = ast.parse("".join(cell["source"])).body
        if not isinstance(last, ast.Expr):
            body, last = [*body, last], None
        exec(compile(ast.Module(body, []), path.name, "exec"), names)
        if last is not None:
            value = eval(compile(ast.Expression(last.value), path.name, "eval"), names)
            shown.append(value._repr_html_() if hasattr(value, "_repr_html_") else repr(value))
    return shown


@pytest.mark.slow
@pytest.mark.parametrize(
    "path, said",
    [
        ("measure-and-calibrate", "times better"),
        ("diagnose", "backlash at strut 3"),
        ("certify", "With 80 % confidence, 80 % of poses"),
    ],
)
def test_a_notebook_runs(path, said, monkeypatch):
    monkeypatch.chdir(os.getcwd())
    shown = executed(ROOT / "docs" / "notebooks" / f"{path}.ipynb")
    assert any(said in text for text in shown), shown
    assert len(shown) >= 3 and not any("Error" in text for text in shown)


def test_all_notebooks_are_run():
    assert [path.stem for path in NOTEBOOKS] == ["certify", "diagnose", "measure-and-calibrate"]
