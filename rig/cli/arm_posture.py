"""rig arm posture: posture of a redundant arm.

The optimal one at a fixed hand pose, for sensing or exerting a force.
"""

from __future__ import annotations

import re
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.array_and_json_types import Json
from rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion import make_quantity_parser, parse_numbers
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    add_json_option,
    add_overwrite_option,
    file_or_stdout,
    print_json,
    require_matplotlib,
)
from rig.errors import RigError
from rig.formats.numbers_and_units import parse_number
from rig.formats.output_files import write_text

if TYPE_CHECKING:
    from rig.array_and_json_types import Floats
    from rig.formats.rig_toml.arm_dynamics_entries import ArmDynamics
    from rig.model.mechanism_geometry_classes import Arm
    from rig.posture.arm_force_transmission_and_exertable_wrench import ExertionObjective
    from rig.posture.best_posture import PostureOptions


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig arm posture` to a parser."""
    parser._negative_number_matcher = re.compile(
        r"^-[\d.]"
    )  # so that a value may begin with a minus: --pose -0.4,0.1,..
    parser.add_argument(
        "arm", metavar="ARM.toml", help="a rig.toml with an arm, or the name of a shipped one, as panda"
    )
    parser.add_argument(
        "--pose", nargs="+", metavar="N", help="x,y,z,rx,ry,rz of the hand, m and rad (rotation vector)"
    )
    parser.add_argument(
        "--among",
        metavar="REC",
        type=Path,
        help="compare the postures that the arm took in this recording with the hand "
        "there, and return to the best along the recorded path; by default with the hand as at its first exposure",
    )
    parser.add_argument(
        "--sweep",
        metavar="10deg",
        type=make_quantity_parser("rad", "rad"),
        help="search nothing: visit the self-motion from end to end with the fastest joint in steps of at most this (a "
        "plain number is in rad, of slides m), and write it to --out as a plan commands:FILE, whose recording --among "
        "compares; through --from, by default through a solution of --pose; it takes --hold alone beside",
    )
    parser.add_argument(
        "--force-axes",
        dest="force",
        nargs="+",
        action="extend",
        default=[],
        metavar="AXIS",
        help="x, y or z: force directions considered",
    )
    parser.add_argument(
        "--moment-axes",
        dest="moment",
        nargs="+",
        action="extend",
        default=[],
        metavar="AXIS",
        help="x, y or z: moment directions considered",
    )
    parser.add_argument(
        "--norm", choices=("2", "inf"), default="2", help="of a direction's column of the transposed Jacobian"
    )
    parser.add_argument(
        "--whole",
        choices=("det", "norm"),
        default="det",
        help="with no direction chosen: det(J J^T) or the norm of J^T",
    )
    parser.add_argument(
        "--above",
        type=parse_number,
        metavar="LIMIT",
        help="stop as soon as the measure exceeds this (0: as long as it is not zero)",
    )
    parser.add_argument(
        "--hold", choices=("pose", "position", "orientation"), default="pose", help="fixed part of the hand"
    )
    _add_exertion_options(parser)
    parser.add_argument(
        "--from", dest="start", nargs="+", metavar="Q", help="joint angles now, rad; by default a solution of the pose"
    )
    parser.add_argument(
        "--motion",
        choices=("end", "way"),
        default="end",
        help="reach the posture after the hand has arrived, or during its motion",
    )
    parser.add_argument(
        "--speed", type=parse_number, default=0.5, metavar="RAD/S", help="of the fastest joint, for --out"
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=file_or_stdout,
        help="commands.csv of the motion into the posture; with --sweep frame,q1..qn of the sweep",
    )
    add_overwrite_option(parser, "--overwrite")
    add_json_option(parser)


def _add_exertion_options(parser: ArgumentParser) -> None:
    """Add the options of the wrench to exert: --exert, --limits, --draw."""
    parser.add_argument(
        "--exert",
        nargs="+",
        metavar="N",
        help="fx,fy,fz or fx,fy,fz,mx,my,mz that the hand is to exert, N and Nm in the axes of "
        "poses: torques, margin to their limits, and, with no --force or --moment, the posture that can "
        "exert most of it",
    )
    parser.add_argument(
        "--limits",
        nargs="+",
        metavar="N",
        help="torque limits of the joints, Nm (slides: N), in place of [dynamics] torque_limits",
    )
    parser.add_argument(
        "--draw", metavar="FILE.svg", type=Path, help="with --exert: force polytope and ellipsoid of the posture"
    )


def run(arguments: Namespace) -> None:
    """Run `rig arm posture`.

    Search the best posture of an arm and print it.
    """
    from rig.formats.rig_toml import arm_dynamics_entries
    from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_arm
    from rig.planning.layout import shipped_arms_and_layouts
    from rig.posture.best_posture import best_posture, posture_sweep

    path = shipped_arms_and_layouts.shipped_arm_path(arguments.arm)
    design, dynamics = arm_dynamics_entries.load_arm_design_and_dynamics(path)
    arm = require_arm(design.mechanism)
    options = _options(arguments, arm, _exertion(arguments, arm, dynamics, design.gravity, path))
    arguments.outputs.inputs.append(path)
    out, draw = (arguments.outputs.file(name) if name else None for name in (arguments.out, arguments.draw))
    if arguments.sweep is not None:
        sweep = posture_sweep(arm, options, arguments.sweep)
        if out:
            sweep.write(out)
        return print_json(sweep.tree()) if arguments.json else print(sweep)
    result = best_posture(arm, options)
    if out:
        result.write(out)
    if draw and options.exertion is not None:
        require_matplotlib("pictures of postures")
        write_text(draw, result.force_svg(options.exertion))
    tree = result.tree()
    if arguments.json:
        print_json(tree)
    else:
        print(_table(tree, arguments))


def _options(arguments: Namespace, arm: Arm, exertion: ExertionObjective | None) -> PostureOptions:
    """What posture is searched for, by the arguments."""
    import numpy as np

    from rig.model.pose import pose
    from rig.posture.arm_force_transmission_and_exertable_wrench import TransmissionObjective
    from rig.posture.best_posture import PostureOptions
    from rig.recording import recording_folder

    norm = np.inf if arguments.norm == "inf" else 2
    objective = TransmissionObjective(_directions(arguments), norm, arguments.whole)
    hand = parse_numbers(arguments.pose, 6, "--pose") if arguments.pose else None
    return PostureOptions(
        None if hand is None else pose(hand[:3], hand[3:]),
        objective,
        exertion,
        arguments.above,
        arguments.hold,
        np.array(parse_numbers(arguments.start, len(arm.axes), "--from")) if arguments.start else None,
        arguments.motion == "way",
        arguments.speed,
        recording_folder.load_recording(arguments.among) if arguments.among is not None else None,
    )


def _exertion(
    arguments: Namespace, arm: Arm, dynamics: ArmDynamics, gravity: Floats, path: Path
) -> ExertionObjective | None:
    """Requested exertion (--exert) or None. gravity : (3,) m/s^2; path : of the arm. Raises RigError for bad options"""
    import numpy as np

    from rig.posture.arm_force_transmission_and_exertable_wrench import ExertionObjective, TorqueBounds

    if arguments.exert is None:
        if arguments.draw is not None or arguments.limits is not None:
            raise RigError("--draw and --limits require --exert")
        return None
    n, given = len(arm.axes), " ".join(arguments.exert).replace(",", " ").split()
    wrench = np.array(
        parse_numbers(arguments.exert, 3 if len(given) == 3 else 6, "--exert") + [0.0] * (3 if len(given) == 3 else 0)
    )
    if not wrench.any():
        raise RigError("--exert requires a nonzero force or moment")
    limits = (
        np.array(parse_numbers(arguments.limits, n, "--limits"))
        if arguments.limits
        else dynamics.need("torque_limits", path)
    )
    if not (limits > 0).all():
        raise RigError(f"--limits takes positive torques, not {limits.min():g} Nm")
    return ExertionObjective(wrench, TorqueBounds(limits, dynamics.links, gravity))


def _directions(arguments: Namespace) -> tuple[str, ...]:
    from rig.posture.arm_force_transmission_and_exertable_wrench import DIRECTIONS

    chosen = []
    for kind, texts in (("f", arguments.force), ("m", arguments.moment)):
        for text in texts:
            axes = text.lower().replace(",", "")
            axes = axes[1:] if axes[:1] == kind and len(axes) == 2 else axes
            if not axes or set(axes) - set("xyz"):
                raise RigError(f"{'--force' if kind == 'f' else '--moment'} takes x, y or z, not {text!r}")
            chosen += [kind + axis for axis in axes]
    return tuple(name for name in DIRECTIONS if name in chosen)


def _table(tree: Json, arguments: Namespace) -> str:
    import numpy as np

    units = tree["q_units"]
    slides = "m" in units
    large = ", ".join(
        f"{np.degrees(q):.4f}" if unit == "rad" else f"{q * 1e3:.4f} mm" for q, unit in zip(tree["q"], units)
    )
    lines = [
        f"joint {'values' if slides else 'angles'}, degrees{' and, of slides, mm' if slides else ''}: {large}",
        f"joint {'values' if slides else 'angles'}, rad{' and m' if slides else ''}: "
        f"{','.join(f'{q:.9f}' for q in tree['q'])}",
        f"measure ({tree['measure']}, norm {tree['norm']}): {tree['value']:.6f}, from "
        f"{tree['start']['value']:.6f} where the search began",
        "columns of J^T: "
        + ", ".join(f"{name} {value:.6f}" for name, value in tree["columns"].items())
        + f" (Nm{', of slides N,' if slides else ''} per N for forces, per Nm for moments)",
        f"the hand moved by {tree['hand_moved']['position'] * 1e3:.2g} mm and "
        f"{tree['hand_moved']['rotation'] * 1e3:.2g} mrad; joints at "
        f"their limits: {', '.join(map(str, tree['at_limit'])) or 'none'}",
        _how(tree),
    ]
    if "certificate" in tree:
        share = tree["certificate"]["gradient_over_global_here"]
        lines.append(
            f"certificate: the whole self-motion was traced; the gradient alone reaches {share:.4f} of its best; "
            f"{tree['joint_solutions_searched']} joint solutions were searched"
        )
    elif arguments.above is None and tree["search"] not in ("among", "solutions"):
        lines.append("no certificate: the self-motion has more than one dimension and cannot be traced completely")
    lines += (
        _exertion_lines(tree["exert"], tuple("Nm" if unit == "rad" else "N" for unit in units))
        if "exert" in tree
        else []
    )
    if arguments.out:
        lines.append(f"motion written to {arguments.out}")
    if arguments.draw:
        lines.append(f"drawn: {arguments.draw}")
    return "\n".join(lines)


def _how(tree: Json) -> str:
    """How the posture was found."""
    values = ", ".join(f"{name} {value:.6f}" for name, value in tree["values"].items())
    if tree["search"] == "among":
        return (
            f"the best of {tree['compared']} postures visited in {tree['recording']} is that of frame "
            f"{tree['frame']} ({values}); in "
            f"{tree['elsewhere']} more the hand pose differed"
        )
    if tree["search"] == "solutions":
        return f"the best of {tree['joint_solutions_searched']} joint solutions of the pose: the arm is not redundant"
    return f"found by the {tree['search']} search; from the same start: {values}"


def _exertion_lines(figures: Json, units: tuple[str, ...]) -> list[str]:
    """Lines of text about an exertion. units : of each joint, "Nm", or "N" of a slide"""
    mixed = len(set(units)) > 1
    cells = ", ".join(
        f"{torque:.3f}{' ' + unit if mixed else ''} ({margin:+.3f})"
        for torque, margin, unit in zip(figures["torques"], figures["margin"], units)
    )
    held = ", link weight included" if figures["weight_counted"] else " (the weight of the links is not stated)"
    out = [f"torques that exert it{held}, and margin to the limits{'' if mixed else ', ' + units[0]}: {cells}"]
    if figures["greatest"] is None:
        return [*out, f"joint {figures['tightest_joint']} cannot even hold the arm's own weight here"]
    multiple, joint = figures["greatest_multiple"], figures["tightest_joint"]
    out.append(
        f"at most {multiple:.4g} times the wanted wrench"
        + (
            ""
            if multiple >= 1
            else f": it CANNOT be exerted, joint {joint} falls short by "
            f"{-figures['margin'][joint - 1]:.3f} {units[joint - 1]}"
        )
    )
    for name, words in (
        ("strongest", "the strongest direction of a force"),
        ("weakest", "in every direction at least, the weakest"),
    ):
        d = figures[name]
        out.append(f"{words}: {d['force']:.4g} N along ({', '.join(f'{part:+.3f}' for part in d['direction'])})")
    return out
