"""rig correct serve: serve corrected commands for wanted poses.

It answers on a loopback port, for programs of this computer.
"""

from __future__ import annotations

import signal
from argparse import ArgumentParser, Namespace
from pathlib import Path

from rig.cli.shared import input_options, refutation_printing_and_writing
from rig.formats.numbers_and_units import parse_whole_number


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig correct serve` to a parser."""
    parser.add_argument("calibration", metavar="CALIBRATION", type=Path)
    parser.add_argument("--port", type=parse_whole_number, default=0, metavar="PORT", help="0 (the default): any free")
    parser.add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS", help="an address of the loopback (default 127.0.0.1)"
    )
    input_options.add_user_effect_files_option(parser)


def run(arguments: Namespace) -> None:
    """Run `rig correct serve`.

    Answer until interrupted or terminated.
    """
    from calib.api.correction_server import CorrectionServer

    calibration = input_options.calibration_of_arguments(arguments)
    refutation_printing_and_writing.read_and_print_refutations(arguments.calibration)
    for ending in (signal.SIGINT, signal.SIGTERM):  # a shell's background job ignores the first
        signal.signal(ending, signal.default_int_handler)
    server = CorrectionServer(calibration, arguments.host, arguments.port)
    try:
        print(f"serving {server.address[0]} port {server.address[1]}", flush=True)
        server.serve(lambda: True)
    except KeyboardInterrupt:
        print("ended")
    finally:
        server.close()
