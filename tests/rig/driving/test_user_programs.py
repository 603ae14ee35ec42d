"""Programs that rig.toml names: read by nobody but who drives, not from a recording, and found from its folder."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from rig.cli.command_line import main
from rig.driving.controller_address_and_urgent_stop import controller_address_in_rig_toml
from rig.driving.driver_opening_and_settling import design_with_controller_port
from rig.errors import FileError, RigError
from rig.formats.rig_toml import design_from_rig_toml
from rig.planning.layout import hexapod_layout_and_camera_placement
from tests.conftest import ROOT
from tests.emulated_run import CONTROLLER
from tests.rig.cli.test_stop_without_delay import WATCHED

MARK = "import pathlib\n\npathlib.Path(__file__).with_name('was_run').touch()\n"


def stated(folder, protocol="file:mine.py", port="none", source=None):
    """A rig.toml in a folder, with a protocol of the user's own next to it that leaves a mark once it is run."""
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=1)
    if source:
        text = text.replace('shutter = "global"', f'shutter = "global"\nsource = "{source}"')
    folder.mkdir(exist_ok=True)
    path = folder / "rig.toml"
    path.write_text(text + CONTROLLER.format(protocol=protocol, port=port))
    template = (ROOT / "rig" / "driving" / "example_user_protocol_with_emulator.py").read_text()
    (folder / "mine.py").write_text(template + MARK)
    return path


def test_a_path_is_relative_to_rig_toml_and_reading_runs_nothing(tmp_path, monkeypatch):
    path = stated(tmp_path / "lab", source="file:eyes/cam.py")
    monkeypatch.chdir(tmp_path)
    design = design_from_rig_toml.load_design("lab/rig.toml")
    assert design.controller.protocol == "file:lab/mine.py" and design.cameras[0].source == "file:lab/eyes/cam.py"
    assert controller_address_in_rig_toml(path, "/dev/x").urgent_stop() == b"!"
    assert not (tmp_path / "lab" / "was_run").exists()
    design_with_controller_port(path, None)
    assert not (tmp_path / "lab" / "was_run").exists()


@pytest.mark.parametrize(
    "protocol, message",
    [
        ("file:/etc/mine.py", r"rig.toml:\d+:\d+: controller.protocol: expected file:NAME.py, a path relative"),
        ("file:mine.txt", "expected file:NAME.py"),
        ("package:a b", "expected package:NAME"),
        ("grbhal", "one of 'grblhal', .* 'struts', 'epics', .*, file:NAME.py or package:NAME"),
    ],
)
def test_what_is_no_program_is_refused_with_its_line(tmp_path, protocol, message):
    with pytest.raises(FileError, match=message):
        design_from_rig_toml.load_design(stated(tmp_path / "lab", protocol))


@pytest.mark.parametrize("mark", ["journal.jsonl", "frames.csv"])
@pytest.mark.parametrize("names", [{}, {"protocol": "struts", "source": "command:touch was_run"}])
def test_no_program_is_run_from_a_recording(tmp_path, mark, names, capsys):
    path = stated(tmp_path / "rec", **names)
    (tmp_path / "rec" / mark).touch()
    design_from_rig_toml.load_design(path)  # whoever reads the recording
    for words in (["status", str(path)], ["emulate", str(path)], ["emulate", str(path), "--conform"]):
        assert main(words) == 1 and "is part of a recording" in capsys.readouterr().err
    assert not (tmp_path / "rec" / "was_run").exists()


def test_no_program_is_run_from_behind_a_url(tmp_path, monkeypatch):
    design = design_from_rig_toml.load_design(stated(tmp_path / "lab", "package:acme"))
    monkeypatch.setattr(design_from_rig_toml, "load_design", lambda path: design)
    with pytest.raises(RigError, match=r"names a program \(package:acme\) and is behind a URL"):
        design_with_controller_port(Path("https://host/rig.toml"), None)


def test_the_stop_of_a_file_is_sent_before_anything_slow_and_the_file_is_not_run(tmp_path):
    ours, theirs = os.openpty()
    path = stated(tmp_path / "lab", port=os.ttyname(theirs))
    words = [sys.executable, "-c", WATCHED, str(ours), str(path)]
    done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT, pass_fds=(ours,))
    os.close(ours)
    os.close(theirs)
    assert "b'!" in done.stdout and not (tmp_path / "lab" / "was_run").exists(), done.stdout + done.stderr


@pytest.mark.slow
def test_a_rig_with_a_protocol_of_its_own_is_driven_over_tcp(tmp_path):
    path = stated(tmp_path / "lab")
    rig = [shutil.which("rig", path=os.path.dirname(sys.executable))]
    with subprocess.Popen([*rig, "emulate", str(path), "--tcp", "0"], stdout=subprocess.PIPE, text=True) as emulator:
        try:
            port = emulator.stdout.readline().split()[1]
            assert port.startswith("socket://")
            done = subprocess.run([*rig, "home", str(path), "--port", port], capture_output=True, text=True)
            assert done.returncode == 0, done.stderr
            done = subprocess.run([*rig, "status", str(path), "--port", port], capture_output=True, text=True)
            assert "idle" in done.stdout and done.returncode == 0, done.stdout + done.stderr
        finally:
            emulator.terminate()
