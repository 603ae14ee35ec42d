"""The pages hold to the code: references are whole and current, every command in them is one, the site builds and needs
no network.
"""

import argparse
import ast
import re
import shutil
import sys
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import get_args

import pytest

from docs.make import commands, messages, rig_toml, tables
from rig.cli.command_names_groups_summaries_and_exit_statuses import COMMANDS
from rig.cli.command_parser_execution_and_exit_status import (
    argument_adder_and_runner_of_command,
    join_command_words_and_find_earlier_name,
)
from rig.cli.shared.shared_output_controller_hand_and_worker_options import add_common_options
from rig.errors import FileError
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism
from rig.recording.recording_folder import load_recording
from tests.docs import document_commands

ROOT = document_commands.ROOT
READERS = ("text", "number", "whole", "array", "pose", "each", "identifier", "get", "flag")


def test_rig_toml_is_current():
    assert (ROOT / "docs" / "rig-toml.md").read_text(encoding="utf-8") == rig_toml.page(), (
        "python -m docs.make.rig_toml > docs/rig-toml.md"
    )


def test_tables_are_current():
    assert (ROOT / "docs" / "tables.md").read_text(encoding="utf-8") == tables.page(), (
        "python -m docs.make.tables > docs/tables.md"
    )


@pytest.mark.skipif(sys.version_info[:2] != (3, 11), reason="argparse lays out usage as its Python does; 3.11 made it")
def test_commands_are_current():
    assert (ROOT / "docs" / "commands.md").read_text(encoding="utf-8") == commands.page(), (
        "python -m docs.make.commands > docs/commands.md"
    )


def keys_read() -> set[str]:
    """Keys that stand as words in the reader's own calls."""
    found = set()
    for path in (ROOT / "rig" / "formats" / "rig_toml").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Attribute)
                and node.func.attr in READERS
                and node.args
                and isinstance(node.args[0], ast.Constant)
            ):
                found.add(node.args[0].value)
    return found - {"schema", "kind"}


def test_every_key_that_the_reader_names_is_on_the_page_and_told():
    rows = dict(re.findall(r"^\| `(\w+)` \|.*\| (.*) \|$", rig_toml.page(), re.MULTILINE))
    assert len(keys_read()) > 50 and keys_read() - set(rows) == set()
    assert [key for key, words in rows.items() if not words] == []


def test_every_kind_of_mechanism_is_on_the_page():
    assert [
        kind.kind
        for kind in get_args(Mechanism)
        if not re.search(rf'^## \[mechanism\] kind = "{kind.kind}(:NAME.py)?"$', rig_toml.page(), re.MULTILINE)
    ] == []


def test_every_file_of_a_recording_is_on_the_page():
    assert {
        part for part in re.findall(r'"(\w+\.csv)"', (ROOT / "rig" / "recording" / "recording_folder.py").read_text())
    } == set(tables.requested_columns())


@cache
def messages_of_files() -> list[messages.Message]:
    """The longer messages of the readers of files."""
    return [m for m in messages.messages() if m.kind == "FileError" and len(m.words) > 20]


def refusal(folder: Path) -> str:
    with pytest.raises(FileError) as refused:
        load_recording(folder)
    return str(refused.value)


@pytest.mark.parametrize(
    "file, header, row",
    [
        ("commands.csv", "t,l1", "0,0.4"),
        ("commands.csv", "t,l1,l2,l3,l4,l5,l6", "0,0.4,0.4,0.4,0.4,0.4,0.4"),
        ("frames.csv", "frame,t,camera", "0,0,cam0"),
        ("frames.csv", "frame,t,camera,image", "0,1,nobody,"),
        ("corners.csv", "frame,camera,marker,corner,u,v", "0,cam0,999,0,1,1"),
    ],
)
def test_a_message_that_is_met_is_found_on_the_page(tmp_path, file, header, row):
    folder = tmp_path / "rec"
    shutil.copytree(ROOT / "tests" / "data" / "bench" / "check", folder)
    (folder / file).write_text(f"{header}\n{row}\n")
    met = refusal(folder)
    on_the_page = [m.words for m in messages_of_files() if all(part in met for part in m.words.split(".."))]
    assert on_the_page, met


def test_every_kind_of_error_and_every_mistake_is_told():
    assert set(messages.ADVICE) == set(messages.error_kinds())
    listed = list(messages.messages())
    assert len(listed) > 300 and {m.kind for m in listed} <= set(messages.ADVICE)
    assert len(set(messages.mistakes())) > 40 and all(m.do for m in messages.mistakes())


def parsed(words: list[str]) -> argparse.Namespace:
    words, parser = join_command_words_and_find_earlier_name(words)[0], argparse.ArgumentParser(exit_on_error=False)
    argument_adder_and_runner_of_command(words[0])[0](parser)
    add_common_options(parser, words[0])
    return parser.parse_args(words[1:])


@pytest.mark.parametrize("page", document_commands.PAGES, ids=lambda path: path.name)
def test_every_command_in_the_pages_is_one(page, capsys):
    wrong = []
    for command in document_commands.commands(page):
        try:
            parsed(document_commands.words(command))
        except (argparse.ArgumentError, SystemExit, ModuleNotFoundError) as error:
            wrong.append(f"{command}: {error} {capsys.readouterr().err}")
    assert wrong == []


def test_pages_tell_enough_commands_for_that_to_mean_something():
    assert sum(len(document_commands.commands(page)) for page in document_commands.PAGES) > 60


def test_every_page_that_commands_write_is_pictured():
    code = [
        path.read_text(encoding="utf-8")
        for name in ("rig", "calib", "synthetic")
        for path in (ROOT / name).rglob("*.py")
    ]
    kinds = set(re.findall(r'Page\(\s*"(\w+)"', "".join(code)))
    pictures = {path.stem: path.stat().st_size for path in (ROOT / "docs" / "pages").glob("*.webp")}
    assert len(kinds) > 12 and set(pictures) == kinds | {"run", "index"}, "python -m docs.make.pictures"
    page = (ROOT / "docs" / "pages.md").read_text(encoding="utf-8")
    assert [name for name in pictures if f"](pages/{name}.webp)" not in page] == [] and sum(pictures.values()) < 2e6


def test_all_commands_are_on_the_page_of_commands():
    page = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    assert [name for name in COMMANDS if f"\n## rig {name}\n" not in page] == []


class Loads(HTMLParser):
    """from_elsewhere : what a page would fetch from another host"""

    def __init__(self):
        super().__init__()
        self.from_elsewhere = []

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        place = (
            given.get("src") or (given.get("href") if tag == "link" and given.get("rel") != "canonical" else None) or ""
        )
        if re.match(r"(https?:)?//", place):
            self.from_elsewhere.append(place)


@pytest.mark.slow
def test_the_site_builds_with_no_broken_link_and_loads_nothing_from_elsewhere(site):
    pages = list(site.glob("*.html"))
    assert {"index.html", "commands.html", "troubleshooting.html", "api.html", "rig-toml.html"} <= {
        page.name for page in pages
    }
    for page in pages:
        loads = Loads()
        loads.feed(page.read_text(encoding="utf-8"))
        assert loads.from_elsewhere == [], page.name
    assert not re.search(
        r"url\((https?:)?//", "".join(path.read_text(encoding="utf-8") for path in site.rglob("*.css"))
    )


@pytest.mark.slow
def test_formulae_are_drawn_by_the_browser_itself(site):
    text = (site / "mathematics.html").read_text(encoding="utf-8")
    assert text.count("<math") > 50 and "arithmatex" not in text and '<span class="number">(12)</span>' in text
