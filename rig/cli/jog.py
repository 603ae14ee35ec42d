"""rig jog: move struts once.

By a distance or to given lengths, checked as any move; nothing is interactive.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from rig.cli.shared.common_options import add_controller_arguments, add_speed_option, add_trust_unhomed_position_option
from rig.cli.shared.option_value_parsing import require_share
from rig.errors import PositionLost, RigError
from rig.formats.numbers_and_units import parse_number, parse_numbers, parse_whole_number

if TYPE_CHECKING:
    from rig.array_and_json_types import Floats


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig jog` to a parser."""
    add_controller_arguments(parser)
    parser.add_argument(
        "--strut",
        type=parse_whole_number,
        action="append",
        metavar="N",
        help="1.. (may be repeated; by default all of them)",
    )
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--by", type=parse_number, metavar="MM", help="longer by this amount")
    where.add_argument("--to", metavar="MM,MM,..", help="to these lengths, one for every strut")
    add_speed_option(parser, 0.25)
    parser.add_argument(
        "--unlock",
        action="store_true",
        help="clear the controller's alarm first; its position is then trusted with --trust only",
    )
    add_trust_unhomed_position_option(parser)


def run(arguments: Namespace) -> None:
    """Run `rig jog`.

    Jog struts, checked as any move.
    """
    import numpy as np

    from rig.cli.shared.run_display_and_controller_status import print_status
    from rig.driving.driver_opening_and_settling import design_with_controller_port, open_driver

    design = design_with_controller_port(arguments.design, arguments.port)
    count = len(design.mechanism.axes)
    struts = arguments.strut or list(range(1, count + 1))
    if not all(1 <= strut <= count for strut in struts):
        raise RigError(f"--strut takes 1 .. {count}, got {', '.join(map(str, struts))}")
    require_share(arguments.speed)
    if arguments.to and arguments.strut:
        raise RigError("--to states every strut's length; omit --strut")
    with open_driver(design, arguments.trace, print) as driver:
        if arguments.unlock:
            driver.unlock()
        if arguments.trust:
            driver.trust()
        if not driver.status().known:
            raise PositionLost(
                "the position of the struts is not known, and so not their remaining travel; home them, or use --trust"
            )
        goal = (
            _lengths(arguments.to, count)
            if arguments.to
            else driver.lengths() + arguments.by * 1e-3 * np.isin(np.arange(1, count + 1), struts)
        )
        driver.move(goal, arguments.speed)
        print_status(driver.status(), design)


def _lengths(text: str, count: int) -> Floats:
    """(count,) m of lengths in mm separated by commas."""
    import numpy as np

    try:
        values = np.array(parse_numbers(text.split(","))) * 1e-3
    except ValueError:
        values = np.zeros(0)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise RigError(f"--to takes {count} lengths in mm separated by commas, got {text!r}")
    return values
