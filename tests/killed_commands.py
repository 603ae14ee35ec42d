"""Commands that are killed, or whose disk is full, in a folder with what they had made before: what is left of it, and
whether they work again.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from dataclasses import dataclass
from pathlib import Path

from rig.cli import command_line
from rig.errors import FileError
from rig.formats.output_files import require_folder_of_uninterrupted_command
from tests.conftest import ROOT

RECORD = "simulate rig.toml --plan sobol:24 --out {} --seed {}"
PREPARED = (
    "design --radius 0.3 --out rig.toml",
    "design --radius 0.3 --size 320x256 --cubes 3 --out small.toml",
    RECORD.format("rec", 1),
    RECORD.format("rec2", 2),
    "calibrate rec --out cal.json",
)
COMMANDS = {  # what a command did before, and what it is doing when it is stopped
    "design": ("design --radius 0.3 --out made.toml", "design --radius 0.31 --out made.toml"),
    "print": ("print rig.toml --out s.pdf", "print rig.toml --out s.pdf --paper A3"),
    "simulate": (
        "simulate rig.toml --plan sobol:9 --out sim --truth t.json",
        "simulate rig.toml --plan sobol:6 --seed 2 --out sim --truth t.json",
    ),
    "images": (
        "simulate small.toml --plan sobol:3 --images --out pics",
        "simulate small.toml --plan sobol:2 --seed 2 --images --out pics",
    ),
    "measure": ("measure rec --out measured", "measure rec2 --out measured"),
    "calibrate": ("calibrate rec --out c.json", "calibrate rec2 --out c.json"),
    "correct": ("correct cal.json --poses w1.csv --out cmd.csv", "correct cal.json --poses w2.csv --out cmd.csv"),
    "export": ("export cal.json --format json --out e.txt", "export cal.json --format csv --out e.txt"),
    "plan": (
        "plan rig.toml --for parameters --count 8 --out p.csv",
        "plan rig.toml --for parameters --count 9 --out p.csv",
    ),
    "view": ("view rec --frame 1 --out v.png", "view rec --frame 2 --out v.png"),
    "online": ("online rec --state s.json", "online rec2 --state s.json"),
    "diagnose": ("diagnose rec --only backlash --out diag", "diagnose rec2 --only backlash --out diag"),
    "blind": (
        "blind --season 2 --frames 40 --hide nothing --out campaign --cases 1",
        "blind --season 2 --frames 40 --hide nothing --out campaign --cases 1-2",
    ),
}
QUICK = ("design", "print", "simulate", "export")
POSES = "frame,x,y,z,rx,ry,rz\n0,0,0,0.45,0,0,0\n1,{},0,0.45,0,0,0.02\n"
CHANGES = re.compile(
    rb"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00|CreationDate \(D:[^)]*\)|\"seconds\": [\d.]+|[\d.]+ s "
    rb"each|median seconds[^\n]*"
)


@dataclass(frozen=True)
class Scene:
    """What one command may do: folder : as it was before; old, new : its files before and after it has run;
    seconds : that that took.
    """

    name: str
    folder: Path
    old: dict[str, bytes]
    new: dict[str, bytes]
    seconds: float

    @property
    def words(self) -> list[str]:
        """The command that is stopped."""
        return COMMANDS[self.name][1].split()


class Command:
    """`rig` with some words in a folder, as a process of its own that is forked from this one, so that importing takes
    no time.
    """

    def __init__(self, folder: Path, words: list[str]) -> None:
        self._messages = tempfile.TemporaryFile()  # noqa: SIM115
        self.error = ""  # what it printed on the error output, once it has ended
        self.pid = os.fork()
        if not self.pid:
            status = 99
            try:
                os.setsid()  # by which those that it starts are known
                os.chdir(folder)
                os.environ.update(PYTHONPATH=str(ROOT), OMP_NUM_THREADS="1")
                nothing = os.open(os.devnull, os.O_RDWR)
                for descriptor, to in ((0, nothing), (1, nothing), (2, self._messages.fileno())):
                    os.dup2(to, descriptor)
                sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", closefd=False)  # noqa: SIM115
                status = command_line.main(words)
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stderr.flush()
                os._exit(status)

    def ended(self, seconds: float | None = None) -> int | None:
        """Its exit status (less than 0: the signal that ended it), or None where it runs still after so many
        seconds.
        """
        end = None if seconds is None else time.monotonic() + seconds
        while True:
            pid, status = os.waitpid(self.pid, 0 if end is None else os.WNOHANG)
            if pid:
                with self._messages as messages:
                    messages.seek(0)
                    self.error = messages.read().decode()
                return os.waitstatus_to_exitcode(status)
            if time.monotonic() > end:
                return None
            time.sleep(0.002)

    def outlived(self) -> bool:
        """Whether a process that it started still runs two seconds from now."""
        end = time.monotonic() + 2
        while any(_session(process) == self.pid for process in Path("/proc").glob("[0-9]*")):
            if time.monotonic() > end:
                return True
            time.sleep(0.01)
        return False


def _session(process: Path) -> int | None:
    try:
        state, _, _, session = (process / "stat").read_text().rsplit(")", 1)[1].split()[:4]
    except (OSError, ValueError):
        return None
    return None if state == "Z" else int(session)


def run(folder: Path, words: list[str]) -> None:
    command = Command(folder, words)
    assert command.ended() == 0, f"{' '.join(words)}: {command.error}"


def files(folder: Path) -> dict[str, bytes]:
    """Content of all files but temporaries, without what differs from run to run (a campaign's score counts its
    seconds).
    """
    return {
        str(path.relative_to(folder)): CHANGES.sub(b"", path.read_bytes())
        for path in sorted(folder.rglob("*"))
        if path.is_file() and ".rig-" not in str(path.relative_to(folder)) and not path.match("campaign/score.*")
    }


def prepared(base: Path, names: tuple[str, ...]) -> list[Scene]:
    """The scenes of some commands."""
    common = base / "common"
    common.mkdir()
    for k, x in ((1, 0.01), (2, 0.02)):
        (common / f"w{k}.csv").write_text(POSES.format(x))
    needed = PREPARED if set(names) - {"design", "print", "simulate", "images"} else PREPARED[:2]
    for line in needed:
        run(common, line.split())
    scenes = []
    for name in names:
        before, after = base / f"{name}-before", base / f"{name}-after"
        shutil.copytree(common, before)
        run(before, COMMANDS[name][0].split())
        shutil.copytree(before, after)
        start = time.monotonic()
        run(after, COMMANDS[name][1].split())
        scenes.append(Scene(name, before, files(before), files(after), time.monotonic() - start))
    return scenes


def killed(scene: Scene, work: Path, share: float, number: int = signal.SIGKILL) -> str:
    """What is wrong after a command was killed a share of its time after its beginning; an empty text where nothing
    is.
    """
    shutil.copytree(scene.folder, work)
    command = Command(work, scene.words)
    if command.ended(share * scene.seconds) is None:
        os.kill(command.pid, number)
        command.ended()
    if command.outlived():
        return f"{scene.name} at {share:.3f}: processes are left"
    return _damage(scene, work) or _failure_of_repetition(scene, work) or _done(work)


def starved(scene: Scene, disk: Path, room: int) -> str:
    """What is wrong after a command's disk was full once it had written so much (bytes); disk : a folder to mount one
    on.
    """
    size = sum(-(-path.stat().st_size // 4096) * 4096 + 4096 for path in scene.folder.rglob("*")) + 65536
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size + room}", "tmpfs", str(disk)], check=True)
    try:
        work = disk / "work"
        shutil.copytree(scene.folder, work)
        command = Command(work, scene.words)
        status, error = command.ended(), command.error
        if "Traceback" in error or "No space left on device" not in error and status:
            return f"{scene.name} with {room} bytes: status {status}, {error.strip()[-300:]}"
        if status and scene.name != "blind" and files(work) != scene.old or list(work.rglob(".rig-*.part")):
            return f"{scene.name} with {room} bytes: what was there is not as it was"
        subprocess.run(["mount", "-o", "remount,size=1g", str(disk)], check=True)
        return _damage(scene, work) or _failure_of_repetition(scene, work)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def _damage(scene: Scene, work: Path) -> str:
    """A file that is neither as it was nor as it was to be, one that is gone, or a folder that is a mixture, where the
    folder is not marked.
    """
    left, marked = files(work), _marked(work)
    for name, content in left.items():
        if content not in (scene.old.get(name), scene.new.get(name)):
            return f"{scene.name}: {name} is neither as it was nor as it was to be"
    for top in sorted({name.split("/")[0] for name in (*left, *scene.old)} - marked):
        current, old, new = (
            {name: content for name, content in tree.items() if name.split("/")[0] == top}
            for tree in (left, scene.old, scene.new)
        )
        if current not in (old, new):
            return f"{scene.name}: {top} is a mixture and not marked"
    return ""


def _marked(work: Path) -> set[str]:
    out = set()
    for folder in work.iterdir():
        if folder.is_dir():
            try:
                require_folder_of_uninterrupted_command(folder)
            except FileError:
                out.add(folder.name)
    return out


def _failure_of_repetition(scene: Scene, work: Path) -> str:
    command = Command(work, scene.words)
    status, error = command.ended(), command.error
    if status and not (scene.name == "online" and "count twice" in error):
        return f"{scene.name} again: {error.strip()[-300:]}"
    now = files(work)
    wrong = [name for name in scene.new.keys() | now.keys() if now.get(name) != scene.new.get(name)]
    if wrong or list(work.glob("**/.rig-new-*")):
        return f"{scene.name} again: {wrong or 'something staged'} is not as it would have been"
    return ""


def _done(work: Path) -> str:
    shutil.rmtree(work)
    return ""


def can_mount() -> bool:
    """Whether a disk of a size of one's own can be had here."""
    return (
        os.geteuid() == 0
        and sys.platform == "linux"
        and shutil.which("mount") is not None
        and not subprocess.run(["unshare", "--mount", "true"], capture_output=True).returncode
    )
