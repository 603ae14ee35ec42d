"""rig emulate: emulate a controller.

At a pseudo-terminal or over TCP, with faults on request.
"""

from __future__ import annotations

import signal
import tempfile
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.errors import RigError
from rig.formats.numbers_and_units import parse_number, parse_whole_number
from rig.model.protocol_port_and_user_program_name_checks import PROTOCOLS

if TYPE_CHECKING:
    from synthetic.emulated_camera_images_sensors_and_server_process import EmulatedCameraProcess


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig emulate` to a parser."""
    parser.add_argument(
        "design",
        metavar="RIG.toml",
        type=Path,
        nargs="?",
        help="the rig; with --conform by default a hexapod, of urscript an arm",
    )
    parser.add_argument(
        "--protocol",
        metavar="NAME",
        help=f"{', '.join(PROTOCOLS)}, or a file of your own, mine.py; by default as stated in [controller] of the "
        "rig.toml",
    )
    parser.add_argument(
        "--conform",
        action="store_true",
        help="test the protocol: its driver against its emulator, through every fault, stops, restarts and cut lines",
    )
    parser.add_argument(
        "--moves", type=parse_whole_number, default=300, metavar="N", help="of --conform, with all faults at 5 %%"
    )
    parser.add_argument(
        "--new", metavar="NAME", help="write NAME.py, a protocol of your own with its emulator, to begin with"
    )
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="KIND[:RATE]",
        help="a fault seen in the field: once, at the next move, or at a rate per move; all:RATE for all kinds; "
        "may be repeated; "
        "--fault list names them",
    )
    parser.add_argument(
        "--tcp",
        metavar="[HOST:]PORT",
        help="listen there instead of at a pseudo-terminal (port 0: any; host 127.0.0.1)",
    )
    parser.add_argument("--link", metavar="PATH", type=Path, help="maintain a symbolic link to the pseudo-terminal")
    parser.add_argument(
        "--speed",
        type=parse_number,
        default=1.0,
        metavar="N",
        help="axes N times as fast as [controller] states (default 1)",
    )
    parser.add_argument(
        "--start",
        metavar="300mm,..",
        help="initial lengths or angles, one for every axis (plain numbers are in m, of joints in rad; default: home)",
    )
    parser.add_argument(
        "--history",
        metavar="FILE",
        type=Path,
        help="write the true commands of the axes, as commands.csv, continuously",
    )
    parser.add_argument(
        "--cameras",
        metavar="[HOST:]PORT",
        help="render the camera images and emulate the sensors there (port 0: any); "
        'rig.toml: source = "emulator:HOST:PORT", [sensors] port = "socket://HOST:PORT", ask = "sensors"',
    )
    parser.add_argument(
        "--truth",
        metavar="FILE",
        type=Path,
        help="the machine, its cameras and effects as rig simulate --truth wrote them, "
        "for --cameras (default: all as RIG.toml states)",
    )
    parser.add_argument(
        "--seed", type=parse_whole_number, default=0, help="of the faults, the temperatures and the noise of images"
    )


def run(arguments: Namespace) -> None:
    """Run `rig emulate`.

    Emulate a controller until interrupted, test a protocol, or write one to begin with.
    """
    if arguments.new is not None:
        return _new(arguments)
    if arguments.design is not None and arguments.design.suffix == ".py":
        raise RigError(f"{arguments.design} is a protocol: it is given by --protocol {arguments.design}")
    if arguments.conform:
        return _conform(arguments)
    if arguments.fault == ["list"]:
        return _list_faults()
    if arguments.design is None:
        raise RigError("rig emulate takes a RIG.toml, whose axes it emulates")
    _emulate(arguments)


def _list_faults() -> None:
    """Print the kinds of faults."""
    from rig.driving.emulators.emulated_axis_motion_and_controller_faults import KINDS

    for kind, text in KINDS.items():
        print(f"{kind:17} {text}")


def _emulate(arguments: Namespace) -> None:
    """Emulate a controller until interrupted."""
    from rig.driving import emulators
    from rig.driving.driving_clock import SystemClock
    from rig.driving.emulators import emulator_opening_and_serving_over_terminal_or_tcp
    from rig.driving.emulators.emulator_opening_and_serving_over_terminal_or_tcp import emulator_of_rig_toml_controller
    from rig.formats.rig_toml.design_from_rig_toml import load_design

    clock = SystemClock()
    if arguments.truth and not arguments.cameras:
        raise RigError("--truth is for --cameras, which show the true machine")
    options = emulator_opening_and_serving_over_terminal_or_tcp.EmulatorOptions(
        _protocol(arguments), tuple(arguments.fault), arguments.seed, arguments.start, arguments.speed
    )
    emulator = emulator_of_rig_toml_controller(arguments.design, options, clock)
    wire = (
        emulator_opening_and_serving_over_terminal_or_tcp.tcp_server_for_emulator(
            emulator, _address(arguments.tcp, "--tcp")
        )
        if arguments.tcp is not None
        else emulator_opening_and_serving_over_terminal_or_tcp.Terminal(arguments.link)
    )
    scratch = tempfile.TemporaryDirectory(
        prefix="rig-emulate-"
    )  # of what the cameras follow, where nobody else wants it
    followed = arguments.history or (Path(scratch.name) / "history.csv" if arguments.cameras else None)
    names = load_design(arguments.design).mechanism.axes
    history = emulators.TrueCommandsLog(emulator, followed, names) if followed else None
    cameras = _cameras(arguments, followed) if followed and arguments.cameras else None
    for ending in (signal.SIGINT, signal.SIGTERM):  # a shell's background job ignores the first
        signal.signal(ending, signal.default_int_handler)
    try:
        emulator_opening_and_serving_over_terminal_or_tcp.serve_emulator(
            emulator, wire, lambda: True, _print_port, history.record if history else lambda: None
        )
    except KeyboardInterrupt:
        print(f"{len(emulator.machine.executed)} moves executed; faults: {', '.join(emulator.faults.struck) or 'none'}")
    finally:
        wire.close()
        if cameras:
            cameras.close()
        if history:
            history.close()
        scratch.cleanup()


def _protocol(arguments: Namespace) -> str | None:
    """The protocol that is asked for, as a rig.toml would state it; None for the rig.toml's own. Raises RigError."""
    stated: str | None = arguments.protocol
    if stated is None or stated in PROTOCOLS or stated.startswith("package:"):
        return stated
    path = Path(stated.removeprefix("file:"))
    if path.suffix != ".py":
        raise RigError(f"--protocol takes {', '.join(PROTOCOLS)}, FILE.py or package:NAME, not {stated!r}")
    return f"file:{path}"


def _conform(arguments: Namespace) -> None:
    """Print each check of a protocol. Raises RigError where one is not passed."""
    from rig.driving.emulators.protocol_conformance_checks_against_emulator import (
        check_protocol_conformance,
        protocol_conformance_design,
    )

    design = protocol_conformance_design(arguments.design, _protocol(arguments))
    protocol = _protocol(arguments) or (design.driver().protocol if arguments.design else None)
    if protocol is None:
        raise RigError("--conform takes a RIG.toml, or --protocol mine.py")
    failed = count = 0
    for check in check_protocol_conformance(design, protocol, arguments.moves, arguments.seed):
        failed, count = failed + bool(check.problem), count + 1
        print(f"{'FAILED' if check.problem else 'passed'}  {check.name}: {check.problem or check.found}", flush=True)
    if failed:
        raise RigError(f"{failed} of {count} checks failed: this protocol is not safe to drive a machine with")
    print(f"all {count} checks passed")


def _new(arguments: Namespace) -> None:
    """Write a protocol with its emulator."""
    from importlib.resources import files

    from rig.formats.output_files import write_text

    name = arguments.new.removesuffix(".py")
    if not name.isidentifier():
        raise RigError(f"--new takes a name of letters, digits and underscores, not {arguments.new!r}")
    text, path = (
        files("rig.driving").joinpath("example_user_protocol_with_emulator.py").read_text(encoding="utf-8"),
        name + ".py",
    )
    write_text(arguments.outputs.file(Path(path)), text)
    print(f"written: {path}; rig emulate --conform --protocol {path} tests it")


def _cameras(arguments: Namespace, followed: Path) -> EmulatedCameraProcess:
    """The process that draws; its address is printed."""
    from synthetic.emulated_camera_images_sensors_and_server_process import EmulatedCameraProcess

    cameras = EmulatedCameraProcess(
        arguments.design, arguments.truth, followed, _address(arguments.cameras, "--cameras"), arguments.seed
    )
    print(f"cameras {cameras.name}", flush=True)
    return cameras


def _print_port(name: str) -> None:
    print(f"port {name}", flush=True)


def _address(text: str, option: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not port.isdigit() or int(port) > 65535:
        raise RigError(f"{option} takes [HOST:]PORT, not {text!r}")
    return host or "127.0.0.1", int(port)
