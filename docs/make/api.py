"""The page of the Python interface: what `rig`, `synthetic`, `vision`, `calib` hand on, and the rooms below. Made when
the documents are built.
"""

import ast
import importlib
import inspect
from pathlib import Path

from docs.make.field_texts import in_cell

ROOT = Path(__file__).parents[2]
ENTRIES = ("rig", "synthetic", "vision", "calib")
HEAD = """# From Python

Made from the code. What a command computes is one function here: `rig calibrate` takes its arguments, calls
`calib.calibrate`, prints and writes. Each verb takes options and returns a result, both frozen. A result states its
verdict with `print`, shows itself in a notebook, and writes what the command writes. `import rig, synthetic, vision,
calib` takes no time: a name is opened when it is first used.

The [gallery](gallery.md) shows each step as a short script, with what it prints.

What a function refuses is a `rig.RigError`. `progress` of a function is called with (label, done, of), `notice` with
lines on what is unlikely in a recording; both are silent unless given.

## Installing it

`pip install .` in a copy of the source puts four packages on the top level of an environment: `rig`, `vision`, `calib`
and `synthetic`. These are common words. Where another distribution, or a folder of your own project, has one of these
names, Python imports whichever stands first on its path, and `pip` does not warn.
`python -c "import calib; print(calib.__file__)"` shows which one that is. Give `rig` an environment of its own then
(`python -m venv`), and call its commands from there, or rename your own folder.

Below the entry points all modules may be imported, folder by folder; arrays are stated with shape and unit in their
docstrings.
"""


def page() -> str:
    """The page in Markdown."""
    parts = [HEAD]
    for name in ENTRIES:
        package = importlib.import_module(name)
        parts.append(f"\n## {name}\n\n{inspect.getdoc(package)}\n")
        parts += [_entry(f"{name}.{public}", getattr(package, public)) for public in package.__all__]
    parts.append("\n## The rooms\n\n| module | what it does |\n|---|---|\n")
    for package_name in ENTRIES:
        parts += [
            _row(path)
            for path in sorted((ROOT / package_name).rglob("*.py"))
            if path.name != "__init__.py" and "cli" not in path.parts
        ]
    return "".join(parts)


def _entry(name: str, made: object) -> str:
    signature = "" if inspect.isclass(made) else str(inspect.signature(made)).replace("'", "")
    text = "\n".join(f"    {line}".rstrip() for line in f"{name}{signature}\n\n{inspect.getdoc(made)}".splitlines())
    return f"\n### {name}\n\n{text}\n"


def _row(path: Path) -> str:
    words = (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").split("\n\n")[0]
    name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
    return f"| `{name}` | {in_cell(' '.join(words.split()))} |\n"
