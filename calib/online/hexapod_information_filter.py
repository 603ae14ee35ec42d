"""Information filter of the hexapod's parameters.

Square-root form, 42 parameters, pose by pose, with change detection.

Linearised at every pose about the estimate of the moment, the first poses once more about a later one, it ends where a
batch of the same poses does. What changed (information_filter_kernels_and_change_detection.py) is told within three
poses; the
filter then goes back
to before it, opens what changed, and learns the poses since anew. A pose that disagrees is held until the next ones say
whether it alone was wrong.
Source: docs/mathematics.md (22), (23).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.models.platform.platform_identification import PRIOR
from calib.online import information_filter_state_steps_and_json_file
from calib.online.information_filter_kernels_and_change_detection import (
    SUSPECT,
    WINDOW,
    Change,
    Machine,
    Pose,
    detect_changes,
)
from calib.online.information_filter_state_steps_and_json_file import (
    RELINEARISED_AT,
    Start,
    State,
    evidence_of_changes_in_last_poses,
    initial_state,
    relinearised_state,
    state_of_new_session,
    state_refiltered_with_changes_freed,
    state_with_pose,
)
from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import mechanism_with_parameters

LARGEST = 6  # changes at one pose
EARLY = 2  # times that the first poses are linearised again before what they seem to show is believed


@dataclass(frozen=True, slots=True, eq=False)
class Update:
    """number : of the pose, from 0; innovation : (6,) whitened, N(0, I) where nothing is wrong; changes : Changes found
    with it
    held : whether the pose waits for the next one's word; dropped : numbers of poses found wrong with it"""

    number: int
    innovation: Floats
    changes: tuple[Change, ...]
    held: bool
    dropped: tuple[int, ...]


class Online:
    """The filter. Its estimate is `mechanism`, with `covariance`; `save` and `load` carry it over a restart exactly.

    number : poses so far; data : marks of what was learnt (see rig.recording.frame_selection_and_content_hashes), so
        that it is not learnt again
    """

    def __init__(
        self, nominal: Hexapod, shared: int = 0, scatter: Floats | None = None, covariance: Floats | None = None
    ) -> None:
        """A filter before its first pose.

        nominal : Hexapod to start from; shared : draws that all poses' errors have in common
        scatter : (6,) m of each strut beyond the poses' covariance, or None
        covariance : (42, 42) m^2 of the start, from a calibration, or None for what an owner's figures are worth (5 mm)
        """
        root = (
            np.eye(42) / PRIOR
            if covariance is None
            else np.asarray(np.linalg.qr(np.linalg.inv(np.linalg.cholesky(covariance)), mode="r"))
        )
        self.scatter = np.zeros(6) if scatter is None else np.asarray(scatter, float)
        self.start = Start(nominal, root, Machine(np.ascontiguousarray(nominal.home.as_matrix()), self.scatter**2))
        self.state = initial_state(self.start, shared)
        self.held: tuple[Pose, ...] = ()
        self.number, self.data = 0, set[str]()

    @property
    def nominal(self) -> Hexapod:
        """The Hexapod that it started from."""
        return self.start.nominal

    @property
    def p(self) -> Floats:
        """(42,) m, the parameters as estimated now."""
        return self.state.estimate.p

    @property
    def mechanism(self) -> Hexapod:
        """The Hexapod as estimated now."""
        return mechanism_with_parameters(self.nominal, self.p)

    @property
    def covariance(self) -> Floats:
        """(42, 42) m^2 of the estimate."""
        S = self.state.estimate.S
        half = np.linalg.inv(S[:, : len(S)])
        return (half @ half.T)[-42:, -42:]

    def new_session(self, shared: int = 0) -> None:
        """From here on the poses share other errors: `shared` new draws, what was known of the old ones is
        marginalised.

        Poses that were held are given up.
        """
        self.state, self.held = state_of_new_session(self.state, shared), ()

    def update(
        self, x: Floats, T_base_platform: RigidTransform, covariance: Floats, common: Floats | None = None
    ) -> Update:
        """One pose. x : (6,) m commanded; T_base_platform : RigidTransform measured; covariance : (6, 6) tangent on the
        right
        common : (6, shared) factor of the shared errors, needed where there are any. Returns Update.

        A pose whose command closes nowhere by the estimate, but does by the start, is dropped.
        Raises ValueError for wrong shapes, RigError for a command that closes on no pose or a covariance that is none;
            then nothing changed
        """
        matrix, shared = T_base_platform.as_matrix(), len(self.state.estimate.s)
        common = np.zeros((6, 0)) if common is None else np.ascontiguousarray(common, float)
        pose = Pose(
            self.number,
            np.array(x, float),
            matrix[:3, :3].copy(),
            matrix[:3, 3].copy(),
            np.array(covariance, float),
            common,
        )
        if (
            pose.command.shape != (6,)
            or pose.covariance.shape != (6, 6)
            or common.shape != (6, shared)
            or not np.isfinite(pose.command).all()
        ):
            raise ValueError(
                f"expected a command (6,), a covariance (6, 6) and common (6, {shared}), got {pose.command.shape}, "
                f"{pose.covariance.shape} and {common.shape}"
            )
        try:
            updated = _pose_update(self.state, self.held, pose, self.start)
        except RigError:
            updated = _unexpected(self.state, self.held, pose, self.start)
        self.state, self.held = updated.state, updated.held
        self.number += 1
        return Update(pose.number, updated.innovation, updated.changes, bool(updated.held), updated.dropped)

    def save(self, path: Path | str) -> None:
        """Write the state, whole or not at all: the filter before its last poses, and those."""
        information_filter_state_steps_and_json_file.save_filter_state(
            path,
            information_filter_state_steps_and_json_file.Saved(
                self.start, self.scatter, self.state, self.held, self.number, frozenset(self.data)
            ),
        )

    @classmethod
    def load(cls, path: Path | str) -> "Online":
        """The filter as saved. Raises FileError for a file that is missing, cut off, or none of these."""
        saved = information_filter_state_steps_and_json_file.load_filter_state(path)
        made = cls(saved.start.nominal, 0, saved.scatter)
        made.start, made.state, made.held, made.number, made.data = (
            saved.start,
            saved.state,
            saved.held,
            saved.number,
            set(saved.data),
        )
        return made


class _PoseUpdate(NamedTuple):
    """What a pose made of the filter, as in Update; held : poses that wait."""

    state: State
    held: tuple[Pose, ...]
    innovation: Floats
    changes: tuple[Change, ...]
    dropped: tuple[int, ...]


def _pose_update(before: State, waiting: tuple[Pose, ...], pose: Pose, start: Start) -> _PoseUpdate:
    """What a pose makes of a state with poses that wait."""
    state = before
    for each in (*waiting, pose):
        state = state_with_pose(state, each, start)
    state, found = _examined(state, start)
    dropped, innovation = tuple[int, ...](), state.innovation
    if waiting and not found:
        alone = state_with_pose(before, pose, start)
        innovation = alone.innovation
        if min(state.square, alone.square) < SUSPECT:  # those held were wrong, each alone
            dropped, waiting = tuple(each.number for each in waiting), ()
            state, found = _examined(alone, start)
            innovation = state.innovation
    changes: tuple[Change, ...] = ()
    while found and len(changes) < LARGEST:
        try:
            state = state_refiltered_with_changes_freed(state, found, start)
        except RigError:  # with these changes the machine closes on no pose: they explain nothing, and the pose waits
            break
        changes += found
        found, innovation = detect_changes(evidence_of_changes_in_last_poses(state)), state.innovation
    if not changes and (waiting or state.square > SUSPECT):
        held = (*waiting, pose)
        if len(held) == WINDOW:  # nothing explains them: the oldest is given up
            dropped, held = (*dropped, held[0].number), held[1:]
        return _PoseUpdate(before, held, innovation, changes, dropped)
    if state.first is not None and len(state.first) in RELINEARISED_AT:
        state = relinearised_state(state, start)
        innovation = state.innovation
    return _PoseUpdate(state, (), innovation, changes, dropped)


def _unexpected(state: State, waiting: tuple[Pose, ...], pose: Pose, start: Start) -> _PoseUpdate:
    """What is made of a pose whose command the geometry as estimated reaches nowhere: it is left out, as one that
    agrees with no other.

    Raises RigError where the geometry that the filter started from reaches it nowhere either, or covariance is invalid
    """
    alone = state_with_pose(initial_state(start, len(state.estimate.s)), pose, start)
    return _PoseUpdate(state, waiting, alone.innovation, (), (pose.number,))


def _examined(state: State, start: Start) -> tuple[State, tuple[Change, ...]]:
    """(State, Changes that its last poses bear out); early on, when a pose may still move the estimate far, only once
    linearised there.
    """
    found = detect_changes(evidence_of_changes_in_last_poses(state))
    for _ in range(EARLY):
        if state.first is None or not (found or state.square > SUSPECT):
            break
        state = relinearised_state(state, start)
        found = detect_changes(evidence_of_changes_in_last_poses(state))
    return state, found
