"""rig posture ARM.toml --pose x,y,z,rx,ry,rz --force y --norm 2."""

from __future__ import annotations

import json
import re
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.commands.output import SEED, add_force, file_or_stdout
from rig.errors import RigError

if TYPE_CHECKING:
    import numpy as np
    from scipy.spatial.transform import RigidTransform

    from rig.design import Arm
    from rig.posture.measure import Wish
    from rig.posture.search import Found

STARTS = 24  # joint solutions of the pose from which self-motions are looked for


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser._negative_number_matcher = re.compile(r"^-[\d.]")  # so that a value may begin with a minus: --pose -0.4,0.1,..
    parser.add_argument("arm", metavar="ARM.toml", help="a rig.toml with an arm, or the name of a shipped one: panda, puma560")
    parser.add_argument("--pose", nargs="+", required=True, metavar="N", help="x,y,z,rx,ry,rz of the hand, m and rad (rotation vector)")
    parser.add_argument("--force", nargs="+", action="extend", default=[], metavar="AXIS", help="x, y or z: directions of force that count")
    parser.add_argument("--moment", nargs="+", action="extend", default=[], metavar="AXIS", help="x, y or z: directions of moment that count")
    parser.add_argument("--norm", choices=("2", "inf"), default="2", help="of a direction's column of the transposed Jacobian")
    parser.add_argument("--whole", choices=("det", "norm"), default="det", help="with no direction chosen: det(J J^T) or the norm of J^T")
    parser.add_argument("--above", type=float, metavar="LIMIT", help="stop as soon as the measure exceeds this (0: as long as it is not zero)")
    parser.add_argument("--hold", choices=("pose", "position"), default="pose", help="what of the hand stays")
    parser.add_argument("--from", dest="start", nargs="+", metavar="Q", help="joint angles now, rad; by default a solution of the pose")
    parser.add_argument("--motion", choices=("end", "way"), default="end", help="take the posture when the hand has arrived, or on its way")
    parser.add_argument("--speed", type=float, default=0.5, metavar="RAD/S", help="of the fastest joint, for --out")
    parser.add_argument("--out", metavar="FILE", type=file_or_stdout, help="commands.csv of the motion into the posture")
    add_force(parser, "--overwrite")
    parser.add_argument("--json", action="store_true", help="print JSON (m, rad) instead of a table")


def run(arguments: Namespace) -> None:
    """Search, and print the posture with what certifies it."""
    import numpy as np

    from rig.mechanisms import arm as mechanism
    from rig.pose import difference, pose
    from rig.posture import measure, search

    arm = _arm(arguments.arm)
    n = len(arm.joints)
    wish = measure.Wish(_directions(arguments), np.inf if arguments.norm == "inf" else 2, arguments.whole)
    numbers = _numbers(arguments.pose, 6, "--pose")
    wanted = pose(numbers[:3], numbers[3:])
    if arguments.above is not None and not arguments.above >= 0:
        raise RigError(f"--above must be at least 0, not {arguments.above:g}")
    if not arguments.speed > 0:
        raise RigError(f"--speed must be positive rad/s, not {arguments.speed:g}")
    arguments.outputs.inputs.append(Path(arguments.arm))
    out = arguments.outputs.file(arguments.out) if arguments.out else None
    now = np.array(_numbers(arguments.start, n, "--from")) if arguments.start else None
    arrived = now is not None and np.abs(difference(mechanism.forward(now, arm), wanted)).max() < 1e-6
    if now is not None and not arrived and arguments.motion == "end":
        raise RigError("--from has the hand elsewhere than --pose: bring it there first, or take the posture on the way (--motion way)")
    first = now if now is not None and arrived else mechanism.inverse(wanted, arm, now)
    starts = first[None] if arrived and arguments.motion == "end" else _starts(first, wanted, arm)
    rng = np.random.default_rng(SEED)
    found = {"gradient": search.gradient_search(starts, arm, wish, arguments.hold, arguments.above)}
    if arguments.above is None:
        found["sampled"] = search.sampled_search(starts, arm, wish, rng, arguments.hold)
        if n - search.HELD[arguments.hold] == 1:
            found["global"] = search.global_search(starts, arm, wish, arguments.hold)
        name, k = max(((name, int(f.value.argmax())) for name, f in found.items()), key=lambda pair: found[pair[0]].value[pair[1]])
    else:
        name = "gradient"
        enough = np.flatnonzero(found[name].value > arguments.above)
        if not len(enough):
            raise RigError(f"no posture found whose measure exceeds {arguments.above:g}; the best reaches {found[name].value.max():.6g}")
        k = int(enough[np.abs(found[name].q[enough] - first).max(axis=1).argmin()])  # the least motion will do
    if out:
        _write(out, arguments, arm, now if now is not None else first, starts[k], found[name].q[k])
    tree = _tree(arm, wish, first, starts, found, name, k)
    print(json.dumps(tree, indent=1) if arguments.json else _table(tree, arguments))


def _arm(text: str) -> Arm:
    from rig import shelf

    mechanism = shelf.load(text).mechanism
    if mechanism.kind != "arm":
        raise RigError(f"{text} has a mechanism of kind {mechanism.kind!r}; postures are for arms")
    return mechanism


def _directions(arguments: Namespace) -> tuple[str, ...]:
    from rig.posture.measure import DIRECTIONS

    chosen = []
    for kind, texts in (("f", arguments.force), ("m", arguments.moment)):
        for text in texts:
            axes = text.lower().replace(",", "")
            axes = axes[1:] if axes[:1] == kind and len(axes) == 2 else axes
            if not axes or set(axes) - set("xyz"):
                raise RigError(f"{'--force' if kind == 'f' else '--moment'} takes x, y or z, not {text!r}")
            chosen += [kind + axis for axis in axes]
    return tuple(name for name in DIRECTIONS if name in chosen)


def _numbers(texts: list[str], count: int, option: str) -> list[float]:
    try:
        numbers = [float(word) for word in re.split(r"[,\s]+", " ".join(texts).strip(", "))]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(abs(number) < 1e6 for number in numbers):
        raise RigError(f"{option} takes {count} numbers, apart by commas or spaces, not {' '.join(texts)!r}")
    return numbers


def _starts(first: np.ndarray, wanted: RigidTransform, arm: Arm) -> np.ndarray:
    """(k, n) joint solutions of a pose within the limits: the first, and others far and wide."""
    import numpy as np
    from scipy.spatial.transform import RigidTransform

    from rig.mechanisms import arm as mechanism

    many = RigidTransform.from_matrix(np.tile(wanted.as_matrix(), (STARTS, 1, 1)))
    guess = np.random.default_rng(SEED).uniform(arm.limits[:, 0], arm.limits[:, 1], (STARTS, len(first)))
    q, left = mechanism.solve(many, arm, guess)
    inside = (left <= mechanism.GOOD) & (mechanism.limits(q, arm) == 0).all(axis=1)
    return np.vstack([first, q[inside]])


def _write(out: Path, arguments: Namespace, arm: Arm, now: np.ndarray, start: np.ndarray, goal: np.ndarray) -> None:
    from rig import writing
    from rig.posture import motion

    rows = motion.on_the_way(now, goal, arm) if arguments.motion == "way" else motion.at_the_end(start, goal, arm)
    t = motion.timed(rows, arguments.speed)
    lines = [",".join([f"{moment:.6f}", *(f"{angle:.12f}" for angle in angles)]) for moment, angles in zip(t, rows)]
    writing.write_table(out, ("t", *arm.axes), lines)


def _tree(arm: Arm, wish: Wish, first: np.ndarray, starts: np.ndarray, found: dict[str, Found], name: str, k: int) -> dict:
    from rig.posture import measure

    best = found[name]
    tree = {"schema": "posture/1", "unit": "rad, m", "directions": list(wish.directions) or "all", "norm": str(wish.norm),
            "measure": "smallest column of J^T" if wish.directions else wish.whole, "search": name, "q": best.q[k].tolist(),
            "value": float(best.value[k]), "start": {"q": starts[k].tolist(), "value": float(best.start[k])},
            "hand_moved": {"position": float(best.moved[k, 0]), "rotation": float(best.moved[k, 1])},
            "at_limit": [i + 1 for i in range(len(best.q[k])) if best.at_limit[k, i]],
            "columns": dict(zip(wish.directions or measure.DIRECTIONS, measure.columns(best.q[k], arm, wish).tolist())),
            "joint_solutions_searched": len(starts),
            "values": {key: float(f.value[k]) for key, f in found.items()}}
    if "global" in found:
        tree["certificate"] = {"gradient_over_global_here": float(found["gradient"].value[k] / found["global"].value[k]),
                               "reached_over_best_of_all_self_motions": float(best.value[k] / found["global"].value.max())}
    return tree


def _table(tree: dict, arguments: Namespace) -> str:
    import numpy as np

    lines = [f"joint angles, degrees: {', '.join(f'{angle:.4f}' for angle in np.degrees(tree['q']))}",
             f"joint angles, rad: {','.join(f'{angle:.9f}' for angle in tree['q'])}",
             f"measure ({tree['measure']}, norm {tree['norm']}): {tree['value']:.6f}, from {tree['start']['value']:.6f} where the search began",
             "columns of J^T: " + ", ".join(f"{name} {value:.6f}" for name, value in tree["columns"].items())
             + " (Nm per N for forces, Nm per Nm for moments)",
             f"the hand moved by {tree['hand_moved']['position'] * 1e3:.2g} mm and {tree['hand_moved']['rotation'] * 1e3:.2g} mrad; joints at "
             f"their limits: {', '.join(map(str, tree['at_limit'])) or 'none'}",
             f"found by the {tree['search']} search; from the same start: "
             + ", ".join(f"{name} {value:.6f}" for name, value in tree["values"].items())]
    if "certificate" in tree:
        share = tree["certificate"]["gradient_over_global_here"]
        lines.append(f"certificate: the whole self-motion was traced; the gradient alone reaches {share:.4f} of its best; "
                     f"{tree['joint_solutions_searched']} joint solutions were searched")
    elif arguments.above is None:
        lines.append("no certificate: the self-motion has more than one dimension and cannot be traced whole")
    if arguments.out:
        lines.append(f"motion written to {arguments.out}")
    return "\n".join(lines)
