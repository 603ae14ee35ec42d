"""rig simulate: simulate a recording.

Under a plan or from a diagnosis.
Its truth is written separately.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared import input_file_options_and_loading
from rig.cli.shared.escaped_output_progress_error_table_and_refutations import Progress
from rig.cli.shared.shared_output_controller_hand_and_worker_options import add_overwrite_option
from rig.errors import RigError
from rig.formats.numbers_and_units import parse_number, parse_whole_number

if TYPE_CHECKING:
    from synthetic.api import SimulateOptions

SENSOR = {
    "blur": "px, standard deviation of the optics' spot",
    "defocus": "px, radius of a disc on top of it",
    "vignetting": "share of the light lost in the corners",
    "gain": "grey levels of a white face in full light",
    "exposure": "s",
    "exposures": "pictures averaged over the exposure",
    "read_noise": "grey levels",
    "electrons": "per grey level, for shot noise",
    "bits": "8 or 12",
}


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig simulate` to a parser."""
    parser.add_argument("design", metavar="RIG.toml", type=Path, nargs="?")
    parser.add_argument(
        "--from",
        dest="source",
        metavar="DIR",
        type=Path,
        help="simulate a diagnosed recording instead: DIR is what rig diagnose "
        "wrote; OUT gets two recordings, with/ and without/ the identified effects",
    )
    parser.add_argument(
        "--plan",
        default="standard",
        help="of sobol:N, division:Q, grid:N, simplices:N, axes:N, "
        "combined:N, ladder:N, payload:N, moving:N, zigzag:N, warmup:N, repeat:N, dwell:N, wait:MINUTES, "
        "iso9283:CYCLES, "
        "turn:CUBE (before all others: that cube is put back turned by a quarter turn), commands:FILE; or "
        "standard (the default)",
    )
    parser.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="NAME:PLACE:PARAMETER=VALUE,..",
        help="unmodelled effect, as NAME:strut3:gap=80um; a plain number is in the SI unit; may be repeated",
    )
    input_file_options_and_loading.add_user_effect_files_option(parser)
    parser.add_argument(
        "--noise", type=parse_number, default=0.04, metavar="PX", help="of corners, standard deviation (default 0.04)"
    )
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--images", action="store_true", help="draw images (needs OpenGL)")
    kind.add_argument("--corners", action="store_true", help="write corners.csv (the default)")
    parser.add_argument(
        "--seed",
        type=parse_whole_number,
        default=0,
        help="of the secret machine, the poses, the temperatures and the noise",
    )
    parser.add_argument(
        "--secret",
        type=parse_number,
        default=1.0,
        metavar="SIZE",
        help="size of the geometry's and cameras' errors (default 1)",
    )
    parser.add_argument(
        "--machine", type=Path, metavar="TRUTH", help="take the machine, its cameras and effects from this truth file"
    )
    parser.add_argument(
        "--sensors",
        metavar="FILE",
        type=Path,
        help="sensors.csv of temperatures and payload, in place of simulated ones",
    )
    parser.add_argument("--out", metavar="REC", type=Path, required=True)
    parser.add_argument("--truth", metavar="FILE", type=Path, help="write the truth here (JSON)")
    parser.add_argument("--background", choices=("plain", "cluttered"), default="plain")
    parser.add_argument(
        "--compression",
        type=parse_whole_number,
        default=1,
        choices=range(10),
        metavar="0..9",
        help="of the PNG files (default 1)",
    )
    add_overwrite_option(parser)
    for name, text in SENSOR.items():
        parser.add_argument(
            "--" + name.replace("_", "-"),
            type=parse_whole_number if name in ("bits", "exposures") else parse_number,
            help=text,
        )


def run(arguments: Namespace) -> None:
    """Run `rig simulate`.

    Simulate a recording and write it, its truth apart.
    """
    if arguments.source is not None:
        return _draw_anew(arguments)
    if arguments.design is None:
        raise RigError("simulating requires a RIG.toml, or --from with the folder of a diagnosis")
    from synthetic.api import simulate

    _protect_inputs(arguments)
    done, progress = simulate(arguments.design, _options(arguments)), Progress()  # what is wrong with it is said first
    out = arguments.outputs.folder(arguments.out)
    truth = arguments.outputs.file(arguments.truth) if arguments.truth else None
    done.write(out, lambda k, of: progress("drawing", k, of))
    if truth is not None:
        done.write_truth(truth)
    print(f"{done}; written: {arguments.out}" + (f", truth in {arguments.truth}" if truth else ""))


def _options(arguments: Namespace) -> SimulateOptions:
    """How a recording is simulated, by the arguments."""
    from synthetic.api import ImageOptions, SimulateOptions

    changed = tuple((name, getattr(arguments, name)) for name in SENSOR if getattr(arguments, name) is not None)
    return SimulateOptions(
        arguments.plan,
        tuple(arguments.effect),
        input_file_options_and_loading.known_effects(input_file_options_and_loading.load_effect_files(arguments)),
        arguments.noise,
        arguments.seed,
        arguments.secret,
        arguments.machine,
        arguments.sensors,
        arguments.images,
        ImageOptions(changed, arguments.background, arguments.compression),
    )


def _protect_inputs(arguments: Namespace) -> None:
    """Protect what is read without being named as a path, and have the recording's manifest state nothing of its
    truth.
    """
    outputs = arguments.outputs
    if (arguments.design.parent / "frames.csv").exists():
        outputs.inputs.append(arguments.design.parent)
    outputs.inputs += [
        Path(part.removeprefix("commands:")) for part in arguments.plan.split(",") if part.startswith("commands:")
    ]
    outputs.arguments = (str(arguments.design), "--plan", arguments.plan)


def _draw_anew(arguments: Namespace) -> None:
    """Draw a diagnosed recording anew, with and without what was found."""
    if arguments.design is not None or arguments.machine or arguments.effect or arguments.sensors:
        raise RigError(
            "--from has its own rig, machine, effects and sensors; omit RIG.toml, --machine, --effect and --sensors"
        )
    from synthetic.api import simulate_with_and_without_findings

    out = arguments.outputs.folder(arguments.out)
    done = simulate_with_and_without_findings(arguments.source, _options(arguments))
    for kind, part in done.items():
        part.write(out / kind)
    found = done["with"]
    names = ", ".join(f"{effect.name} at {effect.place}" for effect in found.effects) or "none was found"
    print(
        f"{len(found.simulation.plan.t)} frames, effects: {names}; written: {arguments.out / 'with'} and "
        f"{arguments.out / 'without'}"
    )
