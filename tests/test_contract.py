"""The arrows between the packages run one way, and the ground floor stays light."""

import subprocess
import sys

from importlinter.cli import lint_imports

from tests.conftest import ROOT


def test_imports_keep_the_contract(monkeypatch):
    monkeypatch.chdir(ROOT)
    assert lint_imports(no_cache=True) == 0


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from rig.cli.command_line import main\n"
        "for words in (['--help'], ['simulate', '--help'], ['measure', '--help']):\n"
        "    try: main(words)\n    except SystemExit: pass\n"
        "heavy = {'numpy', 'scipy', 'cv2', 'numba', 'matplotlib', 'pyrender'} & set(sys.modules)\n"
        "print('HEAVY', heavy)"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "measure" in out and "HEAVY set()" in out


def test_what_reads_a_recording_opens_nothing_that_it_does_not_need_yet(tmp_path):
    code = (
        "import sys; from rig.cli.command_line import main\n"
        f"for name in ('measure', 'calibrate', 'diagnose'): main([name, {str(tmp_path / 'none')!r}, '--out', "
        f"{str(tmp_path / 'out')!r}])\n"
        "heavy = {'cv2', 'matplotlib', 'numba', 'pyrender', 'scipy.interpolate', 'scipy.optimize', "
        "'scipy.stats', 'trimesh'}\n"
        "print('HEAVY', heavy & set(sys.modules), 'numpy' in sys.modules)"
    )
    assert (
        "HEAVY set() True"
        in subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    )


def test_no_file_outgrows_its_room():
    files = [path for package in ("rig", "vision", "calib", "synthetic") for path in (ROOT / package).rglob("*.py")]
    sizes = {str(path.relative_to(ROOT)): len(path.read_text().splitlines()) for path in files}
    assert {name: lines for name, lines in sizes.items() if lines > 410} == {}  # as formatted at 120 columns
