"""What kind of machine there is, is asked where mechanisms and their calibration are: all else asks what it has."""

import ast
from pathlib import Path

from tests.conftest import ROOT
from tests.source_trees import nodes

MOST = 21  # tests of a kind elsewhere: this may only fall
ROOMS = ("rig", "vision", "calib", "synthetic", "docs/make")
OWN = ("rig/model/mechanisms", "calib/models")  # where a kind may be asked
CLASSES = {"Arm", "Chain", "Hexapod", "Planar2", "Free"}
WORDS = {"arm", "chain", "hexapod", "planar2", "free"}


def names(node: ast.AST) -> set[str]:
    """All names and attributes in an expression."""
    return {
        n.id if isinstance(n, ast.Name) else n.attr for n in ast.walk(node) if isinstance(n, ast.Name | ast.Attribute)
    }


def words(node: ast.AST) -> set[str]:
    """The strings that an expression is, or lists."""
    if isinstance(node, ast.Tuple | ast.List | ast.Set):
        return set().union(*map(words, node.elts)) if node.elts else set()
    return {node.value} if isinstance(node, ast.Constant) and isinstance(node.value, str) else set()


def asks_kind(node: ast.AST) -> bool:
    """Whether an expression, or a case of a match, asks for a kind of machine."""
    if isinstance(node, ast.Call):
        return names(node.func) <= {"isinstance", "issubclass"} and any(names(part) & CLASSES for part in node.args[1:])
    if isinstance(node, ast.Compare):
        parts = [node.left, *node.comparators]
        called = any(name.endswith("kind") for part in parts for name in names(part))
        return called and any(words(part) & WORDS for part in parts)
    if isinstance(node, ast.MatchClass):
        return bool(names(node.cls) & CLASSES)
    return isinstance(node, ast.MatchValue) and bool(words(node.value) & WORDS)


def kind_tests(path: Path) -> list[int]:
    """Lines of a file that ask for a kind of machine."""
    return sorted(n.lineno for n in nodes(path) if asks_kind(n))


def test_every_way_to_ask_is_found(tmp_path):
    (tmp_path / "a.py").write_text(
        'if m.kind == "arm":\n    pass\nif kind not in ("hexapod", "planar2"):\n    pass\nisinstance(m, Arm | Chain)\n'
        'match m:\n    case Hexapod():\n        pass\nmatch m.kind:\n    case "free":\n        pass\n'
        'if place == "arm" or m.kind == other.kind or isinstance(m, int):\n    pass\n'
    )
    assert kind_tests(tmp_path / "a.py") == [1, 3, 5, 7, 10]


def test_a_machines_kind_is_asked_in_few_places():
    found = {
        str(path.relative_to(ROOT)): lines
        for room in ROOMS
        for path in sorted((ROOT / room).rglob("*.py"))
        if not any(ROOT / own in path.parents for own in OWN) and (lines := kind_tests(path))
    }
    assert sum(map(len, found.values())) <= MOST, found
