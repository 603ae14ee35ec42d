"""How sure a corrected pose is, of whichever machine; and by that, the workspace of a calibration."""

from dataclasses import replace

from scipy.spatial.transform import RigidTransform

from calib.certification.calibration import Calibration
from calib.models.machine_models import model_of
from calib.workspace.workspace_cells import map_workspace
from rig.arrays import Floats


def corrected_pose_covariance(calibration: Calibration, T_base_platform: RigidTransform, commands: Floats) -> Floats:
    """Covariance (n, 6, 6) (m, rad) of the corrected poses (n,) at commands (n, axes), docs/mathematics.md (21)."""
    return model_of(calibration.correction.nominal).pose_covariance(calibration, T_base_platform, commands)


def calibration_with_workspace(calibration: Calibration) -> Calibration:
    """Calibration with its workspace computed; a chain has none.

    Raises NotConverged where no configuration closes on a pose
    """
    if calibration.correction.nominal.bodies:
        return calibration
    return replace(
        calibration,
        workspace=map_workspace(
            calibration.correction, lambda T, commands: corrected_pose_covariance(calibration, T, commands)
        ),
    )
