"""Conflict between the lengths of redundant struts, which causes internal forces.

Lengths that no pose closes hold the platform all the same: struts give way, and press and pull against each other. What
each gives way by, times its stiffness, is its internal force. It is determined where followers read how long they would
be without force. Source: Merlet, Parallel Robots, 2nd ed., ch. 9 (redundant actuation)
"""

from dataclasses import dataclass

import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Floats
from rig.formats.numbers_and_units import quantity_text
from rig.model.mechanisms import redundant_strut_best_six_legs_and_loop_closures
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism, is_redundant


@dataclass(frozen=True, slots=True)
class StrutConflict:
    """Lengths' contradiction, RMS over poses and struts, m: commanded by the nominal model (before) and corrected
    (after); unavoidable : what struts scatter by themselves, and no commands avoid.
    """

    before: float
    after: float
    unavoidable: float

    def line(self) -> str:
        """What it says of internal forces, in a sentence."""
        before, after, unavoidable = (quantity_text(one, "m") for one in (self.before, self.after, self.unavoidable))
        return (
            f"internal forces: all driven, each strut would give way by {before} RMS as the nominal model commands and "
            f"by {after} corrected, of which its own scatter may make {unavoidable}; times its stiffness, its force"
        )


def strut_conflict(calibration: Calibration, samples: Samples, recorded_mechanism: Mechanism) -> StrutConflict | None:
    """Conflict between the lengths of redundant struts (StrutConflict).

    At samples that were not used for the calibration.
    recorded_mechanism : that of their recording. None for six struts, and where it had no followers: then all lengths
    are commanded, and none is read
    """
    nominal, fitted = calibration.correction.nominal, calibration.correction.fitted
    if not (
        is_redundant(recorded_mechanism)
        and recorded_mechanism.followers
        and is_redundant(nominal)
        and is_redundant(fitted)
    ):
        return None
    T, count = samples.T_base_platform, len(nominal.axes)
    corrected = samples.effective - calibration.correction.rho(samples.effective)
    return StrutConflict(
        _size(
            redundant_strut_best_six_legs_and_loop_closures.incompatible_strut_length_component(
                T, samples.commanded, nominal
            )
        ),
        _size(
            redundant_strut_best_six_legs_and_loop_closures.incompatible_strut_length_component(T, corrected, fitted)
        ),
        _size(calibration.scatter) * float(np.sqrt((count - 6) / count)),
    )


def _size(lengths: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(lengths))))
