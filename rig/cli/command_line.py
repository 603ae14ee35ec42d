"""Entry points of the command line rig.

`rig stop` begins before the command line itself is imported, with what imports nothing that takes time.
"""

from __future__ import annotations

import os
import sys

TYPE_CHECKING = False  # typing would take time
if TYPE_CHECKING:
    from typing import NoReturn


def main(argv: list[str] | None = None) -> int:
    """Run one command.

    Returns the exit status, one of `rig.cli.command_names_groups_summaries_and_exit_statuses.exit_status_meanings`
    Raises SystemExit where help was asked for or the usage is wrong
    """
    words, begun = sys.argv[1:] if argv is None else argv, None
    if words[:1] == ["stop"]:
        from rig.cli.urgent_stop_before_slow_imports import begin_urgent_stop_or_return_error

        begun = begin_urgent_stop_or_return_error(words[1:])
    from rig.cli.command_parser_execution_and_exit_status import run_command_line_words

    return run_command_line_words(words, main, begun)


def run_script() -> NoReturn:
    """Entry point of the `rig` script.

    Run `main` and end the process with its exit status.

    Products of matrices take one thread unless the environment says otherwise: several wait for each other, for cores
    that other processes use, ten times as long as they save.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    status = main()
    if status > 128:
        os._exit(status)
    sys.exit(status)
