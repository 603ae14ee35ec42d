"""--next FILE: the plan of the experiment that would best tell apart what a diagnosis leaves alike."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.command_options import SEED
from rig.errors import RigError
from rig.formats.number_parsing_and_rounding import parse_number

if TYPE_CHECKING:
    from calib.api.experiment_options import ExperimentOptions


def arguments(parser: ArgumentParser) -> None:
    """Add --next, how long it may take and what it may do."""
    parser.add_argument(
        "--next",
        metavar="FILE",
        type=Path,
        help="write the plan of the experiment that would best tell apart what is "
        "still alike (frame,t,payload_mass_kg,l1..l6; `rig simulate --plan commands:FILE` tries it); "
        "next.json says its chance",
    )
    parser.add_argument(
        "--minutes",
        metavar="MIN",
        type=parse_number,
        default=60.0,
        help="for --next: that the experiment may take (default 60)",
    )
    parser.add_argument(
        "--may",
        action="append",
        metavar="payload|wait|'turn cube NAME'",
        help="for --next: what may be asked of an operator, in "
        "place of what rig.toml says under [experiment]; may be given again",
    )
    parser.add_argument(
        "--standing",
        action="store_true",
        help="for --next: only plans at whose exposures the struts stand, as rig run takes them",
    )


def experiment_options(arguments: Namespace) -> ExperimentOptions | None:
    """What the next experiment may take, None where none is asked for. Raises RigError for what cannot be meant"""
    from calib.api.experiment_options import ExperimentOptions

    may = None if arguments.may is None else tuple(arguments.may)
    found = ExperimentOptions(arguments.minutes, may, arguments.standing, SEED + 1 + len(arguments.further))
    if arguments.next is None and (arguments.standing or arguments.may):
        raise RigError("--standing and --may are for --next FILE")
    return None if arguments.next is None else found
