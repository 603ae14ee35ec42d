"""States of the on-line information filter, the steps between them, and their JSON file.

The steps from one state to the next, and its JSON file.

A step makes a new state: to go back is to keep one.

Source of the steps: Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, docs/mathematics.md
(22).
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.models.platform.determined_parameters_and_stated_geometry_tolerance import (
    parameter_changes_by_base_and_platform_frame_motion,
)
from calib.online.information_filter_kernels_and_change_detection import (
    ALARM,
    KINDS,
    REFUSED,
    SUMS,
    WINDOW,
    Change,
    Estimate,
    Evidence,
    Machine,
    Pose,
    add_pose_to_estimate_in_place,
    add_triangular_solution_to_estimate,
)
from rig.array_and_json_types import Floats
from rig.errors import FileError, RigError
from rig.formats import json_toml_and_yaml_loading
from rig.formats.checked_toml_and_json_entries import LARGEST_RIG, Entries
from rig.formats.output_files import write_text
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import geometric_parameters, mechanism_with_parameters
from rig.model.pose import pose as pose_of
from rig.model.pose import pose_to_vector

RELINEARISED_AT = (8, 16, 32, 64, 128)  # poses after which all up to then are linearised again
LARGER = 3.0  # times a change's size: standard deviation that what changed is opened by
ASIDE = 2.0  # the same for the joints of a strut that changed in length


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where the filter starts. nominal : Hexapod; root : (42, 42) 1/m, square root of the information at the start;
    machine : Machine.
    """

    nominal: Hexapod
    root: Floats
    machine: Machine


class Learnt(NamedTuple):
    """One of the last poses. own : (SUMS,) its own sums; before, first : the state's before it."""

    pose: Pose
    own: Floats
    before: Estimate
    first: tuple[Pose, ...] | None


class State(NamedTuple):
    """estimate : Estimate; learnt : how many poses, those learnt again too; recent : the last ones, at most WINDOW;
    first : poses to linearise again, None once that is over; innovation : (6,) whitened, of the last pose;
        alarm : whether it leaves room for a change."""

    estimate: Estimate
    learnt: int
    recent: tuple[Learnt, ...]
    first: tuple[Pose, ...] | None
    innovation: Floats
    alarm: bool

    @property
    def square(self) -> float:
        """The innovation squared; chi-square with 6 degrees of freedom while nothing changes."""
        return float(self.innovation @ self.innovation)


def _initial_estimate(p: Floats, root: Floats, shared: int) -> Estimate:
    """Estimate of parameters p (42,) m with the square root (42, 42) 1/m of their information, before any pose;
    `shared` draws, unknown.
    """
    k = shared + 42
    S = np.zeros((k, k + 1 + KINDS * WINDOW))
    S[:shared, :shared], S[shared:, shared:k] = np.eye(shared), root
    return Estimate(p.copy(), np.zeros(shared), S, np.zeros((WINDOW, SUMS)))


def initial_state(start: Start, common_error_count: int) -> State:
    """Initial state, before any pose."""
    return State(
        _initial_estimate(geometric_parameters(start.nominal), start.root, common_error_count),
        0,
        (),
        (),
        np.zeros(6),
        False,
    )


def state_of_new_session(state: State, common_errors: int) -> State:
    """State of the filter at the start of a new session.

    It has so many new draws of common errors.
    """
    c, estimate = len(state.estimate.s), state.estimate
    return State(
        _initial_estimate(estimate.p, estimate.S[c:, c : c + 42], common_errors),
        state.learnt,
        (),
        None,
        state.innovation,
        False,
    )


def state_with_pose(state: State, pose: Pose, start: Start, update_at_once: bool = True) -> State:
    """State with one more pose.

    update_at_once : whether the estimate follows at once.
    Raises RigError for a command that closes on no pose or a covariance that is none
    """
    before, slot, innovation = state.estimate, state.learnt % WINDOW, np.empty(6)
    after = Estimate(before.p.copy(), before.s.copy(), before.S.copy(), before.sums.copy())
    try:
        outcome = add_pose_to_estimate_in_place(pose, start.machine, after, slot, innovation, update_at_once)
    except ZeroDivisionError:  # a strut without length
        outcome = REFUSED
    if outcome == REFUSED:
        raise RigError(
            f"pose {pose.number}: the commanded lengths {pose.command.round(6).tolist()} m close on no pose, "
            "or covariance is invalid"
        )
    recent = (*state.recent[1 - WINDOW :], Learnt(pose, after.sums[slot].copy(), before, state.first))
    first = state.first
    if first is not None:
        first = (*first, pose) if len(first) < RELINEARISED_AT[-1] else None
    return State(after, state.learnt + 1, recent, first, innovation, outcome == ALARM)


def relinearised_state(state: State, start: Start) -> State:
    """Filter state after all poses so far are filtered again about the present estimate.

    So the filter ends where the batch does, docs/mathematics.md (7)
    """
    assert state.first is not None
    p, s = state.estimate.p, state.estimate.s
    begins, k = _initial_estimate(p, start.root, len(s)), len(s) + 42
    begins.s[:] = s
    begins.S[:, k] = np.r_[-s, start.root @ (geometric_parameters(start.nominal) - p)]
    relinearised = State(begins, state.learnt, (), (), state.innovation, False)
    for pose in state.first:
        relinearised = state_with_pose(relinearised, pose, start, update_at_once=False)
    add_triangular_solution_to_estimate(
        relinearised.estimate.p, relinearised.estimate.s, relinearised.estimate.S
    )  # in place: nothing else holds this estimate yet
    return relinearised


def evidence_of_changes_in_last_poses(state: State) -> list[Evidence]:
    """Evidence of changes from the last 1, 2, .. poses.

    None where no hypothesis can hold.
    """
    found: list[Evidence] = []
    if not state.alarm:
        return found
    for poses in range(1, len(state.recent) + 1):
        total = state.estimate.sums[(state.learnt - poses) % WINDOW]
        if round(total[-1]) != poses:
            break
        last = state.recent[-poses:]
        single = np.array([[each.own[1:7], each.own[1 + KINDS : -1 : KINDS + 1][:6]] for each in last])
        found.append(
            Evidence(
                last[0].pose.number, total[0], total[1 : 1 + KINDS], total[1 + KINDS : -1].reshape(KINDS, KINDS), single
            )
        )
    return found


def state_refiltered_with_changes_freed(state: State, changes: tuple[Change, ...], start: Start) -> State:
    """Filter state with changed quantities freed.

    Set back before the changes, later poses filtered again.
    """
    at = next(k for k in range(1, WINDOW + 1) if state.recent[-k].pose.number == changes[0].onset)
    before = state.recent[-at].before
    estimate = Estimate(before.p, before.s, before.S.copy(), np.zeros_like(before.sums))
    for change in changes:
        _loosen(estimate, change, start.nominal)
    refiltered = State(estimate, state.learnt - at, (), None, state.innovation, False)
    for each in state.recent[-at:]:
        refiltered = state_with_pose(refiltered, each.pose, start)
    return refiltered


def _loosen(estimate: Estimate, change: Change, nominal: Hexapod) -> None:
    """Process noise along what changed, into the estimate's triangle: x_new = x_old + g w, w ~ N(0, I), in information
    form.
    """
    k, c = len(estimate.S), len(estimate.s)
    if change.strut is not None:
        i, size = change.strut - 1, max(abs(float(change.size)), 3 * float(change.sigma))
        g = np.zeros((k, 7))
        g[c + 36 + i, 0] = LARGER * size
        for k0, joint in enumerate((c + 3 * i, c + 18 + 3 * i)):
            g[joint + np.arange(3), 1 + 3 * k0 + np.arange(3)] = (LARGER if change.kind == "joint" else ASIDE) * size
    else:
        moves = parameter_changes_by_base_and_platform_frame_motion(mechanism_with_parameters(nominal, estimate.p))[
            :, :6
        ]
        g = np.concatenate([np.zeros((c, 6)), moves * LARGER * np.abs(change.size)])
    R, r = estimate.S[:, :k], g.shape[1]
    both = np.asarray(np.linalg.qr(np.block([[np.eye(r), np.zeros((r, k))], [-R @ g, R]]), mode="r"))
    estimate.S[:, :k] = both[r:, r:]


SCHEMA = "online/1"
MOST_SHARED = 1000  # draws that all poses' errors have in common: six for a camera
SINGULAR = 1e-12  # 1/m; what a triangle's diagonal must exceed


@dataclass(frozen=True, slots=True, eq=False)
class Saved:
    """start : Start; scatter : (6,) m; state : State; held : poses that wait; number : poses so far; data : marks of
    what was learnt.
    """

    start: Start
    scatter: Floats
    state: State
    held: tuple[Pose, ...]
    number: int
    data: frozenset[str]


def save_filter_state(path: Path | str, saved: Saved) -> None:
    """Save a filter's state.

    It is written whole or not at all.
    """
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


def load_filter_state(path: Path | str) -> Saved:
    """Load a filter's Saved state.

    Raises FileError for a file that is missing, cut off or of another kind.
    """
    tree = json_toml_and_yaml_loading.load_json(Path(path), "state of on-line learning", SCHEMA)
    nominal, s = _nominal(tree.table("nominal")), tree.array("s", (None,))
    if len(s) > MOST_SHARED:
        tree.fail(f"s has {len(s)} draws, more than {MOST_SHARED}", "s")
    scatter = tree.array("scatter", (6,))
    root, p = tree.array("root", (42, 42)), tree.array("p", (42,), length_limit=LARGEST_RIG)
    start = Start(nominal, root, Machine(np.ascontiguousarray(nominal.home.as_matrix()), scatter**2))
    estimate = _initial_estimate(p, root, len(s))
    k = len(estimate.S)
    estimate.s[:], estimate.S[:, : k + 1] = s, tree.array("S", (k, k + 1))
    for key, R in (("root", root), ("S", estimate.S[:, :k])):
        if not (np.abs(np.diag(R)) > SINGULAR).all() or np.tril(R, -1).any() and key == "S":
            tree.fail(f"{key} is no triangle with an inverse", key)
    first = None if tree.get("first") is None else _in(tree, "first", len(s), RELINEARISED_AT[-1])
    recent, held = _in(tree, "recent", len(s), WINDOW), _in(tree, "held", len(s), WINDOW)
    number = tree.whole("number", 0)
    state = State(estimate, 0, (), first, np.zeros(6), False)
    try:
        for pose in recent:
            state = state_with_pose(state, pose, start)
    except RigError as error:
        raise FileError(path, f"is no state of on-line learning: its last poses cannot be replayed: {error}") from None
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


def _out(pose: Pose) -> list[object]:
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
