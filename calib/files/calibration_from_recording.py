"""What was found of a recording, kept as a calibration: with where it came from and what it does to the workspace."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from calib.certify.calibration import Calibration
from calib.certify.platform_certification import Certified
from calib.certify.workspace_claim import Claim
from calib.correct.physics import Physics
from calib.files import calibration_file
from calib.models.arm.certification import Certified as ArmCertified
from calib.models.chain.certification import Certified as ChainCertified
from calib.models.corrected_pose_covariance import add_workspace
from calib.samples.confounded_conditions import confounds_of_samples
from calib.samples.recording_samples import Sampled
from rig.recording.recording_folder import Recording

SEED = 0  # of draws; results are the same from run to run


def calibration_with_provenance(
    recording: Recording,
    sampled: Sampled,
    done: Certified | ArmCertified | ChainCertified,
    claim: Claim,
    arguments: Sequence[str] = (),
    known: tuple[Physics, np.ndarray] | None = None,
    before: tuple[Calibration, dict[str, Any]] | None = None,
) -> Calibration:
    """Calibration of what was found, with where it came from and what it does to the workspace.

    arguments : of the command; known : (Physics, covariance of the parameters with it, m^2), or None; before : on which
        this is one more pass
    """
    frames, found = sampled.samples.frame, done.found
    covariance, scatter, together = found.covariance, found.scatter, None
    if isinstance(done, Certified) and done.covariance is not None and done.strut_covariance is not None:
        covariance, together = done.covariance, done.strut_covariance  # with all that these samples leave unknown
        scatter = np.sqrt(np.diag(together))
    physics, covariance = (None, covariance) if known is None else known
    source = calibration_file.calibration_provenance(
        recording, arguments, SEED, sampled.source == "images", sampled.files, sampled.data
    )
    if before is not None:
        source = calibration_file.pass_provenance(source, *before)
    return add_workspace(
        Calibration(
            done.correction,
            covariance,
            scatter,
            tuple(frames[found.inliers].tolist()),
            tuple(frames[~found.inliers].tolist()),
            done.held_out,
            source,
            claim,
            physics,
            confounds=confounds_of_samples(sampled.samples, recording.design.mechanism),
            strut_covariance=together,
        )
    )
