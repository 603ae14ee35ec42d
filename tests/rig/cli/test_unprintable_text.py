"""Text of others (names of files, values, what a controller answers) reaches a terminal as text alone; names that are
no UTF-8 are refused.
"""

import os
import shutil
import threading

import pytest

from rig.cli.command_line import main
from rig.cli.shared.escaped_output_progress_error_table_and_refutations import EscapedStream
from rig.cli.shared.terminal_run_display_and_printed_controller_status import TerminalBlockDisplay
from rig.formats.output_files.atomic_file_writing_and_process_locks import escape_unprintable
from rig.planning.layout.hexapod_layout_and_camera_placement import hexapod_layout_rig_toml
from tests.conftest import ROOT

WIPE = "\x1b[2J\x1b]0;title\x07"  # clears a screen, and names its window


@pytest.fixture
def printed(capfd):
    """(what main printed, to standard output and error) of words."""

    def run(*words):
        main(list(map(str, words)))
        out, err = capfd.readouterr()
        assert not set(out + err) & {"\x1b", "\x07", "\x9b", "\r"} and "Traceback" not in err
        return out + err

    return run


@pytest.fixture
def recording(tmp_path):
    return shutil.copytree(ROOT / "tests" / "data" / "bench" / "check", tmp_path / f"rec{WIPE}")


def test_names_of_folders_and_images_are_escaped(recording, printed):
    assert printed("check", recording)
    table = recording / "frames.csv"
    lines = table.read_text().splitlines()
    lines[1] = ",".join([*lines[1].split(",")[:3], f"images/{WIPE}.png"])
    table.write_text("\n".join(lines) + "\n")
    assert r"\x1b[2J" in printed("check", recording) and r"\x1b[2J" in printed(
        "measure", recording, "--out", recording.parent / "out"
    )


@pytest.mark.parametrize(
    "edit",
    [
        ('name = "cam0"', 'name = "\\u001b[2J"'),
        ('shutter = "global"', 'shutter = "\\u001b[2J"'),
        ("[environment]", '"\\u001b[2J" = 1\n[environment]'),
        ('name = "', 'name = "\x1b[2J'),
    ],
)
def test_values_and_keys_of_toml_are_escaped(tmp_path, printed, edit):
    text = hexapod_layout_rig_toml(0.3, cameras=1)
    assert edit[0] in text
    (tmp_path / "rig.toml").write_text(text.replace(*edit, 1))
    assert "x1b" in printed("effects", tmp_path / "rig.toml", "--json") + printed(
        "print", tmp_path / "rig.toml", "--out", tmp_path / "x.pdf"
    )


def test_what_a_controller_answers_is_escaped(tmp_path, printed):
    master, slave = os.openpty()

    def answer():
        while data := os.read(master, 100):
            if b"q" in data:
                return
            os.write(master, b"\x1b[2J <Idle|MPos:\x9b1,2|\x07>\r\nALARM:\x1b[2J\r\n")

    thread = threading.Thread(target=answer, daemon=True)
    thread.start()
    stated = f'[controller]\nprotocol = "grblhal"\nport = "{os.ttyname(slave)}"\nmax_speed = 0.01\ntimeout = 0.1\n'
    (tmp_path / "rig.toml").write_text(hexapod_layout_rig_toml(0.3, cameras=1) + stated)
    assert "rig status: " in printed("status", tmp_path / "rig.toml")
    os.write(slave, b"q")
    thread.join()
    os.close(master)
    os.close(slave)


def test_what_a_terminal_draws_itself_still_moves_its_cursor(capfd):
    import sys

    out = EscapedStream(sys.stdout)
    assert TerminalBlockDisplay(out)._out is sys.stdout and out.isatty() is False
    out.write("a\x1b\u202eb\tc\r\n\r.\udcff")
    assert capfd.readouterr().out == "a\\x1b\\u202eb\tc\r\n\\x0d.\\xff"


def test_line_ends_and_letters_of_any_script_stay():
    assert escape_unprintable("µm ≥ 5 °\tΔ\n日本") == "µm ≥ 5 °\tΔ\n日本"


@pytest.mark.parametrize(
    "words",
    [
        ("measure", "{}", "--out", "out"),
        ("calibrate", "{}", "--out", "c.json"),
        ("simulate", "rig.toml", "--out", "{}"),
        ("import", "{}/images", "--out", "r"),
    ],
)
def test_a_name_that_is_no_utf_8_is_refused_in_words(tmp_path, printed, words, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = os.fsdecode(b"rec\xff")
    shutil.copytree(ROOT / "tests" / "data" / "bench" / "check", folder)
    assert (
        r"rec\xff" in (message := printed(*(word.format(folder) for word in words)))
        and "is not UTF-8; rename" in message
    )


@pytest.mark.slow
def test_images_and_a_working_folder_whose_names_are_no_utf_8_end_in_words(tmp_path, printed, monkeypatch):
    folder = tmp_path / os.fsdecode(b"here\xff")
    shutil.copytree(ROOT / "tests" / "data" / "bench" / "check", folder)
    monkeypatch.chdir(folder)
    assert "nothing wrong" in printed("check", ".") and "nothing wrong" in printed("check", folder)
    assert "is not UTF-8; rename" in printed("measure", ".", "--out", tmp_path / "out")
    first = sorted(folder.rglob("*.png"))[0]
    os.rename(first, first.with_name(os.fsdecode(b"000\xff.png")))
    assert r"here\xff/images/cam0/00000.png: no such image" in printed("check", folder)
    os.rename(folder, tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here")
    assert "rig import: " in printed(
        "import", "images", "--rig", "rig.toml", "--commands", "commands.csv", "--out", "imported"
    )
