"""rig kinematics: forward and inverse kinematics of an arm, all solutions, step by step on request."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared.command_options import add_json_option, print_json
from rig.errors import RigError
from rig.formats.json_tree import Json

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

    from calib.models.arm.correction import ArmCorrection
    from rig.arrays import Floats, Integers
    from rig.model.mechanism_geometry import Arm
    from rig.model.mechanisms.arm_kinematics_steps import Step
    from rig.model.mechanisms.six_joint_inverse import SixR

LEAVES = 1e-9  # m or rad of a pose, from which it is said
SINGULAR = 1e-6  # least over greatest singular value of the Jacobian, below which a configuration is called singular


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument(
        "arm", metavar="ARM", help="a rig.toml with an arm, an arm's calibration.json, or the name of a shipped one"
    )
    way = parser.add_mutually_exclusive_group(required=True)
    way.add_argument("--forward", metavar="FILE", type=Path, help="frame,q1..qn (rad, of slides m) -> poses")
    way.add_argument("--inverse", metavar="FILE", type=Path, help="frame,x,y,z,rx,ry,rz -> all joint solutions")
    parser.add_argument(
        "--steps",
        action="store_true",
        help="points A, B, C (D, E) and space vectors after each joint, in the arm's global frame",
    )
    add_json_option(parser)


def run(arguments: Namespace) -> None:
    """Print what joint values give, or all joint values that give poses, step by step where asked for."""
    from rig.formats import csv_table
    from rig.recording import recording_tables

    arm, correction = _arm(arguments.arm)
    if arguments.forward:
        rows = csv_table.read(arguments.forward, ("frame", *arm.axes))
        tree = _forward(rows.whole("frame"), rows.matrix(arm.axes), arm, correction, arguments.steps)
    else:
        poses = recording_tables.load_poses(arguments.inverse)
        tree = _inverse(poses.frame, poses.T_base_platform, arm, correction, arguments.steps)
    if arguments.json:
        print_json(tree)
    else:
        print("\n".join(_forward_text(tree) if arguments.forward else _inverse_text(tree)))


def _arm(text: str) -> tuple[Arm, ArmCorrection | None]:
    """(Arm as its owner believes it, its correction or None)."""
    from rig.model.mechanism_kinds import require_arm
    from rig.planning.layout import shipped_arm_layout

    if Path(text).suffix != ".json":
        return require_arm(shipped_arm_layout.load_shipped_arm(text).mechanism), None

    from calib.files import calibration_file
    from calib.models.arm.correction import ArmCorrection

    calibration = calibration_file.load(text)
    correction = calibration.correction
    if calibration.physics is not None and calibration.physics.compensable_effects():
        names = ", ".join(f"{e.label()} at {e.place}" for e in calibration.physics.compensable_effects())
        print(
            f"{text} undoes {names} besides, by what went before a pose: that is not in what follows; rig "
            "correct does it",
            file=sys.stderr,
        )
    if not isinstance(correction, ArmCorrection):
        raise RigError(f"{text} is the calibration of a {correction.nominal.kind}; this takes an arm's")
    return correction.nominal, correction


def _forward(frames: Integers, q: Floats, arm: Arm, correction: ArmCorrection | None, steps: bool) -> Json:
    """What `--forward` tells, as JSON holds it."""
    from rig.model import mechanisms
    from rig.model.mechanisms import arm as mechanism
    from rig.model.mechanisms import arm_kinematics_steps
    from rig.model.pose import pose_to_vector

    T = mechanism.forward(q, arm)
    beyond = mechanism.limits(q, arm)
    out = []
    for i, frame in enumerate(frames.tolist()):
        entry: Json = {
            "frame": frame,
            "q": q[i].tolist(),
            "pose": pose_to_vector(T[i]).tolist(),
            "near_singular": _near_singular(q[i], arm),
            "beyond_limits": [p for p, b in zip(mechanisms.axis_places(arm), beyond[i]) if b],
        }
        if correction is not None:
            entry["corrected"] = pose_to_vector(correction.predict(q[i])).tolist()
        out.append(entry | ({"steps": _steps(arm_kinematics_steps.forward_steps(q[i], arm))} if steps else {}))
    return {"schema": "kinematics/1", "units": list(mechanisms.axis_units(arm)), "frames": out}


def _near_singular(q: Floats, arm: Arm) -> float:
    """Least over greatest singular value of the Jacobian, 0 where singular; over as many directions as the joints can
    lead in at all.
    """
    import numpy as np

    from rig.model.mechanisms import arm as mechanism
    from rig.model.mechanisms import numerical_arm_inverse

    values = np.linalg.svd(mechanism.jacobian(q, arm), compute_uv=False)
    return float(values[sum(numerical_arm_inverse.reachable_direction_counts(arm)) - 1] / values[0])


def _inverse(frames: Integers, T: RigidTransform, arm: Arm, correction: ArmCorrection | None, steps: bool) -> Json:
    """What `--inverse` tells, as JSON holds it."""
    from rig.model import mechanisms
    from rig.model.mechanisms import six_joint_inverse

    form, why_none = None, ""
    try:
        form = six_joint_inverse.six_joint_arm(arm)
    except RigError as error:
        why_none = str(error)
    out = []
    for i, frame in enumerate(frames.tolist()):
        state, entries = _numeric(T[i], arm, steps) if form is None else _closed(T[i], form, steps)
        for entry in entries:
            entry["beyond_limits"] = _beyond(entry["q"], arm)
            if correction is not None:
                entry["corrected"] = _finished(T[[i]], entry["q"], correction)
        out.append({"frame": frame, "state": state, "solutions": entries})
    return {
        "schema": "kinematics/1",
        "units": list(mechanisms.axis_units(arm)),
        "form": form.kind if form is not None else f"numeric: {why_none}",
        "frames": out,
    }


def _closed(T: RigidTransform, form: SixR, steps: bool) -> tuple[str, list[Json]]:
    """(state of a pose in words, its branches), in closed form."""
    from rig.model.mechanisms import arm_kinematics_steps, six_joint_inverse

    found = six_joint_inverse.inverse(T, form)
    return found.why(0), [
        {
            "q": q.tolist(),
            "singular": _singular(flags),
            **({"steps": _steps(arm_kinematics_steps.inverse_steps(T, form, q))} if steps else {}),
        }
        for q, flags in zip(found.q[found.there], found.singular[found.there].tolist())
    ]


def _numeric(T: RigidTransform, arm: Arm, steps: bool) -> tuple[str, list[Json]]:
    """(state of a pose in words, the solutions that many starts lead to, named as found so); rest : what few joints
    leave of it.
    """
    from rig.model.mechanisms import arm_kinematics_steps
    from rig.model.mechanisms.numerical_arm_inverse import inverse_solutions

    found = inverse_solutions(T, arm)
    if not len(found.q):
        return f"out of reach: the arm comes no nearer than {found.missed[0]:.3g} m and {found.missed[1]:.3g} rad", []
    entries = [
        {
            "q": q.tolist(),
            "singular": "singular" if _near_singular(q, arm) < SINGULAR else "",
            "rest": rest.tolist(),
            "found": "numerically",
            **({"steps": _steps(arm_kinematics_steps.inverse_steps_of_numerical_solution(T, arm, q))} if steps else {}),
        }
        for q, rest in zip(found.q, found.rest)
    ]
    return ("singular" if all(entry["singular"] for entry in entries) else "regular"), entries


def _beyond(q: list[float], arm: Arm) -> list[str]:
    """Places of the joints that no whole turn brings within their limits."""
    import numpy as np

    from rig.model import mechanisms
    from rig.model.mechanisms import arm as mechanism

    beyond = mechanism.limits(mechanism.nearest_equivalent_angles(np.array(q), arm, np.zeros(len(q))), arm)
    return [place for place, by in zip(mechanisms.axis_places(arm), beyond) if by]


def _finished(T: RigidTransform, q: list[float], correction: ArmCorrection) -> list[float] | None:
    """Commands of the calibrated arm for a pose (1,), sought from a solution of its owner's model; None where none is
    near.
    """
    import numpy as np

    commands = correction.near(T, np.array([q]))[0]
    return None if np.isnan(commands).any() else commands.tolist()


def _singular(flags: int) -> str:
    from rig.model.mechanisms import six_joint_inverse

    return ", ".join(name for bit, name in six_joint_inverse.SINGULAR.items() if flags & bit)


def _steps(steps: list[Step]) -> list[Json]:
    return [
        {
            "joint": s.joint,
            "value": s.value,
            "axis": {"point": s.axis[0].tolist(), "vector": s.axis[1].tolist()},
            "points": dict(zip(s.names, s.points.tolist())),
            "AB": (s.points[1] - s.points[0]).tolist(),
            "AC": (s.points[2] - s.points[0]).tolist(),
        }
        for s in steps
    ]


def _forward_text(tree: Json) -> list[str]:
    """Lines of `--forward`, lengths in mm and angles in degrees."""
    lines = []
    for entry in tree["frames"]:
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
            lines.append(f"  as calibrated {_pose(entry['corrected'])}")
        lines += _steps_text(entry.get("steps", []), tree["units"], "at zero", ("turned about", "moved along"))
    return lines


def _inverse_text(tree: Json) -> list[str]:
    """Lines of `--inverse`, lengths in mm and angles in degrees."""
    numeric = tree["form"].startswith("numeric")
    lines = [
        f"joint solutions: {tree['form']}"
        + ("; those that many starts lead to, found numerically" if numeric else ", all branches in closed form")
    ]
    start = "the hand of the pose" if numeric else "A at the crossing of axes 5 and 6"
    way = (
        ("found numerically, turned back about", "found numerically, moved back along")
        if numeric
        else ("read and returned about",) * 2
    )
    for entry in tree["frames"]:
        lines.append(f"frame {entry['frame']}: {entry['state']}; {len(entry['solutions'])} solutions")
        for k, one in enumerate(entry["solutions"], 1):
            said = "; ".join(_said(one))
            lines.append(f"  {k}: {_joints(one['q'], tree['units'])}{'; ' if said else ''}{said}")
            if "corrected" in one:
                finished = "none near it" if one["corrected"] is None else _joints(one["corrected"], tree["units"])
                lines.append(f"     as calibrated, finished numerically: {finished}")
            lines += _steps_text(one.get("steps", []), tree["units"], start, way)
    return lines


def _said(one: Json) -> list[str]:
    """What is to be said of a solution: what it leaves of the pose, singularities, limits."""
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
        axis = f"the axis through {_three(s['axis']['point'], 1e3)} along {_three(s['axis']['vector'], 1)}"
        head = (
            first
            if j == 0
            else (f"joint {j} = {_joints([s['value']], [units[j - 1]])}, {done[units[j - 1] == 'm']} {axis}")
        )
        points = "  ".join(f"{name} {_three(point, 1e3)}" for name, point in s["points"].items())
        lines += [f"     {head}", f"       {points}  AB {_three(s['AB'], 1)}  AC {_three(s['AC'], 1)}"]
    return lines


def _three(values: list[float], scale: float) -> str:
    return "(" + ", ".join(f"{value * scale + 0.0:.4f}" for value in values) + ")"


def _joints(q: list[float], units: list[str]) -> str:
    return ", ".join(
        f"{value * 1e3:.4f} mm" if unit == "m" else f"{degrees(value):.4f}°" for value, unit in zip(q, units)
    )


def _pose(vector: list[float]) -> str:
    return f"position {_three(vector[:3], 1e3)} mm, rotation vector {_three(vector[3:], 1)} rad"
