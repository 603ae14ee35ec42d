"""A correction whose geometry is solved for anew, with cameras and lenses, from a recording's corners."""

from dataclasses import replace

import numpy as np

from calib.correct.correction import Correction
from calib.correct.interpolate.radial import Radial
from calib.identify.geometry import Identified
from calib.identify.with_cameras import commanded_state, solve
from calib.pipeline import Sampled
from rig.design import Design, Hexapod
from rig.errors import RigError


def refine(sampled: Sampled, design: Design, correction: Correction[Hexapod, Radial],
           found: Identified) -> tuple[Correction[Hexapod, Radial], Identified]:
    """(Correction, Identified) with geometry and covariance from the joint solve of a recording's corners.

    sampled : pipeline.Sampled; design : Design as stated; correction, found : as `calibrate` gives them
    Raises RigError for poses that no camera saw, or where struts scatter, so that a command does not give a frame's pose
    """
    if sampled.measurement is None:
        raise RigError(f"a joint solve takes corners or images; these poses came from {sampled.source}")
    if found.scatter.any():
        i = int(np.argmax(found.scatter))
        raise RigError(f"a joint solve takes struts that do as commanded; strut {i + 1} scatters by {found.scatter[i] * 1e6:.1f} um beyond the poses")
    corners, commanded, state = commanded_state(sampled.measurement, sampled.samples.take(found.inliers))
    done = solve(corners, commanded - correction.rho(commanded), state, design.cameras, correction.nominal, found.hexapod)
    return replace(correction, fitted=done.hexapod), replace(found, hexapod=done.hexapod, covariance=done.covariance, root=done.root)
