"""Kernels are compiled and kept on an installation that cannot be written, by a user without a home, and nobody else's
are loaded.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from rig.cli.shared.escaped_output_progress_error_table_and_refutations import Progress, print_compilation_notice
from rig.compute import numba_compilation_and_kernel_cache_folder
from tests.conftest import ROOT


def forget():
    for found in (
        numba_compilation_and_kernel_cache_folder.kernel_cache_folder,
        numba_compilation_and_kernel_cache_folder.user_kernel_cache_folder,
        numba_compilation_and_kernel_cache_folder.is_private_folder,
    ):
        found.cache_clear()


@pytest.fixture
def locked(monkeypatch, tmp_path):
    """An installation that cannot be written, and temporary files in tmp_path."""
    writable = os.access
    monkeypatch.setattr(
        os,
        "access",
        lambda path, mode: (
            not Path(path).is_relative_to(numba_compilation_and_kernel_cache_folder.HERE) and writable(path, mode)
        ),
    )
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    forget()
    yield
    forget()


def test_a_home_is_used_where_there_is_one(locked, monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert numba_compilation_and_kernel_cache_folder.kernel_cache_folder() == tmp_path / "home" / ".cache" / "rig"


@pytest.mark.parametrize("planted", [None, "link", "open"])
def test_without_a_home_a_folder_of_ones_own(planted, locked, monkeypatch, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("HOME", str(tmp_path / "file"))
    folder = tmp_path / f"rig-kernels-{os.getuid()}"
    if planted == "link":
        (tmp_path / "theirs").mkdir()
        folder.symlink_to(tmp_path / "theirs")
    if planted == "open":
        folder.mkdir()
        folder.chmod(0o777)
    found = numba_compilation_and_kernel_cache_folder.kernel_cache_folder()
    assert (found == folder) == (planted is None) and not found.is_symlink() and found.stat().st_mode & 0o077 == 0
    assert f"is kept in {found}" in capsys.readouterr().err
    forget()
    if planted is None:
        assert (
            numba_compilation_and_kernel_cache_folder.kernel_cache_folder() == folder and not capsys.readouterr().err
        )  # said once


@pytest.mark.parametrize("mode", [0o777, 0o775, 0o707])
def test_a_folder_to_which_others_can_write_is_not_taken(mode, locked, monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    theirs = tmp_path / "theirs"
    (theirs / "below").mkdir(parents=True)
    theirs.chmod(mode)
    own = tmp_path / "home" / ".cache" / "rig"
    assert (
        numba_compilation_and_kernel_cache_folder.private_or_user_kernel_cache_folder(theirs) == own
        and own.stat().st_mode & 0o077 == 0
    )
    assert numba_compilation_and_kernel_cache_folder.is_private_folder(theirs / "below") == (mode == 0o775), (
        "who can write above can put another folder in its place"
    )
    forget()
    own.chmod(mode)
    assert (
        numba_compilation_and_kernel_cache_folder.private_or_user_kernel_cache_folder(theirs)
        == tmp_path / f"rig-kernels-{os.getuid()}"
    )
    assert f"others can write to {theirs}, and {own.parent} can be written to by others" in capsys.readouterr().err


def test_a_folder_of_somebody_else_is_not_taken(monkeypatch, tmp_path):
    forget()
    assert numba_compilation_and_kernel_cache_folder.is_private_folder(
        tmp_path
    ) and numba_compilation_and_kernel_cache_folder.is_private_folder(tmp_path / "new" / "folder")
    forget()
    owner = tmp_path.stat().st_uid
    monkeypatch.setattr(os, "getuid", lambda: owner + 1)
    assert numba_compilation_and_kernel_cache_folder.is_private_folder(tmp_path) == (owner == 0)
    forget()


KERNEL = (
    "from rig.compute.numba_compilation_and_kernel_cache_folder import njit\n{imports}\n@njit(cache=True)\n{function}"
)


@pytest.mark.slow
@pytest.mark.parametrize("changed", ["kernel", "number", "array"])
def test_a_kernel_is_compiled_anew_after_a_change_of_what_it_takes_from_another_file(changed, tmp_path):
    def written(gain):
        at = {name: gain if name == changed else 2.0 for name in ("kernel", "number", "array")}
        below = f"import numpy as np\nNUMBER, ARRAY = {at['number']}, np.array([{at['array']}])\n"
        below += KERNEL.format(imports="", function=f"def below(x):\n    return x * {at['kernel']}\n")
        above = "def above(x):\n    return below(x) * NUMBER * ARRAY[0]\n"
        (tmp_path / "lower.py").write_text(below)
        (tmp_path / "upper.py").write_text(
            KERNEL.format(imports="from lower import ARRAY, NUMBER, below\n", function=above)
        )
        # no bytecode: Python takes that of an equally long source that was written within the same second
        environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}", "PYTHONDONTWRITEBYTECODE": "1"}
        environment |= {"NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
        code = "import upper; print(upper.above(1.0))"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
        assert not done.returncode, done.stderr
        return float(done.stdout)

    assert [written(2.0), written(3.0), written(2.0)] == [8.0, 12.0, 8.0]


@pytest.mark.slow
def test_kernels_kept_by_an_earlier_version_whose_modules_have_moved_are_compiled_anew(tmp_path):
    def total(module):
        (tmp_path / f"{module}.py").write_text("from typing import NamedTuple\nclass Pair(NamedTuple):\n    a: float\n")
        imports, function = f"from {module} import Pair", "def total(pair):\n    return pair.a + 1.0\n"
        (tmp_path / "kernel.py").write_text(KERNEL.format(imports=imports, function=function))
        environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}", "PYTHONDONTWRITEBYTECODE": "1"}
        environment |= {"NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
        code = "import kernel; print(kernel.total(kernel.Pair(2.0)))"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
        (tmp_path / f"{module}.py").unlink()
        assert not done.returncode, done.stderr
        return float(done.stdout)

    assert [total("first"), total("second")] == [3.0, 3.0]


@pytest.mark.slow
@pytest.mark.parametrize("named", [None, "generic"])
def test_kernels_are_compiled_for_all_processors_of_a_kind_unless_one_is_named(named):
    code = (
        "from rig.effects.framework import machine_motion_and_play as motion; import numba, numpy as np; "
        "from numba.core.registry import cpu_target; "
        "assert motion.play_operator(np.ones((3, 1)), 0.5).sum() == 3; "
        "print(cpu_target.target_context.codegen().magic_tuple()[1:])"
    )
    environment = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_CPU")}
    environment |= {"NUMBA_CPU_NAME": named} if named else {}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, env=environment)
    assert not done.returncode, done.stderr
    portable = [name for name, _ in numba_compilation_and_kernel_cache_folder.PORTABLE.values()]
    assert done.stdout in [f"{(name, '')}\n" for name in ([named] if named else portable)], done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("open_one", ["NUMBA_CACHE_DIR", "__pycache__"])
def test_no_kernel_is_loaded_from_where_others_can_write(open_one, tmp_path):
    shutil.copytree(ROOT / "rig", tmp_path / "rig", ignore=shutil.ignore_patterns("__pycache__"))
    theirs = (
        tmp_path / "rig" / "effects" / "framework" / "__pycache__" if open_one == "__pycache__" else tmp_path / "theirs"
    )
    theirs.mkdir()
    theirs.chmod(0o777)
    code = (
        "from rig.effects.framework import machine_motion_and_play as motion; import numpy as np; "
        "print(motion.play_operator(np.ones((3, 1)), 0.5).sum())"
    )
    environment = {
        "PATH": os.environ["PATH"],
        "PYTHONPATH": str(tmp_path),
        "HOME": str(tmp_path / "home"),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    if open_one == "NUMBA_CACHE_DIR":
        environment[open_one] = str(theirs)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, env=environment)
    assert done.returncode == 0 and done.stdout == "3.0\n", done.stderr
    assert not list(theirs.rglob("*.nb?")) and list((tmp_path / "home" / ".cache" / "rig").rglob("*.nbi"))


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0 or not shutil.which("setpriv"), reason="takes root, to become somebody else")
def test_a_kernel_runs_on_a_read_only_installation_without_a_home(tmp_path):
    shutil.copytree(ROOT / "rig", tmp_path / "rig", ignore=shutil.ignore_patterns("__pycache__"))
    for parent in (
        tmp_path,
        *(
            p
            for p in tmp_path.parents
            if p.is_relative_to(Path(tempfile.gettempdir())) and p != Path(tempfile.gettempdir())
        ),
    ):
        parent.chmod(parent.stat().st_mode | 0o055)
    nobody = ["setpriv", "--reuid=65534", "--clear-groups", "--inh-caps=-all", sys.executable]
    if subprocess.run([*nobody, "-c", "import numba"], capture_output=True, cwd="/").returncode:
        pytest.skip("this Python is out of other users' reach")
    (tmp_path / "tmp").mkdir()
    (tmp_path / "tmp").chmod(0o777)
    code = (
        "from rig.effects.framework import machine_motion_and_play as motion; import numpy as np\n"
        "print(motion.__file__, motion.play_operator(np.ones((3, 1)), 0.5).sum())"
    )
    done = subprocess.run(
        [*nobody, "-c", code],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={"PYTHONPATH": str(tmp_path), "HOME": "/nonexistent", "TMPDIR": str(tmp_path / "tmp")},
    )
    assert done.returncode == 0 and str(tmp_path / "rig") in done.stdout and done.stdout.split()[-1] == "3.0", (
        done.stderr
    )
    assert "is kept in" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.slow
def test_who_waits_for_what_is_compiled_is_told_once_and_not_again_where_it_is_loaded(tmp_path):
    code = (
        "from rig.compute.numba_compilation_and_kernel_cache_folder import announce_compilation; "
        "from rig.effects.framework import "
        "machine_motion_and_play as motion; import "
        "numpy as np\n"
        "with announce_compilation(lambda: print('compiling')):\n    "
        "for values in (np.ones((3, 1)), np.ones((3, 1), np.float32)): motion.play_operator(values, 0.5)"
    )
    outputs = [
        subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            cwd=ROOT,
            check=True,
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        ).stdout
        for _ in range(2)
    ]
    assert outputs == ["compiling\n", ""]


@pytest.mark.parametrize(
    "shown, terminal, words",
    [
        ("auto", True, "compiling for this computer, once: up to a minute\n"),
        ("auto", False, ""),
        ("none", True, ""),
        ("lines", False, "compiling for this computer, once: up to a minute\n"),
    ],
)
def test_a_compile_notice_is_for_terminals_or_where_lines_are_wanted(shown, terminal, words, monkeypatch, capsys):
    """In a pipe the first line is the command's own, however slow the machine compiles."""
    monkeypatch.setattr(Progress, "shown", shown)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    print_compilation_notice()
    assert capsys.readouterr().err == words
