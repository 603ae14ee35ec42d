"""One file, whole or not at all: what stands there is never half of anything, links and devices are what they are."""

import os
import resource
import stat
import subprocess
import sys
import threading

import pytest

from rig.errors import FileError
from rig.formats.output_files import write_bytes, write_text


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_file_keeps_its_mode_and_a_link_its_target(tmp_path):
    real, link = tmp_path / "real.txt", tmp_path / "link.txt"
    real.write_text("old")
    real.chmod(0o640)
    link.symlink_to("real.txt")
    write_text(link, "new")
    assert link.is_symlink() and real.read_text() == "new" and stat.S_IMODE(real.stat().st_mode) == 0o640
    dangling = tmp_path / "dangling"
    dangling.symlink_to(tmp_path / "made")
    write_text(dangling, "x")
    assert dangling.is_symlink() and (tmp_path / "made").read_text() == "x"
    assert names(tmp_path) == ["dangling", "link.txt", "made", "real.txt"]


def test_a_new_file_has_the_mode_that_the_mask_leaves(tmp_path):
    before = os.umask(0o027)
    try:
        write_bytes(tmp_path / "x", b"")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "x").stat().st_mode) == 0o640


def test_the_longest_name_that_a_folder_takes_can_be_written(tmp_path):
    write_text(tmp_path / ("n" * 255), "x")
    with pytest.raises(FileError, match="File name too long"):
        write_text(tmp_path / ("n" * 256), "x")


def test_what_is_no_regular_file_is_written_straight_to(tmp_path):
    fifo, got = tmp_path / "fifo", []
    os.mkfifo(fifo)
    reader = threading.Thread(target=lambda: got.append(fifo.read_text()))
    reader.start()
    write_text(fifo, "through")
    reader.join()
    assert got == ["through"] and stat.S_ISFIFO(fifo.stat().st_mode)
    write_text("/dev/null", "x")
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)
    with pytest.raises(FileError, match="/dev/full: cannot be written: No space left on device"):
        write_text("/dev/full", "x")
    assert stat.S_ISCHR(os.stat("/dev/full").st_mode)


@pytest.mark.parametrize("named", ["/dev/stdout", "out.txt"])
def test_what_the_shell_sent_the_output_to_gets_it_in_order(named, tmp_path):
    code = (
        "from rig.formats.output_files import write_text; print('before'); "
        f"write_text({str(tmp_path / named)!r}, 'whole\\n'); print('after')"
    )
    with open(tmp_path / "out.txt", "w") as out:
        subprocess.run([sys.executable, "-c", code], stdout=out, check=True)
    assert (tmp_path / "out.txt").read_text() == "before\nwhole\nafter\n"


@pytest.mark.parametrize("room", [0, 1, 4096, 9999])
def test_a_full_disk_leaves_what_was_there_and_nothing_else(room, tmp_path):
    path = tmp_path / "x"
    path.write_bytes(b"earlier")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        with pytest.raises(FileError, match=r"x: cannot be written: File too large"):
            write_bytes(path, b"a" * 10000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_bytes() == b"earlier" and names(tmp_path) == ["x"]


def test_who_is_interrupted_leaves_no_temporary(tmp_path, monkeypatch):
    def stop(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", stop)
    with pytest.raises(KeyboardInterrupt):
        write_text(tmp_path / "x", "y")
    assert names(tmp_path) == []


@pytest.mark.skipif(os.geteuid() == 0 and not os.path.exists("/usr/bin/setpriv"), reason="root may write anywhere")
@pytest.mark.parametrize("spoil", [lambda folder: folder.chmod(0o555), lambda folder: (folder / "x").chmod(0o444)])
def test_no_permission_is_said(spoil, tmp_path):
    tmp_path.chmod(0o777)
    (tmp_path / "x").write_text("earlier")
    (tmp_path / "x").chmod(0o666)
    spoil(tmp_path)
    code = f"from rig.formats.output_files import write_text; write_text({str(tmp_path / 'x')!r}, 'new')"
    as_nobody = ["setpriv", "--reuid=65534", "--clear-groups", "--inh-caps=-all"] if os.geteuid() == 0 else []
    for parent in (tmp_path, *tmp_path.parents[:2]):
        parent.chmod(parent.stat().st_mode | 0o111)
    done = subprocess.run([*as_nobody, sys.executable, "-c", code], capture_output=True, text=True)
    assert "x: cannot be written: Permission denied" in done.stderr.splitlines()[-1]
    assert (tmp_path / "x").read_text() == "earlier" and names(tmp_path) == ["x"]


def test_a_planted_link_is_not_followed(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "rig.formats.output_files.atomic_file_writing_and_process_locks.secrets.token_hex", lambda _: "guessed"
    )
    victim = tmp_path / "victim"
    victim.write_text("mine")
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / ".rig-guessed.part").symlink_to(victim)
    with pytest.raises(FileError, match="File exists"):
        write_text(tmp_path / "d" / "x", "new")
    assert victim.read_text() == "mine" and not (tmp_path / "d" / "x").exists()


@pytest.mark.parametrize(
    "path, message", [(".", "is a folder"), ("no/x", "No such file or directory"), ("loop", "levels of symbolic links")]
)
def test_what_cannot_be_a_file_is_said(path, message, tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(FileError, match=message):
        write_text(tmp_path / path, "x")


def race(tmp_path, writes):
    """(failures, torn reads) of two writers to one file and a reader."""
    path, failed, torn = tmp_path / "x", [], []
    texts = ["a" * 5000, "b" * 9000]
    write_text(path, texts[0])
    left = [2]

    def write(text):
        for _ in range(writes):
            try:
                write_text(path, text)
            except FileError as error:
                failed.append(error)
        left[0] -= 1

    threads = [threading.Thread(target=write, args=(text,)) for text in texts]
    for thread in threads:
        thread.start()
    while left[0]:
        if path.read_text() not in texts:
            torn.append(1)
    for thread in threads:
        thread.join()
    assert names(tmp_path) == ["x"]
    return len(failed), len(torn)


def test_two_writers_to_one_file(tmp_path):
    assert race(tmp_path, 100) == (0, 0)


@pytest.mark.slow
def test_two_writers_to_one_file_three_thousand_times(tmp_path):
    assert race(tmp_path, 1500) == (0, 0)
