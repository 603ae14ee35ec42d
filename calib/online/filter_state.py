"""What the on-line filter knows at one moment, and the steps from one state to the next. A step makes a new state: to
go back is to keep one.

Source of the steps: Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, docs/mathematics.md (22).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.models.platform.identification import parameters, with_parameters
from calib.models.platform.parameter_observability import frame_motion_columns
from calib.online.change_detection import Change, Evidence
from calib.online.square_root_kernels import ALARM, KINDS, REFUSED, SUMS, WINDOW, Estimate, Machine, Pose, follow, learn
from rig.errors import RigError
from rig.model.design import Hexapod

AGAIN = (8, 16, 32, 64, 128)  # poses after which all up to then are linearised again
LARGER = 3.0  # times a change's size: standard deviation that what changed is opened by
ASIDE = 2.0  # the same for the joints of a strut that changed in length


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where the filter starts. nominal : Hexapod; root : (42, 42) 1/m, square root of the information at the start;
    machine : Machine.
    """

    nominal: Hexapod
    root: np.ndarray
    machine: Machine


class Learnt(NamedTuple):
    """One of the last poses. own : (SUMS,) its own sums; before, first : the state's before it."""

    pose: Pose
    own: np.ndarray
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
    innovation: np.ndarray
    alarm: bool

    @property
    def square(self) -> float:
        """The innovation squared; chi-square with 6 degrees of freedom while nothing changes."""
        return float(self.innovation @ self.innovation)


def initial_estimate(p: np.ndarray, root: np.ndarray, shared: int) -> Estimate:
    """Estimate of parameters p (42,) m with the square root (42, 42) 1/m of their information, before any pose;
    `shared` draws, unknown.
    """
    k = shared + 42
    S = np.zeros((k, k + 1 + KINDS * WINDOW))
    S[:shared, :shared], S[shared:, shared:k] = np.eye(shared), root
    return Estimate(p.copy(), np.zeros(shared), S, np.zeros((WINDOW, SUMS)))


def initial_state(start: Start, shared: int) -> State:
    """State before any pose."""
    return State(initial_estimate(parameters(start.nominal), start.root, shared), 0, (), (), np.zeros(6), False)


def state_of_new_session(state: State, shared: int) -> State:
    """State from which on the poses share other errors: `shared` new draws; what was known of the old ones is
    marginalised.
    """
    c, estimate = len(state.estimate.s), state.estimate
    return State(
        initial_estimate(estimate.p, estimate.S[c:, c : c + 42], shared),
        state.learnt,
        (),
        None,
        state.innovation,
        False,
    )


def state_with_pose(state: State, pose: Pose, start: Start, move: bool = True) -> State:
    """State with a pose. move : whether the estimate follows at once.

    Raises RigError for a command that closes on no pose or a covariance that is none
    """
    before, slot, innovation = state.estimate, state.learnt % WINDOW, np.empty(6)
    after = Estimate(before.p.copy(), before.s.copy(), before.S.copy(), before.sums.copy())
    try:
        said = learn(pose, start.machine, after, slot, innovation, move)
    except ZeroDivisionError:  # a strut without length
        said = REFUSED
    if said == REFUSED:
        raise RigError(
            f"pose {pose.number}: the commanded lengths {pose.command.round(6).tolist()} m close on no pose, "
            "or its covariance is none"
        )
    recent = (*state.recent[1 - WINDOW :], Learnt(pose, after.sums[slot].copy(), before, state.first))
    first = state.first
    if first is not None:
        first = (*first, pose) if len(first) < AGAIN[-1] else None
    return State(after, state.learnt + 1, recent, first, innovation, said == ALARM)


def relinearised_state(state: State, start: Start) -> State:
    """State with all poses so far, which `first` holds, once more from the start, linearised about the present
    estimate.

    So the filter ends where the batch does, docs/mathematics.md (7)
    """
    assert state.first is not None
    p, s = state.estimate.p, state.estimate.s
    begins, k = initial_estimate(p, start.root, len(s)), len(s) + 42
    begins.s[:] = s
    begins.S[:, k] = np.r_[-s, start.root @ (parameters(start.nominal) - p)]
    again = State(begins, state.learnt, (), (), state.innovation, False)
    for pose in state.first:
        again = state_with_pose(again, pose, start, move=False)
    follow(again.estimate.p, again.estimate.s, again.estimate.S)  # in place: nothing else holds this estimate yet
    return again


def change_evidence(state: State) -> list[Evidence]:
    """Evidence of the last 1, 2, .. poses; none where no hypothesis can hold."""
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


def state_with_freed_changes(state: State, changes: tuple[Change, ...], start: Start) -> State:
    """State that goes back to before changes, lets what changed move, and has learnt the poses since anew."""
    at = next(k for k in range(1, WINDOW + 1) if state.recent[-k].pose.number == changes[0].onset)
    before = state.recent[-at].before
    estimate = Estimate(before.p, before.s, before.S.copy(), np.zeros_like(before.sums))
    for change in changes:
        _loosen(estimate, change, start.nominal)
    again = State(estimate, state.learnt - at, (), None, state.innovation, False)
    for each in state.recent[-at:]:
        again = state_with_pose(again, each.pose, start)
    return again


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
        moves = frame_motion_columns(with_parameters(nominal, estimate.p))[:, :6]
        g = np.concatenate([np.zeros((c, 6)), moves * LARGER * np.abs(change.size)])
    R, r = estimate.S[:, :k], g.shape[1]
    both = np.asarray(np.linalg.qr(np.block([[np.eye(r), np.zeros((r, k))], [-R @ g, R]]), mode="r"))
    estimate.S[:, :k] = both[r:, r:]
