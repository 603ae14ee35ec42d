"""Exit statuses of the commands: each that a command documents is in the list, in its help and in the documents."""

import re

import pytest

from rig.cli.command_names_groups_summaries_and_exit_statuses import (
    COMMANDS,
    STATUSES,
    exit_status_meanings,
    exit_status_text,
)
from rig.cli.command_parser_execution_and_exit_status import argument_adder_and_runner_of_command, command_line_parser
from tests.conftest import ROOT


@pytest.mark.parametrize("command", COMMANDS)
def test_the_documented_exit_status_of_a_command_is_listed(command):
    run = argument_adder_and_runner_of_command(command)[1]
    documented = [int(status) for status in re.findall(r"[Ee]xit status (\d+)", run.__doc__)]
    listed = [STATUSES[command][0]] if command in STATUSES else []
    assert documented == listed and (run.__annotations__["return"] in (int, "int")) == bool(listed)
    sub = command_line_parser([command])._subparsers._group_actions[0].choices[command]
    assert re.findall(r"[Ee]xit status (\d+)", sub.format_help()) == [str(status) for status in listed]


def test_the_lists_of_help_and_documents_have_every_status():
    page = re.sub(r"\[([^]]+)\]\([^)]+\)", r"\1", (ROOT / "docs" / "files.md").read_text(encoding="utf-8"))
    for status, meaning in exit_status_meanings().items():
        assert f"| `{status}` | {meaning} |\n" in page
        assert f"  {status:<8}  {meaning[:10].replace('`', '')}" in exit_status_text(80)
    assert {str(status) for status, _ in STATUSES.values()} < set(exit_status_meanings())
    assert [command for command in STATUSES if f"`rig {command}`" not in "".join(exit_status_meanings().values())] == []
