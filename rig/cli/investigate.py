"""rig investigate: investigate a machine's errors.

Plan, record and diagnose in a loop.
Until nothing is ambiguous; then it calibrates and certifies.
"""

import re
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path

from calib.experiment import FIRST, LOADED, STANDING
from rig.cli.shared.shared_output_controller_hand_and_worker_options import SEED, add_json_result_option
from rig.formats.numbers_and_units import parse_whole_number


def parse_minutes(text: str) -> float:
    """Parse a duration such as 2h or 90min, in minutes.

    Raises ArgumentTypeError for anything else
    """
    found = re.fullmatch(r"([0-9]{1,4}(?:\.[0-9]{1,3})?)(h|min)", text)
    value = float(found[1]) * (60 if found[2] == "h" else 1) if found else 0.0
    if not 0 < value <= 6000:
        raise ArgumentTypeError(f"{text!r} must be a time of the rig above 0 and up to 100h, as 2h or 90min")
    return value


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig investigate` to a parser."""
    parser.add_argument("design", metavar="RIG.toml", type=Path)
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        required=True,
        help="recordings, diagnoses, plans, notebook.md and notebook.html, and at "
        "the end calibration.json and certificate; a new folder, or with --resume the one to continue",
    )
    parser.add_argument(
        "--budget", metavar="2h", type=parse_minutes, default=120.0, help="of the rig's time (default 2h)"
    )
    who = parser.add_mutually_exclusive_group()
    who.add_argument(
        "--machine",
        metavar="TRUTH",
        type=Path,
        help="a simulated machine, as rig simulate --machine takes it, instead of [controller]",
    )
    who.add_argument(
        "--by-hand", action="store_true", help="an operator makes the moves: each plan is written and awaited"
    )
    parser.add_argument(
        "--plan",
        help=f"the first one (default {FIRST}, and {LOADED} where rig.toml allows a payload; where the "
        f"struts must stand {STANDING})",
    )
    parser.add_argument(
        "--seed", type=parse_whole_number, default=SEED, help="of plans, and of a simulated machine's noise"
    )
    parser.add_argument(
        "--verify",
        metavar="N",
        type=parse_whole_number,
        default=60,
        help="new poses by which the calibration is verified (default 60, which a certificate requires)",
    )
    parser.add_argument("--port", help="controller address, instead of the one in [controller]")
    parser.add_argument("--settle", default="time:1", metavar="HOW", help="as for rig run")
    parser.add_argument("--no-home", action="store_true", help="as for rig run")
    parser.add_argument("--resume", action="store_true", help="resume DIR, whatever interrupted it")
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Run `rig investigate`.

    Plan, record and diagnose in a loop, then calibrate and certify.
    """
    from calib.api.investigate import investigate
    from calib.experiment.investigation_plan_execution import InvestigateOptions

    options = InvestigateOptions(
        arguments.budget,
        arguments.machine,
        arguments.by_hand,
        arguments.plan,
        arguments.seed,
        arguments.verify,
        arguments.port,
        arguments.settle,
        arguments.no_home,
        arguments.resume,
    )
    result = investigate(arguments.design, arguments.out, arguments.call, options)
    arguments.result = result.tree()
    print(result)
    if result.waiting is None:
        print(f"{result.ended}; look at {arguments.out / 'notebook.html'}")
