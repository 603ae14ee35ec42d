"""Move of the machine to one pose through a calibration.

How near it comes is reported (rig go).
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.api.correct import rms_and_greatest_uncertainty
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.correction import require_reachable
from calib.models.wanted_pose_commands import commands_along_route
from rig.array_and_json_types import Floats, Json
from rig.driving.controller_status_and_limits import ControllerStatus
from rig.driving.strut_driver import Driver
from rig.errors import RigError
from rig.model import mechanisms
from rig.model.design import Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_hexapod
from rig.model.pose import pose_to_vector


@dataclass(frozen=True, slots=True, eq=False)
class PoseMove:
    """A move to a pose. design; calibration; wanted : T_base_platform; lengths : (axes,) m to command; uncorrected :
    whether these are by the nominal model; status : once it has been made, else None; covariance : (6, 6) m and rad, on
    the right, of the pose that the lengths give, None where they are not corrected
    """

    design: Design
    calibration: Calibration
    wanted: RigidTransform
    lengths: Floats
    uncorrected: bool = False
    status: ControllerStatus | None = None
    covariance: Floats | None = None

    @property
    def off_nominal(self) -> Floats:
        """(axes,) m by which the lengths differ from the nominal model's."""
        return self.lengths - self.calibration.correction.uncorrected(self.wanted)

    @property
    def remainder(self) -> RigidTransform | None:
        """T_wanted_reached by the calibration, None before the move and where it is not corrected."""
        if self.status is None or self.uncorrected:
            return None
        correction = self.calibration.correction
        commanded = correction.inverse_without_physics(self.wanted) + self.status.lengths - self.lengths
        return self.wanted.inv() * correction.predict(commanded)

    @property
    def uncertainty(self) -> tuple[float, float] | None:
        """Standard uncertainty (m, rad) of the pose by the calibration, over all three directions; None uncorrected."""
        return None if self.covariance is None else rms_and_greatest_uncertainty(self.covariance[None])[0]

    @property
    def within(self) -> tuple[float, float] | None:
        """(m, rad) within which the platform is of the wanted pose, k=2: what the struts left of the way, and the
        calibration's own uncertainty; None before the move and uncorrected.
        """
        left, own = self.remainder, self.uncertainty
        if left is None or own is None:
            return None
        sizes = float(np.linalg.norm(left.translation)), float(left.rotation.magnitude())
        return float(np.hypot(sizes[0], 2 * own[0])), float(np.hypot(sizes[1], 2 * own[1]))

    def __str__(self) -> str:
        return f"{'to command' if self.status is None else 'commanded'}: {self.lengths * 1e3} mm"

    def tree(self) -> Json:
        """What `rig go --json` prints."""
        tree: Json = {
            "schema": "gone/1",
            "commanded": self.lengths.tolist(),
            "off_owners_model": self.off_nominal.tolist(),
            "moved": self.status is not None,
        }
        if self.status is not None:
            tree["lengths"] = self.status.lengths.tolist()
        if self.uncertainty is not None:
            tree["uncertainty"] = list(self.uncertainty)
        if self.remainder is not None and self.within is not None:
            tree |= {"left": pose_to_vector(self.remainder).tolist(), "within": list(self.within)}
        return tree

    def carry_out(self, driver: Driver, speed: float = 1.0) -> "PoseMove":
        """The same once made: from where the struts stand, not from home. speed : share of the greatest

        Raises Unreachable for lengths out of range, MotionError where the struts do not arrive
        """
        lengths, covariance = self.lengths, self.covariance
        if self.calibration.physics is not None and not self.uncorrected:
            lengths, covariance = _lengths(self.calibration, self.wanted, driver.status().lengths)
            require_reachable(lengths[None], require_hexapod(self.design.mechanism), ["the pose"])
        driver.move(lengths, speed)
        return replace(self, lengths=lengths, covariance=covariance, status=driver.status())


def plan_pose_move(
    design: Design, calibration: Calibration, wanted: RigidTransform, uncorrected: bool = False
) -> PoseMove:
    """PoseMove to a wanted pose T_base_platform (), checked.

    What nobody logs is taken as when calibrated.
    Raises Unreachable for lengths out of range
    """
    correction = calibration.correction
    home = mechanisms.kinematics_of(correction.nominal).home_values(correction.nominal)
    if uncorrected:
        lengths, covariance = correction.uncorrected(wanted), None
    else:
        lengths, covariance = _lengths(calibration, wanted, home)
    require_reachable(np.array([lengths]), require_hexapod(design.mechanism), ["the pose"])
    return PoseMove(design, calibration, wanted, lengths, uncorrected, covariance=covariance)


def require_same_rig(design: Design, calibration: Calibration, design_path: Path, calibration_path: Path) -> None:
    """Raise RigError where a calibration is of another rig than a design.

    The paths are for the message.
    """
    nominal, mechanism = calibration.correction.nominal, require_hexapod(design.mechanism)
    names = [name for name in mechanism.geometry_arrays if name != "strut_zeros"]
    if nominal.kind != mechanism.kind or not all(
        np.allclose(getattr(nominal, name), getattr(mechanism, name), rtol=0, atol=1e-6) for name in names
    ):
        raise RigError(
            f"{calibration_path} is a calibration of another rig than {design_path}: their stated joints differ"
        )


def _lengths(calibration: Calibration, wanted: RigidTransform, start: Floats) -> tuple[Floats, Floats | None]:
    """((axes,) m that give a wanted pose (), (6, 6) covariance of the pose), the axes coming from start (axes,)."""
    T = RigidTransform.from_matrix(wanted.as_matrix()[None])
    found = commands_along_route(calibration, T, np.asarray(start, float))
    return found.values[0], None if found.covariance is None else found.covariance[0]
