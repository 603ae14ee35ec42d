"""The empirical way to a posture: those that an arm really took are compared, and the best is gone back to along the
way it came.

Source: patent on force measurement with redundant manipulators, [0023].
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.errors import RigError
from rig.model.design import Arm
from rig.model.mechanisms import arm as mechanism
from rig.model.pose import pose_difference
from rig.posture import force_transmission
from rig.posture.exertable_wrench import Exertion
from rig.posture.force_transmission import Wish
from rig.posture.null_space_search import HELD
from rig.recording.recording_folder import Recording

SAME = np.repeat([1e-3, 2e-3], 3)  # m, rad; a hand that is off by less, as controllers hold it, has stayed


@dataclass(frozen=True, slots=True, eq=False)
class Visited:
    """k postures taken with the hand where it is wanted. frame, t : (k,) number and s; q : (k, n) rad; value : (k,) the
    measure; best : index
    elsewhere : how many more the recording has, with the hand elsewhere; back : (j, n) rad, the way from where the
        recording ends to the best"""

    frame: np.ndarray
    t: np.ndarray
    q: np.ndarray
    value: np.ndarray
    best: int
    elsewhere: int
    back: np.ndarray


def best_visited_posture(
    recording: Recording, arm: Arm, wish: Wish | Exertion, held: str, wanted: RigidTransform | None = None
) -> Visited:
    """Visited of the postures commanded at a recording's exposures. held : what of the hand must be the same, as of
    rig.posture.null_space_search
    wanted : T_base_platform of the hand, by default that of the first exposure

    Raises RigError for an arm of other joints, without commands, and where no posture, or one alone, has the hand there
    """
    frames, t, q = recording.commanded()
    if q.shape[1] != len(arm.axes):
        raise RigError(f"{recording.folder} commands {q.shape[1]} axes; the arm has {len(arm.axes)} joints")
    T = mechanism.forward(q, arm)
    apart = np.abs(pose_difference(T[0] if wanted is None else wanted, T))
    there = (apart <= SAME)[:, HELD[held]].all(axis=1)
    if there.sum() < 2:
        raise RigError(
            f"{recording.folder}: {there.sum()} of {len(q)} postures have the hand's {held} where it is "
            "wanted; comparing takes two"
        )
    value = force_transmission.transmission_measure(q[there], arm, wish)
    best = int(value.argmax())
    return Visited(
        frames[there], t[there], q[there], value, best, int((~there).sum()), _back(recording, float(t[there][best]))
    )


def _back(recording: Recording, t: float) -> np.ndarray:
    """(j, n) rad from the last exposure back to a time (s), as commanded between them, turned round."""
    assert recording.commands is not None  # or `commanded` had said so
    last, c = float(recording.exposures.times()[1].max()), recording.commands
    inside = c.t[(c.t > t) & (c.t < last)]
    rows = c.at(np.concatenate([[t], inside, [last]]))[::-1]
    return rows[np.r_[True, np.abs(np.diff(rows, axis=0)).max(axis=1) > 0]]
