"""Force that an arm's posture can exert (rig posture --exert): joint torques, margins, limits, a drawing."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.command_options import parse_numbers, require_matplotlib
from rig.errors import RigError
from rig.formats.json_tree import Json

if TYPE_CHECKING:
    from rig.arrays import Floats
    from rig.formats.rig_toml.arm_dynamics_entries import ArmDynamics
    from rig.model.mechanism_geometry import Arm
    from rig.posture.exertable_wrench import Exertion


def add_exertion_options(parser: ArgumentParser) -> None:
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


def requested_exertion(
    arguments: Namespace, arm: Arm, dynamics: ArmDynamics, gravity: Floats, path: Path
) -> Exertion | None:
    """Requested exertion (--exert) or None. gravity : (3,) m/s^2; path : of the arm. Raises RigError for bad options"""
    import numpy as np

    from rig.posture.exertable_wrench import Exertion, Strength

    if arguments.exert is None:
        if arguments.draw is not None or arguments.limits is not None:
            raise RigError("--draw and --limits say more of what --exert wants")
        return None
    n, given = len(arm.axes), " ".join(arguments.exert).replace(",", " ").split()
    wrench = np.array(
        parse_numbers(arguments.exert, 3 if len(given) == 3 else 6, "--exert") + [0.0] * (3 if len(given) == 3 else 0)
    )
    if not wrench.any():
        raise RigError("--exert takes a force or a moment that is not nothing")
    limits = (
        np.array(parse_numbers(arguments.limits, n, "--limits"))
        if arguments.limits
        else dynamics.need("torque_limits", path)
    )
    if not (limits > 0).all():
        raise RigError(f"--limits takes positive torques, not {limits.min():g} Nm")
    return Exertion(wrench, Strength(limits, dynamics.links, gravity))


def exertion_dict(q: Floats, arm: Arm, exertion: Exertion) -> Json:
    """Dict of an exertion at posture q (n,) rad for JSON: torques, margins, greatest multiple, extreme directions."""
    import numpy as np

    from rig.posture import exertable_wrench as of

    strength = exertion.strength
    weight, load = strength.weight(q, arm), of.joint_torques_for_wrench(q, arm, exertion.wrench)
    low, high = strength.box(q, arm)
    torque = weight + load
    margin, multiple = strength.limits - np.abs(torque), float(exertion.value(q, arm))
    A = of.joint_torques_for_wrench(q, arm, np.eye(6)[:, :3]).reshape(len(q), 3)
    bears = bool((low <= 0).all() and (high >= 0).all())
    out = {
        "wrench": exertion.wrench.tolist(),
        "torques": torque.tolist(),
        "weight": weight.tolist(),
        "limits": strength.limits.tolist(),
        "margin": margin.tolist(),
        "tightest_joint": int(np.argmin(margin / strength.limits)) + 1,
        "greatest_multiple": multiple,
        "greatest": (multiple * exertion.wrench).tolist() if bears else None,
        "weight_counted": strength.links is not None,
    }
    if bears:
        every = of.force_polytope_corners(A, low, high)
        size, least = np.linalg.norm(every, axis=1), of.weakest_force_direction(A, low, high)
        out["strongest"] = {"force": float(size.max()), "direction": (every[size.argmax()] / size.max()).tolist()}
        out["weakest"] = {"force": least[0], "direction": least[1].tolist()}
    return out


def exertion_lines(figures: Json, units: tuple[str, ...]) -> list[str]:
    r"""Lines of text about an exertion, from `exertion_dict`. units : of each joint, \"Nm\", or \"N\" of a slide."""
    mixed = len(set(units)) > 1
    cells = ", ".join(
        f"{torque:.3f}{' ' + unit if mixed else ''} ({margin:+.3f})"
        for torque, margin, unit in zip(figures["torques"], figures["margin"], units)
    )
    held = ", own weight held" if figures["weight_counted"] else " (the weight of the links is not stated)"
    out = [f"torques that exert it{held}, and what is left to the limits{'' if mixed else ', ' + units[0]}: {cells}"]
    if figures["greatest"] is None:
        return [*out, f"joint {figures['tightest_joint']} cannot even hold the arm's own weight here"]
    multiple, joint = figures["greatest_multiple"], figures["tightest_joint"]
    out.append(
        f"at most {multiple:.4g} times what is wanted"
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


def exertion_svg(q: Floats, arm: Arm, exertion: Exertion) -> str:
    """SVG of the exertion at posture q (n,) rad: force polytope. Raises RigError where it cannot hold its own weight"""
    import numpy as np

    require_matplotlib("pictures of postures")
    from rig.posture import exertable_wrench as of
    from rig.posture import force_polytope_figure

    low, high = exertion.strength.box(q, arm)
    if (low > 0).any() or (high < 0).any():
        raise RigError("the posture cannot hold the arm's own weight, and there is nothing to draw")
    A = of.joint_torques_for_wrench(q, arm, np.eye(6)[:, :3]).reshape(len(q), 3)
    return force_polytope_figure.force_polytope_svg(
        A, exertion.strength.limits, of.force_polytope_corners(A, low, high), exertion.wrench[:3]
    )
