"""An effect's name stands in its own room: outside rig/effects nobody asks an effect its name."""

import ast
import re

import pytest

from rig.effects.catalogue.effect_list import BY_NAME
from tests.conftest import ROOT

NAME = re.compile(rf"(?<![\w-])({'|'.join(BY_NAME)})(?![\w-])")
ROOMS = ("rig", "vision", "calib", "synthetic")


def named(path):
    """[(line, text)] of the strings of a file, docstrings aside, that hold an effect's name."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    documented = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    return [
        (node.lineno, node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and id(node) not in documented
        and NAME.search(node.value)
    ]


def test_a_name_is_found_where_it_stands(tmp_path):
    (tmp_path / "a.py").write_text(
        '"""Says backlash."""\nif name == "backlash":\n    pass\nb = f"the backlash of {name}"\n'
    )
    assert [line for line, _ in named(tmp_path / "a.py")] == [2, 4]


@pytest.mark.parametrize("room", ROOMS)
def test_no_effect_is_named_outside_its_room(room):
    found = {
        str(path.relative_to(ROOT)): named(path)
        for path in sorted((ROOT / room).rglob("*.py"))
        if (ROOT / "rig" / "effects") not in path.parents
    }
    assert {path: lines for path, lines in found.items() if lines} == {}
