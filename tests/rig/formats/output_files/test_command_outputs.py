"""What a command makes: nothing of others' is written over, nothing of its own from before stays, and all of it comes
or nothing does.
"""

import json
import os
import shutil
import signal
import subprocess
import sys

import pytest

from rig.errors import FileError, RigError
from rig.formats.output_files import MANIFEST, CommandOutputs, require_folder_of_uninterrupted_command, write_text
from rig.formats.output_files.staged_folder_and_manifest import load_manifest
from rig.recording import recording_folder as recording
from tests.conftest import ROOT


def make(folder, files, command="measure", **how):
    """What a command does that writes these files ({name: text}) into a folder."""
    with CommandOutputs(command, **how) as outputs:
        staged = outputs.folder(folder)
        for name, text in files.items():
            (staged / name).parent.mkdir(parents=True, exist_ok=True)
            write_text(staged / name, text)


def put(path, text, command="plan", **how):
    with CommandOutputs(command, **how) as outputs:
        write_text(outputs.file(path), text)


def tree(folder):
    return {
        str(path.relative_to(folder)): path.read_text()
        for path in folder.rglob("*")
        if path.is_file() and path.name != MANIFEST
    }


def test_a_folder_is_replaced_whole(tmp_path):
    out = tmp_path / "a" / "out"
    make(out, {"frames.csv": "1", "images/cam0/1.png": "x", "images/cam0/2.png": "y", "sensors.csv": "s"})
    (out / "notes.txt").write_text("mine")
    make(out, {"frames.csv": "2", "images/cam1/1.png": "z"})
    assert (
        tree(out) == {"frames.csv": "2", "images/cam1/1.png": "z", "notes.txt": "mine"}
        and not (out / "images" / "cam0").exists()
    )
    known = load_manifest(out)
    assert (
        known.origin.command == "measure"
        and known.origin.complete
        and set(known.files) == {"frames.csv", "images/cam1/1.png"}
    )


@pytest.mark.parametrize(
    "spoil, says",
    [
        (lambda out: (out / "rig.toml").write_text("edited"), "rig.toml: was changed or added since"),
        (lambda out: (out / "sensors.csv").write_text("added"), "sensors.csv: was changed or added since"),
        (lambda out: (out / "poses_stage1.csv").write_text("added"), "poses_stage1.csv: was changed or added since"),
        (lambda out: (out / MANIFEST).unlink(), "did not make what is in it"),
    ],
)
def test_what_somebody_else_did_to_a_folder_is_kept_unless_forced(spoil, says, tmp_path):
    out = tmp_path / "out"
    make(out, {"rig.toml": "a", "frames.csv": "1"})
    spoil(out)
    before = tree(out)
    with pytest.raises(FileError, match=says):
        make(out, {"rig.toml": "b"})
    assert tree(out) == before
    make(out, {"rig.toml": "b"}, force=True)
    assert tree(out) == {"rig.toml": "b"}


def test_another_commands_folder_is_refused(tmp_path):
    make(tmp_path / "rec", {"frames.csv": "1"}, "simulate")
    with pytest.raises(FileError, match="`rig measure` did not make what is in it"):
        make(tmp_path / "rec", {"frames.csv": "2"})
    assert tree(tmp_path / "rec") == {"frames.csv": "1"}


@pytest.mark.parametrize("force", [False, True])
def test_an_input_is_never_written_over(force, tmp_path):
    rec, link = tmp_path / "rec", tmp_path / "link"
    make(rec, {"rig.toml": "a", "frames.csv": "1"})
    link.symlink_to(rec)
    for out, given in (
        (rec, rec),
        (link, rec),
        (rec, link),
        (rec, rec / "rig.toml"),
        (tmp_path / "x" / ".." / "rec", rec),
    ):
        with pytest.raises(RigError, match="remains unchanged"):
            make(out, {"rig.toml": "b"}, inputs=[given], force=force)
    os.link(rec / "rig.toml", tmp_path / "hard.toml")
    for out, given in (
        (rec / "rig.toml", rec / "rig.toml"),
        (link / "rig.toml", rec / "rig.toml"),
        (tmp_path / "hard.toml", rec / "rig.toml"),
        (rec / "poses.csv", rec),
    ):
        with pytest.raises(RigError, match="remains unchanged"):
            put(out, "b", inputs=[given], force=force)
    assert tree(rec) == {"rig.toml": "a", "frames.csv": "1"}


def test_photographs_below_a_folder_are_not_taken_away_by_what_reads_them(tmp_path):
    out = tmp_path / "out"
    (out / "images").mkdir(parents=True)
    (out / "images" / "1.png").write_text("photograph")
    with pytest.raises(FileError, match="remains unchanged"):
        make(out, {"camera.toml": "c"}, "lens", inputs=[out / "images"], force=True)
    assert tree(out) == {"images/1.png": "photograph"}


def test_a_file_is_known_again_and_others_are_kept(tmp_path):
    path = tmp_path / "plan.csv"
    put(path, "1")
    put(path, "2")
    assert path.read_text() == "2"
    with pytest.raises(FileError, match="was not made by `rig correct`"):
        put(path, "3", "correct")
    path.write_text("edited")
    with pytest.raises(FileError, match="was changed since `rig plan` wrote it"):
        put(path, "3")
    assert path.read_text() == "edited"
    put(path, "3", force=True)
    put(path, "4")
    assert tree(tmp_path) == {"plan.csv": "4"}


def test_what_accompanies_a_file_is_not_written_over_either(tmp_path):
    (tmp_path / "c.html").write_text("mine")
    with CommandOutputs("calibrate") as outputs, pytest.raises(FileError, match="c.html: is there"):
        outputs.stage_file(outputs.file(tmp_path / "c.json"), ".html")
    assert CommandOutputs("calibrate").stage_file(CommandOutputs("calibrate").file("/dev/null"), ".html") is None
    assert tree(tmp_path) == {"c.html": "mine"}


def test_who_fails_leaves_everything_as_it_was(tmp_path):
    make(tmp_path / "old", {"frames.csv": "1"})
    before = sorted(path.name for path in (tmp_path / "old").iterdir())
    for out in (tmp_path / "old", tmp_path / "new" / "deep"):
        with pytest.raises(KeyboardInterrupt), CommandOutputs("measure") as outputs:
            write_text(outputs.folder(out) / "frames.csv", "2")
            raise KeyboardInterrupt
    with pytest.raises(ZeroDivisionError), CommandOutputs("plan") as outputs:
        write_text(outputs.file(tmp_path / "p.csv"), "x")
        raise ZeroDivisionError
    assert (
        tree(tmp_path) == {"old/frames.csv": "1"}
        and sorted(path.name for path in (tmp_path / "old").iterdir()) == before
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["old"]


def test_an_error_names_the_place_where_a_file_would_have_been(tmp_path):
    with pytest.raises(FileError) as error, CommandOutputs("plan") as outputs:
        raise FileError(outputs.file(tmp_path / "p.csv"), "cannot be written: No space left on device")
    assert str(error.value) == f"{tmp_path}/p.csv: cannot be written: No space left on device"


def test_of_two_places_that_one_cannot_be_written_is_one_error(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    with pytest.raises(FileError, match="t.json: is there"), CommandOutputs("simulate") as outputs:
        write_text(outputs.file(tmp_path / "a" / "p.csv"), "1")
        write_text(outputs.file(tmp_path / "b" / "t.json"), "2")
        (tmp_path / "b" / "t.json").write_text("somebody else's, meanwhile")
    assert tree(tmp_path) == {"a/p.csv": "1", "b/t.json": "somebody else's, meanwhile"}


KILLED = """
import os, signal, sys
from pathlib import Path
from rig.formats.output_files import CommandOutputs, write_text
count = [0]
def counted(function):
    def call(*given, **more):
        count[0] += 1
        if count[0] == int(sys.argv[2]):
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*given, **more)
    return call
os.replace, os.unlink, os.fsync = counted(os.replace), counted(os.unlink), counted(os.fsync)
with CommandOutputs("measure") as outputs:
    folder = outputs.folder(Path(sys.argv[1]))
    for name in ("frames.csv", "poses.csv"):
        write_text(folder / name, "new " + name)
print("done")
"""


@pytest.mark.slow
def test_killed_at_every_step_a_folder_is_old_or_new_or_marked(tmp_path):
    """A process is killed before its nth change on the disk, for every n: files are whole, mixtures are marked, and the
    next run works.
    """
    old, new = ({"frames.csv": "1", "corners.csv": "c"}, {"frames.csv": "new frames.csv", "poses.csv": "new poses.csv"})
    seen = set()
    for step in range(1, 99):
        out = tmp_path / str(step)
        make(out, old)
        done = subprocess.run(
            [sys.executable, "-c", KILLED, str(out), str(step)],
            capture_output=True,
            text=True,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        assert done.returncode in (0, -signal.SIGKILL), done.stderr
        left = {name: text for name, text in tree(out).items() if not name.startswith(".rig-")}
        assert all(text in (old.get(name), new.get(name)) for name, text in left.items())
        try:
            require_folder_of_uninterrupted_command(out)
            seen.add("old" if left == old else "new")
            assert left in (old, new)
        except FileError:
            seen.add("marked")
        make(out, new)
        assert (
            tree(out) == new and require_folder_of_uninterrupted_command(out) is None
        )  # nothing staged is left either
        if done.returncode == 0:
            break
    assert seen == {"old", "marked", "new"} and step > 10


def test_a_recording_that_was_not_finished_is_no_recording(tmp_path, recording_folder):
    write_text(
        recording_folder / MANIFEST,
        json.dumps(
            {
                "schema": "made/1",
                "files": {},
                "origin": {"command": "simulate", "arguments": [], "complete": False, "data": []},
            }
        ),
    )
    with pytest.raises(FileError, match="is not complete: `rig simulate` was ended while writing it"):
        recording.load_recording(recording_folder)
    (recording_folder / MANIFEST).write_text("{")
    with pytest.raises(FileError, match="is not a manifest"):
        recording.load_recording(recording_folder)
    (recording_folder / MANIFEST).unlink()
    assert recording.load_recording(recording_folder).exposures.frame.size


@pytest.mark.parametrize("name", ["../victim", "/etc/hostname", "images/../../victim", "a//b", ""])
def test_a_manifest_names_no_file_outside_its_folder(name, tmp_path):
    out = tmp_path / "out"
    make(out, {"frames.csv": "1"})
    (tmp_path / "victim").write_text("mine")
    manifest = json.loads((out / MANIFEST).read_text())
    manifest["files"][name] = {"command": "measure", "sha256": []}
    (out / MANIFEST).write_text(json.dumps(manifest))
    for force in (False, True):
        with pytest.raises(FileError, match="is not a file of its folder"):
            make(out, {"frames.csv": "2"}, force=force)
    assert (tmp_path / "victim").read_text() == "mine"


def test_a_link_out_of_a_folder_is_not_followed(tmp_path):
    out = tmp_path / "out"
    make(out, {"images/1.png": "drawn"})
    (tmp_path / "photographs").mkdir()
    (tmp_path / "photographs" / "1.png").write_text("drawn")
    shutil.rmtree(out / "images")
    (out / "images").symlink_to(tmp_path / "photographs")
    for files in ({"images/1.png": "new"}, {"frames.csv": "new"}):
        with pytest.raises(FileError, match="leads out of the folder"):
            make(out, files, force=True)
    assert (tmp_path / "photographs" / "1.png").read_text() == "drawn"


def test_a_folder_written_in_place_is_marked_until_its_end(tmp_path):
    out = tmp_path / "campaign"
    with pytest.raises(ZeroDivisionError), CommandOutputs("blind") as outputs:
        write_text(outputs.growing(out) / "x", "1")
        with pytest.raises(RigError, match="another rig command is writing"):
            CommandOutputs("blind").growing(out)
        with pytest.raises(RigError, match="another rig command is writing"), CommandOutputs("blind") as other:
            other.folder(out)
        raise ZeroDivisionError
    with pytest.raises(FileError, match="not complete"):
        require_folder_of_uninterrupted_command(out)
    with CommandOutputs("blind") as outputs:
        write_text(outputs.growing(out) / "y", "2")
    assert require_folder_of_uninterrupted_command(out) is None and tree(out) == {"x": "1", "y": "2"}
    with pytest.raises(FileError, match="did not make"), CommandOutputs("run") as outputs:
        outputs.growing(out)


def test_two_commands_in_one_folder_do_not_undo_each_other(tmp_path):
    with CommandOutputs("plan") as one, CommandOutputs("design") as two:
        write_text(one.file(tmp_path / "plan.csv"), "p")
        write_text(two.file(tmp_path / "rig.toml"), "d")
    assert tree(tmp_path) == {"plan.csv": "p", "rig.toml": "d"} and set(load_manifest(tmp_path).files) == {
        "plan.csv",
        "rig.toml",
    }


def test_what_a_killed_command_had_staged_is_swept(tmp_path):
    left = tmp_path / ".rig-new-0123"
    left.mkdir()
    (left / "frames.csv").write_text("half")
    put(tmp_path / "p.csv", "1")
    assert not left.exists()


def test_a_link_to_a_file_stays_a_link(tmp_path):
    (tmp_path / "there").mkdir()
    (tmp_path / "p.csv").symlink_to("there/real.csv")
    put(tmp_path / "p.csv", "1")
    put(tmp_path / "p.csv", "2")
    assert (tmp_path / "p.csv").is_symlink() and (tmp_path / "there" / "real.csv").read_text() == "2"


def test_a_copied_folder_is_its_commands_still(tmp_path):
    make(tmp_path / "a", {"frames.csv": "1"})
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    make(tmp_path / "b", {"frames.csv": "2"})
    assert tree(tmp_path / "b") == {"frames.csv": "2"}
