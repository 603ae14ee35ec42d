"""How the tree is written: linter and type checker are clean, what is public is annotated and told, functions are
short.
"""

import ast
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.source_trees import nodes, tree

ROOT = Path(__file__).parents[1]
PACKAGES = ("rig", "vision", "calib", "synthetic")
MOST_LINES, MOST_PARAMETERS = 100, 8  # lines as the formatter lays them out
SHAPE = re.compile(
    r"\((\.\.\.?|\w+)( [-+*]+)?( \w+)?,[^()]*\)|\(\.\.\.\)|\(\d+ \+ "
)  # (n, 2), (..., 6), (f a, q), (k,), (...)
ARRAYS = re.compile(r"\b(Floats|Singles|Integers|Booleans|ImageBytes|Pixels|NDArray)\b")  # see rig.array_and_json_types
UNITS = ("m ", "m,", "m;", "rad", "px", "s ", "s,", "Nm", "kg", "image", "level")  # as docstrings write them


class Function:
    """A function of the tree. where : FILE:NAME; owner : the class that it stands in, or None"""

    def __init__(self, where: str, node: ast.FunctionDef, owner: ast.ClassDef | None) -> None:
        self.where, self.node, self.owner = where, node, owner
        given = node.args
        self.parameters = [
            a
            for a in (*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg)
            if a is not None and a.arg not in ("self", "cls")
        ]
        self.compiled = any("njit" in ast.unparse(d) or "kernel" in ast.unparse(d) for d in node.decorator_list)
        self.lines = node.end_lineno - node.lineno + 1

    @property
    def untyped(self) -> bool:
        """Whether a parameter or the result lacks its type."""
        return self.node.returns is None or any(a.annotation is None for a in self.parameters)


def functions(*packages: str) -> Iterator[Function]:
    """All functions of some packages, those within functions too."""
    for package in packages:
        yield from _of(package)


@cache
def _of(package: str) -> list[Function]:
    paths = sorted((ROOT / package).rglob("*.py"))
    return [function for path in paths for function in _within(tree(path), str(path.relative_to(ROOT)), None)]


def _within(node: ast.AST, path: str, owner: ast.ClassDef | None) -> Iterator[Function]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef):
            yield Function(f"{path}:{child.name}", child, owner)
        inside = child if isinstance(child, ast.ClassDef) else None if isinstance(child, ast.FunctionDef) else owner
        yield from _within(child, path, inside)


def quiet(*command: str) -> str:
    """What a tool, or Python with options, prints about the tree; nothing where it is content."""
    words = command if command[0].startswith("-") else ("-m", *command)
    done = subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, text=True)
    return "" if done.returncode == 0 else done.stdout + done.stderr


def test_linter_is_clean():
    assert quiet("ruff", "check", "-q", ".") == ""


def test_formatter_would_change_nothing():
    assert quiet("ruff", "format", "-q", "--check", ".") == ""


def test_types_are_clean():
    """mypy frees next to nothing until it ends: a quarter of its time would be the search for garbage."""
    without_search = "import gc; gc.enable = gc.disable; gc.disable()"
    assert quiet("-c", f"{without_search}; from mypy.__main__ import console_entry; console_entry()") == ""


def test_all_functions_are_annotated():
    assert [f.where for f in functions(*PACKAGES) if f.untyped and not f.compiled] == []


def test_functions_are_short():
    assert [f.where for f in functions(*PACKAGES) if f.lines > MOST_LINES and not f.compiled] == []


def test_functions_take_few_parameters():
    assert [f.where for f in functions(*PACKAGES) if len(f.parameters) > MOST_PARAMETERS and not f.compiled] == []


def test_public_methods_are_told_by_their_class_or_its_base():
    documented = {f.node.name for f in functions(*PACKAGES) if f.owner is not None and ast.get_docstring(f.node)}
    public = [
        f
        for f in functions(*PACKAGES)
        if f.owner is not None and not f.owner.name.startswith("_") and not f.node.name.startswith("_")
    ]
    silent = [f.where for f in public if f.node.name not in documented]
    assert silent == []


@pytest.mark.parametrize("package", PACKAGES)
def test_arrays_are_told_with_shape_or_unit(package):
    """A public function whose types name an array says of what shape or unit: a bracketed shape or a unit stands in its
    docstring.
    """
    missing = []
    for f in functions(package):
        types = [ast.unparse(t) for t in (*(a.annotation for a in f.parameters), f.node.returns) if t is not None]
        words = ast.get_docstring(f.node)
        if (
            not f.node.name.startswith("_")
            and words
            and f.owner is None
            and any(ARRAYS.search(t) for t in types)
            and not SHAPE.search(words)
            and not any(f" {unit}" in f" {words}" for unit in UNITS)
        ):
            missing.append(f.where)
    assert missing == []


def annotations(nodes: Iterable[ast.AST]) -> Iterator[ast.expr]:
    """All annotations among a module's nodes, of parameters, results and variables, and what it casts to."""
    for node in nodes:
        if isinstance(node, ast.FunctionDef):
            yield from [] if node.returns is None else [node.returns]
        elif isinstance(node, (ast.arg, ast.AnnAssign)):
            yield from [] if node.annotation is None else [node.annotation]
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == "cast":
            yield node.args[0]


def test_arrays_are_annotated_with_what_they_hold():
    """No annotation says np.ndarray, of which a type checker knows no more than that it is an array:
    rig.array_and_json_types has the words for them.
    """
    bare = [
        f"{path.relative_to(ROOT)}:{annotation.lineno}"
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
        for annotation in annotations(nodes(path))
        if "ndarray" in ast.unparse(annotation)
    ]
    assert bare == []


def raised(function: Function) -> set[str]:
    """Names of the exceptions that a function itself raises, not those within it."""
    inner = {
        id(node)
        for child in ast.walk(function.node)
        if isinstance(child, ast.FunctionDef) and child is not function.node
        for node in ast.walk(child)
    }
    ends = [node.exc for node in ast.walk(function.node) if isinstance(node, ast.Raise) and id(node) not in inner]
    return {
        name
        for end in ends
        if isinstance(end, ast.Call) and (name := ast.unparse(end.func).split(".")[-1])[:1].isupper()
    }


def test_what_a_public_function_raises_is_told():
    """Hooks are told by their base; a command's run raises what the command says."""
    documented = [
        f
        for f in functions(*PACKAGES)
        if not f.node.name.startswith("_") and f.node.name != "run" and ast.get_docstring(f.node)
    ]
    assert [f.where for f in documented if raised(f) and "aise" not in ast.get_docstring(f.node)] == []


MOST_ANY = 5  # signatures that say Any, each with its reason


def signatures_with_any(package: str) -> Iterator[tuple[str, list[str]]]:
    """(FILE:LINE of a function, texts of the lines from the one above its annotation that says Any) of a package."""
    for path in sorted((ROOT / package).rglob("*.py")):
        lines = path.read_text().splitlines()
        for node in nodes(path):
            if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                continue
            given = node.args
            arguments = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
            for annotation in [*(a.annotation for a in arguments if a is not None), node.returns]:
                named = [] if annotation is None else [n for n in ast.walk(annotation) if isinstance(n, ast.Name)]
                if any(n.id == "Any" for n in named):
                    first = min([node.lineno, *(d.lineno for d in node.decorator_list)])
                    around = [lines[first - 2], *lines[annotation.lineno - 2 : annotation.lineno]]
                    yield f"{path.relative_to(ROOT)}:{annotation.lineno}", around


def test_few_signatures_say_any_and_each_says_why():
    """Any switches the type checker off for whoever calls; where nothing else will do, a comment "Any: .." says why."""
    found = [one for package in PACKAGES for one in signatures_with_any(package)]
    assert [where for where, lines in found if not any("# Any: " in line for line in lines)] == []
    assert len(found) <= MOST_ANY, [where for where, _ in found]
