"""An effect's name and class stand in their own room: outside rig/effects nobody names an effect, or imports one."""

import ast
import re

import pytest

from rig.effects.catalogue.effect_list import BY_NAME
from tests.conftest import ROOT
from tests.source_trees import nodes

NAME = re.compile(rf"(?<![\w-])({'|'.join(BY_NAME)})(?![\w-])")
ROOMS = ("rig", "vision", "calib", "synthetic")
CATALOGUE, LIST = "rig.effects.catalogue", "effect_list"  # the list of all effects names none


def named(path):
    """[(line, text)] of the strings of a file, docstrings aside, that hold an effect's name."""
    documented = {
        id(node.body[0].value)
        for node in nodes(path)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    return [
        (node.lineno, node.value)
        for node in nodes(path)
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


def imported(path):
    """[(line, module)] of a file's imports of single effects."""
    found = []
    for node in nodes(path):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            whole = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Import):
            whole = [alias.name for alias in node.names]
        else:
            continue
        modules = {name.split(".")[3] for name in whole if name.startswith(f"{CATALOGUE}.")}
        found += [(node.lineno, module) for module in sorted(modules - {LIST})]
    return found


def test_an_import_of_an_effect_is_found(tmp_path):
    (tmp_path / "a.py").write_text(
        "from rig.effects.catalogue.backlash import Backlash\nfrom rig.effects.catalogue import effect_list, creep\n"
        "import rig.effects.catalogue.warm_up as warm\nfrom rig.effects.catalogue.effect_list import ALL\n"
    )
    assert imported(tmp_path / "a.py") == [(1, "backlash"), (2, "creep"), (3, "warm_up")]


def test_no_effect_is_imported_outside_its_room():
    found = {
        str(path.relative_to(ROOT)): lines
        for room in (*ROOMS, "docs/make")
        for path in sorted((ROOT / room).rglob("*.py"))
        if (ROOT / "rig" / "effects") not in path.parents and (lines := imported(path))
    }
    assert found == {}
