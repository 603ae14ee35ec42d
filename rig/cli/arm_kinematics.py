"""rig arm kinematics: forward and inverse kinematics.

Of an arm, or of a platform.
All solutions, step by step on request.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from dataclasses import replace
from math import degrees
from pathlib import Path

from rig.array_and_json_types import Json
from rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion import parse_length
from rig.cli.shared.shared_output_controller_hand_and_worker_options import add_json_option, print_json
from rig.errors import RigError

LEAVES = 1e-9  # m or rad of a pose, from which it is said


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig arm kinematics` to a parser."""
    parser.add_argument(
        "arm",
        metavar="MACHINE",
        help="a rig.toml with an arm, a platform on struts or a kinematics file; its calibration.json; or the name of "
        "a shipped arm",
    )
    direction = parser.add_mutually_exclusive_group(required=True)
    direction.add_argument("--forward", metavar="FILE", type=Path, help="frame,q1..qn (rad, of slides m) -> poses")
    direction.add_argument("--inverse", metavar="FILE", type=Path, help="frame,x,y,z,rx,ry,rz -> all joint solutions")
    parser.add_argument(
        "--steps",
        action="store_true",
        help="points A, B, C (D, E) and space vectors after each joint, in the arm's global frame",
    )
    parser.add_argument(
        "--spacing",
        type=parse_length,
        metavar="100mm",
        help="of --steps: how far B and C lie from A, along z and y of the hand at zero (default 1 m)",
    )
    parser.add_argument(
        "--trace",
        action="store_true",
        help="of --forward for platforms: each iteration's matrix B, step x and what it moved",
    )
    add_json_option(parser)


def run(arguments: Namespace) -> None:
    """Run `rig arm kinematics`.

    Print forward or inverse kinematics of an arm or a platform.
    """
    from calib.api.arm_kinematics import ArmKinematics, load_kinematics
    from rig.formats import csv_and_parquet_tables_and_time_origin
    from rig.recording import corner_and_pose_csv_tables

    if arguments.spacing is not None and not arguments.steps:
        raise RigError("--spacing places the points that --steps prints; give --steps as well")
    if arguments.trace and arguments.inverse:
        raise RigError("--trace prints the iterations of --forward; --inverse has none that are printed")
    machine = load_kinematics(arguments.arm)
    if arguments.spacing is not None and isinstance(machine, ArmKinematics):
        machine = replace(machine, spacing=arguments.spacing)
    if machine.left_out is not None:
        print(machine.left_out, file=sys.stderr)
    if arguments.forward:
        rows = csv_and_parquet_tables_and_time_origin.read_csv_table(arguments.forward, ("frame", *machine.axes))
        tree = machine.forward(rows.whole("frame"), rows.matrix(machine.axes), arguments.steps, arguments.trace)
    else:
        poses = corner_and_pose_csv_tables.load_poses(arguments.inverse)
        tree = machine.inverse(poses.frame, poses.T_base_platform, arguments.steps)
    if arguments.json:
        print_json(tree)
    else:
        print("\n".join(_forward_text(tree) if arguments.forward else _inverse_text(tree)))


def _forward_text(tree: Json) -> list[str]:
    """Lines of `--forward`, lengths in mm and angles in degrees."""
    from calib.api.arm_kinematics import SINGULAR

    lines = []
    for entry in tree["frames"]:
        if entry["pose"] is None:
            lines.append(f"frame {entry['frame']}: {_joints(entry['q'], tree['units'])}: {entry['refused']}")
            lines += _trace_text(entry, tree["units"])
            continue
        near = (
            "singular"
            if entry["near_singular"] < SINGULAR
            else f"singular values down to {entry['near_singular']:.3g} of the greatest"
        )
        beyond = f"; beyond the limits: {', '.join(entry['beyond_limits'])}" if entry["beyond_limits"] else ""
        lines.append(
            f"frame {entry['frame']}: {_joints(entry['q'], tree['units'])} -> {_pose(entry['pose'])}; {near}{beyond}"
        )
        if "corrected" in entry:
            corrected = entry["corrected"]
            lines.append(f"  as calibrated {entry['refused'] if corrected is None else _pose(corrected)}")
        lines += _steps_text(entry.get("steps", []), tree["units"], "at zero", ("turned about", "moved along"))
        lines += _trace_text(entry, tree["units"])
    return lines


def _trace_text(entry: Json, units: list[str]) -> list[str]:
    """Lines of the iterations of a forward solution: B x = b, and what x moves. units : of each axis"""
    lines, known = [], None
    for one in entry.get("trace", []):
        off = ", ".join("no value" if b is None else _measure(b, unit) for b, unit in zip(one["b"], units))
        rows = [" ".join(f"{'none':>10}" if v is None else f"{v:10.6f}" for v in row) for row in one["B"]]
        lines += [f"  iteration {one['iteration']}: from {_pose(one['pose'])}", f"    b, by which the axes miss: {off}"]
        if rows == known:
            lines.append("    B as before")
        else:
            along = f"columns {' '.join(entry['unknowns'])} along the axes of the {entry['along']}"
            lines += [f"    B, {' and '.join(dict.fromkeys(units))} by m and rad; {along}:"]
            lines += [f"      {row}" for row in rows]
        known = rows
        moved = zip(entry["unknowns"], one["x"])
        x = ", ".join(f"{name} {_measure(v, 'rad' if name.startswith('r') else 'm')}" for name, v in moved)
        lines.append(f"    x, which moves the platform: {x}")
    if "trace" in entry:
        end = "no pose was found" if entry["pose"] is None else f"settled at {_pose(entry['pose'])}"
        lines.append(f"  {len(entry['trace'])} iterations; {end}")
    return lines


def _inverse_text(tree: Json) -> list[str]:
    """Lines of `--inverse`, lengths in mm and angles in degrees."""
    numeric, arm = tree["form"].startswith("numeric"), not tree["form"].startswith("each axis")
    branches = "; found numerically from many starts" if numeric else ", all branches in closed form"
    lines = [f"joint solutions: {tree['form']}{branches if arm else ''}"]
    start = "the hand of the pose" if numeric else "A at the crossing of axes 5 and 6"
    methods = (
        ("found numerically, turned back about", "found numerically, moved back along")
        if numeric
        else ("read and returned about",) * 2
    )
    for entry in tree["frames"]:
        lines.append(f"frame {entry['frame']}: {entry['state']}; {len(entry['solutions'])} solutions")
        for k, one in enumerate(entry["solutions"], 1):
            message = "; ".join(_solution_remarks(one))
            lines.append(f"  {k}: {_joints(one['q'], tree['units'])}{'; ' if message else ''}{message}")
            if "corrected" in one:
                finished = "none near it" if one["corrected"] is None else _joints(one["corrected"], tree["units"])
                lines.append(f"     as calibrated, finished numerically: {finished}")
            lines += _steps_text(one.get("steps", []), tree["units"], start, methods)
    return lines


def _solution_remarks(one: Json) -> list[str]:
    """Remarks on a solution: its residual pose error, singularities, limits."""
    rest = one.get("rest", [0.0] * 6)
    return (
        ([f"leaves {_pose(rest)}"] if max(map(abs, rest)) > LEAVES else [])
        + (
            [f"singular: {one['singular']}"]
            if one["singular"] not in ("", "singular")
            else [one["singular"]]
            if one["singular"]
            else []
        )
        + ([f"beyond the limits: {', '.join(one['beyond_limits'])}"] if one["beyond_limits"] else [])
    )


def _steps_text(steps: list[Json], units: list[str], first: str, done: tuple[str, str]) -> list[str]:
    """Lines of steps, points in mm. done : what is said of a joint that turns, and of one that slides"""
    lines = []
    for s in steps:
        j = s["joint"]
        axis = f"the axis through {_three(s['axis']['point'], 1e3)} mm along {_three(s['axis']['vector'], 1)}"
        head = (
            first
            if j == 0
            else (f"joint {j} = {_joints([s['value']], [units[j - 1]])}, {done[units[j - 1] == 'm']} {axis}")
        )
        points = "  ".join(f"{name} {_three(point, 1e3)} mm" for name, point in s["points"].items())
        lines += [f"     {head}", f"       {points}  AB {_three(s['AB'], 1)}  AC {_three(s['AC'], 1)}"]
    return lines


def _measure(value: float, unit: str) -> str:
    return f"{value * 1e3:.6g} m{unit}"


def _three(values: list[float], scale: float) -> str:
    return "(" + ", ".join(f"{value * scale + 0.0:.4f}" for value in values) + ")"


def _joints(q: list[float], units: list[str]) -> str:
    return ", ".join(
        f"{value * 1e3:.4f} mm" if unit == "m" else f"{degrees(value):.4f}°" for value, unit in zip(q, units)
    )


def _pose(vector: list[float]) -> str:
    return f"position {_three(vector[:3], 1e3)} mm, rotation vector {_three(vector[3:], 1)} rad"
