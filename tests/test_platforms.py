"""Tests are skipped for what the system lacks, and for nothing else."""

import os
import subprocess
import sys

import pytest

from tests import missing_system_modules
from tests.cli import run
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


def without_posix(code, folder):
    """A finished process that has no more of the standard library than Windows has; kernels are cached in the tree."""
    before = "from tests.system_without_posix import import_every_module, take_posix_away\ntake_posix_away()\n"
    return subprocess.run(
        [sys.executable, "-c", before + code],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "HOME": str(ROOT)},
        capture_output=True,
        text=True,
    )


@pytest.mark.slow
@POSIX
def test_every_module_is_imported_without_what_windows_lacks(tmp_path):
    done = without_posix("print(import_every_module())", tmp_path)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 400


COMMANDS = """
from rig.cli.command_line import main
for words in (
    "simulate r/rig.toml --plan sobol:24 --seed 3 --truth truth.json --out rec --quiet",
    "simulate r/rig.toml --machine truth.json --plan sobol:30 --seed 5 --out second --quiet",
    "check rec",
    "measure rec --out measured --quiet",
    "calibrate measured --out calibration.json --quiet",
    "correct calibration.json --poses wanted.csv --out commands.csv",
    "simulate r/rig.toml --machine truth.json --plan commands:commands.csv --seed 4 --out after --quiet",
    "verify calibration.json after --wanted wanted.csv",
    "view measured --page view.html",
    "certify calibration.json after second --out certificate --coverage 0.8 --quiet",
    "export calibration.json --format csv --out geometry.csv",
    "export calibration.json --format urdf --out machine.urdf",
    "export calibration.json --format linuxcnc-kins --out rigkins.c",
    "export measured --format parquet --out measured.parquet",
    "import pictures/images --rig r/rig.toml --commands pictures/commands.csv --frames pictures/frames.csv --out seen",
    "check seen --detect",
    "measure seen --out measured_in_images --quiet",
    "diagnose measured --out diagnosis",
    "calibrate measured --diagnosis diagnosis --out refined.json --quiet",
):
    status = main(words.split())
    assert status in (0, 3), (words, status)
"""
WANTED = "frame,x,y,z,rx,ry,rz\n" + "".join(f"{i},0.0{i},0.01,0.45,0.0,0.0{i},0.0\n" for i in range(4))


@pytest.mark.slow
@POSIX
def test_the_way_of_files_is_gone_without_what_windows_lacks(tmp_path):
    (tmp_path / "wanted.csv").write_text(WANTED)
    run("new", tmp_path / "r", "--defaults", "--radius", "300mm", "--quiet")  # pictures take the EGL of this system
    words = ("--plan", "sobol:6", "--seed", 6, "--images", "--out", tmp_path / "pictures", "--quiet")
    run("simulate", tmp_path / "r" / "rig.toml", *words)
    done = without_posix(COMMANDS, tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stderr, done.stderr
    for name in (
        "calibration.json",
        "commands.csv",
        "after/corners.csv",
        "measured/poses.csv",
        "certificate/certificate.json",
        "measured_in_images/poses.csv",
        "diagnosis/diagnosis.json",
        "refined.json",
    ):
        assert (tmp_path / name).stat().st_size > 0
    assert not list(tmp_path.rglob(".rig-new-*")) and not list(tmp_path.rglob(".rig-*.part"))
