"""What an adjustment may move, as columns, and where it has moved them to."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from vision.bundle.printing_errors import NONE, Prints
from vision.predict import State

POSE_SCALE = 1e-3  # m, rad; only conditions the equations


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """Which columns belong to whom.

    poses, lenses : {camera index: slice}; markers : {row of the marker map: slice}; targets : {target name: slice}
    local_poses : {moving camera: slice within a frame's block}; shared, local : how many; used : (F, local) bool, seen
        at all
    scale : (shared,) own units per unknown; prior : (shared,) 1 where the stated value holds it, else 0
    names : (who, which part) of each shared unknown; basis : (shared, k) motions that leave the datums where they are
    middles : {target name: (3,) m, what it turns about}; seen : rows of the marker map that are observed
    prints : Prints, how markers held where they are stated are printed
    """

    poses: dict[int, slice]
    lenses: dict[int, slice]
    markers: dict[int, slice]
    targets: dict[str, slice]
    local_poses: dict[int, slice]
    shared: int
    local: int
    used: np.ndarray
    scale: np.ndarray
    prior: np.ndarray
    names: list[tuple[str, str]]
    basis: np.ndarray
    middles: dict[str, np.ndarray]
    seen: np.ndarray
    prints: Prints = NONE


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """State, and how far markers (m,) and targets have moved from where they were stated: T_stated_now, along their own
    axes.
    """

    state: State
    marker_moves: RigidTransform | None
    target_moves: dict[str, RigidTransform]
