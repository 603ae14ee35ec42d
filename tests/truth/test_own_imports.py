"""The second writer shares no code with what it judges."""

import ast
import sys
from pathlib import Path

HERE = Path(__file__).parent


def test_only_numpy_and_scipy_are_imported():
    for path in HERE.glob("*.py"):
        if path.name.startswith("test_"):
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            names = (
                [a.name for a in node.names]
                if isinstance(node, ast.Import)
                else [node.module]
                if isinstance(node, ast.ImportFrom)
                else []
            )
            for name in names:
                root = name.split(".")[0]
                assert (
                    root in sys.stdlib_module_names
                    or root in ("numpy", "scipy")
                    or f"{name}.".startswith("tests.truth.")
                ), (path.name, name)
