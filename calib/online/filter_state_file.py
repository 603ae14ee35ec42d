"""The on-line filter's state <-> a JSON file, whole or not at all: the filter before its last poses, and those, which
are learnt again.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.online.filter_state import AGAIN, Start, State, initial_estimate, state_with_pose
from calib.online.square_root_kernels import WINDOW, Machine, Pose
from rig.errors import FileError, RigError
from rig.formats import json_file
from rig.formats.checked_entries import LARGEST_RIG, Entries
from rig.formats.output_files import write_text
from rig.model.design import Hexapod
from rig.model.pose import pose as pose_of
from rig.model.pose import pose_to_vector

SCHEMA = "online/1"
MOST_SHARED = 1000  # draws that all poses' errors have in common: six for a camera
SINGULAR = 1e-12  # 1/m; what a triangle's diagonal must exceed


@dataclass(frozen=True, slots=True, eq=False)
class Saved:
    """start : Start; scatter : (6,) m; state : State; held : poses that wait; number : poses so far; data : marks of
    what was learnt.
    """

    start: Start
    scatter: np.ndarray
    state: State
    held: tuple[Pose, ...]
    number: int
    data: frozenset[str]


def save(path: Path | str, saved: Saved) -> None:
    """Write a Saved, whole or not at all."""
    nominal, recent = saved.start.nominal, saved.state.recent
    estimate, first = (recent[0].before, recent[0].first) if recent else (saved.state.estimate, saved.state.first)
    tree = {
        "schema": SCHEMA,
        "nominal": {
            "base_joints": nominal.base_joints.tolist(),
            "strut_zeros": nominal.strut_zeros.tolist(),
            "platform_joints": nominal.platform_joints.tolist(),
            "home": pose_to_vector(nominal.home).tolist(),
            "strut_range": nominal.strut_range.tolist(),
        },
        "root": saved.start.root.tolist(),
        "scatter": saved.scatter.tolist(),
        "p": estimate.p.tolist(),
        "s": estimate.s.tolist(),
        "S": estimate.S[:, : len(estimate.S) + 1].tolist(),
        "number": saved.number,
        "data": sorted(saved.data),
        "recent": [_out(each.pose) for each in recent],
        "held": [_out(pose) for pose in saved.held],
        "first": None if first is None else [_out(pose) for pose in first],
    }
    write_text(path, json.dumps(tree) + "\n")


def load(path: Path | str) -> Saved:
    """Saved as `save` wrote it. Raises FileError for a file that is missing, cut off, or none of these: every array's
    shape is checked, since compiled code takes it on trust."""
    tree = json_file.load(Path(path), "state of on-line learning", SCHEMA)
    nominal, s = _nominal(tree.table("nominal")), tree.array("s", (None,))
    if len(s) > MOST_SHARED:
        tree.fail(f"s has {len(s)} draws, more than {MOST_SHARED}", "s")
    scatter = tree.array("scatter", (6,))
    root, p = tree.array("root", (42, 42)), tree.array("p", (42,), length_limit=LARGEST_RIG)
    start = Start(nominal, root, Machine(np.ascontiguousarray(nominal.home.as_matrix()), scatter**2))
    estimate = initial_estimate(p, root, len(s))
    k = len(estimate.S)
    estimate.s[:], estimate.S[:, : k + 1] = s, tree.array("S", (k, k + 1))
    for key, R in (("root", root), ("S", estimate.S[:, :k])):
        if not (np.abs(np.diag(R)) > SINGULAR).all() or np.tril(R, -1).any() and key == "S":
            tree.fail(f"{key} is no triangle with an inverse", key)
    first = None if tree.get("first") is None else _in(tree, "first", len(s), AGAIN[-1])
    recent, held = _in(tree, "recent", len(s), WINDOW), _in(tree, "held", len(s), WINDOW)
    number = tree.whole("number", 0)
    state = State(estimate, 0, (), first, np.zeros(6), False)
    try:
        for pose in recent:
            state = state_with_pose(state, pose, start)
    except RigError as error:
        raise FileError(
            path, f"is no state of on-line learning: its last poses cannot be learnt again: {error}"
        ) from None
    return Saved(start, scatter, state, held, number, frozenset(tree.texts("data") if "data" in tree.tree else ()))


def _nominal(table: Entries) -> Hexapod:
    home = table.array("home", (6,))
    return Hexapod(
        table.array("base_joints", (6, 3), length_limit=LARGEST_RIG),
        table.array("platform_joints", (6, 3), length_limit=LARGEST_RIG),
        table.array("strut_range", (6, 2), length_limit=LARGEST_RIG),
        pose_of(home[:3], home[3:]),
        table.array("strut_zeros", (6,)),
    )


def _out(pose: Pose) -> list[Any]:
    return [pose.number, *[part.tolist() for part in pose[1:]]]


def _in(tree: Entries, key: str, shared: int, most: int) -> tuple[Pose, ...]:
    """Poses of what `_out` wrote, at most so many."""
    rows = tree.lists(key, 6)
    if len(rows) > most:
        tree.fail(f"{key} has {len(rows)} poses, more than {most}", key)
    return tuple(
        Pose(
            row.whole(0, 0),
            row.array(1, (6,)),
            row.array(2, (3, 3)),
            row.array(3, (3,)),
            row.array(4, (6, 6)),
            row.array(5, (6, shared)),
        )
        for row in rows
    )
