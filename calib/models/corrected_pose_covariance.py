"""How sure a corrected pose is, of whichever machine; and by that, the workspace of a calibration."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certify import platform_certification
from calib.certify.calibration import Calibration
from calib.models.arm import certification as arms
from calib.models.chain import certification as chains
from calib.workspace.workspace_cells import map_workspace
from rig.model.design import Arm, Chain


def corrected_pose_covariance(
    calibration: Calibration, T_base_platform: RigidTransform, commands: np.ndarray
) -> np.ndarray:
    """Covariance (n, 6, 6) (m, rad) of the corrected poses (n,) at commands (n, axes), docs/mathematics.md (21)."""
    if isinstance(calibration.correction.nominal, Arm):
        return arms.arm_pose_covariance(calibration, commands)
    if isinstance(calibration.correction.nominal, Chain):
        return chains.chain_pose_covariance(calibration, commands)
    return platform_certification.platform_pose_covariance(calibration, T_base_platform)


def calibration_with_workspace(calibration: Calibration) -> Calibration:
    """Calibration with its workspace computed; a chain has none.

    Raises NotConverged where no configuration closes on a pose
    """
    if isinstance(calibration.correction.nominal, Chain):
        return calibration
    return replace(
        calibration,
        workspace=map_workspace(
            calibration.correction, lambda T, commands: corrected_pose_covariance(calibration, T, commands)
        ),
    )
