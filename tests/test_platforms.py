"""Tests are skipped for what the system lacks, and for nothing else."""

import os
import subprocess
import sys

import pytest

from tests import missing_system_modules
from tests.conftest import ROOT

POSIX = pytest.mark.skipif(os.name != "posix", reason="of a system that has all")


@POSIX
@pytest.mark.parametrize("complaint", ["No module named 'fcntl'", "module 'os' has no attribute 'openpty'"])
def test_nothing_is_skipped_where_nothing_lacks(complaint):
    assert missing_system_modules.missing_part(complaint) is None


def test_what_lacks_is_named_and_other_failures_stay(monkeypatch):
    monkeypatch.setattr(missing_system_modules, "is_absent", lambda *name: True)
    assert "needs the module fcntl (locks on files and ports)" in missing_system_modules.missing_part(
        "E   No module named 'fcntl'"
    )
    assert "needs os.fork" in missing_system_modules.missing_part("module 'os' has no attribute 'fork'")
    for other in ("No module named 'numpy'", "module 'os' has no attribute 'frok'", "assert 1 == 2"):
        assert missing_system_modules.missing_part(other) is None


def test_pictures_are_skipped_off_linux_alone(monkeypatch):
    words = "rendering needs OpenGL through EGL, which cannot be loaded here"
    for platform, skipped in (("linux", False), ("darwin", True), ("win32", True)):
        monkeypatch.setattr(sys, "platform", platform)
        assert (missing_system_modules.missing_part(words) is not None) is skipped


@pytest.mark.parametrize(
    "body, outcome",
    [
        ("import gone_module\ndef test_a(): pass", "1 skipped"),
        ("def test_a():\n    import gone_module", "1 skipped"),
        ("import pytest\n@pytest.fixture\ndef f():\n    import gone_module\ndef test_a(f): pass", "1 skipped"),
        ("def test_a():\n    import other_gone_module", "1 failed"),
        ("def test_a():\n    raise AttributeError('plain')", "1 failed"),
    ],
)
def test_a_module_a_test_and_a_fixture_are_skipped(tmp_path, body, outcome):
    (tmp_path / "test_it.py").write_text(body)
    (tmp_path / "conftest.py").write_text(
        "from tests import missing_system_modules\nfrom tests.conftest import *\n"
        "from tests.conftest import pytest_make_collect_report, pytest_runtest_call, pytest_runtest_setup\n"
        "missing_system_modules.MODULES['gone_module'] = 'what this test lacks'\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-rs", "-p", "no:cacheprovider", str(tmp_path)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert outcome in done.stdout.splitlines()[-1], done.stdout
    assert ("needs the module gone_module (what this test lacks)" in done.stdout) is ("skipped" in outcome)
