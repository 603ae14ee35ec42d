"""rig posture: optimal posture of a redundant arm at a fixed hand pose, for sensing or exerting a force."""

from __future__ import annotations

import re
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared import posture_force
from rig.cli.shared.command_options import (
    SEED,
    add_json_option,
    add_overwrite_option,
    file_or_stdout,
    parse_numbers,
    print_json,
)
from rig.errors import RigError
from rig.formats.json_tree import Json
from rig.formats.number_parsing_and_rounding import parse_number
from rig.formats.output_files import write_text

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

    from rig.arrays import Floats
    from rig.model.mechanism_geometry import Arm
    from rig.posture.exertable_wrench import Exertion
    from rig.posture.force_transmission import TransmissionObjective
    from rig.posture.null_space_search import Found

STARTS = 24  # joint solutions of the pose from which self-motions are looked for


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
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
        "there, and go back to the best along the way it came; by default with the hand as at its first exposure",
    )
    parser.add_argument(
        "--force",
        nargs="+",
        action="extend",
        default=[],
        metavar="AXIS",
        help="x, y or z: directions of force that count",
    )
    parser.add_argument(
        "--moment",
        nargs="+",
        action="extend",
        default=[],
        metavar="AXIS",
        help="x, y or z: directions of moment that count",
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
        "--hold", choices=("pose", "position", "orientation"), default="pose", help="what of the hand stays"
    )
    posture_force.add_exertion_options(parser)
    parser.add_argument(
        "--from", dest="start", nargs="+", metavar="Q", help="joint angles now, rad; by default a solution of the pose"
    )
    parser.add_argument(
        "--motion",
        choices=("end", "way"),
        default="end",
        help="take the posture when the hand has arrived, or on its way",
    )
    parser.add_argument(
        "--speed", type=parse_number, default=0.5, metavar="RAD/S", help="of the fastest joint, for --out"
    )
    parser.add_argument(
        "--out", metavar="FILE", type=file_or_stdout, help="commands.csv of the motion into the posture"
    )
    add_overwrite_option(parser, "--overwrite")
    add_json_option(parser)


def run(arguments: Namespace) -> None:
    """Search, and print the posture with what certifies it."""
    import numpy as np

    from rig.posture import force_transmission

    path, arm, wanted = _wanted(arguments)
    chosen = _directions(arguments)
    wish: TransmissionObjective | Exertion = (
        wanted
        if wanted is not None and not chosen
        else force_transmission.TransmissionObjective(chosen, np.inf if arguments.norm == "inf" else 2, arguments.whole)
    )
    if arguments.above is not None and not arguments.above >= 0:
        raise RigError(f"--above must be at least 0, not {arguments.above:g}")
    if not arguments.speed > 0:
        raise RigError(f"--speed must be positive rad/s, not {arguments.speed:g}")
    arguments.outputs.inputs.append(path)
    out, draw = (arguments.outputs.file(name) if name else None for name in (arguments.out, arguments.draw))
    if arguments.among is not None:
        tree = _among(arguments, arm, wish, out)
    else:
        tree = _searched(arguments, arm, wish, out)
    if wanted is not None:
        tree["exert"] = posture_force.exertion_dict(np.array(tree["q"]), arm, wanted)
        if draw:
            write_text(draw, posture_force.exertion_svg(np.array(tree["q"]), arm, wanted))
    if arguments.json:
        print_json(tree)
    else:
        print(_table(tree, arguments))


def _wanted(arguments: Namespace) -> tuple[Path, Arm, Exertion | None]:
    """(path, Arm, what it is to exert or None) of the arguments."""
    from rig.formats.rig_toml import arm_dynamics_entries
    from rig.model.mechanism_kinds import require_arm
    from rig.planning.layout import shipped_arm_layout

    path = shipped_arm_layout.shipped_arm_path(arguments.arm)
    design, dynamics = arm_dynamics_entries.load_arm_dynamics(path)
    arm = require_arm(design.mechanism)
    return path, arm, posture_force.requested_exertion(arguments, arm, dynamics, design.gravity, path)


def _among(arguments: Namespace, arm: Arm, wish: TransmissionObjective | Exertion, out: Path | None) -> Json:
    """The best of the postures that were visited, as `_tree`; the way back to it is written."""
    from rig.model.pose import pose
    from rig.posture import posture_transition
    from rig.recording import recording_folder

    if arguments.start or arguments.above is not None or arguments.motion == "way":
        raise RigError(
            "--among goes back to a posture from where the recording ends; --from, --above and --motion are "
            "for searches"
        )
    numbered = parse_numbers(arguments.pose, 6, "--pose") if arguments.pose else None
    found = posture_transition.best_visited_posture(
        recording_folder.load_recording(arguments.among),
        arm,
        wish,
        arguments.hold,
        None if numbered is None else pose(numbered[:3], numbered[3:]),
    )
    if out:
        _write(out, arguments, arm, found.back)
    best, first = found.best, found.q[0]
    tree = _tree(arm, wish, found.q[best], first, (float(found.value[best]), float(found.value[0])))
    return tree | {
        "search": "among",
        "recording": str(arguments.among),
        "frame": int(found.frame[best]),
        "compared": len(found.q),
        "elsewhere": found.elsewhere,
        "values": {"best": float(found.value[best]), "worst": float(found.value.min())},
    }


def _searched(arguments: Namespace, arm: Arm, wish: TransmissionObjective | Exertion, out: Path | None) -> Json:
    """The best posture that the searches find, as `_tree`; the motion into it is written."""
    import numpy as np

    from rig.model.mechanisms import arm as mechanism
    from rig.model.pose import pose, pose_difference
    from rig.posture import posture_transition

    if not arguments.pose:
        raise RigError("--pose says where the hand is; without it, --among names a recording")
    n, numbered = len(arm.axes), parse_numbers(arguments.pose, 6, "--pose")
    wanted = pose(numbered[:3], numbered[3:])
    now = np.array(parse_numbers(arguments.start, n, "--from")) if arguments.start else None
    arrived = now is not None and np.abs(pose_difference(mechanism.forward(now, arm), wanted)).max() < 1e-6
    if now is not None and not arrived and arguments.motion == "end":
        raise RigError(
            "--from has the hand elsewhere than --pose: bring it there first, or take the posture on the way "
            "(--motion way)"
        )
    first = now if now is not None and arrived else mechanism.inverse(wanted, arm, now)
    starts = first[None] if arrived and arguments.motion == "end" else _starts(first, wanted, arm)
    found, name, k = _best(arguments, arm, wish, first, starts)
    best = found[name]
    if out:
        _write(
            out,
            arguments,
            arm,
            posture_transition.motion_with_straight_hand(now if now is not None else first, best.q[k], arm)
            if arguments.motion == "way"
            else posture_transition.motion_with_hand_still(starts[k], best.q[k], arm, arguments.hold),
        )
    tree = _tree(arm, wish, best.q[k], starts[k], (float(best.value[k]), float(best.start[k])))
    tree |= {
        "search": name,
        "joint_solutions_searched": len(starts),
        "values": {key: float(f.value[k]) for key, f in found.items()},
    }
    if "global" in found:
        tree["certificate"] = {
            "gradient_over_global_here": float(found["gradient"].value[k] / found["global"].value[k]),
            "reached_over_best_of_all_self_motions": float(best.value[k] / found["global"].value.max()),
        }
    return tree


def _best(
    arguments: Namespace, arm: Arm, wish: TransmissionObjective | Exertion, first: Floats, starts: Floats
) -> tuple[dict[str, Found], str, int]:
    """(what each search found, name of the best, index of its posture) from starts (k, n) rad. Raises RigError where
    nothing exceeds a limit
    """
    import numpy as np

    from rig.posture import null_space_search
    from rig.posture.exertable_wrench import Exertion

    if null_space_search.redundant_joint_count(arm, arguments.hold) < 1 and isinstance(wish, Exertion):
        found = {"solutions": null_space_search.unsearched_postures(starts, arm, wish)}
        return found, "solutions", int(found["solutions"].value.argmax())
    found = {"gradient": null_space_search.gradient_search(starts, arm, wish, arguments.hold, arguments.above)}
    if arguments.above is not None:
        enough = np.flatnonzero(found["gradient"].value > arguments.above)
        if not len(enough):
            raise RigError(
                f"no posture found whose measure exceeds {arguments.above:g}; the best reaches "
                f"{found['gradient'].value.max():.6g}"
            )
        return (
            found,
            "gradient",
            int(enough[np.abs(found["gradient"].q[enough] - first).max(axis=1).argmin()]),
        )  # the least motion will do
    found["sampled"] = null_space_search.sampled_search(starts, arm, wish, np.random.default_rng(SEED), arguments.hold)
    if null_space_search.redundant_joint_count(arm, arguments.hold) == 1:
        found["global"] = null_space_search.global_search(starts, arm, wish, arguments.hold)
    name, k = max(
        ((name, int(f.value.argmax())) for name, f in found.items()), key=lambda pair: found[pair[0]].value[pair[1]]
    )
    return found, name, k


def _directions(arguments: Namespace) -> tuple[str, ...]:
    from rig.posture.force_transmission import DIRECTIONS

    chosen = []
    for kind, texts in (("f", arguments.force), ("m", arguments.moment)):
        for text in texts:
            axes = text.lower().replace(",", "")
            axes = axes[1:] if axes[:1] == kind and len(axes) == 2 else axes
            if not axes or set(axes) - set("xyz"):
                raise RigError(f"{'--force' if kind == 'f' else '--moment'} takes x, y or z, not {text!r}")
            chosen += [kind + axis for axis in axes]
    return tuple(name for name in DIRECTIONS if name in chosen)


def _starts(first: Floats, wanted: RigidTransform, arm: Arm) -> Floats:
    """(k, n) joint solutions of a pose within the limits: the first, and others far and wide."""
    import numpy as np
    from scipy.spatial.transform import RigidTransform

    from rig.model.mechanisms import arm as mechanism

    many = RigidTransform.from_matrix(np.tile(wanted.as_matrix(), (STARTS, 1, 1)))
    guess = np.random.default_rng(SEED).uniform(arm.limits[:, 0], arm.limits[:, 1], (STARTS, len(first)))
    q, left = mechanism.solve_inverse(many, arm, guess)
    inside = (left <= mechanism.GOOD) & (mechanism.limits(q, arm) == 0).all(axis=1)
    return np.vstack([first, q[inside]])


def _write(out: Path, arguments: Namespace, arm: Arm, rows: Floats) -> None:
    """commands.csv of a motion through postures (k, n) rad."""
    from rig.posture import posture_transition
    from rig.recording import recording_tables

    t = posture_transition.posture_times(rows, arguments.speed)
    lines = [",".join([f"{moment:.6f}", *(f"{angle:.12f}" for angle in angles)]) for moment, angles in zip(t, rows)]
    recording_tables.write_table(out, ("t", *arm.axes), lines)


def _tree(
    arm: Arm, wish: TransmissionObjective | Exertion, q: Floats, start: Floats, values: tuple[float, float]
) -> Json:
    """What is said of a posture q (n,) rad beside its search. values : the measure there and at the start"""
    import numpy as np

    from rig.model import mechanisms
    from rig.model.mechanisms import arm as mechanism
    from rig.model.pose import pose_difference
    from rig.posture import force_transmission
    from rig.posture.exertable_wrench import Exertion

    low, high = arm.limits.T
    moved = pose_difference(mechanism.forward(start, arm), mechanism.forward(q, arm))
    told = force_transmission.TransmissionObjective() if isinstance(wish, Exertion) else wish
    return {
        "schema": "posture/1",
        "unit": "rad, m",
        "directions": list(told.directions) or "all",
        "norm": str(told.norm),
        "measure": "greatest multiple"
        if isinstance(wish, Exertion)
        else "smallest column of J^T"
        if told.directions
        else told.whole,
        "q": q.tolist(),
        "q_units": list(mechanisms.axis_units(arm)),
        "value": values[0],
        "start": {"q": start.tolist(), "value": values[1]},
        "hand_moved": {"position": float(np.linalg.norm(moved[:3])), "rotation": float(np.linalg.norm(moved[3:]))},
        "at_limit": (np.flatnonzero((q <= low + 1e-6) | (q >= high - 1e-6)) + 1).tolist(),
        "columns": dict(
            zip(
                told.directions or force_transmission.DIRECTIONS,
                force_transmission.torque_norms_by_direction(q, arm, told).tolist(),
            )
        ),
    }


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
        lines.append("no certificate: the self-motion has more than one dimension and cannot be traced whole")
    lines += (
        posture_force.exertion_lines(tree["exert"], tuple("Nm" if unit == "rad" else "N" for unit in units))
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
            f"{tree['elsewhere']} more the hand was elsewhere"
        )
    if tree["search"] == "solutions":
        return (
            f"the best of {tree['joint_solutions_searched']} joint solutions of the pose: the arm has no joint to spare"
        )
    return f"found by the {tree['search']} search; from the same start: {values}"
