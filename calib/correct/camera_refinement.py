"""A correction whose geometry is solved for anew, with cameras and lenses, from a recording's corners."""

from dataclasses import replace

import numpy as np

from calib.correct.correction import Correction
from calib.correct.interpolation.gaussian_process import Radial
from calib.models.platform.identification import Identified
from calib.models.platform.joint_camera_fit import commanded_state, fit_cameras_and_geometry
from calib.samples.recording_samples import Sampled
from rig.errors import RigError
from rig.model.design import Design
from rig.model.mechanism_kinds import Struts, hexapod_of


def refine_with_cameras(
    sampled: Sampled, design: Design, correction: Correction[Struts, Radial], found: Identified
) -> tuple[Correction[Struts, Radial], Identified]:
    """(Correction, Identified) with geometry and covariance from the joint solve of a recording's corners.

    sampled : pipeline.Sampled; design : Design as stated; correction, found : as `calibrate` gives them
    Raises RigError for a machine that is no hexapod, for poses that no camera saw, or where struts
    scatter, so that a command does not give a frame's pose
    """
    if sampled.measurement is None:
        raise RigError(f"a joint solve takes corners or images; these poses came from {sampled.source}")
    if found.scatter.any():
        i = int(np.argmax(found.scatter))
        raise RigError(
            f"a joint solve takes struts that do as commanded; strut {i + 1} scatters by "
            f"{found.scatter[i] * 1e6:.1f} um beyond the poses"
        )
    corners, commanded, state = commanded_state(sampled.measurement, sampled.samples.take(found.inliers))
    done = fit_cameras_and_geometry(
        corners,
        commanded - correction.rho(commanded),
        state,
        design.cameras,
        hexapod_of(correction.nominal),
        hexapod_of(found.mechanism),
    )
    return replace(correction, fitted=done.mechanism), replace(
        found, mechanism=done.mechanism, covariance=done.covariance, root=done.root
    )
