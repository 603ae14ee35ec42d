"""docs/commands.md: what `rig COMMAND --help` says, of every command.

`python -m docs.make.commands > docs/commands.md`
"""

import argparse

from docs.make.field_texts import in_cell
from rig.cli.command_names_groups_summaries_and_exit_statuses import GROUPS, STATUSES
from rig.cli.command_parser_execution_and_exit_status import argument_adder_and_runner_of_command
from rig.cli.shared.shared_output_controller_hand_and_worker_options import SHARED, add_worker_options

HEAD = """# The commands

Made from the commands themselves (`python -m docs.make.commands`); `rig COMMAND --help` says the same.
A recording is a folder ([its tables](tables.md), [rig.toml](rig-toml.md)). Its tables
are in SI units and radians; figures are printed in millimetres and milliradians. [What commands \
write](files.md) lists the exit statuses, and what
commands never write over.
"""


def page() -> str:
    """The page in Markdown."""
    parts = [HEAD]
    for group, name, words in [(group, *entry) for group, commands in GROUPS.items() for entry in commands.items()]:
        parser = argparse.ArgumentParser(prog=f"rig {name}", add_help=False, formatter_class=_Plain)
        argument_adder_and_runner_of_command(name)[0](parser)
        if name in SHARED:
            add_worker_options(parser)
        usage = "\n".join(f"    {line}" for line in parser.format_usage().removeprefix("usage: ").rstrip().splitlines())
        parts.append(f"\n## rig {name}\n\n{in_cell(words)} Group: {group}.\n\n{usage}\n")
        if name in STATUSES:
            parts.append("\nExit status {} if {}, otherwise 0.\n".format(*STATUSES[name]))
        rows = [_row(action) for action in parser._actions if action.help != argparse.SUPPRESS]
        if rows:
            parts.append("\n| argument | what |\n|---|---|\n" + "\n".join(rows) + "\n")
    return "".join(parts)


class _Plain(argparse.HelpFormatter):
    """Usage lines as wide as a page."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, width=100)


def _row(action: argparse.Action) -> str:
    names = ", ".join(action.option_strings) or str(action.metavar or action.dest)
    value = "" if action.nargs == 0 or not action.option_strings else f" {_value(action)}"
    words = (action.help or "") % {**vars(action), "prog": "rig"}
    stated = (
        isinstance(action.default, str | int | float)
        and not isinstance(action.default, bool)
        and action.default not in ("", argparse.SUPPRESS)
    )
    default = (
        f" (default {action.default})"
        if stated and "default" not in words and f"({action.default})" not in words
        else ""
    )
    return f"| `{names}{value}` | {in_cell(words)}{in_cell(default)} |".replace("| ``", "| `")


def _value(action: argparse.Action) -> str:
    if action.metavar is not None:
        return action.metavar if isinstance(action.metavar, str) else " ".join(action.metavar)
    return "{" + ",".join(map(str, action.choices)) + "}" if action.choices is not None else action.dest.upper()


if __name__ == "__main__":
    print(page(), end="")
