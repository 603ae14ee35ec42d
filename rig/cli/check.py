"""rig check: check a recording for mistakes.

It prints them, the likeliest cause first.
"""

import argparse
from pathlib import Path

from rig.cli.shared.shared_output_controller_hand_and_worker_options import add_json_option, print_json


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `rig check` to a parser."""
    parser.add_argument("recording", metavar="REC", type=Path)
    parser.add_argument(
        "--detect", action="store_true", help="read some images even if corners.csv exists, and compare both"
    )
    add_json_option(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run `rig check`.

    Check a recording for mistakes and print them.

    Exit status 1 where results would mean nothing.
    """
    from calib.api.recording_check_combination_and_view import check

    found = check(arguments.recording, arguments.detect)
    if arguments.json:
        print_json(found.tree())
    else:
        print("\n".join(found.lines()))
    return int(not found.usable)
