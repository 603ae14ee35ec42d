"""Accepted measuring limbs as the source of a run's poses: told at once, with vision looking at some of them while they
are in force.
"""

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certify import redundant_limb_checks
from calib.online.limb_vision_agreement import Disagreement, LimbCheck
from calib.online.measuring_limb_poses import LOOKS
from calib.online.measuring_limbs_file import Accepted


class LimbLive:
    """in_force : whether the limbs still stand for vision, until a check says otherwise. accepted : Accepted;
    every : poses between two looks
    """

    def __init__(self, accepted: Accepted, every: int) -> None:
        self.accepted, self.in_force = accepted, True
        self._checks, self._every, self._number, self._looks = LimbCheck(accepted.limbs), every, 0, 0
        self._last: list[np.ndarray] = []

    def pose(self, lengths: np.ndarray) -> tuple[RigidTransform, np.ndarray, np.ndarray]:
        """(T_base_platform, own (6, 6), common (6, 42)) of readings (limbs,) m; own : covariance, common : factor of
        what all poses share, m and rad.

        Raises NotConverged for readings that close on no pose
        """
        T = self.accepted.limbs.pose(lengths)
        return T, *self.accepted.limbs.uncertainty(T)

    def is_closed(self, lengths: np.ndarray) -> Disagreement | None:
        """What limbs beyond six say of readings (limbs,) m and those before; where they disagree, limbs are out of
        force. Raises as `pose`
        """
        self._last = [*self._last[1 - redundant_limb_checks.IN_A_ROW :], lengths]
        open_ = redundant_limb_checks.first_unclosed_limb(self.accepted.limbs, np.array(self._last))
        self.in_force = open_ is None
        return None if open_ is None else Disagreement(str(open_), open_.limb, redundant_limb_checks.WHO)

    def is_check_due(self, unsure: bool) -> bool:
        """Whether vision looks at the pose in hand, once for each pose. unsure : whether the struts tell otherwise than
        the limbs
        """
        self._looks = LOOKS if unsure else max(self._looks - 1, 0)
        now = self._number % self._every == 0 or self._looks > 0 or self._checks.undecided or not self._checks.count
        self._number += 1
        return now

    def check(
        self, lengths: np.ndarray, T_base_platform: RigidTransform, covariance: np.ndarray
    ) -> Disagreement | None:
        """What vision's pose with its covariance (6, 6), m and rad, says of limbs that read lengths (limbs,) m; where
        it disagrees they are out of force."""
        found = self._checks.take(lengths, T_base_platform, covariance)
        self.in_force = found is None
        return found

    @property
    def undecided(self) -> bool:
        """Whether the last check disagreed and the next ones say who was wrong."""
        return self._checks.undecided
