"""What commands write over, what they refuse to, and what they say where nothing can be written."""

import json
import os
import shutil
import signal
import subprocess
import sys

import pytest

from rig.cli import command_line
from rig.cli import new as design_command
from rig.recording import recording_folder
from tests.cli import RIG
from tests.conftest import ROOT, make_recording

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}


@pytest.fixture(scope="module")
def base(tmp_path_factory, design, rig_text):
    """A rig.toml, a recording and what a user may have beside them."""
    folder = tmp_path_factory.mktemp("base")
    (folder / "rig.toml").write_text(rig_text)
    make_recording(folder / "rec", design, rig_text, 3, count=6)
    make_recording(folder / "other", design, rig_text, 4, count=6)
    (folder / "commands.csv").write_text("frame,l1,l2,l3,l4,l5,l6\n0,0.52,0.52,0.52,0.52,0.52,0.52\n")
    return folder


@pytest.fixture
def here(base, tmp_path, monkeypatch):
    """A copy of that, in which the commands run."""
    shutil.copytree(base, tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "here"


def tree(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.mark.parametrize("force", [[], ["--force"]])
@pytest.mark.parametrize(
    "words",
    [
        "simulate rig.toml --plan sobol:3 --out new --truth rig.toml",
        "simulate rig.toml --plan commands:commands.csv --out new --truth commands.csv",
        "simulate rec/rig.toml --plan sobol:3 --out rec",
        "plan rig.toml --for parameters --count 8 --out rig.toml",
        "print rig.toml --out rig.toml",
        "print rec/rig.toml --out ./rec/../rec/rig.toml",
        "export rig.toml --format json --out rig.toml",
        "measure rec --out rec",
        "measure rec --out link",
        "diagnose rec --out rec",
        "view rec --frame 1 --out rec/corners.csv",
    ],
)
def test_what_is_read_is_never_written_over(words, force, here, capfd):
    (here / "link").symlink_to("rec")
    before = tree(here)
    assert command_line.main([*words.split(), *force]) == 1
    assert capfd.readouterr().err.count("\n") == 1
    assert tree(here) == before


@pytest.mark.parametrize(
    "words",
    [
        "simulate rig.toml --plan sobol:3 --out other",
        "measure rec --out other",
        "diagnose rec --out other",
        "design --radius 0.3 --out rig.toml",
        "print rig.toml --out commands.csv",
        "view rec --frame 1 --out picture.png",
        "simulate rig.toml --plan sobol:3 --out new --truth commands.csv",
    ],
)
def test_what_a_command_did_not_make_is_refused(words, here, capfd):
    (here / "picture.png").write_text("a photograph")
    before = tree(here)
    assert command_line.main(words.split()) == 1
    assert "--force" in capfd.readouterr().err and tree(here) == before


def test_a_recording_drawn_again_is_replaced_and_its_manifest_tells_no_truth(here):
    words = [
        "simulate",
        "rig.toml",
        "--plan",
        "sobol:4",
        "--effect",
        "backlash:strut3:gap=4e-5",
        "--out",
        "sim",
        "--truth",
        "t.json",
    ]
    assert command_line.main([*words, "--seed", "77"]) == 0
    first = tree(here / "sim")
    assert command_line.main([*words, "--seed", "78"]) == 0
    assert tree(here / "sim").keys() == first.keys() and tree(here / "sim") != first
    manifest = first[".rig-made.json"].decode()
    assert (
        json.loads(manifest)["origin"]["complete"]
        and "backlash" not in manifest
        and "77" not in json.loads(manifest)["origin"]["arguments"]
    )
    assert recording_folder.load_recording(here / "sim").exposures.frame.size
    assert command_line.main(["simulate", "rig.toml", "--plan", "sobol:3", "--out", "other", "--force"]) == 0
    assert set(tree(here / "other")) == {
        ".rig-made.json",
        "rig.toml",
        "commands.csv",
        "frames.csv",
        "sensors.csv",
        "corners.csv",
    }


@pytest.mark.slow
def test_a_dash_is_the_standard_output_and_words_go_elsewhere(here):
    done = subprocess.run(
        [*RIG, "export", "rig.toml", "--format", "json", "--out", "-"], capture_output=True, text=True, env=ENVIRONMENT
    )
    assert json.loads(done.stdout)["kind"] == "hexapod" and "written" in done.stderr


@pytest.mark.parametrize(
    "words",
    [
        "design --radius 0.3 --out {}",
        "export rig.toml --format csv --out {}",
        "print rig.toml --out {}",
        "plan rig.toml --for parameters --count 8 --out {}",
        "view rec --frame 1 --out {}",
    ],
)
def test_a_full_device_is_said_in_a_line(words, here, capfd):
    assert command_line.main(words.format("/dev/full").split()) == 1
    assert "/dev/full: cannot be written: No space left on device" in capfd.readouterr().err
    assert os.path.exists("/dev/full") and not os.path.isfile("/dev/full")


@pytest.mark.parametrize("words", ["design --radius 0.3", "--help", "design --help", ""])
def test_a_full_standard_output_is_said_in_a_line(words):
    with open("/dev/full", "w") as full:
        done = subprocess.run([*RIG, *words.split()], stdout=full, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT)
    assert done.returncode not in (0, 120) and done.stderr.count("\n") == 1
    assert "standard output" in done.stderr and "No space left on device" in done.stderr


@pytest.mark.parametrize(
    "error, status, says",
    [
        (MemoryError(), 1, "not enough memory"),
        (OSError(11, "Resource temporarily unavailable"), 1, "Resource temporarily unavailable"),
        (PermissionError(13, "Permission denied", "x.csv"), 1, "x.csv: Permission denied"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_what_ends_a_command_is_said_in_a_line(error, status, says, monkeypatch, capfd):
    def fail(_):
        raise error

    monkeypatch.setattr(design_command, "run_design", fail)
    assert command_line.main(["design", "--radius", "0.3"]) == status
    error_text = capfd.readouterr().err
    assert says in error_text and error_text.count("\n") == 1


def test_a_signal_to_end_clears_away(tmp_path):
    code = (
        "import os, signal, sys; from rig.cli import command_line as cli; from rig.cli import new as design\n"
        "def run(arguments):\n    arguments.outputs.file(arguments.out); os.kill(os.getpid(), "
        "signal.SIGTERM); signal.pause()\n"
        "design.run_design = run; sys.exit(cli.main(['design', '--radius', '1', '--out', 'x']))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, env=ENVIRONMENT)
    assert (
        done.returncode == 128 + signal.SIGTERM
        and "ended by signal 15" in done.stderr
        and list(tmp_path.iterdir()) == []
    )


def test_a_view_names_its_formats_and_its_file(here, capfd, monkeypatch):
    monkeypatch.setattr("webbrowser.open", lambda _: False)
    assert command_line.main(["view", "rec", "--frame", "1", "--out", "x.xyz"]) == 1
    assert ".png, .jpg" in capfd.readouterr().err
    assert command_line.main(["view", "rec", "--frame", "1"]) == 0
    assert (here / "rec-frame-1.png").read_bytes().startswith(
        b"\x89PNG"
    ) and "rec-frame-1.png" in capfd.readouterr().out
    (here / "rec-frame-2.png").write_text("mine")
    assert command_line.main(["view", "rec", "--frame", "2"]) == 1 and (here / "rec-frame-2.png").read_text() == "mine"
    assert (
        command_line.main(["view", "rec", "--frame", "1", "--out", "rec"]) == 1
        and "is a folder" in capfd.readouterr().err
    )
