"""The Python interface: opened when it is used, what it hands on is there and told, examples in docstrings hold,
results show themselves.
"""

import doctest
import importlib
import inspect
import subprocess
import sys

import pytest

import calib
import rig
import synthetic
import vision
from rig.errors import FileError
from rig.report.verdict_refutations_and_result_display import result_html
from tests.docs.document_commands import ROOT

PACKAGES = (rig, synthetic, vision, calib)
BENCH = ROOT / "tests" / "data" / "bench" / "check"
EXAMPLES = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for package in ("rig", "vision", "calib", "synthetic")
    for path in sorted((ROOT / package).rglob("*.py"))
    if ">>> " in path.read_text(encoding="utf-8")
]
LONG = ("vision.api",)  # measure images


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.__name__)
def test_all_that_is_handed_on_is_there_and_told(package):
    for name in package.__all__:
        assert inspect.getdoc(getattr(package, name)), f"{package.__name__}.{name}"
        assert name in package.__doc__ or name[0].isupper(), f"{package.__name__}.{name}"
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        package.nothing  # noqa: B018


def test_nothing_that_is_handed_on_hides_a_module():
    for package in PACKAGES:
        folder = ROOT / package.__name__
        assert [name for name in package.__all__ if (folder / f"{name}.py").exists() or (folder / name).is_dir()] == []


def test_importing_opens_nothing_that_takes_time():
    slow = ["numpy", "scipy", "cv2", "numba", "matplotlib"]
    words = f"import sys, rig, synthetic, vision, calib; print(sorted(set({slow}) & set(sys.modules)))"
    assert (
        subprocess.run([sys.executable, "-c", words], cwd=ROOT, capture_output=True, text=True).stdout.strip() == "[]"
    )


@pytest.mark.parametrize("module", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in EXAMPLES])
def test_examples_in_docstrings_hold(module, monkeypatch):
    monkeypatch.chdir(ROOT)
    done = doctest.testmod(importlib.import_module(module))
    assert done.attempted >= 1 and done.failed == 0


def test_there_are_examples():
    assert set(LONG) < set(EXAMPLES) and len(EXAMPLES) >= 3


def test_a_recording_shows_itself():
    text = rig.load(BENCH)._repr_html_()
    assert "check: 6 frames" in text and "cam0 (" in text and "commands" in text
    with pytest.raises(rig.RigError) as refused:
        rig.load(BENCH / "images")
    assert isinstance(refused.value, FileError)


def test_what_is_shown_is_text_and_nothing_else():
    made = result_html("<b>", ["a & b"], [("h<",), ("<script>",)])
    assert "<script>" not in made and "&lt;b&gt;" in made and "a &amp; b" in made and "<th>h&lt;</th>" in made
