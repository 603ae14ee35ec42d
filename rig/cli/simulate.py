"""rig simulate: simulate a recording under a plan, or from a diagnosis; its truth is written separately."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared import calibration_and_effect_files
from rig.cli.shared.command_options import Progress, add_overwrite_option
from rig.errors import RigError
from rig.formats.number_parsing_and_rounding import parse_number, parse_whole_number

if TYPE_CHECKING:
    from rig.model.design import Sensor

LARGEST_SETTING = 1e6  # of a simulated sensor
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
    """Add this command's arguments to a parser."""
    parser.add_argument("design", metavar="RIG.toml", type=Path, nargs="?")
    parser.add_argument(
        "--from",
        dest="source",
        metavar="DIR",
        type=Path,
        help="draw a diagnosed recording anew instead: DIR is what rig diagnose "
        "wrote; OUT gets two recordings, with/ and without/ the physics that was found",
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
        help="left-out physics; may be repeated",
    )
    calibration_and_effect_files.add_effects_option(parser)
    parser.add_argument(
        "--noise", type=parse_number, default=0.04, metavar="PX", help="of corners, standard deviation (default 0.04)"
    )
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--images", action="store_true", help="draw images (needs OpenGL)")
    kind.add_argument("--corners", action="store_true", help="write corners.csv (the default)")
    parser.add_argument(
        "--seed", type=parse_whole_number, default=0, help="of the secret machine, the temperatures and the noise"
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
        help="sensors.csv of temperatures and payload as they are, in place of drawn ones",
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
    """Simulate a recording and write it, and its truth apart."""
    from rig.effects.texts.effect_text import parse_effect, require_existing_place, require_nonzero_effect
    from rig.formats.rig_toml import design_file

    if arguments.source is not None:
        return _again(arguments)
    if arguments.design is None:
        raise RigError("simulating takes a RIG.toml, or --from with the folder of a diagnosis")
    design, kinds = (
        design_file.load_design(arguments.design),
        calibration_and_effect_files.known_effects(calibration_and_effect_files.load_effect_files(arguments)),
    )
    effects = tuple(
        require_nonzero_effect(require_existing_place(parse_effect(text, kinds), design)) for text in arguments.effect
    )
    sensor = replace(
        design.sensor, **{name: getattr(arguments, name) for name in SENSOR if getattr(arguments, name) is not None}
    )
    _check(arguments, sensor)
    if design.instrument is None and not (design.cameras and design.targets):
        raise RigError(
            f"{arguments.design} has {len(design.cameras)} cameras, {len(design.targets)} targets and no "
            "[instrument]; simulating takes "
            "cameras and targets, or an instrument that sees poses"
        )
    if arguments.images and not (design.cameras and design.targets):
        raise RigError(
            f"--images takes cameras and targets; {arguments.design} has {len(design.cameras)} and "
            f"{len(design.targets)}"
        )

    import numpy as np

    from rig.planning.plan import build_plan
    from rig.recording.recording_folder import load_sensors
    from synthetic import recording_simulation, secret_machine
    from synthetic.image_simulation import Images, check_drawable

    if arguments.images:
        from synthetic.renderer import import_pyrender

        check_drawable(effects)
        import_pyrender()
    rng = np.random.default_rng(arguments.seed)
    if arguments.machine:
        secret = secret_machine.world_from_truth(arguments.machine, design, kinds)
        secret = replace(secret, effects=secret.effects + effects)
    else:
        secret = secret_machine.draw_machine(design, rng, arguments.secret, effects)
    plan = build_plan(design, arguments.plan, arguments.seed)
    _places(arguments)
    out = arguments.outputs.folder(arguments.out)
    truth = arguments.outputs.file(arguments.truth) if arguments.truth else None
    done = recording_simulation.simulate(
        secret, plan, rng, load_sensors(arguments.sensors, plan.origin) if arguments.sensors else None
    )
    text = arguments.design.read_text(encoding="utf-8-sig")
    images = Images(sensor, arguments.background, arguments.compression) if arguments.images else None
    progress = Progress()
    recording_simulation.write_recording(
        done, out, text, rng, arguments.noise, images, lambda k, of: progress("drawing", k, of)
    )
    if truth is not None:
        more = {"corners": recording_simulation.truth_corners(done)} if images else {"noise_px": arguments.noise}
        secret_machine.write_truth(truth, secret, done.run.T_base_platform, seed=arguments.seed, **more)
    names = ", ".join(f"{effect.name} at {effect.place}" for effect in secret.effects) or "none"
    where = f"{arguments.out}" + (f", truth in {arguments.truth}" if truth else "")
    print(f"{len(plan.t)} frames over {plan.commands.t[-1] / 60:.1f} min, effects: {names}; written: {where}")


def _places(arguments: Namespace) -> None:
    """Protect what is read without being named as a path, and have the recording's manifest say nothing of its
    truth.
    """
    outputs = arguments.outputs
    if (arguments.design.parent / "frames.csv").exists():
        outputs.inputs.append(arguments.design.parent)
    outputs.inputs += [
        Path(part.removeprefix("commands:")) for part in arguments.plan.split(",") if part.startswith("commands:")
    ]
    outputs.arguments = (str(arguments.design), "--plan", arguments.plan)


def _again(arguments: Namespace) -> None:
    """Draw a diagnosed recording anew, with and without what was found."""
    if arguments.design is not None or arguments.machine or arguments.effect or arguments.sensors:
        raise RigError(
            "--from brings its own rig, machine, effects and sensors; leave out RIG.toml, --machine, "
            "--effect and --sensors"
        )

    import numpy as np

    from synthetic import recording_simulation
    from synthetic.diagnosis_replay import replay_diagnosis
    from synthetic.image_simulation import Images

    done = replay_diagnosis(
        arguments.source,
        calibration_and_effect_files.known_effects(calibration_and_effect_files.load_effect_files(arguments)),
    )
    out = arguments.outputs.folder(arguments.out)
    sensor = next(iter(done.values())).world.true.sensor
    sensor = replace(
        sensor, **{name: getattr(arguments, name) for name in SENSOR if getattr(arguments, name) is not None}
    )
    _check(arguments, sensor)
    images = Images(sensor, arguments.background, arguments.compression) if arguments.images else None
    text = (arguments.source / "rig.toml").read_text(encoding="utf-8-sig")
    for kind, part in done.items():
        recording_simulation.write_recording(
            part, out / kind, text, np.random.default_rng(arguments.seed), arguments.noise, images
        )
    names = ", ".join(f"{effect.name} at {effect.place}" for effect in done["with"].world.effects) or "none was found"
    print(
        f"{len(done['with'].plan.t)} frames, effects: {names}; written: {arguments.out / 'with'} and "
        f"{arguments.out / 'without'}"
    )


def _check(arguments: Namespace, sensor: Sensor) -> None:
    for name, most, unit in (("noise", 1000, "px"), ("secret", 1000, ""), ("seed", (1 << 63) - 1, "")):
        value = getattr(arguments, name)
        if not 0 <= value <= most:  # true for what is not a number, too
            raise RigError(f"--{name} must be at least 0 and at most {most:g} {unit}".rstrip() + f", not {value:g}")
    for field in fields(sensor):
        if not 0 <= getattr(sensor, field.name) <= LARGEST_SETTING:
            raise RigError(
                f"--{field.name.replace('_', '-')} must not be negative, nor beyond {LARGEST_SETTING:g}, "
                f"got {getattr(sensor, field.name):g}"
            )
    if sensor.bits not in (8, 12):
        raise RigError(f"--bits takes 8 or 12, not {sensor.bits}")
    if sensor.exposure > 0 and sensor.exposures < 2:
        raise RigError("an exposure in time takes --exposures of at least 2")
