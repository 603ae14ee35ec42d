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


def pose_covariance(calibration: Calibration, T_base_platform: RigidTransform, commands: np.ndarray) -> np.ndarray:
    """(n, 6, 6) covariance (m, rad) of the poses (n,) that commands (n, axes) m or rad give, docs/mathematics.md
    (21).
    """
    if isinstance(calibration.correction.nominal, Arm):
        return arms.model_covariance(calibration, commands)
    if isinstance(calibration.correction.nominal, Chain):
        return chains.model_covariance(calibration, commands)
    return platform_certification.model_covariance(calibration, T_base_platform)


def add_workspace(calibration: Calibration) -> Calibration:
    """The Calibration with its workspace worked out; a chain reaches most poses in many ways, and has none.

    Raises NotConverged where no configuration closes on a pose
    """
    if isinstance(calibration.correction.nominal, Chain):
        return calibration
    return replace(
        calibration,
        workspace=map_workspace(calibration.correction, lambda T, commands: pose_covariance(calibration, T, commands)),
    )
