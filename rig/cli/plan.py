"""rig plan: plan a recording.

Which configurations to visit.
For parameters, a promised accuracy, or to separate effects.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion import (
    parse_length,
    parse_length_and_angle,
)
from rig.cli.shared.escaped_output_progress_error_table_and_refutations import Progress
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    SEED,
    add_json_result_option,
    add_overwrite_option,
    add_page_option,
    file_or_stdout,
    page_links,
    page_path,
)
from rig.errors import RigError
from rig.formats.numbers_and_units import parse_whole_number

if TYPE_CHECKING:
    from calib.api.plan_options_and_result import PlanOptions
    from rig.array_and_json_types import Floats
    from rig.model.design import Design
    from rig.recording.recording_folder import Sensors


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig plan` to a parser."""
    parser.add_argument("design", metavar="RIG.toml", type=Path)
    group = parser.add_mutually_exclusive_group(required=True)
    group.add_argument("--for", dest="purpose", choices=("parameters",), help="what the plan is to determine")
    group.add_argument(
        "--separate",
        nargs=2,
        metavar=("EFFECT", "EFFECT"),
        help="which moves distinguish two effects, each written as for "
        "rig simulate --effect, as large as it is expected: OUT gets t,l1..l6 of the best plan",
    )
    group.add_argument(
        "--promise",
        type=parse_length,
        metavar="20um",
        help="the fewest and best poses after which the corrected machine meets this error, "
        "RMS over its workspace; besides those --given the next best ones, in order of benefit",
    )
    group.add_argument(
        "--parts",
        metavar="PARTS",
        help="parts of a plan as for rig simulate --plan, at whose exposures the struts rest, written as "
        "configurations: axes:5,combined:4 goes along and about X, Y and Z, and turns while it moves along each",
    )
    parser.add_argument("--count", type=parse_whole_number, default=60, help="configurations to choose (default 60)")
    parser.add_argument(
        "--criterion",
        choices=("determinant", "noise"),
        default="determinant",
        help="smallest volume of uncertainty (default), or smallest amplification of noise",
    )
    parser.add_argument(
        "--given", metavar="PATH", type=Path, help="visited configurations: a recording, or a table frame,l1..l6"
    )
    parser.add_argument(
        "--sigma",
        nargs=2,
        default=("10um", "100urad"),
        metavar=("10um", "100urad"),
        help="standard deviation of a measured pose, per axis; plain numbers are m and rad (default 10um 100urad)",
    )
    parser.add_argument(
        "--calibration",
        metavar="FILE",
        type=Path,
        help="take the geometry from here, not from RIG.toml, and "
        "exclude configurations whose poses the corrected machine cannot reach",
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=file_or_stdout,
        required=True,
        help="frame,l1..l6, with no frame in rows from which the next is approached; "
        "`rig simulate --plan commands:FILE` runs it",
    )
    add_page_option(parser)
    add_overwrite_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Run `rig plan`.

    Choose configurations to visit and write them.
    """
    page, out = page_path(arguments), arguments.outputs.file(arguments.out)
    from calib.api.plan import plan
    from rig.formats.rig_toml import design_from_rig_toml

    design, progress = design_from_rig_toml.load_design(arguments.design), Progress()
    made = plan(design, _options(arguments, design), progress)
    progress.close()
    made.write(out)
    print("\n".join(filter(None, made.lines())))
    arguments.result = made.tree()
    if page is not None:
        made.write_page(page, str(arguments.out), page_links(arguments, arguments.page))
    unchanged = ", which remains unchanged" if arguments.out.is_file() else ""
    written = f"written: {arguments.out}" if len(made.values) else f"nothing is written to {arguments.out}{unchanged}"
    print(written + (f"; look at {arguments.page}" if page else ""))


def _options(arguments: Namespace, design: Design) -> PlanOptions:
    """Settings of a plan, from the arguments."""
    from calib.api.plan_options_and_result import PlanOptions
    from calib.files import calibration_file

    if arguments.parts and (arguments.given or arguments.calibration):
        raise RigError("--parts are visited as given; --calibration and --given apply to optimised plans")
    return PlanOptions(
        arguments.promise,
        tuple(arguments.separate) if arguments.separate else None,
        arguments.parts,
        arguments.count,
        arguments.criterion,
        parse_length_and_angle(arguments.sigma, "--sigma"),
        _visited(arguments.given, design) if arguments.given else None,
        calibration_file.load(arguments.calibration) if arguments.calibration else None,
        str(arguments.calibration),
        _drawn_log,
    )


def _visited(path: Path, design: Design) -> Floats:
    """(k, axes) m configurations visited: of a recording's frames, or of a table. Raises RigError for a recording of
    another kind of machine
    """
    import rig
    from rig.formats import csv_and_parquet_tables_and_time_origin

    axes = design.mechanism.axes
    if not path.is_dir():
        rows = csv_and_parquet_tables_and_time_origin.read_csv_table(path, ("frame", *axes))
        return rows.matrix(axes)[[bool(frame) for frame in rows.text("frame")]]
    read = rig.load(path)
    if read.design.mechanism.kind != design.mechanism.kind:
        raise RigError(f"{path} is a recording of a mechanism of kind {read.design.mechanism.kind!r}")
    return read.commanded()[2]


def _drawn_log(duration: float) -> Sensors:
    """The sensors' log over a duration (s), as a simulated rig has it."""
    import numpy as np

    from synthetic.random_true_machine_and_truth_file import random_true_and_logged_temperatures

    return random_true_and_logged_temperatures(duration, np.random.default_rng(SEED))[0]
