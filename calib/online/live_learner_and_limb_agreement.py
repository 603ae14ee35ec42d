"""Live learner of the geometry, and limb agreement.

During a run: jumps and drift, and agreement of measuring limbs with vision.
"""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certification import measuring_limb_identification_and_agreement, redundant_limb_checks
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.correction import Correction
from calib.online.filter_kernels_and_change_detection import Change
from calib.online.information_filter import Online
from calib.samples.pose_samples import Samples
from rig.array_and_json_types import Floats
from rig.model import mechanisms
from rig.model.design import Design
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.pose import pose_difference

LATEST = 5  # poses whose median error must exceed the tolerance: one is a bad measurement, five are a drift


@dataclass(frozen=True, slots=True, eq=False)
class Learnt:
    """What one pose said. error : (6,) m and rad, measured less what was expected of the command, in the platform's
    frame
    struts : (6,) m, commanded less what the nominal model says for the measured pose; innovation : RMS of what was
        expected, 1 is normal
    changes : jumps found with it; unsure : whether it disagrees and the next ones will say why; drift : (m, rad) beyond
        the tolerance, or None
    """

    error: Floats
    struts: Floats
    innovation: float
    changes: tuple[Change, ...]
    unsure: bool
    drift: tuple[float, float] | None


class Learner:
    """Learns from a run's poses. nominal : Hexapod; calibration : to start from, or None; tolerance : (m, rad) of
    drift, or None
    shared : draws that all poses' errors have in common."""

    def __init__(
        self,
        nominal: Hexapod,
        calibration: Calibration | None = None,
        tolerance: tuple[float, float] | None = None,
        shared: int = 0,
    ) -> None:
        self._nominal, self._tolerance = nominal, tolerance
        self._correction = calibration.correction if calibration else Correction(nominal, nominal, (None,) * 6)
        self._online = (
            Online(self._correction.fitted, shared, calibration.scatter, calibration.covariance)
            if calibration
            else Online(nominal, shared)
        )
        self._kept = copy(self._online)
        self._calibrated, self._errors = calibration is not None, list[Floats]()
        self._drifting = False

    @property
    def hexapod(self) -> Hexapod:
        """The geometry as learnt by now."""
        return self._online.hexapod

    def expected(self, commanded: Floats) -> RigidTransform:
        """T_base_platform that commanded lengths (6,) m should give, by what is known so far."""
        return mechanisms.kinematics_of(self._nominal).forward(
            commanded - self._correction.rho(commanded), self._online.hexapod
        )

    def save(self) -> None:
        """Remember what is known now."""
        self._kept = copy(self._online)

    def restore(self) -> None:
        """Know again what was known when it was last kept, nothing of what came since; poses to come share no
        errors.
        """
        self._online = copy(self._kept)
        self._online.new_session()

    def learn(
        self, commanded: Floats, T_base_platform: RigidTransform, covariance: Floats, common: Floats | None = None
    ) -> Learnt:
        """One pose. commanded : (6,) m; covariance : (6, 6) tangent on the right; common : (6, shared) factor of errors
        that poses share.

        Raises RigError as `Online.update` does.
        """
        expected = self.expected(commanded)
        error = pose_difference(expected, T_base_platform)
        struts = commanded - mechanisms.kinematics_of(self._nominal).inverse(T_base_platform, self._nominal)
        update = self._online.update(commanded - self._correction.rho(commanded), T_base_platform, covariance, common)
        fresh = (
            self._drift(pose_difference(self._correction.predict(commanded), T_base_platform))
            if self._calibrated
            else None
        )
        return Learnt(
            error, struts, float(np.sqrt(update.innovation @ update.innovation / 6)), update.changes, update.held, fresh
        )

    def _drift(self, error: Floats) -> tuple[float, float] | None:
        """(m, rad) of the drift from the calibration, once, when it leaves the tolerance."""
        self._errors = [*self._errors[1 - LATEST :], error]
        if self._tolerance is None or len(self._errors) < LATEST:
            return None
        middle = np.median(self._errors, axis=0)
        size = float(np.linalg.norm(middle[:3])), float(np.linalg.norm(middle[3:]))
        before, self._drifting = self._drifting, size[0] > self._tolerance[0] or size[1] > self._tolerance[1]
        return size if self._drifting and not before else None


class LimbWatch:
    """Measuring limbs read as a run goes: once they are known from enough poses, every further one must agree with
    vision.
    """

    def __init__(self, design: Design) -> None:
        self._design, self._stated = (design, measuring_limb_identification_and_agreement.stated_limbs(design))
        self._home = measuring_limb_identification_and_agreement.hexapod_of_six_limbs(design).home
        self.channels = self._stated.channels
        self._read: list[tuple[Floats, RigidTransform, Floats]] = []
        self._limbs: redundant_limb_checks.Limbs | None = None
        self._agreed = True

    def take(self, lengths: Floats, T_base_platform: RigidTransform, covariance: Floats) -> bool:
        """Whether limbs that read lengths (limbs,) m newly disagree with vision's pose and its covariance (6, 6)."""
        if self._limbs is None:
            self._read.append((lengths, T_base_platform, covariance))
            if len(self._read) == measuring_limb_identification_and_agreement.FEWEST:
                n = np.arange(measuring_limb_identification_and_agreement.FEWEST)
                read, poses, covariances = zip(*self._read)
                T = RigidTransform.concatenate(poses)
                chosen = redundant_limb_checks.best_six_limbs(self._stated, self._home, T)
                samples = Samples(
                    n,
                    n.astype(float),
                    np.array(read)[:, chosen],
                    T,
                    np.array(covariances),
                    np.zeros((measuring_limb_identification_and_agreement.FEWEST, 6, 0)),
                )
                limbs, _ = measuring_limb_identification_and_agreement.calibrate_limbs(
                    samples,
                    measuring_limb_identification_and_agreement.hexapod_of_six_limbs(self._design, chosen),
                    self._stated.length_sigma,
                )
                self._limbs = replace(limbs, chosen=chosen)
            return False
        T = self._limbs.pose(lengths)
        own, common = self._limbs.uncertainty(T)
        before, self._agreed = (
            self._agreed,
            measuring_limb_identification_and_agreement.vision_agrees_with_limbs(
                T_base_platform, covariance, T, own, common
            ),
        )
        return before and not self._agreed
