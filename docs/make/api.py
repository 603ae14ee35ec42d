"""The page of the Python interface: what `rig`, `vision`, `calib` hand on, and the rooms below. Made when the documents
are built.
"""

import ast
import importlib
import inspect
from pathlib import Path

from docs.make.told import in_cell

ROOT = Path(__file__).parents[2]
ENTRIES = ("rig", "vision", "calib")
HEAD = """# From Python

Made from the code. `import rig, vision, calib` gives what stands first here; it is opened when it is first used, so \
that importing takes no
time. Results show themselves in a notebook; three notebooks go the whole way:
[measure and calibrate](notebooks/measure-and-calibrate.ipynb), [diagnose](notebooks/diagnose.ipynb), \
[certify](notebooks/certify.ipynb).

    import rig, vision, calib

    recording = rig.load_recording("REC")                      # a folder, checked
    measured = vision.measured(recording)            # poses with covariance, cameras adjusted
    calibration = calib.calibrated(recording)        # geometry, corrections, what they are worth
    report = calib.diagnosed(recording)              # what physics is left out
    certificate = calib.certified(calibration, [rig.load_recording("REC2")])
    calib.save("calibration.json", calibration)

Below the entry points all modules may be imported, room by room; arrays are told with shape and unit in their \
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
    for package_name in (*ENTRIES, "synthetic"):
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
