"""Accepted measuring limbs held against vision pose by pose, now and then: what no longer agrees is named within three
poses.

The limbs are learnt on as struts are, from vision's poses, beginning with what their acceptance knows: then what
detects a strut that missed steps (change_detection.py) detects a limb that slipped. One pose of vision that agrees with
nothing is vision's mistake; several in a row are not.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certify.fitted_limbs import Limbs
from calib.online.change_detection import Change
from calib.online.information_filter import Online

IN_A_ROW = 3  # poses of vision that agree with nothing, from which it is not vision that is wrong


@dataclass(frozen=True, slots=True)
class Disagreement:
    """reason : in words; limb : its number, from 1, or None where it is none of them alone; who : says so, in words"""

    reason: str
    limb: int | None
    who: str = "Vision no longer agrees with the measuring limbs"


class LimbCheck:
    """Checks of one session. limbs : Limbs as accepted; shared : draws that all of vision's errors have in common in
    it.
    """

    def __init__(self, limbs: Limbs, shared: int = 0) -> None:
        self._online, self._limbs = Online(limbs.hexapod, shared, limbs.sigma, limbs.covariance), limbs.chosen
        self._strange = 0

    @property
    def count(self) -> int:
        """Checks so far."""
        return self._online.number

    @property
    def undecided(self) -> bool:
        """Whether the last pose disagreed and the next ones will say whether it alone was wrong."""
        return bool(self._online.held)

    def take(
        self,
        lengths: np.ndarray,
        T_base_platform: RigidTransform,
        covariance: np.ndarray,
        common: np.ndarray | None = None,
    ) -> Disagreement | None:
        """What vision's pose says of limbs that read lengths (limbs,) m: None while they agree.

        covariance : (6, 6) of vision's pose, m and rad, tangent on the right; common : (6, shared) factor of the errors
            that vision's poses share
        """
        update = self._online.update(lengths[self._limbs], T_base_platform, covariance, common)
        self._strange = self._strange + len(update.dropped) if update.held or update.dropped else 0
        if update.changes:
            return _named(update.changes[0], self._limbs)
        if self._strange >= IN_A_ROW:
            return Disagreement(f"{self._strange} poses in a row agree with no change of one limb or of the base", None)
        return None


def _named(change: Change, limbs: np.ndarray) -> Disagreement:
    """What a Change says of limbs, of which the six whose numbers (from 0) are given tell the pose."""
    if not isinstance(change.size, float):
        position, rotation = (float(np.linalg.norm(part)) for part in (change.size[:3], change.size[3:]))
        return Disagreement(
            f"vision's poses are moved against the limbs' by {position * 1e6:.1f} um and "
            f"{rotation * 1e6:.1f} urad: a camera, the "
            "base or the limbs' frame was knocked",
            None,
        )
    how = "it slipped" if change.kind == "strut" else "its joint was knocked, the amount differs from pose to pose"
    limb = None if change.strut is None else int(limbs[change.strut - 1]) + 1
    return Disagreement(
        f"limb {limb} is longer by {change.size * 1e6:+.1f} +- {change.sigma * 1e6:.1f} um than it reads: {how}", limb
    )
